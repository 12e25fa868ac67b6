"""Controls: named animator values and their drives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from graphlib import CycleError, TopologicalSorter

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import circle
from animtool.core.record import dataclass
from animtool.rig.drivers import SLIDE, Driver, curve_values
from animtool.rig.expressions import Expression


@dataclass(frozen=True, slots=True)
class Drive:
    """A control's contribution to one target."""

    # ``shape/NAME``, ``control/NAME`` or ``joint/NAME.PART``, PART being ``angle``,
    # ``slide``, ``rotation.x|y|z`` (of a rotation vector) or ``translation.x|y|z``.
    target: str
    # Of control names; None where there is a curve.
    expression: Expression | None = None
    # Points (control value, target value), ascending, joined as `curve_values` says.
    curve: tuple[tuple[float, float], ...] = ()
    # What a value of 1 means: radians or metres of the file's unit, or 1.
    unit: float = 1.0
    smooth: bool = False  # whether a cubic joins the points, and not straight lines

    @property
    def of_length(self) -> bool:
        """Whether its target is a length."""
        kind, _, name = self.target.partition("/")
        slides = name.endswith(f".{SLIDE}")
        return kind == "joint" and (slides or ".translation." in name)

    @property
    def of_angle(self) -> bool:
        """Whether its target is an angle."""
        return self.target.startswith("joint/") and not self.of_length

    def evaluate(self, control: str, values: Mapping[str, FloatArray]) -> FloatArray:
        """Return its contribution, from the values of all controls."""
        if self.expression is not None:
            return self.expression.evaluate(values) * self.unit
        return curve_values(self.curve, values[control], smooth=self.smooth) * self.unit


@dataclass(frozen=True, slots=True)
class Control:
    """A named value."""

    name: str  # A Python identifier, as expressions name it
    low: float | None = None  # least value that is meant; None is no limit
    high: float | None = None  # largest value that is meant
    default: float = 0.0  # its value where nothing sets it
    drives: tuple[Drive, ...] = ()  # what it moves
    driven: Driver | None = None  # what its value is, in place of keys


class ControlCycleError(ValueError):
    """Controls drive each other in a cycle.

    Attributes:
        cycle: Their names, the first one again at the end.
    """

    def __init__(self, cycle: list[str]) -> None:
        self.cycle = cycle
        super().__init__(circle(cycle))


def evaluation_order(controls: Sequence[Control]) -> list[str]:
    """Return the control names in dependency order.

    A control depends on those that drive it, and on all that their expressions read.
    """
    needs: dict[str, dict[str, None]] = {control.name: {} for control in controls}
    for control in controls:
        for drive in control.drives:
            kind, _, name = drive.target.partition("/")
            if kind == "control" and name in needs:
                needs[name] |= dict.fromkeys(_reads(control.name, drive))
    try:
        return list(TopologicalSorter(needs).static_order())
    except CycleError as error:
        raise ControlCycleError(list(error.args[1])) from error


def _reads(control: str, drive: Drive) -> tuple[str, ...]:
    return (control,) if drive.expression is None else drive.expression.names


@dataclass(frozen=True, slots=True)
class DrivenValues:
    """Values of controls and their contributions to targets."""

    # Value of every control, ``(F,)`` or ``(1,)`` where it never moves.
    controls: dict[str, FloatArray]
    # What is added to each joint part or shape, by target.
    targets: dict[str, FloatArray]
    # What each control came to before it was brought into its range.
    reached: dict[str, FloatArray]


def evaluate_controls(
    controls: Sequence[Control],
    keyed: Mapping[str, FloatArray],
    *,
    clamp: bool = False,
) -> DrivenValues:
    """Evaluate controls and their contributions to joints and shapes.

    A control is its keyed value ``(F,)``, else its default, and what others add to it;
    with ``clamp`` brought into its range before it drives others. What several add to
    one target is summed, in the rig's order. Values that are not finite are left as
    they are: the caller looks.
    """
    values = {
        control.name: np.asarray(keyed.get(control.name, [control.default]), np.float64)
        for control in controls
    }
    by_name = {control.name: control for control in controls}
    into: dict[str, list[tuple[str, Drive]]] = {}
    for control in controls:
        for drive in control.drives:
            into.setdefault(drive.target, []).append((control.name, drive))
    reached: dict[str, FloatArray] = {}
    for name in evaluation_order(controls):
        for driver, drive in into.pop(f"control/{name}", ()):
            values[name] = values[name] + drive.evaluate(driver, values)
        reached[name] = values[name]
        low, high = by_name[name].low, by_name[name].high
        if clamp and low is not None and high is not None:
            values[name] = np.clip(values[name], low, high)
    targets: dict[str, FloatArray] = {}
    for target, drives in into.items():
        total = np.zeros(1)
        for driver, drive in drives:
            total = total + drive.evaluate(driver, values)
        targets[target] = total
    return DrivenValues({name: values[name] for name in by_name}, targets, reached)

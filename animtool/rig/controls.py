"""Controls: named animator values and their drives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault
from animtool.core.record import dataclass
from animtool.rig.drivers import SLIDE, Driver, curve_values
from animtool.rig.expressions import Expression
from animtool.rig.parts import dependency_order


@dataclass(frozen=True, slots=True)
class Drive:
    """The contribution of a control to one joint coordinate, shape or control."""

    # ``shape/NAME``, ``control/NAME`` or ``joint/NAME.PART``, PART being ``angle``,
    # ``slide``, ``rotation.x|y|z`` (of a rotation vector) or ``translation.x|y|z``.
    target: str
    # Expression over control names; None if there is a curve.
    expression: Expression | None = None
    # Points (control value, target value), ascending, joined as in `curve_values`.
    curve: tuple[tuple[float, float], ...] = ()
    # Size of a value of 1: radians or metres per unit of the file, or 1.
    unit: float = 1.0
    # Whether a cubic joins the points, instead of straight lines.
    is_smooth: bool = False

    @property
    def is_length(self) -> bool:
        """Whether the target is a joint's slide or translation [m]."""
        kind, _, name = self.target.partition("/")
        is_slide = name.endswith(f".{SLIDE}")
        return kind == "joint" and (is_slide or ".translation." in name)

    @property
    def is_angle(self) -> bool:
        """Whether the target is a joint's angle or rotation [rad]."""
        return self.target.startswith("joint/") and not self.is_length

    def controls_read(self, control: str) -> tuple[str, ...]:
        """Return the names of the controls that this drive of a control reads."""
        return (control,) if self.expression is None else self.expression.names

    def evaluate(self, control: str, values: Mapping[str, FloatArray]) -> FloatArray:
        """Return the drive's contribution ``(F,)`` for the values of all controls."""
        if self.expression is not None:
            return self.expression.evaluate(values) * self.unit
        value = curve_values(self.curve, values[control], is_smooth=self.is_smooth)
        return value * self.unit


@dataclass(frozen=True, slots=True)
class Control:
    """A named animation control with a range, a default value and drives."""

    name: str  # a Python identifier, as used in expressions
    low: float | None = None  # lower end of the intended range; None for no limit
    high: float | None = None  # upper end of the intended range
    default: float = 0.0  # value without keys and drives
    drives: tuple[Drive, ...] = ()  # drives of the control's targets
    driven: Driver | None = None  # driver of the control's value, instead of keys


def evaluation_order(controls: Sequence[Control]) -> list[str]:
    """Return the control names in dependency order.

    A control depends on the controls that drive it, and on all controls that their
    expressions read.
    """
    dependencies_by_control: dict[str, dict[str, None]] = {
        control.name: {} for control in controls
    }
    for control in controls:
        for drive in control.drives:
            kind, _, name = drive.target.partition("/")
            if kind == "control" and name in dependencies_by_control:
                dependencies_by_control[name] |= dict.fromkeys(
                    drive.controls_read(control.name)
                )
    return dependency_order(dependencies_by_control)


@dataclass(frozen=True, slots=True)
class ControlEffects:
    """Values of controls and their contributions to targets."""

    # Value of every control, ``(F,)``, or ``(1,)`` if constant.
    controls: dict[str, FloatArray]
    # Contribution to each joint part or shape, by target.
    targets: dict[str, FloatArray]
    # Value of each control before clamping to its range.
    unclamped_controls: dict[str, FloatArray]


def undefined_faults(
    values_by_name: Mapping[str, FloatArray], times: FloatArray
) -> list[Fault]:
    """Return a fault for each name whose values ``(F,)`` or ``(1,)`` are not finite."""
    faults = []
    for name, values in values_by_name.items():
        undefined_frames = np.flatnonzero(~np.isfinite(values))
        if undefined_frames.size and len(times):
            frame = times[undefined_frames[0] if len(values) > 1 else 0]
            message = f"{name} has no value at frame {frame:g}"
            hint = "an expression divides by zero or overflows"
            faults.append(Fault("CLIP015", message, None, (), hint))
    return faults


def evaluate_controls(
    controls: Sequence[Control],
    keyed_values: Mapping[str, FloatArray],
    *,
    clamp: bool = False,
) -> ControlEffects:
    """Evaluate controls and their contributions to joints and shapes.

    A control is its keyed value ``(F,)``, else its default, plus what others add to it;
    with ``clamp``, it is clamped to its range before it drives others. Contributions to
    one target are summed in the rig's order. Values that are not finite are kept; the
    caller has to check.
    """
    values_by_control = {
        control.name: np.asarray(
            keyed_values.get(control.name, [control.default]), np.float64
        )
        for control in controls
    }
    controls_by_name = {control.name: control for control in controls}
    drives_by_target: dict[str, list[tuple[str, Drive]]] = {}
    for control in controls:
        for drive in control.drives:
            drives_by_target.setdefault(drive.target, []).append((control.name, drive))
    unclamped_by_control: dict[str, FloatArray] = {}
    for name in evaluation_order(controls):
        for driving_name, drive in drives_by_target.pop(f"control/{name}", ()):
            values_by_control[name] = values_by_control[name] + drive.evaluate(
                driving_name, values_by_control
            )
        unclamped_by_control[name] = values_by_control[name]
        range_low, range_high = controls_by_name[name].low, controls_by_name[name].high
        if clamp and range_low is not None and range_high is not None:
            values_by_control[name] = np.clip(
                values_by_control[name], range_low, range_high
            )
    contributions_by_target: dict[str, FloatArray] = {}
    for target, drives in drives_by_target.items():
        contribution = np.zeros(1)
        for driving_name, drive in drives:
            contribution = contribution + drive.evaluate(
                driving_name, values_by_control
            )
        contributions_by_target[target] = contribution
    return ControlEffects(
        {name: values_by_control[name] for name in controls_by_name},
        contributions_by_target,
        unclamped_by_control,
    )

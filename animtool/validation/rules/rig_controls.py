"""Rules on controls: what they drive over their ranges, and how far."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault
from animtool.core.record import dataclass
from animtool.documents.document import Location
from animtool.maths import so3
from animtool.rig.controls import Control, DrivenValues, evaluate_controls
from animtool.rig.driver_plan import plan_of
from animtool.rig.limits import BallLimit, RangeLimit
from animtool.rig.parts import Shape
from animtool.rig.shapes import combination_order
from animtool.rig.skeleton import Joint
from animtool.validation.rules.rig_joints import shown
from animtool.validation.subjects.rig import RigSubject

# Sampled values of each control, besides the points of its curves.
SAMPLES = 17
# Poses of all controls at once, in which a corrective must act in some.
POSES = 2048
# Share of the poses in which a control is at an end of its range.
AT_ENDS = 0.8
# Tolerance for degrees rounded in a file [rad], [m]; of a range [1].
SLACK = 1e-6
_NONE: FloatArray = np.zeros(1)


@dataclass(frozen=True, slots=True)
class _Sweep:
    """Every control swept over its range, one after the other."""

    moved: list[Control]  # which control moves in each frame ``(F,)``
    keyed: dict[str, FloatArray]  # values of all of them ``(F,)``
    driven: DrivenValues  # what they come to

    def spread(self, values: FloatArray) -> FloatArray:
        """Return a value for each frame ``(F,)``."""
        return np.broadcast_to(values, len(self.moved))

    def keys(self, frame: int) -> str:
        """Return the control values of a frame."""
        name = self.moved[frame].name
        return f"{name!r} at {float(self.keyed[name][frame]):g}"

    def worst(self, excess: FloatArray) -> Iterator[tuple[Control, int]]:
        """Yield controls that exceed something, and the worst frame."""
        # What is not finite is a fault of the expression (RIG207).
        wide = self.spread(np.where(np.isfinite(excess), np.abs(excess), 0.0))
        worst: dict[str, int] = {}
        for frame in np.flatnonzero(wide > SLACK).tolist():
            name = self.moved[frame].name
            best = worst.get(name)
            if best is None or wide[frame] > wide[best]:
                worst[name] = frame
        for frame in worst.values():
            yield self.moved[frame], frame


def beyond_limits(rig: RigSubject) -> Iterator[Fault]:
    """Yield controls that drive a joint beyond its limits (RIG204)."""
    sweep = _sweep(rig)
    for joint in rig.rig.joints:
        excess = _excess(joint, sweep.driven.targets)
        for control, frame in sweep.worst(excess):
            excess_text = shown(rig, joint, abs(float(sweep.spread(excess)[frame])))
            message = (
                f"{sweep.keys(frame)} drives {joint.name!r} {excess_text} beyond its "
            )
            message += "limits"
            at = _drive(rig, control, f"joint/{joint.name}.")
            hint = "widen the limits, or reduce the drive"
            yield rig.fault("RIG204", at, message, hint)


def beyond_range(rig: RigSubject) -> Iterator[Fault]:
    """Yield controls that drive another beyond its range (RIG206)."""
    sweep = _sweep(rig)
    for control in rig.rig.controls:
        if control.low is None or control.high is None:
            continue
        reached = sweep.driven.unclamped[control.name]
        width = max(control.high - control.low, SLACK)
        excess = (reached - np.clip(reached, control.low, control.high)) / width
        for by, frame in sweep.worst(excess):
            message = (
                f"{sweep.keys(frame)} drives {control.name!r} to "
                f"{float(sweep.spread(reached)[frame]):.4g}; its range is "
                f"{control.low:g} to {control.high:g}"
            )
            at = _drive(rig, by, f"control/{control.name}")
            hint = "use clamp(…) in the expression, or a wider range"
            yield rig.fault("RIG206", at, message, hint)


def undefined(rig: RigSubject) -> Iterator[Fault]:
    """Yield drives without a value somewhere in a control's range (RIG207)."""
    sweep = _sweep(rig)
    values = sweep.driven.controls
    for control in rig.rig.controls:
        for k, drive in enumerate(control.drives):
            with np.errstate(all="ignore"):
                added = drive.evaluate(control.name, values)
            read = (
                (control.name,) if drive.expression is None else drive.expression.names
            )
            # A value that comes from another drive without one is its fault.
            inputs_finite = np.all(
                [sweep.spread(np.isfinite(values[n])) for n in read], axis=0
            )
            wrong = sweep.spread(~np.isfinite(added)) & inputs_finite
            if not wrong.any():
                continue
            by_moved = wrong & [moved.name in read for moved in sweep.moved]
            frame = int((by_moved if by_moved.any() else wrong).argmax())
            by = sweep.moved[frame]
            value = float(sweep.keyed[by.name][frame])
            text = drive.expression.text if drive.expression else ""
            message = f"{text!r} is undefined where {by.name!r} is {value:g}"
            hint = "avoid division by 0; log and sqrt need more than 0"
            at = (*rig.at("controls", control.name), "drives", k)
            yield rig.fault("RIG207", at, message, hint)


def never_acts(rig: RigSubject) -> Iterator[Fault]:
    """Yield correctives that no control pose activates (RIG208)."""
    # What coordinates of joints drive moves without controls.
    moved = set(plan_of(rig.rig).shapes) if rig.rig.is_driven else set()
    combined = [
        shape
        for shape in rig.rig.shapes
        if shape.combine and not moved.intersection(shape.combine)
    ]
    driven = {
        drive.target.removeprefix("shape/")
        for control in rig.rig.controls
        for drive in control.drives
        if drive.target.startswith("shape/")
    }
    if not combined or not driven:
        return
    weights = _weights(rig, driven)
    for shape in combined:
        undriven = [name for name in shape.combine if name not in weights]
        at = (*rig.at("shapes", shape.name), "combine")
        if undriven:
            message = (
                f"no control drives {undriven[0]!r}, which {shape.name!r} combines"
            )
            yield rig.fault("RIG208", at, message, "drive it, or remove the shape")
        elif not _product(shape, weights).any():
            message = f"{shape.name!r} is 0 in every pose of the controls"
            hint = f"{' and '.join(shape.combine)} are never both above 0"
            yield rig.fault("RIG208", at, message, hint)


def idle(rig: RigSubject) -> Iterator[Fault]:
    """Yield controls that drive nothing and that no expression reads (RIG220)."""
    read = {
        name
        for control in rig.rig.controls
        for drive in control.drives
        if drive.expression is not None
        for name in drive.expression.names
    }
    read |= {
        name
        for driver in (
            *(joint.driven for joint in rig.rig.joints),
            *(shape.driven for shape in rig.rig.shapes),
            *(control.driven for control in rig.rig.controls),
        )
        if driver is not None
        for name in driver.names
    }
    for control in rig.rig.controls:
        if not control.drives and control.name not in read:
            message = f"{control.name!r} drives nothing, and nothing reads it"
            at = rig.at("controls", control.name)
            yield rig.fault("RIG220", at, message, "add drives, or remove it")


@lru_cache(maxsize=1)
def _sweep(rig: RigSubject) -> _Sweep:
    """Return a sweep of each control with the others at their defaults."""
    controls = rig.rig.controls
    ranges = {control.name: _values(control) for control in controls}
    count = sum(map(len, ranges.values()))
    keyed: dict[str, FloatArray] = {}
    moved: list[Control] = []
    for control in controls:
        values = np.full(count, control.default)
        samples = ranges[control.name]
        values[len(moved) : len(moved) + len(samples)] = samples
        moved += [control] * len(samples)
        keyed[control.name] = values
    with np.errstate(all="ignore"):
        driven = evaluate_controls(controls, keyed)
    return _Sweep(moved, keyed, driven)


def _values(control: Control) -> FloatArray:
    if control.low is None or control.high is None:
        return np.zeros(0)
    corners = [x for drive in control.drives for x, _ in drive.curve]
    spread = np.linspace(control.low, control.high, SAMPLES)
    values = np.concatenate([spread, np.array(corners, np.float64)])
    # `numpy.unique` would import numpy.ma.
    return np.array(sorted(set(np.clip(values, control.low, control.high).tolist())))


def _excess(joint: Joint, targets: dict[str, FloatArray]) -> FloatArray:
    """Return how far controls drive a joint beyond its limits ``(F,)`` or ``(1,)``."""
    if isinstance(joint.limits, RangeLimit):
        part = "slide" if joint.type == "prismatic" else "angle"
        value = targets.get(f"joint/{joint.name}.{part}")
        return _NONE if value is None else joint.limits.excess(value)
    if isinstance(joint.limits, BallLimit):
        names = [f"joint/{joint.name}.rotation.{axis}" for axis in "xyz"]
        parts = [targets.get(name, _NONE) for name in names]
        if not any(name in targets for name in names) or _well_within(
            joint.limits, parts
        ):
            return _NONE
        rotation = so3.exp(np.stack(np.broadcast_arrays(*parts), axis=-1))
        finite = np.isfinite(rotation).all(axis=-1, keepdims=True)
        return joint.limits.excess(np.where(finite, rotation, so3.IDENTITY))
    return _NONE


def _well_within(limits: BallLimit, parts: list[FloatArray]) -> bool:
    """Return whether rotations are too small to exceed swing and twist limits.

    Neither is larger than the turn itself. Most are, and the whole way is slow.
    """
    most = float(np.sqrt(sum(np.abs(part).max() ** 2 for part in parts)))
    low, high = limits.twist or (-np.inf, np.inf)
    return most <= min(*(limits.swing or (np.inf, np.inf)), -low, high)


def _drive(rig: RigSubject, control: Control, target: str) -> Location:
    """Return the drive of a control that affects a target, or the control."""
    at = rig.at("controls", control.name)
    for k, drive in enumerate(control.drives):
        if f"{drive.target}.".startswith(target):
            return (*at, "drives", k)
    return at


def _weights(rig: RigSubject, driven: set[str]) -> dict[str, FloatArray]:
    """Return weights of driven and combined shapes, in poses of all controls."""
    rng = np.random.default_rng(0)
    keyed = {}
    for control in rig.rig.controls:
        low = -1.0 if control.low is None else control.low
        high = 1.0 if control.high is None else control.high
        ends = np.where(rng.random(POSES) < 0.5, low, high)
        inner = rng.uniform(low, high, POSES)
        keyed[control.name] = np.where(rng.random(POSES) < AT_ENDS, ends, inner)
    with np.errstate(all="ignore"):
        targets = evaluate_controls(rig.rig.controls, keyed).targets
    weights = {name: targets[f"shape/{name}"] for name in sorted(driven)}
    for shape in combination_order(rig.rig.shapes):
        if shape.combine and all(name in weights for name in shape.combine):
            weight = weights.get(shape.name, np.zeros(1))
            weights[shape.name] = weight + _product(shape, weights)
    return weights


def _product(shape: Shape, weights: dict[str, FloatArray]) -> FloatArray:
    product = np.ones(1)
    for name in shape.combine:
        product = product * weights[name]
    return product

"""Rules on controls and drivers: their effects over the ranges of their inputs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault
from animtool.core.record import dataclass
from animtool.documents.document import Location
from animtool.maths import so3
from animtool.rig.controls import Control, ControlEffects, evaluate_controls
from animtool.rig.driver_plan import plan_of
from animtool.rig.drivers import SLIDE, SWING, TWIST, Driver, split_coordinate
from animtool.rig.limits import BallLimit, RangeLimit
from animtool.rig.parts import Shape
from animtool.rig.shapes import combination_order
from animtool.rig.skeleton import Joint, Rig
from animtool.validation.rules.rig_joints import LIMIT_TOLERANCE, range_text, value_text
from animtool.validation.subjects.rig import RigSubject

# Sampled values of each control, in addition to the points of its curves.
SWEEP_SAMPLES = 17
# Number of sampled poses of all controls, some of which must activate a corrective.
POSE_SAMPLES = 2048
# Probability that a control is at an end of its range in a sampled pose.
RANGE_END_PROBABILITY = 0.8
_ZERO: FloatArray = np.zeros(1)


@dataclass(frozen=True, slots=True)
class _ControlSweep:
    """Samples of a rig in which one control after another covers its range."""

    moving_controls: list[Control]  # the moving control of each frame ``(F,)``
    control_values: dict[str, FloatArray]  # values of all controls ``(F,)``
    driven_values: ControlEffects  # resulting values

    def broadcast(self, values: FloatArray) -> FloatArray:
        """Repeat values ``(1,)`` for all frames of the sweep; ``(F,)`` stay as is."""
        return np.broadcast_to(values, len(self.moving_controls))

    def frame_text(self, frame: int) -> str:
        """Return the name and value of the control that moves in a frame."""
        name = self.moving_controls[frame].name
        return f"{name!r} at {float(self.control_values[name][frame]):g}"

    def worst_frames(self, excess: FloatArray) -> Iterator[tuple[Control, int]]:
        """Yield each control that exceeds a limit, and the frame with most excess."""
        # Values that are not finite are a fault of the expression (RIG207).
        absolute_excess = self.broadcast(
            np.where(np.isfinite(excess), np.abs(excess), 0.0)
        )
        worst_frames: dict[str, int] = {}
        for frame in np.flatnonzero(absolute_excess > LIMIT_TOLERANCE).tolist():
            name = self.moving_controls[frame].name
            worst_frame = worst_frames.setdefault(name, frame)
            if absolute_excess[frame] > absolute_excess[worst_frame]:
                worst_frames[name] = frame
        for frame in worst_frames.values():
            yield self.moving_controls[frame], frame


def controls_beyond_limits(rig: RigSubject) -> Iterator[Fault]:
    """Report controls that drive a joint beyond its limits (RIG204)."""
    sweep = _sweep_controls(rig)
    for joint in rig.rig.joints:
        excess = _limit_excess(joint, sweep.driven_values.targets)
        for control, frame in sweep.worst_frames(excess):
            largest_excess = abs(float(sweep.broadcast(excess)[frame]))
            excess_text = value_text(rig, joint, largest_excess)
            message = (
                f"{sweep.frame_text(frame)} drives {joint.name!r} {excess_text} "
                "beyond its limits"
            )
            location = _affecting_drive(rig, control, f"joint/{joint.name}.")
            hint = "widen the limits, or reduce the drive"
            yield rig.fault("RIG204", location, message, hint)


def controls_beyond_range(rig: RigSubject) -> Iterator[Fault]:
    """Report controls that drive another control beyond its range (RIG206)."""
    sweep = _sweep_controls(rig)
    for control in rig.rig.controls:
        if control.low is None or control.high is None:
            continue
        values = sweep.driven_values.unclamped_controls[control.name]
        range_width = max(control.high - control.low, LIMIT_TOLERANCE)
        excess = (values - np.clip(values, control.low, control.high)) / range_width
        for driving_control, frame in sweep.worst_frames(excess):
            message = (
                f"{sweep.frame_text(frame)} drives {control.name!r} to "
                f"{float(sweep.broadcast(values)[frame]):.4g}; its range is "
                f"{control.low:g} to {control.high:g}"
            )
            location = _affecting_drive(rig, driving_control, f"control/{control.name}")
            hint = "use clamp(…) in the expression, or a wider range"
            yield rig.fault("RIG206", location, message, hint)


def undefined_drives(rig: RigSubject) -> Iterator[Fault]:
    """Report drives that are undefined at a value in their control's range (RIG207)."""
    sweep = _sweep_controls(rig)
    values = sweep.driven_values.controls
    for control in rig.rig.controls:
        for drive_index, drive in enumerate(control.drives):
            with np.errstate(all="ignore"):
                drive_values = drive.evaluate(control.name, values)
            input_names: Sequence[str] = (control.name,)
            if drive.expression is not None:
                input_names = drive.expression.names
            # If another drive's value is undefined, that drive is at fault.
            is_undefined = ~np.isfinite(drive_values)
            for input_name in input_names:
                is_undefined = is_undefined & np.isfinite(values[input_name])
            if not is_undefined.any():
                continue
            is_input_moving = [c.name in input_names for c in sweep.moving_controls]
            if (is_undefined & is_input_moving).any():
                is_undefined = is_undefined & is_input_moving
            frame = int(sweep.broadcast(is_undefined).argmax())
            name = sweep.moving_controls[frame].name
            value = float(sweep.control_values[name][frame])
            expression_text = drive.expression.text if drive.expression else ""
            message = f"{expression_text!r} is undefined where {name!r} is {value:g}"
            hint = "avoid division by 0; log and sqrt need more than 0"
            location = (*rig.at("controls", control.name), "drives", drive_index)
            yield rig.fault("RIG207", location, message, hint)


def inactive_correctives(rig: RigSubject) -> Iterator[Fault]:
    """Report correctives that no control pose activates (RIG208)."""
    # Shapes driven by joint coordinates move without controls.
    joint_driven_shapes = set(plan_of(rig.rig).shapes) if rig.rig.is_driven else set()
    correctives = [
        shape
        for shape in rig.rig.shapes
        if shape.combine and not joint_driven_shapes.intersection(shape.combine)
    ]
    driven_shapes = {
        drive.target.removeprefix("shape/")
        for control in rig.rig.controls
        for drive in control.drives
        if drive.target.startswith("shape/")
    }
    if not correctives or not driven_shapes:
        return
    weights = _shape_weights(rig, driven_shapes)
    for shape in correctives:
        undriven_names = [name for name in shape.combine if name not in weights]
        location = (*rig.at("shapes", shape.name), "combine")
        if undriven_names:
            message = f"no control drives {undriven_names[0]!r}, "
            message += f"which {shape.name!r} combines"
            hint = "drive it, or remove the shape"
            yield rig.fault("RIG208", location, message, hint)
        elif not _combined_weight(shape, weights).any():
            message = f"{shape.name!r} is 0 in every pose of the controls"
            hint = f"{' and '.join(shape.combine)} are never both above 0"
            yield rig.fault("RIG208", location, message, hint)


def idle_controls(rig: RigSubject) -> Iterator[Fault]:
    """Report controls that drive nothing and that no expression reads (RIG220)."""
    read_names = {
        name
        for control in rig.rig.controls
        for drive in control.drives
        if drive.expression is not None
        for name in drive.expression.names
    }
    read_names |= {
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
        if not control.drives and control.name not in read_names:
            message = f"{control.name!r} drives nothing, and nothing reads it"
            location = rig.at("controls", control.name)
            yield rig.fault("RIG220", location, message, "add drives, or remove it")


@lru_cache(maxsize=1)
def _sweep_controls(rig: RigSubject) -> _ControlSweep:
    """Return a sweep of each control with all other controls at their defaults."""
    controls = rig.rig.controls
    samples_by_control = {
        control.name: _sampled_values(control) for control in controls
    }
    frame_count = sum(map(len, samples_by_control.values()))
    values_by_control: dict[str, FloatArray] = {}
    moving_controls: list[Control] = []
    for control in controls:
        values = np.full(frame_count, control.default)
        samples = samples_by_control[control.name]
        values[len(moving_controls) : len(moving_controls) + len(samples)] = samples
        moving_controls += [control] * len(samples)
        values_by_control[control.name] = values
    with np.errstate(all="ignore"):
        driven_values = evaluate_controls(controls, values_by_control)
    return _ControlSweep(moving_controls, values_by_control, driven_values)


def _sampled_values(control: Control) -> FloatArray:
    """Return test values over a control's range, ascending; none if it is open."""
    if control.low is None or control.high is None:
        return np.zeros(0)
    curve_inputs = [x for drive in control.drives for x, _ in drive.curve]
    samples = np.linspace(control.low, control.high, SWEEP_SAMPLES)
    values = np.concatenate([samples, np.array(curve_inputs, np.float64)])
    # `numpy.unique` would import numpy.ma.
    return np.array(sorted(set(np.clip(values, control.low, control.high).tolist())))


def _limit_excess(joint: Joint, targets: dict[str, FloatArray]) -> FloatArray:
    """Return how far controls drive a joint beyond its limits ``(F,)`` or ``(1,)``."""
    if isinstance(joint.limits, RangeLimit):
        coordinate = "slide" if joint.type == "prismatic" else "angle"
        coordinate_values = targets.get(f"joint/{joint.name}.{coordinate}")
        return (
            _ZERO
            if coordinate_values is None
            else joint.limits.excess(coordinate_values)
        )
    if isinstance(joint.limits, BallLimit):
        target_names = [f"joint/{joint.name}.rotation.{axis}" for axis in "xyz"]
        axis_angles = [targets.get(name, _ZERO) for name in target_names]
        is_driven = any(name in targets for name in target_names)
        if not is_driven or _is_within_limits(joint.limits, axis_angles):
            return _ZERO
        rotation = so3.exp(np.stack(np.broadcast_arrays(*axis_angles), axis=-1))
        is_finite = np.isfinite(rotation).all(axis=-1, keepdims=True)
        return joint.limits.excess(np.where(is_finite, rotation, so3.IDENTITY))
    return _ZERO


def _is_within_limits(limits: BallLimit, axis_values: list[FloatArray]) -> bool:
    """Return whether rotations are too small to reach the swing and twist limits.

    Swing and twist are at most as large as the rotation. Most rotations are small, and
    the full computation is slow.
    """
    largest_angle = np.sqrt(sum(np.abs(values).max() ** 2 for values in axis_values))
    twist_low, twist_high = limits.twist or (-np.inf, np.inf)
    swing = limits.swing or (np.inf, np.inf)
    return bool(largest_angle <= min(*swing, -twist_low, twist_high))


def _affecting_drive(rig: RigSubject, control: Control, target: str) -> Location:
    """Return the location of a control's drive with a target, else of the control."""
    location = rig.at("controls", control.name)
    for drive_index, drive in enumerate(control.drives):
        if f"{drive.target}.".startswith(target):
            return (*location, "drives", drive_index)
    return location


def _shape_weights(rig: RigSubject, driven_names: set[str]) -> dict[str, FloatArray]:
    """Return the weights of driven and combination shapes in poses of all controls."""
    rng = np.random.default_rng(0)
    values_by_control = {}
    for control in rig.rig.controls:
        low = -1.0 if control.low is None else control.low
        high = 1.0 if control.high is None else control.high
        end_values = np.where(rng.random(POSE_SAMPLES) < 0.5, low, high)
        inner_values = rng.uniform(low, high, POSE_SAMPLES)
        is_end = rng.random(POSE_SAMPLES) < RANGE_END_PROBABILITY
        values_by_control[control.name] = np.where(is_end, end_values, inner_values)
    with np.errstate(all="ignore"):
        targets = evaluate_controls(rig.rig.controls, values_by_control).targets
    weights = {name: targets[f"shape/{name}"] for name in sorted(driven_names)}
    for shape in combination_order(rig.rig.shapes):
        if shape.combine and all(name in weights for name in shape.combine):
            weight = weights.get(shape.name, np.zeros(1))
            weights[shape.name] = weight + _combined_weight(shape, weights)
    return weights


def _combined_weight(shape: Shape, weights: dict[str, FloatArray]) -> FloatArray:
    product = np.ones(1)
    for name in shape.combine:
        product = product * weights[name]
    return product


# Number of sampled values of each coordinate, with the others at rest, and of samples
# of all at once.
INPUT_SAMPLES, RANDOM_SAMPLES = 33, 512
# Range of unlimited coordinates [rad], [m].
UNLIMITED_ANGLE, UNLIMITED_LENGTH = np.pi, 1.0


def drivers_beyond_limits(rig: RigSubject) -> Iterator[Fault]:
    """Report drivers that move a joint beyond its limits (RIG223)."""
    for joint in rig.rig.joints:
        if joint.driven is None or not isinstance(joint.limits, RangeLimit):
            continue
        if joint.name in rig.mirrored:
            continue
        values = _driver_values(joint.driven, _input_samples(rig, joint.driven))
        excess = joint.limits.excess(np.where(np.isfinite(values), values, 0.0))
        worst_sample = int(np.argmax(np.abs(excess)))
        if abs(excess[worst_sample]) <= LIMIT_TOLERANCE:
            continue
        reached_text = value_text(rig, joint, float(values[worst_sample]))
        limits = range_text(rig, joint, joint.limits.low, joint.limits.high)
        message = (
            f"the driver of {joint.name!r} reaches {reached_text} within the limits of "
            f"its inputs; its limits are {limits}"
        )
        location = (*rig.at("joints", joint.name), "driven")
        hint = "widen the limits, or reduce the driver"
        yield rig.fault("RIG223", location, message, hint)


def undefined_drivers(rig: RigSubject) -> Iterator[Fault]:
    """Report drivers that are undefined at a sample of their inputs (RIG224)."""
    for key, kind, elements in (
        ("joints", "joint", rig.rig.joints),
        ("shapes", "shape", rig.rig.shapes),
        ("controls", "control", rig.rig.controls),
    ):
        for element in elements:
            if element.driven is None or element.name in rig.mirrored:
                continue
            inputs = _input_samples(rig, element.driven)
            is_undefined = ~np.isfinite(_driver_values(element.driven, inputs))
            if not is_undefined.any():
                continue
            sample = int(is_undefined.argmax())
            input_texts = [
                f"{name} is {values[sample] / element.driven.unit_of(name):.4g}"
                for name, values in inputs.items()
            ]
            message = f"the driver of {kind} {element.name!r} is undefined where "
            message += " and ".join(input_texts) or "it has no inputs"
            location = (*rig.at(key, element.name), "driven")
            hint = "avoid division by 0; log and sqrt need more than 0"
            yield rig.fault("RIG224", location, message, hint)


def _driver_values(driver: Driver, inputs: dict[str, FloatArray]) -> FloatArray:
    """Evaluate a driver at all samples of its inputs ``(N,)``."""
    sample_count = RANDOM_SAMPLES + INPUT_SAMPLES * len(inputs)
    return np.broadcast_to(driver.evaluate(inputs), sample_count)


def _input_samples(rig: RigSubject, driver: Driver) -> dict[str, FloatArray]:
    """Sample the inputs of a driver: each alone over its range, then all at random."""
    rng = np.random.default_rng(0)
    input_names = driver.names
    samples_by_input = {}
    for i, name in enumerate(input_names):
        lower, upper = _input_range(rig.rig, name)
        rest_value = min(max(0.0, lower), upper)
        values = np.full((len(input_names), INPUT_SAMPLES), rest_value)
        values[i] = np.linspace(lower, upper, INPUT_SAMPLES)
        random_values = rng.uniform(lower, upper, RANDOM_SAMPLES)
        samples_by_input[name] = np.concatenate([values.ravel(), random_values])
    return samples_by_input


def _input_range(rig: Rig, name: str) -> tuple[float, float]:
    """Return lowest and highest value of a coordinate or control [rad], [m], [1]."""
    joint_name, coordinate = split_coordinate(name)
    if not joint_name:
        control = next(control for control in rig.controls if control.name == name)
        if control.low is None or control.high is None:
            return control.default, control.default
        return control.low, control.high
    limits = rig.joints[rig.index(joint_name)].limits
    if isinstance(limits, RangeLimit):
        return limits.low, limits.high
    if not isinstance(limits, BallLimit):
        range_limit = UNLIMITED_LENGTH if coordinate == SLIDE else UNLIMITED_ANGLE
        return -range_limit, range_limit
    if coordinate == TWIST:
        return limits.twist or (-UNLIMITED_ANGLE, UNLIMITED_ANGLE)
    max_swing = max(limits.swing) if limits.swing else UNLIMITED_ANGLE
    return (0.0, max_swing) if coordinate == SWING else (-max_swing, max_swing)

"""Clip sampling on a rig: curves, controls, joints, shapes, limits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from typing import TYPE_CHECKING

import numpy as np

from animtool.clip.channels import ClipChannel, evaluate_channels
from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, FormatError, Severity, listed, warning
from animtool.core.quantities import percent_hint
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.motion.motion import Channel, Motion
from animtool.rig.controls import ControlEffects, evaluate_controls, undefined_faults
from animtool.rig.joints import DRIVEN_PARTS, KEYED_PARTS, split_part
from animtool.rig.limits import BallLimit, RangeLimit
from animtool.rig.shapes import add_combinations
from animtool.rig.skeleton import Joint, JointType, Rig

if TYPE_CHECKING:
    from animtool.motion.driver_run import DriverRun

# A smaller excess is rounding [rad], [m], [1].
LIMIT_TOLERANCE = 1e-9
# Joint values gathered in a call: few calls, at most 8 MB.
BATCH_ROWS = 2**18

# Values ``(F or 1, D)`` of a joint by part, such as ``angle`` or ``+translation.x``.
JointParts = dict[str, FloatArray]


@dataclass(frozen=True, slots=True)
class ClipNotice:
    """A notice about the values of a control or a joint."""

    fault: Fault  # the fault, without a location
    target: str  # ``control/NAME`` or ``joint/NAME``
    frame: float | None = None  # the worst frame; None if it concerns all frames
    excess: float = 0.0  # in the worst frame [rad], [m], [1]


@dataclass(frozen=True, slots=True)
class SampledMotion:
    """The sampled motion of a clip, with notices."""

    motion: Motion  # joints, shapes and controls; static values are stored once
    # Controls out of range and exceeded limits, with the worst frame and excess of
    # each; joints whose keys override a mimic or the contribution of a moving control.
    clip_notices: list[ClipNotice]

    @property
    def notices(self) -> list[Fault]:
        """The notices as faults, without their targets."""
        return [notice.fault for notice in self.clip_notices]


def sample_channels(
    channels: Sequence[ClipChannel], rig: Rig, times: FloatArray, *, clamp: bool = False
) -> SampledMotion:
    """Sample a clip's channels on a rig at times ``(F,)`` [frame of the clip].

    Channels with equal keys are not sampled; joints that neither a channel nor a moving
    control affects stay at rest. Contributions of channels and controls to one joint
    are added: rotations of controls are rotation vectors, applied before the channel's
    rotation. A channel of ``local_translation`` or ``local_rotation`` replaces the rest
    transform and everything that would be added to it. A combined shape's weight is the
    product of its drivers, plus the values of keys and controls. Drivers of the rig
    that read joint coordinates override keys.

    Ascending times are fastest. ``clamp`` keeps controls in their ranges and joints
    within their limits.
    """
    values = evaluate_channels(channels, times)
    sampled_motion = sample_values(values, rig, times, clamp=clamp)
    notices_with_keys = [
        with_keys(notice, channels, rig, times)
        for notice in sampled_motion.clip_notices
    ]
    return replace(sampled_motion, clip_notices=notices_with_keys)


# Number of key frames listed in a message.
MAX_LISTED_FRAMES = 8


def with_keys(
    notice: ClipNotice, channels: Sequence[ClipChannel], rig: Rig, times: FloatArray
) -> ClipNotice:
    """Return a notice with the key frames at which a control is out of range."""
    if notice.fault.code != "CLIP101":
        return notice
    name = notice.target.removeprefix("control/")
    control = next(control for control in rig.controls if control.name == name)
    assert control.low is not None
    assert control.high is not None
    limits = RangeLimit(control.low, control.high)
    frames_outside = [
        float(t)
        for c in channels
        if c.target == notice.target
        for t in c.times[np.abs(limits.excess(c.values[:, 0])) > LIMIT_TOLERANCE]
        if times.min() <= t <= times.max()
    ]
    if not frames_outside or frames_outside == [notice.frame]:
        return notice
    message = notice.fault.message.removesuffix(_CLAMPED_SUFFIX)
    suffix = _CLAMPED_SUFFIX if message != notice.fault.message else ""
    keys_text = (
        f"{len(frames_outside)} keys are" if len(frames_outside) > 1 else "a key is"
    )
    frame_noun = "frames" if len(frames_outside) > 1 else "frame"
    frames = listed([f"{frame:g}" for frame in frames_outside], MAX_LISTED_FRAMES)
    message += f"; {keys_text} outside, at {frame_noun} {frames}{suffix}"
    return replace(notice, fault=replace(notice.fault, message=message))


def sample_values(
    keyed_values: Mapping[str, FloatArray],
    rig: Rig,
    times: FloatArray,
    *,
    clamp: bool = False,
    run: DriverRun | None = None,
) -> SampledMotion:
    """Return the motion of a rig from target values; see `sample_channels`.

    The values are ``(F, D)`` by target, or ``(1, D)`` where one never moves; rotations
    are quaternions. ``run`` evaluates the rig's drivers and collects their notices, if
    the times continue earlier ones.
    """
    frame_count = len(times)
    notices: list[ClipNotice] = []
    values_by_control = {
        name.removeprefix("control/"): value[:, 0]
        for name, value in keyed_values.items()
        if name.startswith("control/")
    }
    control_effects = evaluate_controls(rig.controls, values_by_control, clamp=clamp)
    effect_values = control_effects.unclamped_controls | control_effects.targets
    for fault in undefined_faults(effect_values, times):
        raise FormatError(fault)
    notices += _range_notices(rig, control_effects, times, clamp=clamp)
    parts_by_joint = _parts_by_joint(keyed_values, control_effects)
    notices += _remove_replaced_parts(parts_by_joint)
    notices += _apply_mimics(rig, parts_by_joint, clamp=clamp)
    joint_values = _JointValues(rig, times, clamp, notices)
    for name, joint_parts in parts_by_joint.items():
        joint_values.add_joint(rig.index(name), joint_parts)
    control_channel = None
    if values_by_control:
        columns = [control_effects.controls[control.name] for control in rig.controls]
        control_channel = _column_channel(columns, frame_count)
    values_by_coordinate = {}
    if rig.is_driven:
        values_by_coordinate = _joint_coordinates(rig, parts_by_joint, clamp=clamp)
    motion = Motion(
        joint_values.build_channel("translations", rig.rest_translations),
        joint_values.build_channel("rotations", rig.rest_rotations),
        joint_values.build_channel("scales", np.ones((len(rig.joints), 3)))
        if joint_values.values_by_channel["scales"]
        else None,
        _weight_channel(rig, keyed_values, control_effects, frame_count),
        control_channel,
    )
    if rig.is_driven:
        from animtool.motion.driver_run import DriverRun

        driver_run = run or DriverRun(rig, reports_replaced=True)
        motion = driver_run.evaluate(motion, times, values_by_coordinate)
        if run is None:
            located_notices = driver_run.located_notices()
            notices += [ClipNotice(*notice) for notice in located_notices]
    return SampledMotion(motion, notices)


def _joint_coordinates(
    rig: Rig, parts_by_joint: Mapping[str, JointParts], *, clamp: bool
) -> dict[str, FloatArray]:
    """Return joint angles and slides from keys and controls, by name."""
    values_by_coordinate = {}
    for name, joint_parts in parts_by_joint.items():
        joint = rig.joints[rig.index(name)]
        part, local_part = _MIMIC_PARTS.get(joint.type, ("", ""))
        value = _add_values(joint_parts.get(part), joint_parts.get(f"+{part}"))
        if value is None or local_part in joint_parts:
            continue
        if clamp and isinstance(joint.limits, RangeLimit):
            value = joint.limits.clamped(value)
        values_by_coordinate[f"{name}.{part}"] = value[:, 0]
    return values_by_coordinate


def _range_notices(
    rig: Rig, control_effects: ControlEffects, times: FloatArray, *, clamp: bool
) -> list[ClipNotice]:
    """Return notices on controls that leave their ranges."""
    notices = []
    for control in rig.controls:
        if control.low is None or control.high is None:
            continue
        values = control_effects.unclamped_controls[control.name]
        excess = values - np.clip(values, control.low, control.high)
        worst_index = int(np.argmax(np.abs(excess)))
        if abs(excess[worst_index]) > LIMIT_TOLERANCE:
            frame = times[worst_index]
            verb = "would be" if clamp else "is"
            message = f"control {control.name!r} {verb} {values[worst_index]:.6g} at "
            message += f"frame {frame:g}, outside {control.low:g} to {control.high:g}"
            message += _CLAMPED_SUFFIX if clamp else ""
            hint = None if clamp else _CLAMP_HINT
            value = float(values[worst_index])
            if not clamp and control.high == 1 and MIN_PERCENT <= value <= 100:
                hint = percent_hint(value)
            fault = warning("CLIP101", message, hint)
            target = f"control/{control.name}"
            worst_excess = float(abs(excess[worst_index]))
            notices.append(ClipNotice(fault, target, float(frame), worst_excess))
    return notices


# A control from 0 to 1 that is so large is keyed in percent.
MIN_PERCENT = 10.0
_CLAMP_HINT = f"{argument('source.clamp', True)} clamps it"
_CLAMPED_SUFFIX = ": clamped"


def _parts_by_joint(
    keyed_values: Mapping[str, FloatArray], control_effects: ControlEffects
) -> dict[str, JointParts]:
    """Return the values of each joint by part; driven parts begin with ``+``."""
    parts_by_joint: dict[str, JointParts] = {}
    for target, value in keyed_values.items():
        if target.startswith("joint/"):
            name, part = split_part(target.removeprefix("joint/"), KEYED_PARTS)
            parts_by_joint.setdefault(name, {})[part] = value
    for target, value in control_effects.targets.items():
        if target.startswith("joint/") and value.any():
            name, part = split_part(target.removeprefix("joint/"), DRIVEN_PARTS)
            parts_by_joint.setdefault(name, {})[f"+{part}"] = value
    return parts_by_joint


def _remove_replaced_parts(
    parts_by_joint: Mapping[str, JointParts],
) -> list[ClipNotice]:
    """Remove driven parts that a local channel replaces; return notices on them."""
    notices = []
    for name, parts in parts_by_joint.items():
        for local_part, driven_parts in _DRIVEN_PARTS_BY_LOCAL_PART.items():
            if local_part not in parts:
                continue
            dropped_values = [parts.pop(key) for key in driven_parts if key in parts]
            if any((values != values[0]).any() for values in dropped_values):
                message = (
                    f"joint {name!r} has keys for {local_part}, so no control moves it"
                )
                fault = Fault("CLIP105", message, severity=Severity.NOTE)
                notices.append(ClipNotice(fault, f"joint/{name}"))
    return notices


# Driven parts that local keys of a joint replace.
_DRIVEN_PARTS_BY_LOCAL_PART = {
    "local_translation": ("+slide", *(f"+translation.{axis}" for axis in "xyz")),
    "local_rotation": ("+angle", *(f"+rotation.{axis}" for axis in "xyz")),
}


# Coordinate of a joint that may be a mimic, and the part that replaces it.
_MIMIC_PARTS = {
    JointType.PIN: ("angle", "local_rotation"),
    JointType.PRISMATIC: ("slide", "local_translation"),
}


def _apply_mimics(
    rig: Rig, parts_by_joint: dict[str, JointParts], *, clamp: bool
) -> list[ClipNotice]:
    """Set the coordinates of mimic joints; keys override a mimic, with a note."""
    notices = []
    for joint in rig.joints:
        if joint.mimic is None:
            continue
        part, local_part = _MIMIC_PARTS[joint.type]
        if parts_by_joint.get(joint.name, {}).keys() & {part, local_part}:
            message = f"joint {joint.name!r} has keys, so it does not follow "
            message += repr(joint.mimic.joint)
            fault = Fault("CLIP103", message, severity=Severity.NOTE)
            notices.append(ClipNotice(fault, f"joint/{joint.name}"))
            continue
        leader_parts = parts_by_joint.get(joint.mimic.joint, {})
        coordinate = np.zeros(1)
        for leader_part in ("angle", "slide"):
            if leader_part in leader_parts:
                coordinate = coordinate + leader_parts[leader_part][:, 0]
            if f"+{leader_part}" in leader_parts:
                coordinate = coordinate + leader_parts[f"+{leader_part}"]
        limits = rig.joints[rig.index(joint.mimic.joint)].limits
        if clamp and isinstance(limits, RangeLimit):
            coordinate = limits.clamped(coordinate)
        value = joint.mimic.gain * coordinate + joint.mimic.offset
        if value.any():
            parts_by_joint.setdefault(joint.name, {})[f"+{part}"] = value
    return notices


@dataclass(slots=True)
class _JointValues:
    """Local transforms of the moving joints."""

    rig: Rig
    times: FloatArray
    clamp: bool
    notices: list[ClipNotice]
    values_by_channel: dict[str, dict[int, FloatArray]] = field(
        default_factory=lambda: {"translations": {}, "rotations": {}, "scales": {}}
    )

    def add_joint(self, j: int, parts: JointParts) -> None:
        """Compute a joint's translation, rotation and scale ``(F or 1, K)``."""
        joint = self.rig.joints[j]
        rest_translation = np.array(joint.translation)
        rest_rotation = np.array(joint.rotation)
        base_translation = parts.get("local_translation", rest_translation[None])
        translation = self._translation_from_rest(joint, parts)
        if translation is not None:
            base_translation = base_translation + so3.rotate(rest_rotation, translation)
        base_rotation = parts.get("local_rotation", rest_rotation[None])
        rotation = self._rotation_from_rest(joint, parts)
        if rotation is not None:
            base_rotation = so3.multiply(base_rotation, rotation)
        if translation is not None or "local_translation" in parts:
            self.values_by_channel["translations"][j] = base_translation
        if rotation is not None or "local_rotation" in parts:
            self.values_by_channel["rotations"][j] = base_rotation
        if "scale" in parts:
            self.values_by_channel["scales"][j] = parts["scale"]

    def build_channel(self, name: str, rest: FloatArray) -> Channel:
        """Return the channel of a part: animated values and constants."""
        constant_values, frame_count = rest.copy(), len(self.times)
        animated_joints: list[int] = []
        columns: list[FloatArray] = []
        for j, values in sorted(self.values_by_channel[name].items()):
            if len(values) == 1 or (values == values[0]).all():
                constant_values[j] = values[0]
            else:
                animated_joints.append(j)
                columns.append(values)
        animated_values = np.zeros((frame_count, len(columns), rest.shape[1]))
        batch_size = max(1, BATCH_ROWS // max(frame_count, 1))
        for first_column in range(0, len(columns), batch_size):
            rows = np.stack(columns[first_column : first_column + batch_size], axis=1)
            rows = so3.align_signs(rows) if name == "rotations" else rows
            animated_values[:, first_column : first_column + batch_size] = rows
        return Channel(
            constant_values, np.array(animated_joints, np.int64), animated_values
        )

    def _translation_from_rest(
        self, joint: Joint, parts: JointParts
    ) -> FloatArray | None:
        """Return the motion's translation in the joint's rest frame."""
        slide = _add_values(parts.get("slide"), parts.get("+slide"))
        if slide is not None:
            slide = self._clamp_to_limits(joint, slide)
            return np.asarray(slide * np.array(joint.axis))
        translation = parts.get("translation")
        for i, axis in enumerate("xyz"):
            if f"+translation.{axis}" in parts:
                offset = parts[f"+translation.{axis}"][:, None] * np.eye(3)[i]
                translation = offset if translation is None else translation + offset
        return translation

    def _rotation_from_rest(self, joint: Joint, parts: JointParts) -> FloatArray | None:
        """Return the motion's rotation in the joint's rest frame."""
        angle = _add_values(parts.get("angle"), parts.get("+angle"))
        if angle is not None:
            angle = self._clamp_to_limits(joint, angle)
            return so3.from_axis_angle(joint.axis, angle[:, 0])
        rotation = parts.get("rotation")
        driven_axes = [parts.get(f"+rotation.{axis}") for axis in "xyz"]
        if any(value is not None for value in driven_axes):
            columns = [np.zeros(1) if v is None else v for v in driven_axes]
            driven_rotation = so3.exp(np.stack(np.broadcast_arrays(*columns), axis=-1))
            rotation = (
                driven_rotation
                if rotation is None
                else so3.multiply(driven_rotation, rotation)
            )
        if rotation is not None and isinstance(joint.limits, BallLimit):
            clamped_rotation = joint.limits.clamped(rotation)
            excess = so3.angle_between(rotation, clamped_rotation)
            self._add_notice(joint, excess, "its cone or twist")
            rotation = clamped_rotation if self.clamp else rotation
        return rotation

    def _clamp_to_limits(self, joint: Joint, values: FloatArray) -> FloatArray:
        """Return a coordinate clamped to the joint's limits, with a notice."""
        if not isinstance(joint.limits, RangeLimit):
            return values
        clamped_values = joint.limits.clamped(values)
        self._add_notice(joint, np.abs(values - clamped_values)[:, 0], "its limits")
        return clamped_values if self.clamp else values

    def _add_notice(self, joint: Joint, excess: FloatArray, limit_name: str) -> None:
        """Add a notice on a joint that exceeds its limits."""
        worst_index = int(np.argmax(excess))
        if not excess[worst_index] > LIMIT_TOLERANCE:
            return
        amount = f"{np.degrees(excess[worst_index]):.4g}°"
        if joint.type is JointType.PRISMATIC:
            amount = f"{excess[worst_index]:.4g} m"
        excess_text = f"exceeds {limit_name} by {amount}"
        if self.clamp:
            excess_text = f"was clamped to {limit_name}, by {amount},"
        message = f"joint {joint.name!r} {excess_text} at frame "
        message += f"{self.times[worst_index]:g}"
        hint = None if self.clamp else _CLAMP_HINT
        fault = warning("CLIP102", message, hint)
        frame = float(self.times[worst_index])
        largest_excess = float(excess[worst_index])
        self.notices.append(
            ClipNotice(fault, f"joint/{joint.name}", frame, largest_excess)
        )


def _add_values(
    keyed_values: FloatArray | None, driven_values: FloatArray | None
) -> FloatArray | None:
    """Add a channel's values ``(F, 1)`` and driven values ``(F,)``; None is 0."""
    if driven_values is None:
        return keyed_values
    column = driven_values[:, None]
    return column if keyed_values is None else keyed_values + column


def _column_channel(columns: list[FloatArray], frame_count: int) -> Channel:
    """Return a channel from columns ``(F,)`` or ``(1,)``."""
    rest_values = np.array([column[0] for column in columns])[:, None]
    animated_columns = [i for i, c in enumerate(columns) if (c != c[0]).any()]
    values = np.zeros((frame_count, len(animated_columns), 1))
    for column_index, i in enumerate(animated_columns):
        values[:, column_index, 0] = columns[i]
    return Channel(rest_values, np.array(animated_columns, np.int64), values)


def _weight_channel(
    rig: Rig,
    keyed_values: Mapping[str, FloatArray],
    control_effects: ControlEffects,
    frame_count: int,
) -> Channel | None:
    """Return the shape weights as a channel; None if all are zero."""
    weights_by_shape: dict[str, FloatArray] = {}
    for shape in rig.shapes:
        target = f"shape/{shape.name}"
        value = np.zeros(1)
        if target in keyed_values:
            value = value + keyed_values[target][:, 0]
        if target in control_effects.targets:
            value = value + control_effects.targets[target]
        weights_by_shape[shape.name] = value
    weights_by_shape = add_combinations(rig.shapes, weights_by_shape)
    if not any(value.any() for value in weights_by_shape.values()):
        return None
    return _column_channel(
        [weights_by_shape[shape.name] for shape in rig.shapes], frame_count
    )

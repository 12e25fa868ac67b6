"""Key channels on named targets: units, interpolation, evaluation."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import AnimtoolError, Fault, OptionError, counted, listed
from animtool.core.names import belong_elsewhere, most_similar, name_hint
from animtool.core.record import dataclass
from animtool.core.units import LengthUnit, unit_name
from animtool.maths import euler
from animtool.maths.curves import Curves, Extrapolation, Interp, evaluate, key_handles
from animtool.maths.rotation_curves import RotationKind, evaluate_rotations
from animtool.maths.tangents import KeySlopes, Parametrization, Tangent
from animtool.rig.joints import KEYED_PARTS, part_hint, split_part
from animtool.rig.skeleton import JointType, Rig


@dataclass(frozen=True, slots=True)
class ClipChannel:
    """The K keys of one target: times [frame] and D components [m] or [rad]."""

    target: str  # ``control/NAME``, ``shape/NAME`` or ``joint/NAME.PART``
    times: FloatArray  # ascending [frames] ``(K,)``
    # ``(K, D)``; quaternions (x, y, z, w), or Euler angles [rad] in the sequence of
    # their order.
    values: FloatArray
    interps: tuple[Interp, ...]  # interpolation of the segment after each key, K long
    # Tangent types before and after each key, K long.
    tangents: tuple[tuple[Tangent, Tangent], ...]
    # Handles before the keys, as offsets: time, then D values ``(K, 1 + D)``; used
    # where the tangent is free.
    in_handles: FloatArray
    out_handles: FloatArray  # handles after the keys, likewise
    tcb: FloatArray  # tension, continuity, bias ``(K, 3)``
    parametrization: Parametrization = Parametrization.UNIFORM  # for Catmull-Rom
    euler: str = ""  # order of the Euler angles; empty for other channels
    pre: Extrapolation = Extrapolation.HOLD  # before the first key
    post: Extrapolation = Extrapolation.HOLD  # after the last key

    def __repr__(self) -> str:
        """Return the target and the number of keys."""
        return f"<ClipChannel {self.target!r}: {counted(len(self.times), 'key')}>"


def target_kind(target: str, rig: Rig | None) -> str | Fault:
    """Return the kind of a target, such as ``angle``, or a fault if it is invalid.

    One of control, shape, angle, slide, translation, rotation, scale. Without a rig,
    all names are valid.

    >>> from animtool.rig.skeleton import Joint, JointType
    >>> arm = Rig("arm", (Joint("elbow", -1, JointType.PIN),))
    >>> target_kind("joint/elbow.angle", arm)
    'angle'
    >>> print(target_kind("joint/elbow.slide", arm))
    CLIP003 a pin joint has no slide; it has angle, local_translation, \
local_rotation, scale
    """
    group, _, name = target.partition("/")
    if group in {"control", "shape"} and name:
        if rig is None:
            return group
        known_names = rig.control_names if group == "control" else rig.shape_names
        if name not in known_names:
            named_parts = rig.controls if group == "control" else rig.shapes
            nearest_hint = name_hint(name, [part.name for part in named_parts])
            hint = _full_target(name, rig) or nearest_hint
            return Fault("CLIP002", f"unknown {group} {name!r}", hint=hint)
        return group
    if group != "joint" or not name:
        hint = "write control/NAME, shape/NAME or joint/NAME.PART"
        hint = _full_target(target, rig) or hint
        return Fault("CLIP001", f"{target!r} is not a target", hint=hint)
    return _joint_kind(name, rig)


def _full_target(written_target: str, rig: Rig | None) -> str | None:
    """Return a hint with the full target of a joint, shape or control given by name."""
    if rig is None:
        return None
    for kind, names in (("control", rig.control_names), ("shape", rig.shape_names)):
        if written_target in names:
            return f"write {kind}/{written_target}"
    joint = (
        written_target
        if written_target in rig.names
        else written_target.rpartition(".")[0]
    )
    if joint not in rig.names:
        return None
    parts = _parts_of(rig.joints[rig.index(joint)].type)
    written_part = written_target[len(joint) + 1 :]
    return f"write joint/{joint}.{written_part if written_part in parts else parts[0]}"


def _parts_of(joint_type: JointType) -> list[str]:
    """Return the parts of joints of a type that can be keyed."""
    return [part for part, types in KEYED_PARTS.items() if joint_type in types]


def _joint_kind(name: str, rig: Rig | None) -> str | Fault:
    """Return the kind of a joint target, or a fault if it is invalid."""
    joint, part = split_part(name, KEYED_PARTS)
    if not part:
        return _part_fault(name, rig)
    if rig is not None and joint not in rig.names:
        hint = rig.joint_hint(joint)
        return Fault("CLIP002", f"unknown joint {joint!r}", hint=hint)
    if rig is not None:
        joint_type = rig.joints[rig.index(joint)].type
        if joint_type not in KEYED_PARTS[part]:
            message = f"a {joint_type} joint has no {part}"
            hint = f"it has {', '.join(_parts_of(joint_type))}"
            return Fault("CLIP003", message, hint=hint)
    return part.removeprefix("local_")


def _part_fault(joint_target: str, rig: Rig | None) -> Fault:
    """Return a fault for a joint target whose part is missing or unknown."""
    joint, part = split_part(joint_target.replace("/", "."), KEYED_PARTS)
    if part and rig is not None and joint in rig.names:
        hint = f"write joint/{joint}.{part}"
        return Fault("CLIP001", f"missing part of joint {joint_target!r}", hint=hint)
    joint, _, part = joint_target.rpartition(".")
    if not joint or rig is None or joint not in rig.names or joint_target in rig.names:
        kind = (
            rig.joints[rig.index(joint_target)].type
            if rig and joint_target in rig.names
            else None
        )
        hint = part_hint(joint_target, KEYED_PARTS, kind)
        return Fault("CLIP001", f"missing part of joint {joint_target!r}", hint=hint)
    hint = part_hint(joint_target, KEYED_PARTS, rig.joints[rig.index(joint)].type)
    return Fault("CLIP001", f"unknown part {part!r} of joint {joint!r}", hint=hint)


# Number of unknown targets from which a clip may be for another rig.
MIN_UNKNOWN_TARGETS = 3


def unknown_targets(targets: Iterable[str], rig: Rig) -> list[str]:
    """Return the targets whose joint, shape or control a rig lacks (CLIP002)."""
    kind_by_target = {target: target_kind(target, rig) for target in targets}
    return [
        target
        for target, kind in kind_by_target.items()
        if isinstance(kind, Fault) and kind.code == "CLIP002"
    ]


def lacks_most_targets(
    missing_targets: Sequence[str], target_count: int, rig: Rig
) -> bool:
    """Return whether a rig lacks so many targets that they are another rig's."""
    names_by_group = {
        "joint": rig.names,
        "shape": [shape.name for shape in rig.shapes],
        "control": [control.name for control in rig.controls],
    }
    are_similar = [
        _full_target(name, rig) is not None
        or most_similar(name, names_by_group[group]) is not None
        for group, name in map(_group_and_name, missing_targets)
    ]
    return belong_elsewhere(are_similar, target_count, MIN_UNKNOWN_TARGETS)


def _group_and_name(target: str) -> tuple[str, str]:
    """Return the group of a target, and the name of its joint, shape or control."""
    group, _, name = target.partition("/")
    return group, split_part(name, KEYED_PARTS)[0] if group == "joint" else name


def missing_targets_text(
    missing_targets: Sequence[str], target_count: int, rig: Rig
) -> str:
    """Return how many targets a rig lacks, and the first of them."""
    summary = f"has none of the {target_count} targets"
    if len(missing_targets) < target_count:
        summary = f"lacks {len(missing_targets)} of the {target_count} targets"
    subjects = (
        f"{group} {name!r}" for group, name in map(_group_and_name, missing_targets)
    )
    return f"rig {rig.name!r} {summary}: {listed(list(dict.fromkeys(subjects)), 4)}"


def rig_file_has_all(path: Path | None, targets: Iterable[str]) -> bool:
    """Return whether a rig file can be read and has all targets."""
    if path is None:
        return False
    try:
        rig = Rig.load(path)
    except AnimtoolError:
        return False
    return all(isinstance(target_kind(target, rig), str) for target in targets)


def check_targets(
    targets: Sequence[str], rig: Rig, clip_rig_path: Path | None = None
) -> None:
    """Raise the faults of all targets that the rig lacks.

    If they are those of another rig, the error names ``clip_rig_path``, the rig file
    that the clip names.
    """
    kinds_or_faults = [target_kind(target, rig) for target in targets]
    faults = [result for result in kinds_or_faults if isinstance(result, Fault)]
    missing_targets = unknown_targets(targets, rig)
    if lacks_most_targets(missing_targets, len(targets), rig):
        message = missing_targets_text(missing_targets, len(targets), rig)
        hint = "is it the right rig?"
        if clip_rig_path is not None:
            hint = f"the clip names {clip_rig_path}; {hint}"
        if rig_file_has_all(clip_rig_path, targets):
            hint = f"the clip is for {clip_rig_path}, which has them; sample it on "
            hint += "that rig, and move the take with animtool.retarget.retarget_take"
        other_faults = [fault for fault in faults if fault.code != "CLIP002"]
        faults = [Fault("CLIP002", message, hint=hint), *other_faults]
    if faults:
        raise OptionError(list(dict.fromkeys(faults)))


LENGTH_PARTS = frozenset({"translation", "local_translation", "slide"})


@dataclass(frozen=True, slots=True)
class ClipUnits:
    """Length unit [m] and angle unit [rad] of a clip."""

    length: float
    angle: float

    @staticmethod
    def of_rig(rig: Rig) -> ClipUnits:
        """Return a rig's units; metres if the format has no name for its unit."""
        name = unit_name(rig.meters_per_unit)
        length = 1.0 if " " in name else LengthUnit(name).meters
        has_radians = rig.radians_per_unit == 1.0
        return ClipUnits(length, 1.0 if has_radians else math.radians(1.0))

    @property
    def angle_name(self) -> str:
        """Name of the angle unit."""
        return "rad" if self.angle == 1.0 else "deg"

    def unit_of(self, target: str, euler: str) -> float:
        """Return the unit of a target's values: [m], [rad] or [1].

        >>> ClipUnits(0.01, 1.0).unit_of("joint/hips.translation", "")
        0.01
        """
        group, _, name = target.partition("/")
        part = split_part(name, KEYED_PARTS)[1] if group == "joint" else ""
        if part in LENGTH_PARTS:
            return self.length
        return self.angle if part == "angle" or euler else 1.0


def component_curves(channels: Sequence[ClipChannel]) -> Curves:
    """Return the components of channels as C = ΣD scalar curves, in order.

    Computed handles lie at thirds of their segments, so that time is linear; free
    handles are kept. Uniform Catmull-Rom uses the secant through the neighbours over
    time, which keeps the velocity continuous for any key times; centripetal and chordal
    follow Barry and Goldman's pyramid.
    """
    channel_curves = [_channel_curves(channel) for channel in channels]
    # Arrays without rows, for a concatenation without channels.
    no_values, no_handles = np.zeros(0), np.zeros((0, 2))
    empty_arrays = no_values, no_values, np.zeros(0, np.int64), no_handles, no_handles
    columns = zip(empty_arrays, *channel_curves, strict=True)
    times, values, kinds, in_handles, out_handles = (
        np.concatenate(column) for column in columns
    )
    component_channels = [channel for channel in channels for _ in channel.values.T]
    key_counts = [len(channel.times) for channel in component_channels]
    return Curves(
        np.cumsum([0, *key_counts], dtype=np.int64),
        times,
        values,
        kinds,
        in_handles,
        out_handles,
        tuple(channel.pre for channel in component_channels),
        tuple(channel.post for channel in component_channels),
    )


def _channel_curves(
    channel: ClipChannel,
) -> tuple[FloatArray, FloatArray, IntArray, FloatArray, FloatArray]:
    """Return times, values, interpolations and handles by component."""
    component_count = channel.values.shape[1]
    slopes = KeySlopes(
        channel.times, channel.values, channel.tcb, channel.parametrization
    )
    in_handles, out_handles, segment_kinds = key_handles(
        slopes,
        channel.interps,
        channel.tangents,
        channel.in_handles,
        channel.out_handles,
    )
    in_rows, out_rows = (
        np.stack(
            [np.tile(handles[:, 0], component_count), handles[:, 1:].T.ravel()], axis=-1
        )
        for handles in (in_handles, out_handles)
    )
    times = np.tile(channel.times, component_count)
    segment_kinds = np.tile(segment_kinds, component_count)
    return times, channel.values.T.ravel(), segment_kinds, in_rows, out_rows


# Rotations per batch: few calls, at most 1 MB each.
ROTATION_BATCH_SIZE = 2**15


def evaluate_channels(
    channels: Sequence[ClipChannel], times: FloatArray
) -> dict[str, FloatArray]:
    """Return the values of every target ``(F, D)``, or ``(1, D)`` if constant.

    There is one channel per target. Rotations are quaternions (x, y, z, w); Euler
    angles are converted. Ascending times are fastest.
    """
    values_by_target: dict[str, FloatArray] = {}
    number_channels: list[ClipChannel] = []
    quaternion_channels: list[ClipChannel] = []
    for channel in channels:
        if is_static(channel):
            values_by_target[channel.target] = _as_quaternions(
                channel, channel.values[:1]
            )
        elif channel.values.shape[1] == 4:
            quaternion_channels.append(channel)
        else:
            number_channels.append(channel)
    values_by_target |= _evaluate_rotation_channels(quaternion_channels, times)
    if number_channels:
        curve_values = evaluate(component_curves(number_channels), times)
        start = 0
        for channel in number_channels:
            end = start + channel.values.shape[1]
            values_by_target[channel.target] = _as_quaternions(
                channel, curve_values[start:end].T
            )
            start = end
    return {channel.target: values_by_target[channel.target] for channel in channels}


def _evaluate_rotation_channels(
    channels: list[ClipChannel], times: FloatArray
) -> dict[str, FloatArray]:
    """Return the rotations ``(F, 4)`` of every target; equal key times are batched."""
    channels_by_timing: dict[tuple[object, ...], list[ClipChannel]] = {}
    for channel in channels:
        timing = channel.interps, channel.pre, channel.post
        channels_by_timing.setdefault((channel.times.tobytes(), *timing), []).append(
            channel
        )
    batch_size = max(1, ROTATION_BATCH_SIZE // max(len(times), 1))
    values_by_target: dict[str, FloatArray] = {}
    batches = (
        same_timing[start : start + batch_size]
        for same_timing in channels_by_timing.values()
        for start in range(0, len(same_timing), batch_size)
    )
    for batch in batches:
        first_channel = batch[0]
        rotations = evaluate_rotations(
            first_channel.times,
            np.stack([channel.values for channel in batch], axis=1),
            np.array([RotationKind[i.name] for i in first_channel.interps], np.int64),
            times,
            first_channel.pre,
            first_channel.post,
        )
        batch_rotations = np.ascontiguousarray(rotations.swapaxes(0, 1))
        values_by_target |= {
            c.target: r for c, r in zip(batch, batch_rotations, strict=True)
        }
    return values_by_target


def is_static(channel: ClipChannel) -> bool:
    """Return whether all keys and handles have the first key's value."""
    has_handles = channel.in_handles[:, 1:].any() or channel.out_handles[:, 1:].any()
    return not has_handles and bool((channel.values == channel.values[0]).all())


def _as_quaternions(channel: ClipChannel, values: FloatArray) -> FloatArray:
    """Convert Euler angles to quaternions; return other values unchanged."""
    if not channel.euler:
        return values
    return euler.to_quaternion(np.degrees(values), channel.euler)


def values_at(channel: ClipChannel, times: FloatArray) -> FloatArray:
    """Return the values of a channel at times ``(F, D)``, rotations as quaternions."""
    values = evaluate_channels([channel], times)[channel.target]
    return np.broadcast_to(values, (len(times), values.shape[1]))

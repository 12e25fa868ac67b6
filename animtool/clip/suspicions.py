"""Warnings about clip files whose numbers suggest another unit or order."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction

import numpy as np

from animtool.clip.channels import (
    LENGTH_PARTS,
    ClipChannel,
    ClipUnits,
    evaluate_channels,
)
from animtool.clip.suspicious_positions import CheckedClip, warn_of_positions
from animtool.core.array_types import FloatArray, distinct_values
from animtool.core.errors import counted, listed
from animtool.core.quantities import length_text, percent_hint
from animtool.core.record import dataclass
from animtool.core.units import unit_name
from animtool.documents.document import Document, Location
from animtool.maths.curves import Interp
from animtool.rig.controls import evaluate_controls
from animtool.rig.joints import KEYED_PARTS, split_part
from animtool.rig.kinematics import rest_size
from animtool.rig.limits import RangeLimit
from animtool.rig.skeleton import MAX_RIG_SIZE, Rig
from animtool.rig.suspicions import (
    ANGLE_NAMES,
    FULL_REVOLUTION,
    HALF_REVOLUTION,
    HALF_REVOLUTION_ABOUT_Z,
    MAX_DEGREES,
    OTHER_ANGLE_UNIT_AND_FACTOR,
    are_multiples,
    warn_of_quaternion,
)
from animtool.rig.suspicious_shape import HINGE_NAMES

# Channels that move by less are noise in any unit [file's angle].
MIN_SPAN = 0.3
# In degrees, a character with this many rotating channels exceeds `HALF_REVOLUTION`
# somewhere.
MIN_ROTATING_CHANNELS = 5
# This many joints of a body, including a knee, do not all rotate several times.
MIN_WOUND_JOINTS = 3
# In radians, some joint of a moving character exceeds this angle [rad].
MIN_LARGEST_ANGLE = 1.0
# Knees and elbows that a few keys bend by this much bend far in radians; in degrees, an
# idle bends them by less.
MAX_POSES, MIN_HINGE_SPAN = 12, 2.0
# Fraction of keys at multiples of 15 degrees in radians that is more than chance.
MIN_EXACT_FRACTION = 0.2
# Radians with three decimals are that near to a whole degree by chance in 6 % [deg], so
# many different keys of one channel in 1e-5.
MIN_INTEGERS, INTEGER_TOLERANCE = 4, 0.03
# A root that travels less than this fraction of the rig's size stays in place.
MAX_TRAVEL = 0.05
# Plausible range of travel in metres, relative to the rig's size.
TRAVEL_RANGE = (0.2, 20.0)
# Range of motion of a clip in metres, and largest motion that is invisible if the clip
# is in the unit of its rig; relative to the rig's size.
METRE_RANGE, MAX_INVISIBLE_MOTION = (0.05, 20.0), 0.005
# Minimum rotation of a limb when a character travels [rad].
MIN_LIMB_ROTATION = math.radians(15)
# Sizes of characters [m], and a speed that even falls do not reach [m/s].
CHARACTER_SIZES, MAX_SPEED = (0.3, 4.0), 50.0
# Interval for measuring a speed; a faster move is a teleport [s].
SPEED_INTERVAL = 0.25
# Number of fast steps in a row of keys that are no teleports.
MIN_FAST_STEPS = 3
SMALLER_UNIT_NAME_BY_METERS = {1.0: "cm", 0.01: "mm"}
# Keys on a driven joint over less than this fraction of a control's range are
# adjustments.
MIN_LAYER_FRACTION = 0.25
# Smallest scale at all keys that may be a percentage [1].
MIN_PERCENT = 10.0
# Largest weight of a shape beyond which weights are percentages [1].
MIN_PERCENT_WEIGHT = 10.0
# Frames at which controls are evaluated.
MAX_EVALUATED_TIMES = 64


def warn_of_numbers(
    document: Document,
    channels: Sequence[ClipChannel],
    fps: Fraction,
    units: ClipUnits,
    rig: Rig | None,
    *,
    has_unit: bool,
) -> None:
    """Warn of quaternions, angles, lengths and speeds that look mistaken."""
    _warn_of_quaternion_order(document, channels)
    _warn_of_angles(document, channels, units, rig)
    _warn_of_weights(document, channels)
    if rig is not None:
        clip = CheckedClip(document, channels, fps, units, rig)
        _warn_of_metres(clip, has_unit)
        _warn_of_speed(clip)
        warn_of_positions(clip)
        _warn_of_scale(clip)
        _warn_of_controls(clip)


def _warn_of_speed(clip: CheckedClip) -> None:
    """Warn of characters that are faster than any fall (CLIP109)."""
    rig, rig_size = clip.rig, rest_size(clip.rig)
    has_limbs = any(HINGE_NAMES.search(name) for name in rig.names)
    if not (has_limbs and CHARACTER_SIZES[0] <= rig_size <= CHARACTER_SIZES[1]):
        return
    for i, channel in clip.root_translations():
        step_seconds = np.diff(channel.times) / float(clip.fps)
        step_lengths = np.linalg.norm(np.diff(channel.values, axis=0), axis=1)
        # A single fast step, or one without frames between, is a cut or a teleport.
        interps = channel.interps[:-1]
        is_continuous = np.array([interp != Interp.STEP for interp in interps], bool)
        is_fast = step_lengths > MAX_SPEED * step_seconds
        is_counted = is_fast & (step_seconds >= SPEED_INTERVAL)
        if is_fast.sum() >= max(MIN_FAST_STEPS, np.count_nonzero(step_lengths) / 2):
            is_counted = is_fast & is_continuous
        if not is_counted.any():
            continue
        speeds = np.where(
            is_counted, step_lengths / np.maximum(step_seconds, 1e-9), 0.0
        )
        fastest_step = int(speeds.argmax())
        length, seconds = step_lengths[fastest_step], step_seconds[fastest_step]
        message = (
            f"{channel.target!r} moves {length_text(length)} in {seconds:.3g} s "
            f"({speeds[fastest_step]:.3g} m/s), and the rig is "
            f"{length_text(rig_size)} tall"
        )
        unit = SMALLER_UNIT_NAME_BY_METERS.get(clip.units.length)
        hint = "check the keys and fps"
        if unit is not None:
            hint += f"; for keys in {unit} write 'units: {{length: {unit}}}'"
        clip.warn("CLIP109", i, fastest_step + 1, message, hint)
        return


def _warn_of_quaternion_order(
    document: Document, channels: Sequence[ClipChannel]
) -> None:
    """Warn of [0, 0, 0, 1], which is the identity only if w is last (CLIP106)."""
    quaternions_by_channel = {
        i: c.values for i, c in enumerate(channels) if c.values.shape[1] == 4
    }
    if any(
        (abs(v[:, 3]) > abs(v[:, 2])).any() for v in quaternions_by_channel.values()
    ):
        return
    for i, values in quaternions_by_channel.items():
        keys = document.value["channels"][i]["keys"]
        for k in np.flatnonzero(abs(values[:, 2]) == 1.0).tolist():
            # Of an array, which is not a list in the document, by its values.
            location: Location = ("channels", i, "keys")
            written_quaternion = [0.0, 0.0, 0.0, values[k, 2]]
            if not isinstance(keys, str):
                location, written_quaternion = (*location, k, "v"), keys[k]["v"]
            if written_quaternion == HALF_REVOLUTION_ABOUT_Z:
                warn_of_quaternion(document, "CLIP106", location)
                return


def _angle_channels(
    channels: Sequence[ClipChannel],
) -> Iterator[tuple[int, FloatArray]]:
    """Yield index and values of channels of angles: pins and Euler angles [rad]."""
    for i, channel in enumerate(channels):
        is_pin = split_part(channel.target, KEYED_PARTS)[1] == "angle"
        if channel.euler or (channel.target.startswith("joint/") and is_pin):
            yield i, channel.values


def _warn_of_angles(
    document: Document,
    channels: Sequence[ClipChannel],
    units: ClipUnits,
    rig: Rig | None,
) -> None:
    """Warn of keys in radians where degrees are declared, and vice versa (CLIP107)."""
    curves = [
        AngleCurve(("channels", i), channels[i].target, values)
        for i, values in _angle_channels(channels)
    ]
    warn_of_angle_keys(document, curves, "rotation keys of", "channel", units, rig)


@dataclass(frozen=True, slots=True)
class AngleCurve:
    """Keyed angles of a clip or targets file, and where they are in it."""

    location: Location  # location of the curve, which contains ``keys``
    name: str  # name of the target or effector
    values: FloatArray  # ``(K, D)`` [rad]


def warn_of_angle_keys(
    document: Document,
    curves: Sequence[AngleCurve],
    label: str,
    noun: str,
    units: ClipUnits,
    rig: Rig | None,
) -> None:
    """Warn of keys in radians where degrees are declared, and vice versa (CLIP107).

    The messages call the keys ``label``, such as ``rotation keys of``, and what has
    them ``noun``, such as ``channel``. The rig's limits show the units of pins.
    """
    angles_of_curves = [(curve, curve.values / units.angle) for curve in curves]
    angles_of_curves = [
        (curve, angles) for curve, angles in angles_of_curves if angles.any()
    ]
    if not angles_of_curves:
        return
    is_in_degrees = units.angle != 1.0
    named_angles = [(curve.name, angles) for curve, angles in angles_of_curves]
    are_all = (
        _look_like_radians(named_angles)
        if is_in_degrees
        else _look_like_degrees(named_angles, rig)
    )
    if not are_all:
        suspicious_angles = [
            (curve, angles)
            for curve, angles in angles_of_curves
            if _are_integer_degrees_in_radians(angles)
        ]
        angles_of_curves = suspicious_angles if is_in_degrees else []
    if not angles_of_curves:
        return
    worst_curve, worst_angles = max(
        angles_of_curves, key=lambda angle: np.abs(angle[1]).max()
    )
    largest_key = int(np.abs(worst_angles).max(axis=1).argmax())
    largest_angle = worst_angles[largest_key][
        np.abs(worst_angles[largest_key]).argmax()
    ]
    file_unit = "deg" if is_in_degrees else "rad"
    likely_unit, factor = OTHER_ANGLE_UNIT_AND_FACTOR[file_unit]
    message = (
        f"{label} {counted(len(angles_of_curves), noun)} look like "
        f"{ANGLE_NAMES[likely_unit]}, but the angle unit is {file_unit}: "
        f"the largest is {largest_angle:.4g}"
    )
    hint = f"this key in {ANGLE_NAMES[file_unit]}: {largest_angle * factor:.4g}"
    unit_hint = f"write 'units: {{angle: {likely_unit}}}', or {hint}"
    hint = unit_hint if are_all else f"write {hint}"
    document.warn(
        "CLIP107", (*worst_curve.location, "keys", largest_key, "v"), message, hint
    )


def _look_like_radians(angles: list[tuple[str, FloatArray]]) -> bool:
    """Return whether angles in a file in degrees look like radians."""
    values = np.concatenate([values.ravel() for _, values in angles])
    values = values[values != 0.0]
    largest = np.abs(values).max()
    multiple_count = np.count_nonzero(are_multiples(values))
    if largest <= FULL_REVOLUTION and multiple_count >= MIN_EXACT_FRACTION * len(
        values
    ):
        return True
    if not MIN_LARGEST_ANGLE <= largest <= HALF_REVOLUTION:
        return False
    if any(
        HINGE_NAMES.search(name)
        and len(channel_values) <= MAX_POSES
        and np.ptp(channel_values, axis=0).max() >= MIN_HINGE_SPAN
        for name, channel_values in angles
    ):
        return True
    moving_names = [name for name, v in angles if np.ptp(v, axis=0).max() > MIN_SPAN]
    return len(moving_names) >= MIN_ROTATING_CHANNELS and any(
        map(HINGE_NAMES.search, moving_names)
    )


def _are_integer_degrees_in_radians(values: FloatArray) -> bool:
    """Return whether rounded values are whole degrees if they are radians."""
    nonzero_values = values[values != 0.0]
    if not (
        nonzero_values.size
        and MIN_SPAN <= np.abs(nonzero_values).max() <= FULL_REVOLUTION
    ):
        return False
    degrees = np.degrees(nonzero_values)
    if not (np.abs(degrees - np.round(degrees)) <= INTEGER_TOLERANCE).all():
        return False
    return len({*nonzero_values.tolist()}) >= MIN_INTEGERS


def _look_like_degrees(angles: list[tuple[str, FloatArray]], rig: Rig | None) -> bool:
    """Return whether angles in a file in radians look like degrees."""
    beyond_revolution = [row for row in angles if _exceeds_revolution(row[1])]
    if any(_winds_up(target, values, rig) for target, values in beyond_revolution):
        return True
    has_hinge = any(HINGE_NAMES.search(target) for target, _ in beyond_revolution)
    if has_hinge and len(beyond_revolution) >= MIN_WOUND_JOINTS:
        return True
    values = np.concatenate([values.ravel() for _, values in angles])
    values = values[values != 0.0]
    are_mostly_integers = bool(np.mean(values == np.round(values)) > 0.5)
    return are_mostly_integers and _exceeds_revolution(values)


def _winds_up(target: str, values: FloatArray, rig: Rig | None) -> bool:
    """Return whether keys wind up a pin whose limits exclude it [rad]."""
    largest = np.abs(values).max()
    name = split_part(target.removeprefix("joint/"), KEYED_PARTS)[0]
    if rig is None or name not in rig.names:
        return False
    limits = rig.joints[rig.index(name)].limits
    if not isinstance(limits, RangeLimit):
        return False
    ends = [abs(end) for end in (limits.low, limits.high) if math.isfinite(end)]
    return len(ends) == 2 and bool(largest > max(ends) + FULL_REVOLUTION)


def _exceeds_revolution(values: FloatArray) -> bool:
    """Return whether the largest absolute angle exceeds a revolution [rad]."""
    return bool(FULL_REVOLUTION < np.abs(values).max() <= MAX_DEGREES)


def _warn_of_metres(clip: CheckedClip, has_unit: bool) -> None:
    """Warn of lengths that seem to be metres in a cm or mm clip (CLIP108)."""
    rig_size, unit = rest_size(clip.rig), clip.units.length
    if unit >= 1.0 or rig_size < CHARACTER_SIZES[0]:
        return
    angles = _angle_channels(clip.channels)
    rotation_ranges = [np.ptp(values, axis=0).max() for _, values in angles]
    largest_rotation = max(rotation_ranges, default=0.0)
    # An idle has small motion of all kinds.
    if rotation_ranges and largest_rotation < MIN_LIMB_ROTATION:
        return
    if not has_unit and _warn_of_small_lengths(clip):
        return
    if not rotation_ranges:
        return
    for i, channel in clip.root_translations():
        largest_distance = float(np.linalg.norm(channel.values, axis=1).max())
        net_distance = float(np.linalg.norm(channel.values[-1] - channel.values[0]))
        distance_in_metres = largest_distance / unit
        shortest_travel, longest_travel = (factor * rig_size for factor in TRAVEL_RANGE)
        is_plausible = shortest_travel <= distance_in_metres <= longest_travel
        has_returned = net_distance < largest_distance / 2
        if largest_distance > MAX_TRAVEL * rig_size or not is_plausible or has_returned:
            continue
        message = (
            f"{channel.target!r} moves by {length_text(net_distance)} while limbs "
            f"rotate by {math.degrees(largest_rotation):.0f}°; "
            f"the rig is {length_text(rig_size)} tall"
        )
        hint = "if these are metres, write 'units: {length: m}': "
        hint += f"{distance_in_metres:.3g} m"
        clip.warn("CLIP108", i, len(channel.times) - 1, message, hint)
        return


def _warn_of_small_lengths(clip: CheckedClip) -> bool:
    """Warn if all lengths of a clip without a unit are plausible metres (CLIP108)."""
    rig_size = rest_size(clip.rig)
    spans = [
        (float(np.ptp(channel.values, axis=0).max()), i)
        for i, channel, _ in clip.joint_channels(*LENGTH_PARTS)
    ]
    span, i = max(spans, default=(0.0, 0))
    span_in_metres = span / clip.units.length
    shortest_span, longest_span = (factor * rig_size for factor in METRE_RANGE)
    is_visible = span > MAX_INVISIBLE_MOTION * rig_size
    if is_visible or not shortest_span <= span_in_metres <= longest_span:
        return False
    values = clip.channels[i].values
    farthest_key = int(np.abs(values - values[0]).max(axis=1).argmax())
    unit = unit_name(clip.units.length)
    message = (
        f"the clip has no unit of length, so it is read in {unit}, the unit of its "
        f"rig: no joint moves by more than {length_text(span)}, and the rig is "
        f"{length_text(rig_size)} tall"
    )
    hint = f"for metres write 'units: {{length: m}}': {span_in_metres:.3g} m; else "
    hint += f"'units: {{length: {unit}}}'"
    clip.warn("CLIP108", i, farthest_key, message, hint)
    return True


def _warn_of_scale(clip: CheckedClip) -> None:
    """Warn of scales that look like percentages, at all keys (CLIP113)."""
    rig_size = rest_size(clip.rig)
    for i, channel, _ in clip.joint_channels("scale"):
        smallest_scale = float(np.abs(channel.values).min())
        if smallest_scale < MIN_PERCENT or rig_size * smallest_scale <= MAX_RIG_SIZE:
            continue
        message = (
            f"{channel.target!r} is {smallest_scale:.4g} or more at all keys; the rig, "
            f"which is {length_text(rig_size)} tall, is "
            f"{length_text(rig_size * smallest_scale)} with it"
        )
        hint = f"1 is the size at rest: {percent_hint(smallest_scale)}"
        clip.warn("CLIP113", i, 0, message, hint)
        return


def _warn_of_weights(document: Document, channels: Sequence[ClipChannel]) -> None:
    """Warn of shape weights that look like percentages (CLIP121)."""
    largest_weights = [
        (float(channel.values.max()), i)
        for i, channel in enumerate(channels)
        if channel.target.startswith("shape/")
    ]
    largest_weight, i = max(largest_weights, default=(0.0, 0))
    if largest_weight < MIN_PERCENT_WEIGHT:
        return
    name = channels[i].target.removeprefix("shape/")
    other_count = sum(weight >= MIN_PERCENT_WEIGHT for weight, _ in largest_weights) - 1
    message = (
        f"shape {name!r} is keyed up to {largest_weight:.4g}, but 1 is its full effect"
    )
    if other_count:
        message += (
            f"; weights of {counted(other_count, 'other shape')} are in percent too"
        )
    hint = percent_hint(largest_weight)
    k = int(channels[i].values[:, 0].argmax())
    document.warn("CLIP121", ("channels", i, "keys", k, "v"), message, hint)


def _warn_of_controls(clip: CheckedClip) -> None:
    """Warn of keys on a joint that a keyed control moves as well (CLIP111)."""
    channels, rig = clip.channels, clip.rig
    controls = [c for c in channels if c.target.startswith("control/")]
    controls = [c for c in controls if np.ptp(c.values) > 0]
    joint_channels = [
        i for i, c in enumerate(channels) if c.target.startswith("joint/")
    ]
    if not controls or not joint_channels:
        return
    times = distinct_values(np.concatenate([channel.times for channel in channels]))
    time_count = min(len(times), MAX_EVALUATED_TIMES)
    times = times[np.linspace(0, len(times) - 1, time_count).astype(int)]
    values_by_target = evaluate_channels(controls, times)
    values_by_control = {
        t.removeprefix("control/"): v[:, 0] for t, v in values_by_target.items()
    }
    driven_targets = evaluate_controls(rig.controls, values_by_control).targets
    for i in joint_channels:
        target = channels[i].target
        spans = [
            float(np.ptp(values))
            for name, values in driven_targets.items()
            if name == target or name.startswith(f"{target}.")
        ]
        channel_span = float(np.ptp(channels[i].values, axis=0).max())
        driven_span = max(spans, default=0.0)
        if not driven_span > 0 or channel_span < MIN_LAYER_FRACTION * driven_span:
            continue
        driving_names = listed(
            list(map(repr, _driving_controls(rig, target, values_by_control))), 3
        )
        is_length = target.endswith(("translation", "slide"))
        span_texts = [
            length_text(span) if is_length else f"{math.degrees(span):.4g}°"
            for span in (channel_span, driven_span)
        ]
        message = (
            f"{target!r} is keyed over {span_texts[0]}, and control {driving_names} "
        )
        message += f"moves it over {span_texts[1]}: both are added"
        clip.warn("CLIP111", i, 0, message, "remove one of them")
        return


def _driving_controls(
    rig: Rig, target: str, values_by_control: Mapping[str, FloatArray]
) -> list[str]:
    """Return the keyed controls that drive a target, or all if none does."""
    control_names = [
        control.name
        for control in rig.controls
        if control.name in values_by_control
        and any(f"{drive.target}.".startswith(f"{target}.") for drive in control.drives)
    ]
    return control_names or list(values_by_control)

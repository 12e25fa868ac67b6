"""Rules on clips: keys, and curves between and outside them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from animtool.clip.channels import ClipChannel, values_at
from animtool.clip.suspicious_times import CYCLE_TOLERANCE
from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.errors import Fault, listed
from animtool.maths import so3
from animtool.maths.curves import Interp
from animtool.rig.limits import BallLimit, RangeLimit
from animtool.rig.skeleton import Rig
from animtool.validation.subjects.clip import ClipSubject

# Closer to 180 degrees, rounding decides the direction of rotation.
MIN_HALF_ROTATION = math.radians(178.0)


def half_rotations(subject: ClipSubject) -> Iterator[Fault]:
    """Report keys 180° from the previous key, an ambiguous rotation (CLIP202)."""
    for channel_index, channel in enumerate(subject.clip.channels):
        if channel.values.shape[1] != 4:
            continue
        angles = so3.angle_between(channel.values[:-1], channel.values[1:])
        for key in np.flatnonzero(angles > MIN_HALF_ROTATION).tolist():
            if channel.interps[key] is Interp.STEP:
                continue
            message = (
                f"{channel.target!r} rotates {math.degrees(angles[key]):.1f}° from "
                f"frame {channel.times[key]:g} to {channel.times[key + 1]:g}: the "
                "direction is ambiguous"
            )
            hint = (
                "add a key between them, or use euler: XYZ, which rotates by the "
                "written angles"
            )
            location = ("channels", channel_index, "keys", key + 1, "v")
            fault = subject.fault("CLIP202", location, message, hint)
            yield replace(fault, frame=float(channel.times[key]))


# Maps values to their excess over a limit, signed or unsigned.
ExcessFunction = Callable[[FloatArray], FloatArray]

# A smaller excess over a limit is rounding in the file [rad], [m], [1].
LIMIT_TOLERANCE = 1e-6
# Keys this close belong to a sampled curve, in which angles may wrap by a full rotation
# [frame].
MAX_SAMPLE_SPACING = 2.0
# Angles that change by more between keys, although the rotations are closer than the
# second value, take a detour of 360 degrees, or of 180 degrees in two of three angles
# [rad].
MIN_FAR_ANGLE, MAX_NEAR_ROTATION = math.radians(150.0), math.radians(90.0)
# Keys farther apart in time wrap if angles change by more than the first value and the
# short path is below 60 degrees [rad]; two angles flip by 180 degrees if the third is
# as close.
MIN_WRAP_ANGLE, MAX_WRAP_SHORT_PATH = math.radians(300.0), math.radians(60.0)
# Motion that continues before or after at this fraction of the speed is a spin [1].
MIN_SPIN_RATIO = 0.5
DEGREE_SIGN = "\N{DEGREE SIGN}"


def overshooting_keys(subject: ClipSubject) -> Iterator[Fault]:
    """Report curves that exceed limits between two keys within the limits (CLIP205)."""
    times = np.array(subject.time_codes)
    for channel_index, channel in enumerate(subject.clip.channels):
        excess = _excess_function(channel, subject.rig)
        if excess is None or len(channel.times) < 2:
            continue
        is_inside = np.abs(excess(values_at(channel, channel.times))) <= LIMIT_TOLERANCE
        excess_at_times = np.abs(excess(values_at(channel, times)))
        segment_of_frame = np.searchsorted(channel.times, times, "right") - 1
        for key in np.flatnonzero(is_inside[:-1] & is_inside[1:]).tolist():
            is_outside = (segment_of_frame == key) & (excess_at_times > LIMIT_TOLERANCE)
            if is_outside.any():
                frames, excesses = times[is_outside], excess_at_times[is_outside]
                message = _excess_text(channel, key, frames, excesses)
                hint = "use tangents: auto_clamped, shorter handles, or a key between"
                location = ("channels", channel_index, "keys", key)
                fault = subject.fault("CLIP205", location, message, hint)
                yield replace(fault, frame=float(frames[0]))


def _excess_text(
    channel: ClipChannel, key: int, frames: FloatArray, excess: FloatArray
) -> str:
    """Return a message about a segment that exceeds limits, by how much and where."""
    largest_excess = float(excess.max())
    amount_text = f"{largest_excess:.3g}"
    if channel.target.endswith((".angle", ".rotation")):
        amount_text = f"{math.degrees(largest_excess):.3g}{DEGREE_SIGN}"
    key_frames = f"{channel.times[key]:g} and {channel.times[key + 1]:g}"
    frames_text = f"frame {frames[0]:g}"
    if len(frames) > 1:
        frames_text = f"frames {frames[0]:g} to {frames[-1]:g}"
    return (
        f"{channel.target!r} is within its limits at the keys of frames {key_frames}, "
        f"but exceeds them by up to {amount_text} in between, in {frames_text}"
    )


def _excess_function(channel: ClipChannel, rig: Rig) -> ExcessFunction | None:
    """Return a function from a channel's values to their excess; None if unlimited."""
    kind, _, name = channel.target.partition("/")
    if kind == "control":
        control = next(control for control in rig.controls if control.name == name)
        if control.low is None or control.high is None:
            return None
        limits = RangeLimit(control.low, control.high)
        return lambda values: limits.excess(values[:, 0])
    joint, _, coordinate = name.rpartition(".")
    if kind != "joint" or coordinate not in {"angle", "slide", "rotation"}:
        return None
    match rig.joints[rig.index(joint)].limits:
        case RangeLimit() as limits if coordinate != "rotation":
            return lambda values: limits.excess(values[:, 0])
        case BallLimit() as ball_limit if coordinate == "rotation":
            return ball_limit.excess
        case _:
            return None


def angle_flips(subject: ClipSubject) -> Iterator[Fault]:
    """Report angles that rotate a full circle from one key to the next (CLIP206)."""
    for channel_index, channel in enumerate(subject.clip.channels):
        if not channel.euler and not channel.target.endswith(".angle"):
            continue
        flip_keys = np.union1d(_flip_keys(channel), _wrap_keys(channel, subject.rig))
        if not len(flip_keys):
            continue
        first_key = int(flip_keys[0])
        message = _full_circle_text(channel, first_key)
        if len(flip_keys) > 1:
            frames = [f"{channel.times[k + 1]:g}" for k in flip_keys[1:].tolist()]
            message += f"; {len(frames)} more times, up to frames {listed(frames)}"
        location = ("channels", channel_index, "keys", first_key + 1, "v")
        hint = _unwrapping_hint(channel, first_key, subject.units.angle)
        fault = subject.fault("CLIP206", location, message, hint)
        yield replace(fault, frame=float(channel.times[first_key]))


def _full_circle_text(channel: ClipChannel, key: int) -> str:
    """Return a message about the angle that changes most between two keys."""
    first_angles = np.degrees(channel.values[key])
    second_angles = np.degrees(channel.values[key + 1])
    axis = int(np.argmax(np.abs(second_angles - first_angles)))
    frame_count = float(channel.times[key + 1] - channel.times[key])
    angle_change = abs(float(second_angles[axis] - first_angles[axis]))
    name = f" {channel.euler[axis].lower()}" if channel.euler else ""
    return (
        f"{channel.target!r}{name} rotates by {angle_change:.4g}{DEGREE_SIGN}, from "
        f"{first_angles[axis]:.5g}{DEGREE_SIGN} at frame {channel.times[key]:g} to "
        f"{second_angles[axis]:.5g}{DEGREE_SIGN} at frame {channel.times[key + 1]:g}, "
        f"{angle_change / frame_count:.3g}{DEGREE_SIGN} per frame; the shortest path "
        f"is {math.degrees(_shortest_rotation(channel, key)):.3g}{DEGREE_SIGN}"
    )


def _unwrapping_hint(channel: ClipChannel, key: int, unit: float) -> str:
    """Return a hint with the value of the next key that gives the short rotation.

    unit: angle unit of the file [rad].
    """
    first, second = channel.values[key], channel.values[key + 1]
    candidates = [
        _unwrapped(first, second),
        _nearby_equivalent_euler(channel, first, second),
    ]
    nearer_angles = min(
        (angles for angles in candidates if angles is not None),
        key=lambda angles: _value_distance(first, angles),
    )
    current_text, nearer_text = (
        ", ".join(f"{value / unit:.6g}" for value in values)
        for values in (second, nearer_angles)
    )
    if channel.euler:
        current_text, nearer_text = f"[{current_text}]", f"[{nearer_text}]"
    return f"write {current_text} as {nearer_text}, the same pose"


def _value_distance(first: FloatArray, second: FloatArray) -> float:
    return float(np.abs(second - first).max())


def _unwrapped(reference: FloatArray, angles: FloatArray) -> FloatArray:
    """Add full revolutions to angles so that they are nearest to a reference [rad]."""
    offsets = np.remainder(angles - reference + math.pi, math.tau)
    return np.asarray(reference + offsets - math.pi)


def _flip_keys(channel: ClipChannel) -> IntArray:
    """Return indices of densely sampled keys after which angles take a detour."""
    is_sampled = np.diff(channel.times) <= MAX_SAMPLE_SPACING
    is_far = (np.abs(np.diff(channel.values, axis=0)) > MIN_FAR_ANGLE).any(axis=1)
    candidate_keys = np.flatnonzero(is_sampled & is_far & _interpolated_keys(channel))
    angles = [_shortest_rotation(channel, key) for key in candidate_keys.tolist()]
    return candidate_keys[np.array(angles) < MAX_NEAR_ROTATION]


def _interpolated_keys(channel: ClipChannel) -> BoolArray:
    """Return a mask of the keys that are not held until the next key ``(K - 1,)``."""
    interps = channel.interps[:-1]
    if Interp.STEP not in interps:
        return np.ones(len(interps), bool)
    return np.array([interp is not Interp.STEP for interp in interps], bool)


def _wrap_keys(channel: ClipChannel, rig: Rig) -> IntArray:
    """Return indices of the keys after which an angle wraps, at any key spacing.

    Intended rotations continue over full circles, or end on one; a spin keeps its speed
    before or after. Wrapped angles are reduced to ±180 or 0 to 360 degrees, and reverse
    before and after.
    """
    steps = np.diff(channel.values, axis=0)
    is_interpolated = _interpolated_keys(channel)
    short_steps = np.remainder(steps + math.pi, math.tau) - math.pi
    is_wrap = (
        (np.abs(steps) > MIN_WRAP_ANGLE)
        & (np.abs(short_steps) > CYCLE_TOLERANCE)
        & is_interpolated[:, None]
    )
    limits = _angle_limits(channel, rig)
    wrap_keys = [
        key
        for key, axis in np.argwhere(is_wrap).tolist()
        if _wraps_after(channel, key, axis, float(short_steps[key, axis]), limits)
    ]
    # Necessary condition of `_nearby_equivalent_euler`, which is slower.
    is_twisted = np.abs(steps[:, ::2]).min(axis=1) > MIN_FAR_ANGLE
    flip_keys = [
        key
        for key in np.flatnonzero(is_interpolated & is_twisted).tolist()
        if _nearby_equivalent_euler(
            channel, channel.values[key], channel.values[key + 1]
        )
        is not None
    ]
    return np.array(sorted({*wrap_keys, *flip_keys}), np.int64)


def _wraps_after(
    channel: ClipChannel,
    key: int,
    axis: int,
    short_path: float,
    limits: RangeLimit | None,
) -> bool:
    """Return whether an angle wraps after a key; ``short_path`` is the short step."""
    angles = channel.values[:, axis]
    first_angle, second_angle = float(angles[key]), float(angles[key + 1])
    if limits is not None and not limits.low <= first_angle + short_path <= limits.high:
        return False
    speeds = np.diff(angles) / np.diff(channel.times)
    adjacent_speeds = [
        float(speeds[j]) for j in (key - 1, key + 1) if 0 <= j < len(speeds)
    ]
    if any(speed / speeds[key] >= MIN_SPIN_RATIO for speed in adjacent_speeds):
        return False
    largest_angle = max(abs(first_angle), abs(second_angle))
    if first_angle * second_angle < 0 and largest_angle <= math.pi + CYCLE_TOLERANCE:
        return True
    # Within another revolution, only reversed motion before and after is a sign of
    # wrapping.
    return len(adjacent_speeds) == 2 and all(
        speed * short_path > 0 for speed in adjacent_speeds
    )


def _angle_limits(channel: ClipChannel, rig: Rig) -> RangeLimit | None:
    """Return the limits of the hinge angle that a channel animates, or None."""
    joint, _, coordinate = channel.target.removeprefix("joint/").rpartition(".")
    if coordinate != "angle":
        return None
    limits = rig.joints[rig.index(joint)].limits
    return limits if isinstance(limits, RangeLimit) else None


def _nearby_equivalent_euler(
    channel: ClipChannel, first: FloatArray, second: FloatArray
) -> FloatArray | None:
    """Return the other Euler angles of a rotation if they are near ``first`` [rad].

    Two of three differ by half a revolution, and the middle one is mirrored; None for
    other differences.
    """
    if len(second) != 3 or len(set(channel.euler)) < 3:
        return None
    angle_steps = np.abs(second - first)
    if angle_steps[[0, 2]].min() <= MIN_FAR_ANGLE:
        return None
    equivalent_angles = [second[0] + math.pi, math.pi - second[1], second[2] + math.pi]
    angles = _unwrapped(first, np.array(equivalent_angles))
    return angles if _value_distance(first, angles) < MAX_WRAP_SHORT_PATH else None


def _shortest_rotation(channel: ClipChannel, key: int) -> float:
    """Return the rotation angle between two keys [rad]."""
    if not channel.euler:
        angle_step = float(channel.values[key + 1, 0] - channel.values[key, 0])
        return abs(math.remainder(angle_step, math.tau))
    first, second = values_at(channel, channel.times[key : key + 2])
    return float(so3.angle_between(first[None], second[None])[0])

"""Rules on clips: keys, and curves between and beyond them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from animtool.clip.channels import ClipChannel, evaluate_channels
from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.errors import Fault, listed
from animtool.maths import so3
from animtool.maths.curves import Extrapolation, Interp
from animtool.rig.limits import BallLimit, RangeLimit
from animtool.rig.skeleton import Rig
from animtool.validation.subjects.clip import ClipSubject

# Closer to 180 degrees, rounding decides the direction of rotation.
NEAR_HALF_ROTATION = math.radians(178.0)


def half_rotations(subject: ClipSubject) -> Iterator[Fault]:
    """Yield keys 180° from the previous one: the direction is ambiguous (CLIP202)."""
    for i, channel in enumerate(subject.clip.channels):
        if channel.values.shape[1] != 4:
            continue
        angles = so3.angle_between(channel.values[:-1], channel.values[1:])
        for k in np.flatnonzero(angles > NEAR_HALF_ROTATION).tolist():
            if channel.interps[k] is Interp.STEP:
                continue
            message = (
                f"{channel.target!r} rotates {math.degrees(angles[k]):.1f}° from "
                f"frame {channel.times[k]:g} to {channel.times[k + 1]:g}: the "
                "direction is ambiguous"
            )
            hint = (
                "add a key between them, or use euler: XYZ, which rotates by the "
                "written angles"
            )
            location = ("channels", i, "keys", k + 1, "v")
            fault = subject.fault("CLIP202", location, message, hint)
            yield replace(fault, frame=float(channel.times[k]))


# Maps values to their excess over a limit, signed or unsigned.
Excess = Callable[[FloatArray], FloatArray]

# A smaller excess over a limit is rounding in the file [rad], [m], [1].
LIMIT_TOLERANCE = 1e-6
# Keys this close belong to a sampled curve, in which angles may wrap by a full rotation
# [frame].
MAX_SAMPLE_SPACING = 2.0
# Angles that change by more between keys, although the rotations are closer than the
# second value, take a detour of 360 degrees, or of 180 degrees in two of three angles
# [rad].
FAR_ANGLE, NEAR_ROTATION = math.radians(150.0), math.radians(90.0)
# Keys farther apart in time wrap if angles change by more than the first value and the
# short path is below 60 degrees [rad]; two angles flip by 180 degrees if the third is
# as close.
WRAP_ANGLE, WRAP_SHORT_PATH = math.radians(300.0), math.radians(60.0)
# A speed that continues at this fraction before or after is a spin [1].
SPIN_RATIO = 0.5
DEG = "\N{DEGREE SIGN}"
# Ends of a cycle that differ by less look equal [rad]; of the value range [1].
CYCLE_TOLERANCE = 1e-3


def overshoot(subject: ClipSubject) -> Iterator[Fault]:
    """Yield curves that exceed limits between keys within them (CLIP205)."""
    times = np.array(subject.frames)
    for i, channel in enumerate(subject.clip.channels):
        excess = _excess(channel, subject.rig)
        if excess is None or len(channel.times) < 2:
            continue
        is_inside = np.abs(excess(_at(channel, channel.times))) <= LIMIT_TOLERANCE
        excess_at_times = np.abs(excess(_at(channel, times)))
        segments = np.searchsorted(channel.times, times, "right") - 1
        for k in np.flatnonzero(is_inside[:-1] & is_inside[1:]).tolist():
            frames = np.flatnonzero(
                (segments == k) & (excess_at_times > LIMIT_TOLERANCE)
            )
            if len(frames):
                message = _excess_text(
                    channel, k, times[frames], excess_at_times[frames]
                )
                hint = "use tangents: auto_clamped, shorter handles, or a key between"
                location = ("channels", i, "keys", k)
                fault = subject.fault("CLIP205", location, message, hint)
                yield replace(fault, frame=float(times[frames[0]]))


def _excess_text(
    channel: ClipChannel, k: int, frames: FloatArray, excess: FloatArray
) -> str:
    """Return text on the frames of a segment that exceed limits."""
    largest = float(excess.max())
    is_angle = channel.target.endswith((".angle", ".rotation"))
    amount_text = (
        f"{math.degrees(largest):.3g}\N{DEGREE SIGN}" if is_angle else f"{largest:.3g}"
    )
    key_frames = f"{channel.times[k]:g} and {channel.times[k + 1]:g}"
    frames_text = f"frame {frames[0]:g}"
    if len(frames) > 1:
        frames_text = f"frames {frames[0]:g} to {frames[-1]:g}"
    return (
        f"{channel.target!r} is within its limits at the keys of frames {key_frames}, "
        f"but exceeds them by up to {amount_text} in between, in {frames_text}"
    )


def _excess(channel: ClipChannel, rig: Rig) -> Excess | None:
    """Return a function of how far a channel's values exceed its target's limits."""
    kind, _, name = channel.target.partition("/")
    if kind == "control":
        control = next(c for c in rig.controls if c.name == name)
        lower, upper = control.low, control.high
        if lower is None or upper is None:
            return None
        limits = RangeLimit(lower, upper)
        return lambda values: limits.excess(values[:, 0])
    joint, _, part = name.rpartition(".")
    if kind != "joint" or part not in {"angle", "slide", "rotation"}:
        return None
    match rig.joints[rig.index(joint)].limits:
        case RangeLimit() as limits if part != "rotation":
            return lambda values: limits.excess(values[:, 0])
        case BallLimit() as ball if part == "rotation":
            return ball.excess
        case _:
            return None


def _at(channel: ClipChannel, times: FloatArray) -> FloatArray:
    """Return the values of a channel at times ``(F, D)``, rotations as quaternions."""
    values = evaluate_channels([channel], times)[channel.target]
    return np.broadcast_to(values, (len(times), values.shape[1]))


def angle_flips(subject: ClipSubject) -> Iterator[Fault]:
    """Yield angles that rotate a full circle from one key to the next (CLIP206)."""
    for i, channel in enumerate(subject.clip.channels):
        if not channel.euler and not channel.target.endswith(".angle"):
            continue
        flips = np.union1d(_flips(channel), _wraps(channel, subject.rig))
        if not len(flips):
            continue
        k = int(flips[0])
        message = _round_text(channel, k)
        if len(flips) > 1:
            frames = listed([f"{channel.times[j + 1]:g}" for j in flips[1:].tolist()])
            message += f"; {len(flips) - 1} more times, up to frames {frames}"
        location = ("channels", i, "keys", k + 1, "v")
        hint = _unwrapping_hint(channel, k, subject.units.angle)
        fault = subject.fault("CLIP206", location, message, hint)
        yield replace(fault, frame=float(channel.times[k]))


def _round_text(channel: ClipChannel, k: int) -> str:
    """Return text on an angle that rotates a full circle after a key."""
    first_angles, second_angles = (
        np.degrees(channel.values[k]),
        np.degrees(channel.values[k + 1]),
    )
    axis = int(np.argmax(np.abs(second_angles - first_angles)))
    frames = float(channel.times[k + 1] - channel.times[k])
    angle = abs(float(second_angles[axis] - first_angles[axis]))
    name = f" {channel.euler[axis].lower()}" if channel.euler else ""
    return (
        f"{channel.target!r}{name} rotates by {angle:.4g}{DEG}, from "
        f"{first_angles[axis]:.5g}{DEG} at frame {channel.times[k]:g} to "
        f"{second_angles[axis]:.5g}{DEG} "
        f"at frame {channel.times[k + 1]:g}, {angle / frames:.3g}{DEG} per frame; the "
        f"shortest path is {math.degrees(_shortest(channel, k)):.3g}{DEG}"
    )


def _unwrapping_hint(channel: ClipChannel, k: int, unit: float) -> str:
    """Return how to write the next key so that rotation takes the short path.

    unit: angle unit of the file [rad].
    """
    first, second = channel.values[k], channel.values[k + 1]
    nearer_angles = first + np.remainder(second - first + math.pi, math.tau) - math.pi
    equivalent = _nearer_angles(channel, first, second)
    if equivalent is not None and _distance(first, equivalent) < _distance(
        first, nearer_angles
    ):
        nearer_angles = equivalent
    current_text, nearer_text = (
        ", ".join(f"{value / unit:.6g}" for value in values)
        for values in (second, nearer_angles)
    )
    if channel.euler:
        current_text, nearer_text = f"[{current_text}]", f"[{nearer_text}]"
    return f"write {current_text} as {nearer_text}, the same pose"


def _distance(first: FloatArray, second: FloatArray) -> float:
    return float(np.abs(second - first).max())


def _flips(channel: ClipChannel) -> IntArray:
    """Return the keys of a sampled curve after which angles wrap."""
    is_sampled = np.diff(channel.times) <= MAX_SAMPLE_SPACING
    is_far = (np.abs(np.diff(channel.values, axis=0)) > FAR_ANGLE).any(axis=1)
    flips = np.flatnonzero(is_sampled & is_far & _interpolated_keys(channel))
    return flips[[_shortest(channel, k) < NEAR_ROTATION for k in flips.tolist()]]


def _interpolated_keys(channel: ClipChannel) -> BoolArray:
    """Return which keys, except the last, are not held until the next ``(K - 1,)``."""
    interps = channel.interps[:-1]
    if Interp.STEP not in interps:
        return np.ones(len(interps), bool)
    return np.array([interp is not Interp.STEP for interp in interps], bool)


def _wraps(channel: ClipChannel, rig: Rig) -> IntArray:
    """Return the keys after which an angle wraps, whatever the key spacing.

    Intended rotations continue over full circles, or end on one; a spin keeps its speed
    before or after. Wrapped angles are reduced to ±180 or 0 to 360 degrees, and reverse
    before and after.
    """
    steps, is_moving = np.diff(channel.values, axis=0), _interpolated_keys(channel)
    short_path = np.remainder(steps + math.pi, math.tau) - math.pi
    is_wrap = (
        (np.abs(steps) > WRAP_ANGLE)
        & (np.abs(short_path) > CYCLE_TOLERANCE)
        & is_moving[:, None]
    )
    limits = _range_of(channel, rig)
    wrapping_axes = [
        k
        for k, axis in np.argwhere(is_wrap).tolist()
        if _wraps_after(channel, k, axis, float(short_path[k, axis]), limits)
    ]
    # Necessary condition of `_nearer_angles`, which is too slow for every key.
    is_twisted = np.abs(steps[:, ::2]).min(axis=1) > FAR_ANGLE
    flipping_axes = [
        k
        for k in np.flatnonzero(is_moving & is_twisted).tolist()
        if _nearer_angles(channel, channel.values[k], channel.values[k + 1]) is not None
    ]
    return np.unique(np.array([*wrapping_axes, *flipping_axes], np.int64))


def _wraps_after(
    channel: ClipChannel,
    k: int,
    axis: int,
    short_path: float,
    limits: RangeLimit | None,
) -> bool:
    """Return whether an axis wraps after a key; ``short`` is the short path."""
    values = channel.values[:, axis]
    first_value, second_value = float(values[k]), float(values[k + 1])
    if limits is not None and not limits.low <= first_value + short_path <= limits.high:
        return False
    rates_around = np.diff(values) / np.diff(channel.times)
    neighbours = [
        float(rates_around[j]) for j in (k - 1, k + 1) if 0 <= j < len(rates_around)
    ]
    if any(rate / rates_around[k] >= SPIN_RATIO for rate in neighbours):
        return False
    if (
        first_value * second_value < 0
        and max(abs(first_value), abs(second_value)) <= math.pi + CYCLE_TOLERANCE
    ):
        return True
    # Within another revolution, only reversed motion before and after is a sign of
    # wrapping.
    return len(neighbours) == 2 and all(rate * short_path > 0 for rate in neighbours)


def _range_of(channel: ClipChannel, rig: Rig) -> RangeLimit | None:
    """Return the angle limits of a pin joint; None without limits."""
    joint, _, part = channel.target.removeprefix("joint/").rpartition(".")
    if part != "angle":
        return None
    limits = rig.joints[rig.index(joint)].limits
    return limits if isinstance(limits, RangeLimit) else None


def _nearer_angles(
    channel: ClipChannel, first: FloatArray, second: FloatArray
) -> FloatArray | None:
    """Return the equivalent Euler angles of a rotation, if much nearer to another.

    Two of three differ by half a revolution, and the middle one is mirrored; None for
    other differences.
    """
    if len(second) != 3 or len(set(channel.euler)) < 3:
        return None
    equivalent = np.array(
        [second[0] + math.pi, math.pi - second[1], second[2] + math.pi]
    )
    equivalent = first + np.remainder(equivalent - first + math.pi, math.tau) - math.pi
    steps = np.abs(second - first)
    is_twisted = steps[[0, 2]].min() > FAR_ANGLE
    return (
        equivalent
        if is_twisted and _distance(first, equivalent) < WRAP_SHORT_PATH
        else None
    )


def _shortest(channel: ClipChannel, k: int) -> float:
    """Return the rotation angle between two keys [rad]."""
    if not channel.euler:
        angle_step = float(channel.values[k + 1, 0] - channel.values[k, 0])
        return abs(math.remainder(angle_step, math.tau))
    first, second = _at(channel, channel.times[k : k + 2])
    return float(so3.angle_between(first[None], second[None])[0])


def open_cycles(subject: ClipSubject) -> Iterator[Fault]:
    """Yield channels with a discontinuity where their cycle repeats (CLIP207)."""
    clip = subject.clip
    for i, channel in enumerate(clip.channels):
        for key, extrapolation, is_reached in (
            ("pre", channel.pre, float(clip.first) < channel.times[0]),
            ("post", channel.post, float(clip.last) > channel.times[-1]),
        ):
            if (
                extrapolation is not Extrapolation.CYCLE
                or not is_reached
                or _is_closed(channel)
            ):
                continue
            first_time, last_time = channel.times[0], channel.times[-1]
            message = (
                f"{channel.target!r} repeats frames {first_time:g} to {last_time:g}, "
                "but its first and last values differ, so every repeat jumps"
            )
            hint = (
                "give both the same value, or use cycle_offset to continue from the "
                "last"
            )
            yield subject.fault("CLIP207", ("channels", i, key), message, hint)


def _is_closed(channel: ClipChannel) -> bool:
    """Return whether a channel ends as it begins, modulo full rotations."""
    first_value, last_value = channel.values[0], channel.values[-1]
    if (
        channel.target.endswith(".angle")
        and abs(last_value[0] - first_value[0]) > FAR_ANGLE
    ):
        return (
            abs(math.remainder(float(last_value[0] - first_value[0]), math.tau))
            <= CYCLE_TOLERANCE
        )
    if channel.euler or channel.values.shape[1] == 4:
        end_rotations = _at(channel, channel.times[[0, -1]])
        return (
            float(so3.angle_between(end_rotations[:1], end_rotations[1:])[0])
            <= CYCLE_TOLERANCE
        )
    value_range = float(np.ptp(channel.values, axis=0).max())
    return (
        float(np.abs(last_value - first_value).max()) <= CYCLE_TOLERANCE * value_range
    )

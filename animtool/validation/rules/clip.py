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
            at = ("channels", i, "keys", k + 1, "v")
            fault = subject.fault("CLIP202", at, message, hint)
            yield replace(fault, frame=float(channel.times[k]))


# Function of how far values exceed a limit, signed or not.
Excess = Callable[[FloatArray], FloatArray]

# A smaller excess over a limit is rounding in the file [rad], [m], [1].
SLACK = 1e-6
# Keys this close [frame] belong to a sampled curve, in which angles wrap by a full
# rotation without meaning.
SAMPLED = 2.0
# Angles that change more between keys, though the rotations are closer, take a detour:
# by 360 degrees, or by 180 degrees of two of three [rad].
FAR, NEAR = math.radians(150.0), math.radians(90.0)
# Keys farther apart in time wrap if angles change by more than this, and the short path
# is below 60 degrees [rad]; angles flip, two by 180 degrees, if the third is as close.
ROUND, ROUND_NEAR = math.radians(300.0), math.radians(60.0)
# A speed that continues at this fraction before or after is a spin [1].
SPIN = 0.5
DEG = "\N{DEGREE SIGN}"
# Ends of a cycle that differ by less look equal [rad]; of the value range [1].
OPEN = 1e-3


def overshoot(subject: ClipSubject) -> Iterator[Fault]:
    """Yield curves that exceed limits between keys within them (CLIP205)."""
    times = np.array(subject.frames)
    for i, channel in enumerate(subject.clip.channels):
        excess = _excess(channel, subject.rig)
        if excess is None or len(channel.times) < 2:
            continue
        inside = np.abs(excess(_at(channel, channel.times))) <= SLACK
        over = np.abs(excess(_at(channel, times)))
        segments = np.searchsorted(channel.times, times, "right") - 1
        for k in np.flatnonzero(inside[:-1] & inside[1:]).tolist():
            frames = np.flatnonzero((segments == k) & (over > SLACK))
            if len(frames):
                message = _beyond(channel, k, times[frames], over[frames])
                hint = "use tangents: auto_clamped, shorter handles, or a key between"
                at = ("channels", i, "keys", k)
                fault = subject.fault("CLIP205", at, message, hint)
                yield replace(fault, frame=float(times[frames[0]]))


def _beyond(channel: ClipChannel, k: int, frames: FloatArray, over: FloatArray) -> str:
    """Return text on the frames of a segment that exceed limits."""
    most = float(over.max())
    angle = channel.target.endswith((".angle", ".rotation"))
    much = f"{math.degrees(most):.3g}\N{DEGREE SIGN}" if angle else f"{most:.3g}"
    ends = f"{channel.times[k]:g} and {channel.times[k + 1]:g}"
    where = f"frame {frames[0]:g}"
    if len(frames) > 1:
        where = f"frames {frames[0]:g} to {frames[-1]:g}"
    return (
        f"{channel.target!r} is within its limits at the keys of frames {ends}, but "
        f"exceeds them by up to {much} in between, in {where}"
    )


def _excess(channel: ClipChannel, rig: Rig) -> Excess | None:
    """Return a function of how far a channel's values exceed its target's limits."""
    kind, _, name = channel.target.partition("/")
    if kind == "control":
        control = next(c for c in rig.controls if c.name == name)
        low, high = control.low, control.high
        if low is None or high is None:
            return None
        limits = RangeLimit(low, high)
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
        message = _round(channel, k)
        if len(flips) > 1:
            frames = listed([f"{channel.times[j + 1]:g}" for j in flips[1:].tolist()])
            message += f"; {len(flips) - 1} more times, up to frames {frames}"
        at = ("channels", i, "keys", k + 1, "v")
        hint = _unwrapping(channel, k, subject.units.angle)
        fault = subject.fault("CLIP206", at, message, hint)
        yield replace(fault, frame=float(channel.times[k]))


def _round(channel: ClipChannel, k: int) -> str:
    """Return text on an angle that rotates a full circle after a key."""
    one, two = np.degrees(channel.values[k]), np.degrees(channel.values[k + 1])
    axis = int(np.argmax(np.abs(two - one)))
    frames = float(channel.times[k + 1] - channel.times[k])
    angle = abs(float(two[axis] - one[axis]))
    name = f" {channel.euler[axis].lower()}" if channel.euler else ""
    return (
        f"{channel.target!r}{name} rotates by {angle:.4g}{DEG}, from "
        f"{one[axis]:.5g}{DEG} at frame {channel.times[k]:g} to {two[axis]:.5g}{DEG} "
        f"at frame {channel.times[k + 1]:g}, {angle / frames:.3g}{DEG} per frame; the "
        f"shortest path is {math.degrees(_shortest(channel, k)):.3g}{DEG}"
    )


def _unwrapping(channel: ClipChannel, k: int, unit: float) -> str:
    """Return how to write the next key so that rotation takes the short path.

    unit: of the file [rad].
    """
    one, two = channel.values[k], channel.values[k + 1]
    nearer = one + np.remainder(two - one + math.pi, math.tau) - math.pi
    flipped = _flipped(channel, one, two)
    if flipped is not None and _far(one, flipped) < _far(one, nearer):
        nearer = flipped
    written, better = (
        ", ".join(f"{value / unit:.6g}" for value in values) for values in (two, nearer)
    )
    if channel.euler:
        written, better = f"[{written}]", f"[{better}]"
    return f"write {written} as {better}, the same pose"


def _far(one: FloatArray, two: FloatArray) -> float:
    return float(np.abs(two - one).max())


def _flips(channel: ClipChannel) -> IntArray:
    """Return the keys of a sampled curve after which angles wrap."""
    near = np.diff(channel.times) <= SAMPLED
    far = (np.abs(np.diff(channel.values, axis=0)) > FAR).any(axis=1)
    flips = np.flatnonzero(near & far & _moving(channel))
    return flips[[_shortest(channel, k) < NEAR for k in flips.tolist()]]


def _moving(channel: ClipChannel) -> BoolArray:
    """Return which keys but the last do not hold until the next ``(K - 1,)``."""
    interps = channel.interps[:-1]
    if Interp.STEP not in interps:
        return np.ones(len(interps), bool)
    return np.array([how is not Interp.STEP for how in interps], bool)


def _wraps(channel: ClipChannel, rig: Rig) -> IntArray:
    """Return the keys after which an angle wraps, whatever the key spacing.

    Intended rotations continue over full circles, or end on one; a spin keeps its speed
    before or after. Wrapped angles are reduced to ±180 or 0 to 360 degrees, and reverse
    before and after.
    """
    steps, moving = np.diff(channel.values, axis=0), _moving(channel)
    short = np.remainder(steps + math.pi, math.tau) - math.pi
    wraps = (np.abs(steps) > ROUND) & (np.abs(short) > OPEN) & moving[:, None]
    limits = _range_of(channel, rig)
    far = [
        k
        for k, axis in np.argwhere(wraps).tolist()
        if _wrapped(channel, k, axis, float(short[k, axis]), limits)
    ]
    # As `_flipped` needs, whose arithmetic is too slow for every key.
    twisted = np.abs(steps[:, ::2]).min(axis=1) > FAR
    flipped = [
        k
        for k in np.flatnonzero(moving & twisted).tolist()
        if _flipped(channel, channel.values[k], channel.values[k + 1]) is not None
    ]
    return np.unique(np.array([*far, *flipped], np.int64))


def _wrapped(
    channel: ClipChannel,
    k: int,
    axis: int,
    short: float,
    limits: RangeLimit | None,
) -> bool:
    """Return whether an axis wraps after a key; ``short`` is the short path."""
    values = channel.values[:, axis]
    one, two = float(values[k]), float(values[k + 1])
    if limits is not None and not limits.low <= one + short <= limits.high:
        return False
    rates = np.diff(values) / np.diff(channel.times)
    neighbours = [float(rates[j]) for j in (k - 1, k + 1) if 0 <= j < len(rates)]
    if any(rate / rates[k] >= SPIN for rate in neighbours):
        return False
    if one * two < 0 and max(abs(one), abs(two)) <= math.pi + OPEN:
        return True
    # Within another turn only what goes on the other way, before and behind, tells.
    return len(neighbours) == 2 and all(rate * short > 0 for rate in neighbours)


def _range_of(channel: ClipChannel, rig: Rig) -> RangeLimit | None:
    """Return the angle limits of a pin joint; None without limits."""
    joint, _, part = channel.target.removeprefix("joint/").rpartition(".")
    if part != "angle":
        return None
    limits = rig.joints[rig.index(joint)].limits
    return limits if isinstance(limits, RangeLimit) else None


def _flipped(
    channel: ClipChannel, one: FloatArray, two: FloatArray
) -> FloatArray | None:
    """Return the equivalent Euler angles of a rotation, if much nearer to another.

    Two of three differ by half a turn, and the middle one is mirrored; None where
    that is not so.
    """
    if len(two) != 3 or len(set(channel.euler)) < 3:
        return None
    other = np.array([two[0] + math.pi, math.pi - two[1], two[2] + math.pi])
    other = one + np.remainder(other - one + math.pi, math.tau) - math.pi
    steps = np.abs(two - one)
    twisted = steps[[0, 2]].min() > FAR
    return other if twisted and _far(one, other) < ROUND_NEAR else None


def _shortest(channel: ClipChannel, k: int) -> float:
    """Return the rotation angle between two keys [rad]."""
    if not channel.euler:
        step = float(channel.values[k + 1, 0] - channel.values[k, 0])
        return abs(math.remainder(step, math.tau))
    one, two = _at(channel, channel.times[k : k + 2])
    return float(so3.angle_between(one[None], two[None])[0])


def open_cycles(subject: ClipSubject) -> Iterator[Fault]:
    """Yield channels with a discontinuity where their cycle repeats (CLIP207)."""
    clip = subject.clip
    for i, channel in enumerate(clip.channels):
        for key, how, reached in (
            ("pre", channel.pre, float(clip.first) < channel.times[0]),
            ("post", channel.post, float(clip.last) > channel.times[-1]),
        ):
            if how is not Extrapolation.CYCLE or not reached or _meets(channel):
                continue
            first, last = channel.times[0], channel.times[-1]
            message = (
                f"{channel.target!r} repeats frames {first:g} to {last:g}, but its "
                "first and last values differ, so every repeat jumps"
            )
            hint = (
                "give both the same value, or use cycle_offset to continue from the "
                "last"
            )
            yield subject.fault("CLIP207", ("channels", i, key), message, hint)


def _meets(channel: ClipChannel) -> bool:
    """Return whether a channel ends as it begins, modulo full rotations."""
    first, last = channel.values[0], channel.values[-1]
    if channel.target.endswith(".angle") and abs(last[0] - first[0]) > FAR:
        return abs(math.remainder(float(last[0] - first[0]), math.tau)) <= OPEN
    if channel.euler or channel.values.shape[1] == 4:
        ends = _at(channel, channel.times[[0, -1]])
        return float(so3.angle_between(ends[:1], ends[1:])[0]) <= OPEN
    spread = float(np.ptp(channel.values, axis=0).max())
    return float(np.abs(last - first).max()) <= OPEN * spread

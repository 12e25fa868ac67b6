"""Curves of an FBX: keys, tangents, and what lies outside of them.

References: Autodesk, *FBX SDK documentation*, `FbxAnimCurve` and `FbxAnimCurveKey`.
Between two keys a cubic segment is a Bézier curve whose handles lie at a weight of the
segment's time, a third where the key states none, along the slopes of the keys.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.formats.fbx.elements import Element, floats, integers, number
from animtool.formats.fbx.settings import TICKS
from animtool.formats.gltf.places import Notes

CONSTANT, NEXT, LINEAR, CUBIC = range(4)
THIRD = 1.0 / 3.0
MAX_KEYS = 20_000_000
# Ticks of a time that is read; 2^62 leaves room for sums.
MAX_TICKS = 2**61
# Handles of files count ten-thousandths; a comment in one file has 9,999 of them.
_WEIGHT = 1e-4


@dataclass(frozen=True, slots=True)
class Outside:
    """What a curve does before or after its keys.

    mode: C holds, R repeats, A repeats with offset, M mirrors, K goes on straight.
    count: How often; below 0 without end.
    """

    mode: str = "C"
    count: int = -1


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """One value over time.

    Attributes:
        times: Of its K keys, ascending ``(K,)`` [ticks].
        values: ``(K,)``.
        modes: How each goes on to the next ``(K,)``.
        right: Slope out of each key ``(K,)`` [1/s].
        left: Slope into the next key ``(K,)`` [1/s].
        weights: Of the handles out of each key and into the next, of the segment's
            time ``(K, 2)``.
        pre: Before the first key.
        post: After the last key.
    """

    times: IntArray
    values: FloatArray
    modes: IntArray
    right: FloatArray
    left: FloatArray
    weights: FloatArray
    pre: Outside = Outside()
    post: Outside = Outside()

    def is_static(self) -> bool:
        """Return whether it has one value for all times."""
        if (self.values != self.values[0]).any():
            return False
        cubic = self.modes[:-1] == CUBIC
        sloped = (self.right[:-1] != 0) | (self.left[:-1] != 0)
        straight = "K" in {self.pre.mode, self.post.mode} and len(self.times) > 1
        return not (cubic & sloped).any() and not straight

    def at(self, ticks: IntArray) -> FloatArray:
        """Return the values at times ``(F,)`` [ticks]."""
        first, last = int(self.times[0]), int(self.times[-1])
        found = self._inside(np.clip(ticks, first, last))
        for outside, late in ((self.pre, False), (self.post, True)):
            rows = ticks > last if late else ticks < first
            if rows.any() and outside.mode != "C" and last > first:
                found[rows] = self._outside(ticks[rows], outside, late=late)
        return found

    def _outside(self, ticks: IntArray, how: Outside, *, late: bool) -> FloatArray:
        first, last = int(self.times[0]), int(self.times[-1])
        span = last - first
        away = ticks - last if late else first - ticks
        if how.mode == "K":
            slope = self._end_slope(late=late)
            end = self.values[-1 if late else 0]
            return np.asarray(end + slope * (ticks - (last if late else first)) / TICKS)
        turns, rest = np.divmod(away, span)
        if how.count >= 0:
            over = turns >= how.count
            turns = np.where(over, max(how.count - 1, 0), turns)
            rest = np.where(over, span if how.count else 0, rest)
            if not how.count and how.mode != "M":
                rest = np.full_like(rest, span)
                turns = turns - 1
        back = np.full(len(ticks), not late)
        if how.mode == "M":
            back = (turns % 2 == 0) == late
        inside = self._inside(np.where(back, last - rest, first + rest))
        if how.mode == "A":
            step = self.values[-1] - self.values[0]
            inside = inside + (turns + 1) * (step if late else -step)
        return inside

    def _end_slope(self, *, late: bool) -> float:
        k = len(self.times) - 2 if late else 0
        if self.modes[k] == CUBIC:
            return float(self.left[k] if late else self.right[k])
        if self.modes[k] == LINEAR:
            span = float(self.times[k + 1] - self.times[k]) / TICKS
            return float(self.values[k + 1] - self.values[k]) / span
        return 0.0

    def _inside(self, ticks: IntArray) -> FloatArray:
        """Return the values at times between the first key and the last."""
        if len(self.times) == 1:
            return np.full(len(ticks), self.values[0])
        k = np.searchsorted(self.times, ticks, "right") - 1
        k = np.clip(k, 0, len(self.times) - 1)
        found = self.values[k].copy()
        between = ticks != self.times[k]
        if not between.any():
            return found
        rows = np.flatnonzero(between)
        k = k[rows]
        mode = self.modes[k]
        span = (self.times[k + 1] - self.times[k]).astype(np.float64)
        share = (ticks[rows] - self.times[k]) / span
        low, high = self.values[k], self.values[k + 1]
        own = np.where(mode == NEXT, high, low)
        own = np.where(mode == LINEAR, low + share * (high - low), own)
        cubic = mode == CUBIC
        if cubic.any():
            k, seconds = k[cubic], span[cubic] / TICKS
            weights = self.weights[k]
            u = bezier_parameter(share[cubic], weights)
            a = low[cubic] + self.right[k] * weights[:, 0] * seconds
            b = high[cubic] - self.left[k] * weights[:, 1] * seconds
            v = 1.0 - u
            own[cubic] = v * v * (v * low[cubic] + 3 * u * a)
            own[cubic] += u * u * (u * high[cubic] + 3 * v * b)
        found[rows] = own
        return found


def bezier_parameter(share: FloatArray, weights: FloatArray) -> FloatArray:
    """Return where on a Bézier segment a share of its time is ``(F,)``.

    By bisection, then Newton's method where it stays between the bounds.
    """
    u = share.copy()
    odd = np.flatnonzero(np.abs(weights - THIRD).max(axis=1) > 1e-9)
    if not len(odd):
        return u
    s, a, b = share[odd], weights[odd, 0], 1.0 - weights[odd, 1]
    low, high = np.zeros(len(s)), np.ones(len(s))
    x = s.copy()
    for _ in range(60):
        y = 1.0 - x
        off = 3 * y * y * x * a + 3 * y * x * x * b + x**3 - s
        low, high = np.where(off <= 0, x, low), np.where(off >= 0, x, high)
        slope = 3 * y * y * a + 6 * y * x * (b - a) + 3 * x * x * (1 - b)
        step = x - off / np.where(np.abs(slope) > 1e-12, slope, 1e-12)
        inside = (step > low) & (step < high)
        after = np.where(inside, step, 0.5 * (low + high))
        done = np.abs(after - x).max() < 1e-15
        x = after
        if done:
            break
    u[odd] = x
    return u


def curve_of_object(element: Element, notes: Notes) -> Curve | None:
    """Return the curve of an object, as files from 7000 on have it.

    Raises:
        FormatError: Its arrays do not fit together, or times do not ascend (FBX006).
    """
    times = integers(element, "KeyTime", notes)
    if times is None or not len(times):
        return None
    count = len(times)
    values = floats(element, "KeyValueFloat", notes, count)
    flags = integers(element, "KeyAttrFlags", notes)
    data = element.find("KeyAttrDataFloat")
    counts = integers(element, "KeyAttrRefCount", notes)
    _check_times(times, element, notes)
    if values is None or flags is None or counts is None or data is None:
        return notes.fail("FBX006", element.where, "a curve lacks an array of its keys")
    raw = _bits(data, notes)
    fits = len(flags) == len(counts) and raw.size == 4 * len(flags)
    fits = fits and bool((counts >= 0).all() and (counts <= count).all())
    if not fits or int(counts.sum()) != count:
        message = f"the attributes of {count} keys do not fit them"
        notes.fail("FBX006", element.where, message)
    if (flags & 8 != 0)[flags & _TCB != 0].any():
        message = "tangents by tension, continuity and bias are not read"
        notes.fail("FBX004", element.where, message, "bake the curves before exporting")
    flags = np.repeat(flags, counts)
    rows = np.repeat(raw.reshape(-1, 4), counts, axis=0)
    slopes = rows[:, :2].copy().view(np.float32).astype(np.float64)
    packed = rows[:, 2].astype(np.int64) & 0xFFFFFFFF
    weights = np.full((count, 2), THIRD)
    for side, (flag, own) in enumerate(
        ((0x1000000, packed & 0xFFFF), (0x2000000, packed >> 16))
    ):
        given = flags & flag != 0
        weights[given, side] = np.minimum(own[given] * _WEIGHT, 1.0)
    modes = np.where(flags & 8 != 0, CUBIC, np.where(flags & 4 != 0, LINEAR, CONSTANT))
    modes[(modes == CONSTANT) & (flags & 0x100 != 0)] = NEXT
    _put_auto_slopes(times, values, flags, slopes)
    slopes[modes != CUBIC] = 0.0
    return _checked(
        Curve(times, values, modes, slopes[:, 0], slopes[:, 1], weights),
        element,
        notes,
    )


# Flags of keys: automatic tangents, by tension, by hand, and clamped automatic ones.
_AUTO, _TCB, _USER, _PROGRESSIVE = 0x100, 0x200, 0x400, 0x4000
# A slope that is steeper than so many times that to a neighbour overshoots.
STEEPEST = 3.0


def _put_auto_slopes(
    times: IntArray, values: FloatArray, flags: IntArray, slopes: Any
) -> None:
    """Put in the slopes of automatic keys, which files do not always state.

    Between neighbours it is the slope from one to the other. Clamped ones lie flat at
    turning points and ends, and are no steeper than keeps the curve monotone (Fritsch
    and Carlson, 1980); others go along the segment at the ends.
    """
    if len(times) < 2:
        slopes[:] = 0.0
        return
    seconds = times / TICKS
    steps = np.diff(values) / (np.diff(times) / TICKS)
    own = np.concatenate([steps[:1], np.zeros(len(times) - 2), steps[-1:]])
    own[1:-1] = (values[2:] - values[:-2]) / (seconds[2:] - seconds[:-2])
    clamped = own.copy()
    clamped[[0, -1]] = 0.0
    low, high = steps[:-1], steps[1:]
    most = STEEPEST * np.minimum(np.abs(low), np.abs(high))
    inner = np.clip(own[1:-1], -most, most)
    clamped[1:-1] = np.where(low * high <= 0.0, 0.0, inner)
    own = np.where(flags & _PROGRESSIVE != 0, clamped, own)
    auto = (flags & 8 != 0) & (flags & _AUTO != 0) & (flags & _USER == 0)
    slopes[auto, 0] = own[auto]
    slopes[:-1][auto[1:], 1] = own[1:][auto[1:]]


def _bits(data: Element, notes: Notes) -> Any:
    """Return attributes as the bits of float32; text writes them as integers."""
    values = data.values[0] if len(data.values) == 1 else np.array(data.values)
    found = np.asarray(values)
    if found.dtype.kind == "f":
        with np.errstate(all="ignore"):
            return found.astype(np.float32).view(np.int32)
    if found.dtype.kind != "i" or (np.abs(found) >= 2**32).any():
        notes.fail("FBX006", data.where, "the attributes of keys must be numbers")
    return found.astype(np.int64).astype(np.uint32).view(np.int32)


def _checked(curve: Curve, element: Element, notes: Notes) -> Curve:
    """Return a curve with what is outside of its keys, its numbers checked."""
    times = curve.times
    _check_times(times, element, notes)
    for slopes in (curve.right, curve.left):
        if not np.isfinite(slopes).all():
            notes.fail("FBX006", element.where, "a slope of a key is not finite")
    pre, post = (_outside(element, f"{name}-Extrapolation", notes) for name in _SIDES)
    return Curve(
        times,
        curve.values,
        _held_once(curve.modes),
        _held_once(curve.right),
        _held_once(curve.left),
        _held_once(curve.weights),
        pre,
        post,
    )


def _held_once(rows: Any) -> Any:
    """Return an array whose rows are all the same without a copy of each."""
    if len(rows) > 1 and (rows == rows[:1]).all():
        return np.broadcast_to(rows[0].copy(), rows.shape)
    return rows


def _check_times(times: IntArray, element: Element, notes: Notes) -> None:
    if len(times) > MAX_KEYS:
        notes.fail("FBX013", element.where, f"{len(times)} keys in one curve")
    # The least integer has no opposite.
    if (times > MAX_TICKS).any() or (times < -MAX_TICKS).any():
        notes.fail("FBX006", element.where, "the time of a key is out of range")
    if (np.diff(times) <= 0).any():
        notes.fail("FBX006", element.where, "the times of keys must ascend")


_SIDES = ("Pre", "Post")


def _outside(element: Element, name: str, notes: Notes) -> Outside:
    found = element.find(name)
    kind = None if found is None else found.find("Type")
    if found is None or kind is None or not kind.values:
        return Outside()
    mode = kind.values[0]
    if isinstance(mode, int) and 0 <= mode < 256:
        mode = chr(mode)
    if mode not in tuple("CRAMK"):
        message = f"{name} {mode!r} is not known"
        notes.fail("FBX006", kind.where, message)
    repeats = found.find("Repetition")
    count = -1.0 if repeats is None else number(repeats, 0, notes)
    return Outside(str(mode), int(max(-1.0, min(count, 1e9))))


def curve_of_channel(element: Element, notes: Notes) -> Curve | None:
    """Return the curve of a channel of a take, as files before 7000 have it.

    Raises:
        FormatError: Its keys do not parse, or their times do not ascend (FBX006).
    """
    key = element.find("Key")
    if key is None or not key.values:
        return None
    keys = _Keys(key, notes)
    rows = []
    while keys.left():
        rows.append(_key(keys))
    times, values, modes, right, left, first, second = zip(*rows, strict=True)
    curve = Curve(
        np.array(times, np.int64),
        np.array(values),
        np.array(modes, np.int64),
        np.array(right),
        np.array(left),
        np.stack([first, second], axis=1).astype(np.float64),
    )
    return _checked(curve, element, notes)


class _Keys:
    """The values of the keys of a channel, one after the other."""

    def __init__(self, element: Element, notes: Notes) -> None:
        values = element.values
        whole = len(values) == 1 and isinstance(values[0], np.ndarray)
        self.values = values[0].tolist() if whole else values
        self.element, self.notes, self.at = element, notes, 0

    def left(self) -> bool:
        return self.at < len(self.values)

    def value(self) -> Any:
        if not self.left():
            self.fail("the last key of a channel is cut off")
        self.at += 1
        return self.values[self.at - 1]

    def number(self) -> float:
        value = self.value()
        if not isinstance(value, int | float) or not abs(value) < 1e300:
            self.fail(f"{value!r} is no number of a key")
        return float(value)

    def time(self) -> int:
        value = self.value()
        if not isinstance(value, int) or abs(value) > MAX_TICKS:
            self.fail(f"{value!r} is no time of a key")
        return int(value)

    def letter(self) -> str:
        value = self.value()
        if isinstance(value, int) and 0 <= value < 256:
            value = chr(value)
        return value if isinstance(value, str) else self.fail(f"{value!r} in a key")

    def fail(self, message: str) -> Any:
        return self.notes.fail("FBX006", self.element.where, message)


def _key(keys: _Keys) -> tuple[int, float, int, float, float, float, float]:
    time, value, mode = keys.time(), keys.number(), keys.letter()
    if mode == "L":
        return time, value, LINEAR, 0.0, 0.0, THIRD, THIRD
    if mode == "C":
        after = keys.letter()
        return time, value, NEXT if after == "n" else CONSTANT, 0.0, 0.0, THIRD, THIRD
    if mode != "U":
        keys.fail(f"interpolation {mode!r} of a key is not read")
    tangent = keys.letter()
    if tangent not in "sb":
        keys.fail(f"tangents {tangent!r} of a key are not read")
    right, left = keys.number(), keys.number()
    weighted = keys.letter()
    first = keys.number() if weighted in "ar" else THIRD
    second = keys.number() if weighted in "al" else THIRD
    if weighted not in "arln":
        keys.fail(f"weights {weighted!r} of a key are not read")
    return (
        time,
        value,
        CUBIC,
        right,
        left,
        min(max(first, 0.0), 1.0),
        min(max(second, 0.0), 1.0),
    )

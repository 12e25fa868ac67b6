"""FBX animation curves: keys, tangents and extrapolation.

References: Autodesk, *FBX SDK documentation*, `FbxAnimCurve` and `FbxAnimCurveKey`.
Between two keys a cubic segment is a Bézier curve whose handles lie at a weight of the
segment's time, a third where the key states none, along the slopes of the keys.
"""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.formats.fbx.settings import TICKS

CONSTANT, NEXT, LINEAR, CUBIC = range(4)
THIRD = 1.0 / 3.0
MAX_KEYS = 20_000_000
# Ticks of a time that is read; 2^62 leaves room for sums.
MAX_TICKS = 2**61


@dataclass(frozen=True, slots=True)
class Outside:
    """Extrapolation before the first or after the last key.

    mode: C holds, R repeats, A repeats with offset, M mirrors, K goes on straight.
    count: How often; below 0 without end.
    """

    mode: str = "C"
    count: int = -1


@dataclass(frozen=True, slots=True, eq=False)
class FbxCurve:
    """Keys of one scalar over time.

    Attributes:
        times: Of its K keys, ascending ``(K,)`` [ticks].
        values: ``(K,)``.
        modes: How each goes on to the next ``(K,)``.
        right: Slope out of each key ``(K,)`` [1/s]; of straight segments theirs.
        left: Slope into the next key ``(K,)`` [1/s], likewise.
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
        """Return whether the value never changes."""
        if (self.values != self.values[0]).any():
            return False
        cubic = self.modes[:-1] == CUBIC
        sloped = (self.right[:-1] != 0) | (self.left[:-1] != 0)
        straight = "K" in {self.pre.mode, self.post.mode} and len(self.times) > 1
        return not (cubic & sloped).any() and not straight

    def at(self, ticks: IntArray) -> FloatArray:
        """Return the values at times ``(F,)`` [ticks]."""
        first, last = int(self.times[0]), int(self.times[-1])
        values = self._inside(np.clip(ticks, first, last))
        for outside, late in ((self.pre, False), (self.post, True)):
            rows = ticks > last if late else ticks < first
            if rows.any() and outside.mode != "C" and last > first:
                values[rows] = self._outside(ticks[rows], outside, late=late)
        return values

    def _outside(self, ticks: IntArray, how: Outside, *, late: bool) -> FloatArray:
        first, last = int(self.times[0]), int(self.times[-1])
        span = last - first
        away = ticks - last if late else first - ticks
        if how.mode == "K":
            slope = self.left[-2] if late else self.right[0]
            end = self.values[-1 if late else 0]
            return np.asarray(end + slope * (ticks - (last if late else first)) / TICKS)
        if how.count == 0:
            return np.full(len(ticks), self.values[-1 if late else 0])
        repeats, rest = np.divmod(away, span)
        if how.count > 0:
            over = repeats >= how.count
            repeats = np.where(over, how.count - 1, repeats)
            rest = np.where(over, span, rest)
        back = np.full(len(ticks), not late)
        if how.mode == "M":
            back = (repeats % 2 == 0) == late
        inside = self._inside(np.where(back, last - rest, first + rest))
        if how.mode == "A":
            step = self.values[-1] - self.values[0]
            inside = inside + (repeats + 1) * (step if late else -step)
        return inside

    def _inside(self, ticks: IntArray) -> FloatArray:
        """Return the values at times between the first key and the last."""
        if len(self.times) == 1:
            return np.full(len(ticks), self.values[0])
        k = np.searchsorted(self.times, ticks, "right") - 1
        k = np.clip(k, 0, len(self.times) - 1)
        values = self.values[k].copy()
        between = ticks != self.times[k]
        if not between.any():
            return values
        rows = np.flatnonzero(between)
        k = k[rows]
        mode = self.modes[k]
        span = (self.times[k + 1] - self.times[k]).astype(np.float64)
        fraction = (ticks[rows] - self.times[k]) / span
        low, high = self.values[k], self.values[k + 1]
        moved = np.where(mode == NEXT, high, low)
        moved = np.where(mode == LINEAR, low + fraction * (high - low), moved)
        cubic = mode == CUBIC
        if cubic.any():
            k, seconds = k[cubic], span[cubic] / TICKS
            weights = self.weights[k]
            u = bezier_parameter(fraction[cubic], weights)
            a = low[cubic] + self.right[k] * weights[:, 0] * seconds
            b = high[cubic] - self.left[k] * weights[:, 1] * seconds
            v = 1.0 - u
            moved[cubic] = v * v * (v * low[cubic] + 3 * u * a)
            moved[cubic] += u * u * (u * high[cubic] + 3 * v * b)
        values[rows] = moved
        return values


def bezier_parameter(fraction: FloatArray, weights: FloatArray) -> FloatArray:
    """Return the Bézier parameter ``(F,)`` of time fractions of a segment.

    By bisection, then Newton's method where it stays between the bounds.
    """
    u = fraction.copy()
    weighted = np.flatnonzero(np.abs(weights - THIRD).max(axis=1) > 1e-9)
    if not len(weighted):
        return u
    s, a, b = fraction[weighted], weights[weighted, 0], 1.0 - weights[weighted, 1]
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
    u[weighted] = x
    return u

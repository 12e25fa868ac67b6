"""FBX animation curves: keys, tangents and extrapolation.

References: Autodesk, *FBX SDK documentation*, `FbxAnimCurve` and `FbxAnimCurveKey`.
Between two keys a cubic segment is a Bézier curve. Its handles have the slopes of the
keys; their duration is a fraction (weight) of the segment's, by default a third.
"""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.formats.fbx.settings import TICKS_PER_SECOND

# Interpolation of a segment: the value of its start or end key, a line, or a spline.
CONSTANT, NEXT, LINEAR, CUBIC = range(4)
ONE_THIRD = 1.0 / 3.0
MAX_KEYS = 20_000_000
# Largest valid time [tick]; sums of two stay below 2^62.
MAX_TICKS = 2**61


@dataclass(frozen=True, slots=True)
class FbxExtrapolation:
    """Extrapolation before the first or after the last key.

    mode: C constant, R repeat, A repeat with offset, M mirror, K keep slope.
    count: Number of repetitions; below 0 is endless.
    """

    mode: str = "C"
    count: int = -1


@dataclass(frozen=True, slots=True, eq=False)
class FbxCurve:
    """Keys of one scalar over time, with slopes, handle weights and extrapolation."""

    times: IntArray  # times of the K keys, ascending ``(K,)`` [tick]
    values: FloatArray  # ``(K,)``
    modes: IntArray  # interpolation from each key to the next ``(K,)``
    # Slope after each key ``(K,)`` [1/s]; that of the segment if it is linear.
    out_slopes: FloatArray
    in_slopes: FloatArray  # slope before the next key ``(K,)`` [1/s], likewise
    # Weights of the handles out of each key and into the next, as fractions of the
    # segment's duration ``(K, 2)``.
    weights: FloatArray
    pre: FbxExtrapolation = FbxExtrapolation()  # extrapolation before the first key
    post: FbxExtrapolation = FbxExtrapolation()  # extrapolation after the last key

    def is_static(self) -> bool:
        """Return whether the value never changes."""
        if (self.values != self.values[0]).any():
            return False
        is_cubic = self.modes[:-1] == CUBIC
        has_slope = (self.out_slopes[:-1] != 0) | (self.in_slopes[:-1] != 0)
        keeps_slope = "K" in {self.pre.mode, self.post.mode} and len(self.times) > 1
        return not (is_cubic & has_slope).any() and not keeps_slope

    def evaluate(self, ticks: IntArray) -> FloatArray:
        """Return the values at times ``(F,)`` [ticks]."""
        first, last = int(self.times[0]), int(self.times[-1])
        values = self._interpolate(np.clip(ticks, first, last))
        for extrapolation, is_post in ((self.pre, False), (self.post, True)):
            is_outside = ticks > last if is_post else ticks < first
            if is_outside.any() and extrapolation.mode != "C" and last > first:
                values[is_outside] = self._extrapolate(
                    ticks[is_outside], extrapolation, is_post=is_post
                )
        return values

    def _extrapolate(
        self, ticks: IntArray, extrapolation: FbxExtrapolation, *, is_post: bool
    ) -> FloatArray:
        first, last = int(self.times[0]), int(self.times[-1])
        duration = last - first
        distance = ticks - last if is_post else first - ticks
        end_value = self.values[-1 if is_post else 0]
        end_time = last if is_post else first
        if extrapolation.mode == "K":
            slope = self.in_slopes[-2] if is_post else self.out_slopes[0]
            return np.asarray(end_value + slope * (ticks - end_time) / TICKS_PER_SECOND)
        if extrapolation.count == 0:
            return np.full(len(ticks), end_value)
        repeat_index, remainder = np.divmod(distance, duration)
        if extrapolation.count > 0:
            is_exhausted = repeat_index >= extrapolation.count
            repeat_index = np.where(is_exhausted, extrapolation.count - 1, repeat_index)
            remainder = np.where(is_exhausted, duration, remainder)
        is_backward = np.full(len(ticks), not is_post)
        if extrapolation.mode == "M":
            is_backward = (repeat_index % 2 == 0) == is_post
        repeated_values = self._interpolate(
            np.where(is_backward, last - remainder, first + remainder)
        )
        if extrapolation.mode == "A":
            value_step = (self.values[-1] - self.values[0]) * (1 if is_post else -1)
            repeated_values = repeated_values + (repeat_index + 1) * value_step
        return repeated_values

    def _interpolate(self, ticks: IntArray) -> FloatArray:
        """Return the values at times between the first key and the last."""
        if len(self.times) == 1:
            return np.full(len(ticks), self.values[0])
        key_indices = np.searchsorted(self.times, ticks, "right") - 1
        key_indices = np.clip(key_indices, 0, len(self.times) - 1)
        values = self.values[key_indices].copy()
        is_off_key = ticks != self.times[key_indices]
        if not is_off_key.any():
            return values
        off_key_indices = np.flatnonzero(is_off_key)
        key_indices = key_indices[off_key_indices]
        modes = self.modes[key_indices]
        durations = (self.times[key_indices + 1] - self.times[key_indices]).astype(
            np.float64
        )
        fraction = (ticks[off_key_indices] - self.times[key_indices]) / durations
        start_values, end_values = (
            self.values[key_indices],
            self.values[key_indices + 1],
        )
        segment_values = np.where(modes == NEXT, end_values, start_values)
        segment_values = np.where(
            modes == LINEAR,
            start_values + fraction * (end_values - start_values),
            segment_values,
        )
        is_cubic = modes == CUBIC
        if is_cubic.any():
            key_indices, seconds = (
                key_indices[is_cubic],
                durations[is_cubic] / TICKS_PER_SECOND,
            )
            weights = self.weights[key_indices]
            u = solve_bezier_parameter(fraction[is_cubic], weights)
            start_handles = (
                start_values[is_cubic]
                + self.out_slopes[key_indices] * weights[:, 0] * seconds
            )
            end_handles = (
                end_values[is_cubic]
                - self.in_slopes[key_indices] * weights[:, 1] * seconds
            )
            v = 1.0 - u
            segment_values[is_cubic] = (
                v * v * (v * start_values[is_cubic] + 3 * u * start_handles)
            )
            segment_values[is_cubic] += (
                u * u * (u * end_values[is_cubic] + 3 * v * end_handles)
            )
        values[off_key_indices] = segment_values
        return values


def solve_bezier_parameter(fraction: FloatArray, weights: FloatArray) -> FloatArray:
    """Return the Bézier parameters ``(F,)`` at fractions of a segment's duration.

    Uses Newton's method, with bisection if a step leaves the bounds.
    """
    u = fraction.copy()
    weighted_indices = np.flatnonzero(np.abs(weights - ONE_THIRD).max(axis=1) > 1e-9)
    if not len(weighted_indices):
        return u
    s = fraction[weighted_indices]
    a = weights[weighted_indices, 0]
    b = 1.0 - weights[weighted_indices, 1]
    lower, upper = np.zeros(len(s)), np.ones(len(s))
    x = s.copy()
    for _ in range(60):
        y = 1.0 - x
        residual = 3 * y * y * x * a + 3 * y * x * x * b + x**3 - s
        lower = np.where(residual <= 0, x, lower)
        upper = np.where(residual >= 0, x, upper)
        slope = 3 * y * y * a + 6 * y * x * (b - a) + 3 * x * x * (1 - b)
        newton_x = x - residual / np.where(np.abs(slope) > 1e-12, slope, 1e-12)
        is_in_bounds = (newton_x > lower) & (newton_x < upper)
        next_x = np.where(is_in_bounds, newton_x, 0.5 * (lower + upper))
        is_converged = np.abs(next_x - x).max() < 1e-15
        x = next_x
        if is_converged:
            break
    u[weighted_indices] = x
    return u

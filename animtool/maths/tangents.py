"""Slopes of curves at their keys, and Bézier handles of paths through points.

Functions of keys take times ``(K,)``, ascending, and values ``(K, D)``; they return
slopes [value/time] of that shape. With two or more keys the first and the last take the
secant slope of their segment unless stated otherwise; a single key is flat.
"""

from __future__ import annotations

from enum import StrEnum
from functools import cached_property

import numpy as np

from animtool.core.array_types import ArrayLike, FloatArray, IntArray, as_floats


class Tangent(StrEnum):
    """Tangent of a curve at a key: explicit, or by a rule."""

    FREE = "free"
    FLAT = "flat"
    LINEAR = "linear"
    AUTO = "auto"
    AUTO_CLAMPED = "auto_clamped"


class Parametrization(StrEnum):
    """Knot spacing of Catmull-Rom splines."""

    UNIFORM = "uniform"
    CENTRIPETAL = "centripetal"
    CHORDAL = "chordal"


def secant_slopes(times: ArrayLike, values: ArrayLike) -> FloatArray:
    """Return the slope ``(K, D)`` from the key before to the key after.

    >>> secant_slopes([0, 1, 4], [[0], [1], [2]])[1].tolist()
    [0.5]
    """
    times, values, spans, slopes = _checked_segments(times, values)
    inner_slopes = (values[2:] - values[:-2]) / (spans[:-1] + spans[1:])
    return _add_ends(inner_slopes, slopes, values)


def parabola_slopes(times: ArrayLike, values: ArrayLike) -> FloatArray:
    """Return the slope ``(K, D)`` of the parabola through each key and its neighbours.

    >>> parabola_slopes([0, 1, 4], [[0], [1], [16]])[1].tolist()
    [2.0]
    """
    _, values, spans, slopes = _checked_segments(times, values)
    span_before, span_after = spans[:-1], spans[1:]
    inner_slopes = span_after * slopes[:-1] + span_before * slopes[1:]
    inner_slopes = inner_slopes / (span_before + span_after)
    return _add_ends(inner_slopes, slopes, values)


def tcb(
    times: ArrayLike, values: ArrayLike, parameters: ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Return Kochanek-Bartels slopes before and after each key, each ``(K, D)``.

    With tension, continuity and bias all 0 they are `parabola_slopes`; the paper's own
    correction for uneven keys would give `secant_slopes`.

    Args:
        times: ``(K,)``.
        values: ``(K, D)``.
        parameters: Tension, continuity, bias of each key ``(K, 3)`` [1].

    References:
        D. Kochanek and R. Bartels, Interpolating splines with local tension,
        continuity, and bias control, 1984.

    >>> in_slopes, out_slopes = tcb([0, 1, 2], [[0], [1], [0]], [[0, 1, 0]] * 3)
    >>> in_slopes[1].tolist(), out_slopes[1].tolist()
    ([-1.0], [1.0])
    """
    _, values, key_intervals, slopes = _checked_segments(times, values)
    inner_parameters = as_floats(parameters, (len(values), 3), "parameters")[1:-1]
    tension, continuity, bias = inner_parameters.T[:, :, None]
    # Each secant slope is weighted by the length of the other segment.
    factor_before, factor_after = key_intervals[1:], key_intervals[:-1]
    side_slopes = []
    for c in (-continuity, continuity):
        from_before = (1 - tension) * (1 + c) * (1 + bias) * factor_before * slopes[:-1]
        from_after = (1 - tension) * (1 - c) * (1 - bias) * factor_after * slopes[1:]
        inner_slopes = (from_before + from_after) / (
            key_intervals[:-1] + key_intervals[1:]
        )
        side_slopes.append(_add_ends(inner_slopes, slopes, values))
    return side_slopes[0], side_slopes[1]


def auto_clamped(times: ArrayLike, values: ArrayLike) -> FloatArray:
    """Return slopes ``(K, D)`` of a cubic curve that never overshoots.

    Between two keys it stays between their values, and it is flat at local extrema.
    Elsewhere the slope is `parabola_slopes`'s, limited to three times the smaller
    secant slope of both sides; the ends take the one-sided parabola, limited likewise.

    References:
        F. N. Fritsch and R. E. Carlson, Monotone piecewise cubic interpolation,
        1980; J. M. Hyman, Accurate monotonicity preserving cubic interpolation,
        1983, eq. 2.3.

    >>> auto_clamped([0, 1, 2, 3], [[0], [0], [9], [5]]).ravel().tolist()
    [0.0, 0.0, 0.0, -10.5]
    """
    _, values, spans, slopes = _checked_segments(times, values)
    unclamped_slopes = parabola_slopes(times, values)
    if len(values) < 3:
        return unclamped_slopes
    for key, end_key, inner_key in ((0, 0, 1), (-1, -1, -2)):
        weight = spans[end_key] / (spans[end_key] + spans[inner_key])
        unclamped_slopes[key] = slopes[end_key] + weight * (
            slopes[end_key] - slopes[inner_key]
        )
    secants_before = np.concatenate([slopes[:1], slopes])
    secants_after = np.concatenate([slopes, slopes[-1:]])
    is_monotone = np.sign(secants_before) == np.sign(secants_after)
    max_slope = 3 * np.minimum(np.abs(secants_before), np.abs(secants_after))
    signs = np.sign(secants_before)
    clamped_slopes = signs * np.clip(signs * unclamped_slopes, 0, max_slope)
    return np.where(is_monotone, clamped_slopes, 0.0) + 0.0


def catmull_rom_controls(
    points: ArrayLike, alpha: float
) -> tuple[FloatArray, FloatArray]:
    """Return the Bézier handles before and after each point, each ``(K, D)``.

    The path is mirrored at the first and the last point. Coincident points have handles
    of length 0 between them.

    Args:
        points: ``(K, D)``.
        alpha: Power of the distance between knots: 0 uniform, 0.5 centripetal (no
            cusps or loops), 1 chordal.

    References:
        P. J. Barry and R. N. Goldman, A recursive evaluation algorithm for a class
        of Catmull-Rom splines, 1988; C. Yuksel, S. Schaefer and J. Keyser,
        Parameterization and applications of Catmull-Rom curves, 2011.

    >>> in_handles, out_handles = catmull_rom_controls([[0], [3], [6]], 0.5)
    >>> in_handles.ravel().tolist(), out_handles.ravel().tolist()
    ([-1.0, -1.0, -1.0], [1.0, 1.0, 1.0])
    """
    points = as_floats(points, ("K", "D"), "points")
    if len(points) < 2:
        return np.zeros(points.shape), np.zeros(points.shape)
    first, last = 2 * points[:1] - points[1:2], 2 * points[-1:] - points[-2:-1]
    path_points = np.concatenate([first, points, last])
    handles_after, handles_before = _inner_handles(path_points, alpha)
    # The outer handles of the ends have no segment and no effect.
    in_handles = np.concatenate([-handles_after[:1], handles_before])
    return in_handles, np.concatenate([handles_after, -handles_before[-1:]])


def _inner_handles(
    path_points: FloatArray, alpha: float
) -> tuple[FloatArray, FloatArray]:
    """Return Bézier handles after the start and before the end of inner segments."""
    steps = np.diff(path_points, axis=0)
    knots = np.linalg.norm(steps, axis=1, keepdims=True) ** alpha
    a, h, b = knots[:-2], knots[1:-1], knots[2:]
    inner_steps = steps[1:-1]
    return _handle(steps[:-2], a, inner_steps, h), -_handle(
        steps[2:], b, inner_steps, h
    )


def _handle(
    adjacent: FloatArray, a: FloatArray, step: FloatArray, h: FloatArray
) -> FloatArray:
    """Return the Bézier handle of ``step`` at the knot between it and another step.

    It is a third of the parabola's slope there times the knot interval h of the step:
    (h² adjacent / a + a step) / (a + h) / 3. Steps of length 0 have no direction.
    """
    is_defined = (a > 0) & (h > 0)
    ratio = np.where(is_defined, h, 1.0) / np.where(is_defined, a, 1.0)
    parabola = (ratio * adjacent + step / ratio) / (1.0 + 1.0 / ratio)
    return np.where(h > 0, np.where(a > 0, parabola, step), 0.0) / 3


def _checked_segments(
    times: ArrayLike, values: ArrayLike
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Check times and values; also return key intervals ``(K-1, 1)`` and secants."""
    times = as_floats(times, ("K",), "times")
    values = as_floats(values, (len(times), "D"), "values")
    spans = np.diff(times)[:, None]
    if not (spans > 0).all():
        raise ValueError("times must ascend")
    return times, values, spans, np.diff(values, axis=0) / spans


def _add_ends(
    inner_slopes: FloatArray, slopes: FloatArray, values: FloatArray
) -> FloatArray:
    """Return inner slopes extended by the first and last segment's secant slopes."""
    if len(values) < 2:
        return np.zeros(values.shape)
    return np.concatenate([slopes[:1], inner_slopes, slopes[-1:]])


_KNOT_POWERS = {
    Parametrization.UNIFORM: 0.0,
    Parametrization.CENTRIPETAL: 0.5,
    Parametrization.CHORDAL: 1.0,
}


class KeySlopes:
    """Slopes at the keys of a channel, by the rules of its tangents."""

    def __init__(
        self,
        times: FloatArray,
        values: FloatArray,
        tcb: FloatArray,
        parametrization: Parametrization = Parametrization.UNIFORM,
    ) -> None:
        self.times = times  # ascending ``(K,)``
        self.values = values  # ``(K, D)``
        self._tcb_parameters = tcb  # tension, continuity, bias ``(K, 3)``
        self._parametrization = parametrization

    @cached_property
    def tcb(self) -> tuple[FloatArray, FloatArray]:
        """Slopes before and after each key, from its tension, continuity and bias."""
        return tcb(self.times, self.values, self._tcb_parameters)

    @cached_property
    def _parabola(self) -> FloatArray:
        """Slopes of the parabolas through each key and its neighbours."""
        return parabola_slopes(self.times, self.values)

    @cached_property
    def _auto_clamped(self) -> FloatArray:
        """Slopes of curves that never overshoot."""
        return auto_clamped(self.times, self.values)

    def by_rule(
        self, tangent: Tangent, keys: IntArray, segments: IntArray
    ) -> FloatArray:
        """Return the slopes ``(N, D)`` at keys of adjacent segments, each ``(N,)``."""
        if tangent is Tangent.FLAT:
            return np.zeros((len(keys), self.values.shape[1]))
        if tangent is Tangent.LINEAR:
            rises = self.values[segments + 1] - self.values[segments]
            spans = self.times[segments + 1] - self.times[segments]
            return np.asarray(rises / spans[:, None])
        is_auto = tangent is Tangent.AUTO
        return np.asarray((self._parabola if is_auto else self._auto_clamped)[keys])

    def catmull_rom_handles(
        self, segments: IntArray, thirds: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return handle values ``(N, D)`` of segments, after starts and before ends.

        ``segments`` ``(N,)``, ``thirds`` of their lengths ``(N, 1)``.
        """
        if self._parametrization is Parametrization.UNIFORM:
            slopes = secant_slopes(self.times, self.values)
            return slopes[segments] * thirds, -slopes[segments + 1] * thirds
        in_handles, out_handles = catmull_rom_controls(
            self.values, _KNOT_POWERS[self._parametrization]
        )
        return out_handles[segments], in_handles[segments + 1]

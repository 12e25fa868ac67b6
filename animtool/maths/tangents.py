"""Slopes of curves at their keys, and Bézier handles of paths through points.

Functions of keys take times ``(K,)``, ascending, and values ``(K, D)``; they return
slopes [value/time] of that shape. With two or more keys the first and the last take the
secant slope of their segment unless stated otherwise; a single key is flat.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import StrEnum
from typing import Literal, TypeAlias

import numpy as np

from animtool.core.array_types import ArrayLike, FloatArray, as_floats


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


def secant(times: ArrayLike, values: ArrayLike) -> FloatArray:
    """Return the slope ``(K, D)`` from the key before to the key after.

    >>> secant([0, 1, 4], [[0], [1], [2]])[1].tolist()
    [0.5]
    """
    times, values, spans, slopes = _segments(times, values)
    inner = (values[2:] - values[:-2]) / (spans[:-1] + spans[1:])
    return _with_ends(inner, slopes, values)


def nonuniform(times: ArrayLike, values: ArrayLike) -> FloatArray:
    """Return the slope ``(K, D)`` of the parabola through each key and its neighbours.

    >>> nonuniform([0, 1, 4], [[0], [1], [16]])[1].tolist()
    [2.0]
    """
    _, values, spans, slopes = _segments(times, values)
    a, b = spans[:-1], spans[1:]
    inner = (b * slopes[:-1] + a * slopes[1:]) / (a + b)
    return _with_ends(inner, slopes, values)


def tcb(
    times: ArrayLike,
    values: ArrayLike,
    parameters: ArrayLike,
    rule: Literal["nonuniform", "kb84"] = "nonuniform",
) -> tuple[FloatArray, FloatArray]:
    """Return slopes before and after each key, each ``(K, D)``.

    With tension, continuity and bias all 0, "nonuniform" gives `nonuniform`. "kb84"
    is the paper's rule, with its correction for uneven keys.

    Args:
        times: ``(K,)``.
        values: ``(K, D)``.
        parameters: Tension, continuity, bias of each key ``(K, 3)`` [1].
        rule: Treatment of uneven spacing.

    References:
        D. Kochanek and R. Bartels, Interpolating splines with local tension,
        continuity, and bias control, 1984.

    >>> ins, outs = tcb([0, 1, 2], [[0], [1], [0]], [[0, 1, 0]] * 3)
    >>> ins[1].tolist(), outs[1].tolist()
    ([-1.0], [1.0])
    """
    _, values, spans, slopes = _segments(times, values)
    settings = as_floats(parameters, (len(values), 3), "parameters")[1:-1]
    tension, continuity, bias = settings.T[:, :, None]
    a, b = spans[:-1], spans[1:]
    # Factor of each secant slope; its key difference is a or b times the slope.
    before, behind = (b, a) if rule == "nonuniform" else (a, b)
    sides = []
    for c in (-continuity, continuity):
        one = (1 - tension) * (1 + c) * (1 + bias) * before * slopes[:-1]
        two = (1 - tension) * (1 - c) * (1 - bias) * behind * slopes[1:]
        sides.append(_with_ends((one + two) / (a + b), slopes, values))
    return sides[0], sides[1]


def auto_clamped(times: ArrayLike, values: ArrayLike) -> FloatArray:
    """Return slopes ``(K, D)`` of a cubic curve that never overshoots.

    Between two keys it stays between their values, and it is flat at local extrema.
    Elsewhere the slope is `nonuniform`'s, limited to three times the smaller secant
    slope of both sides; the ends take the one-sided parabola, limited likewise.

    References:
        F. N. Fritsch and R. E. Carlson, Monotone piecewise cubic interpolation,
        1980; J. M. Hyman, Accurate monotonicity preserving cubic interpolation,
        1983, eq. 2.3.

    >>> auto_clamped([0, 1, 2, 3], [[0], [0], [9], [5]]).ravel().tolist()
    [0.0, 0.0, 0.0, -10.5]
    """
    _, values, spans, slopes = _segments(times, values)
    clamped = nonuniform(times, values)
    if len(values) < 3:
        return clamped
    for end, one, two in ((0, 0, 1), (-1, -1, -2)):
        weight = spans[one] / (spans[one] + spans[two])
        clamped[end] = slopes[one] + weight * (slopes[one] - slopes[two])
    before = np.concatenate([slopes[:1], slopes])
    behind = np.concatenate([slopes, slopes[-1:]])
    monotone = np.sign(before) == np.sign(behind)
    limit = 3 * np.minimum(np.abs(before), np.abs(behind))
    along = np.sign(before) * clamped
    return np.where(monotone, np.sign(before) * np.clip(along, 0, limit), 0.0) + 0.0


def catmull_rom_spatial(points: ArrayLike, alpha: float, u: ArrayLike) -> FloatArray:
    """Return positions ``(N, D)`` between the second and third of four points.

    Args:
        points: ``(4, D)``.
        alpha: Power of the distance between knots: 0 uniform, 0.5 centripetal (no
            cusps or loops), 1 chordal.
        u: From 0 at the second point to 1 at the third ``(N,)``.

    References:
        P. J. Barry and R. N. Goldman, A recursive evaluation algorithm for a class
        of Catmull-Rom splines, 1988; C. Yuksel, S. Schaefer and J. Keyser,
        Parameterization and applications of Catmull-Rom curves, 2011.

    >>> catmull_rom_spatial([[0], [1], [2], [3]], 0.5, [0, 0.5, 1]).tolist()
    [[1.0], [1.5], [2.0]]
    """
    points = as_floats(points, (4, "D"), "points")
    u = as_floats(u, ("N",), "u")[:, None]
    outs, ins = _controls(points, alpha)
    start, end = points[1], points[2]
    w = 1.0 - u
    # Computed from the nearer point, so that both ends are exact.
    early = start + u * u * (3 * w + u) * (end - start)
    late = end + w * w * (3 * u + w) * (start - end)
    handles = 3 * u * w * (w * outs[0] + u * ins[0])
    return np.asarray(np.where(u <= 0.5, early, late) + handles)


def catmull_rom_controls(
    points: ArrayLike, alpha: float
) -> tuple[FloatArray, FloatArray]:
    """Return the Bézier handles before and after each point, each ``(K, D)``.

    A segment with these as control offsets equals `catmull_rom_spatial`, uniform in its
    knots. The path is mirrored at the first and the last point. Coinciding points have
    no handles between them.

    ``points`` ``(K, D)``.

    >>> ins, outs = catmull_rom_controls([[0], [3], [6]], 0.5)
    >>> ins.ravel().tolist(), outs.ravel().tolist()
    ([-1.0, -1.0, -1.0], [1.0, 1.0, 1.0])
    """
    points = as_floats(points, ("K", "D"), "points")
    if len(points) < 2:
        return np.zeros(points.shape), np.zeros(points.shape)
    first, last = 2 * points[:1] - points[1:2], 2 * points[-1:] - points[-2:-1]
    path = np.concatenate([first, points, last])
    behind, before = _controls(path, alpha)
    # The outer handles of the ends have no segment and no effect.
    return (
        np.concatenate([-behind[:1], before]),
        np.concatenate([behind, -before[-1:]]),
    )


def _controls(path: FloatArray, alpha: float) -> tuple[FloatArray, FloatArray]:
    """Return handles after the start and before the end of each inner segment."""
    steps = np.diff(path, axis=0)
    knots = np.linalg.norm(steps, axis=1, keepdims=True) ** alpha
    a, h, b = knots[:-2], knots[1:-1], knots[2:]
    return (
        _handle(steps[:-2], a, steps[1:-1], h),
        -_handle(steps[2:], b, steps[1:-1], h),
    )


def _handle(
    other: FloatArray, a: FloatArray, along: FloatArray, h: FloatArray
) -> FloatArray:
    """Return a third of the slope of the parabola at the knot between two steps.

    Times the knot interval h of the step ``along``: (h² other / a + a along) /
    (a + h) / 3. Steps of no length have no direction.
    """
    proper = (a > 0) & (h > 0)
    ratio = np.where(proper, h, 1.0) / np.where(proper, a, 1.0)
    curved = (ratio * other + along / ratio) / (1.0 + 1.0 / ratio)
    return np.where(h > 0, np.where(a > 0, curved, along), 0.0) / 3


def _segments(
    times: ArrayLike, values: ArrayLike
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return checked times and values, and spans ``(K-1, 1)`` and slopes between."""
    times = as_floats(times, ("K",), "times")
    values = as_floats(values, (len(times), "D"), "values")
    spans = np.diff(times)[:, None]
    if not (spans > 0).all():
        raise ValueError("times must ascend")
    return times, values, spans, np.diff(values, axis=0) / spans


def _with_ends(inner: FloatArray, slopes: FloatArray, values: FloatArray) -> FloatArray:
    if len(values) < 2:
        return np.zeros(values.shape)
    return np.concatenate([slopes[:1], inner, slopes[-1:]])


_Rule: TypeAlias = Callable[[FloatArray, FloatArray], FloatArray]

_ALPHA = {
    Parametrization.UNIFORM: 0.0,
    Parametrization.CENTRIPETAL: 0.5,
    Parametrization.CHORDAL: 1.0,
}


class KeySlopes:
    """Slopes at the keys of a channel by tangent rules, computed once."""

    def __init__(
        self,
        times: FloatArray,
        values: FloatArray,
        tcb: FloatArray,
        parametrization: Parametrization = Parametrization.UNIFORM,
    ) -> None:
        self.times = times  # ascending ``(K,)``
        self.values = values  # ``(K, D)``
        self._weights = tcb  # tension, continuity, bias ``(K, 3)``
        self._parametrization = parametrization
        self._by_rule: dict[str, FloatArray] = {}
        self._paths: tuple[FloatArray, FloatArray] | None = None
        self._tcb: tuple[FloatArray, FloatArray] | None = None

    @property
    def tcb(self) -> tuple[FloatArray, FloatArray]:
        """Slopes before and after each key ``(K, D)``."""
        if self._tcb is None:
            self._tcb = tcb(self.times, self.values, self._weights)
        return self._tcb

    def by_rule(self, tangent: Tangent, key: int, segment: int) -> FloatArray:
        """Return the slope at a key of an adjacent segment ``(D,)``."""
        if tangent is Tangent.FLAT:
            return np.zeros(self.values.shape[1])
        if tangent is Tangent.LINEAR:
            rise = self.values[segment + 1] - self.values[segment]
            return np.asarray(rise / (self.times[segment + 1] - self.times[segment]))
        rule = {
            Tangent.AUTO: nonuniform,
            Tangent.AUTO_CLAMPED: auto_clamped,
        }[tangent]
        return np.asarray(self._slopes(rule.__name__, rule)[key])

    def catmull_rom(self, k: int, third: float) -> tuple[FloatArray, FloatArray]:
        """Return the handle values of a segment, after its start and before its end."""
        if self._parametrization is Parametrization.UNIFORM:
            slopes = self._slopes("secant", secant)
            return slopes[k] * third, -slopes[k + 1] * third
        if self._paths is None:
            alpha = _ALPHA[self._parametrization]
            self._paths = catmull_rom_controls(self.values, alpha)
        ins, outs = self._paths
        return outs[k], ins[k + 1]

    def _slopes(self, name: str, rule: _Rule) -> FloatArray:
        if name not in self._by_rule:
            self._by_rule[name] = rule(self.times, self.values)
        return self._by_rule[name]

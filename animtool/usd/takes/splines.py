"""Scalar curves as USD splines (`Ts`), so that a control stays editable after a bake.

A control is a custom double attribute with a spline. Its segments become

==========  ================================================================== HOLD
held LINEAR      linear CUBIC       curve; both widths are a third of the segment h,
slopes dv / (h / 3) BEZIER      curve; widths abs(dt), slopes dv / dt ==========
==================================================================

and extrapolation becomes

============  ============================================================== HOLD
held LINEAR        sloped, with the slope of the curve there CYCLE         loopReset
CYCLE_OFFSET  loopRepeat OSCILLATE     loopOscillate ============
==============================================================

At the very end of a cycle USD is already in the next one (the first value again, or the
held value before the last key), we are still at the last key: `CurveReport.seam`.

A handle that exceeds its segment is clamped to it with its slope kept, as USD's
``AntiRegressionContain`` does. A handle with dt = 0 and dv ≠ 0 has no slope: the
segment is split close to that key. After the split the curve is the same, with handles
that have slopes; before it, for a time of ``SPLIT_TIME`` of the segment, the spline is
linear, with an error of the order of 1e-5 dv, which no sample of
`CurveReport.difference` hits.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from pxr import Sdf, Ts

from animtool.core.array_types import FloatArray
from animtool.core.record import dataclass
from animtool.maths.curves import Curves, Extrapolation, SegmentKind, evaluate
from animtool.usd.layers.finite import ValueLabels, check_value
from animtool.usd.layers.names import distinct_names
from animtool.usd.layers.sdf import attribute_spec

# Namespace of the attributes of controls.
CONTROL_NAMESPACE = "animtool:control:"

# Time of a split from its key, relative to the segment. Less would be lost if a shot
# shifts or scales time: time codes of 1e6 are 1e-10 apart.
MIN_SPLIT_TIME = 2.0**-30
# Samples per segment, and on either side, to measure the spline.
SAMPLES_PER_SEGMENT = 16

_INTERPOLATION = {
    SegmentKind.HOLD: Ts.InterpHeld,
    SegmentKind.LINEAR: Ts.InterpLinear,
    SegmentKind.CUBIC: Ts.InterpCurve,
    SegmentKind.BEZIER: Ts.InterpCurve,
}
_EXTRAPOLATION = {
    Extrapolation.HOLD: Ts.ExtrapHeld,
    Extrapolation.LINEAR: Ts.ExtrapSloped,
    Extrapolation.CYCLE: Ts.ExtrapLoopReset,
    Extrapolation.CYCLE_OFFSET: Ts.ExtrapLoopRepeat,
    Extrapolation.OSCILLATE: Ts.ExtrapLoopOscillate,
}

Evaluate = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, slots=True)
class CurveReport:
    """Result of writing one curve."""

    name: str
    knots: int  # knots of the spline
    split: int  # number of split segments
    # Largest difference between spline and curve, over samples at the keys, within
    # every segment and outside the keys [value].
    difference: float
    seam: float  # difference at the very end of a cycle [value]


def author_controls(
    layer: Any, prim_path: str, controls: Mapping[str, Curves]
) -> list[CurveReport]:
    """Write the curves of controls; return a report per control.

    Controls with names illegal in USD keep them as display names.
    """
    names = distinct_names(*[list(controls)] * 3)
    reports = []
    for name, (control, curves) in zip(names.names, controls.items(), strict=True):

        def values(times: FloatArray, curves: Curves = curves) -> FloatArray:
            values: FloatArray = evaluate(curves, times)[0]
            return values

        report = author_curve(
            layer, prim_path, CONTROL_NAMESPACE + name, curves, values
        )
        if name != control:
            path = f"{prim_path}.{CONTROL_NAMESPACE}{name}"
            layer.GetAttributeAtPath(path).displayName = control
        reports.append(replace(report, name=control))
    return reports


def author_curve(
    layer: Any,
    prim_path: str,
    name: str,
    curves: Curves,
    evaluate: Evaluate,
) -> CurveReport:
    """Write one curve as a spline on a custom attribute, and measure its error.

    ``evaluate`` returns its values ``(F,)`` at times ``(F,)``, to measure the error and
    to extrapolate.
    """
    if len(curves.pre) != 1 or not len(curves.times):
        raise ValueError("at least one curve needs a key")
    spline, where = Ts.Spline("double"), f"{prim_path}.{name}"
    pieces = [
        piece
        for i in range(len(curves.times) - 1)
        for piece in _curve_segments(curves, i)
    ]
    with Ts.AntiRegressionAuthoringSelector(Ts.AntiRegressionContain):
        for knot in _spline_knots(pieces, curves, where):
            spline.SetKnot(knot)
        extrapolations = (curves.pre[0], -1), (curves.post[0], 1)
        pre_extrapolation, post_extrapolation = (
            _spline_extrapolation(mode, curves, evaluate, side, where)
            for mode, side in extrapolations
        )
        spline.SetPreExtrapolation(pre_extrapolation)
        spline.SetPostExtrapolation(post_extrapolation)
    spec = layer.GetPrimAtPath(prim_path)
    attr = attribute_spec(spec, name, Sdf.ValueTypeNames.Double)
    attr.custom = True
    attr.SetSpline(spline)
    difference, seam = _measure_error(spline, curves, evaluate)
    split_count = len({piece.segment for piece in pieces if piece.part})
    return CurveReport(name, len(spline.GetKnots()), split_count, difference, seam)


@dataclass(frozen=True, slots=True)
class _CurveSegment:
    """A curve segment, or part of one.

    The control points ``(4, 2)`` are (time from the segment's first key, value).
    """

    segment: int
    part: int
    kind: SegmentKind
    begin: float
    points: FloatArray


def _curve_segments(curves: Curves, i: int) -> list[_CurveSegment]:
    kind = SegmentKind(int(curves.kinds[i]))
    end_points = np.stack([curves.times[i : i + 2], curves.values[i : i + 2]], axis=1)
    h = float(end_points[1, 0] - end_points[0, 0])
    out_handle, in_handle = curves.outs[i].copy(), curves.ins[i + 1].copy()
    if kind is SegmentKind.CUBIC:
        out_handle[0], in_handle[0] = h / 3, -h / 3
    out_handle, in_handle = (
        _clamped_handle(out_handle, h),
        _clamped_handle(in_handle, h),
    )
    begin = float(end_points[0, 0])
    points = np.stack(
        [
            end_points[0],
            end_points[0] + out_handle,
            end_points[1] + in_handle,
            end_points[1],
        ]
    )
    points[:, 0] = 0.0, out_handle[0], h + in_handle[0], h
    if kind is not SegmentKind.BEZIER:
        return [_CurveSegment(i, 0, kind, begin, points)]
    point_sets = [points]
    if _is_vertical(out_handle):
        point_sets = _split_bezier(
            points, _parameter_at(points[:, 0], h * MIN_SPLIT_TIME)
        )
    if _is_vertical(in_handle):
        last_points = point_sets.pop()
        mirrored_points = last_points[::-1] * [-1.0, 1.0] + [h, 0.0]
        near_points, other_points = _split_bezier(
            mirrored_points, _parameter_at(mirrored_points[:, 0], h * MIN_SPLIT_TIME)
        )
        point_sets += [
            piece_points[::-1] * [-1.0, 1.0] + [h, 0.0]
            for piece_points in (other_points, near_points)
        ]
    kinds = [SegmentKind.BEZIER] * len(point_sets)
    if _is_vertical(out_handle):
        kinds[0] = SegmentKind.LINEAR
    if _is_vertical(in_handle):
        kinds[-1] = SegmentKind.LINEAR
    return [
        _CurveSegment(i, piece_points, kind, begin, points)
        for piece_points, (kind, points) in enumerate(
            zip(kinds, point_sets, strict=True)
        )
    ]


def _clamped_handle(handle: FloatArray, h: float) -> FloatArray:
    """Return a handle clamped to its segment, slope kept."""
    length = abs(handle[0])
    return handle * (h / length) if length > h else handle


def _is_vertical(handle: FloatArray) -> bool:
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        return bool(handle[1] != 0.0 and not np.isfinite(handle[1] / handle[0]))


def _parameter_at(times: FloatArray, at: float) -> float:
    """Return the parameter of a monotonic cubic from 0 at a time, by bisection."""
    _, a, b, c = times.tolist()
    lower, upper = 0.0, 1.0
    while lower < (middle := (lower + upper) / 2) < upper:
        complement = 1.0 - middle
        x = middle * (
            3 * complement * (complement * a + middle * b) + middle * middle * c
        )
        lower, upper = (middle, upper) if x < at else (lower, middle)
    return upper


def _split_bezier(points: FloatArray, u: float) -> list[FloatArray]:
    """Return the two parts of a Bézier curve (de Casteljau)."""
    rows = [points]
    while len(rows[-1]) > 1:
        rows.append(rows[-1][:-1] + u * (rows[-1][1:] - rows[-1][:-1]))
    return [
        np.stack([row[0] for row in rows]),
        np.stack([row[-1] for row in rows[::-1]]),
    ]


def _spline_knots(pieces: list[_CurveSegment], curves: Curves, where: str) -> list[Any]:
    """Return the knots at the ends of all pieces."""
    piece_starts = [(*(p.points[0] + [p.begin, 0.0]).tolist(), p) for p in pieces]
    end_point = (float(curves.times[-1]), float(curves.values[-1]), None)
    knots = []
    previous: _CurveSegment | None = None
    for time, value, piece in [*piece_starts, end_point]:
        fields: dict[str, Any] = {"nextInterp": Ts.InterpHeld}
        if previous is not None and previous.kind >= SegmentKind.CUBIC:
            width, slope = _tangent_of_handle(previous.points[3] - previous.points[2])
            fields |= {"preTanWidth": width, "preTanSlope": slope}
        if piece is not None:
            fields["nextInterp"] = _INTERPOLATION[piece.kind]
            if piece.kind >= SegmentKind.CUBIC:
                width, slope = _tangent_of_handle(piece.points[1] - piece.points[0])
                fields |= {"postTanWidth": width, "postTanSlope": slope}
        numbers = [n for n in (time, value, *fields.values()) if isinstance(n, float)]
        check_value(numbers, "d", ValueLabels(where, f"the knot at {time:.10g}"))
        knots.append(Ts.Knot("double", time=time, value=value, **fields))
        previous = piece
    return knots


def _tangent_of_handle(handle: FloatArray) -> tuple[float, float]:
    """Return width and slope of a handle from its time and value offsets."""
    width, value_offset = handle.tolist()
    return (width, value_offset / width) if width > 0 else (0.0, 0.0)


def _spline_extrapolation(
    mode: Extrapolation, curves: Curves, evaluate: Evaluate, side: int, where: str
) -> Any:
    extrapolation = Ts.Extrapolation(_EXTRAPOLATION[mode])
    if mode is Extrapolation.LINEAR:
        edge = float(curves.times[0 if side < 0 else -1])
        magnitude = max(1.0, abs(edge), float(np.ptp(curves.times)))
        far_time = edge + side * 1024.0 * magnitude
        at_edge, far_value = evaluate(np.array([edge, far_time])).tolist()
        slope = (far_value - at_edge) / (far_time - edge)
        check_value(slope, "d", ValueLabels(where, "the slope outside the keys"))
        extrapolation.slope = slope
    return extrapolation


def _measure_error(
    spline: Any, curves: Curves, evaluate: Evaluate
) -> tuple[float, float]:
    """Return the largest error, and the error at the end of a cycle."""
    times = curves.times
    steps = np.arange(SAMPLES_PER_SEGMENT) / SAMPLES_PER_SEGMENT
    segment_times = times[:-1, None] + np.diff(times)[:, None] * steps
    span = float(np.ptp(times)) or 1.0
    outside_times = (
        span * (np.arange(3 * SAMPLES_PER_SEGMENT) + 0.5) / SAMPLES_PER_SEGMENT
    )
    at = np.concatenate(
        [times[0] - outside_times, segment_times.ravel(), times[-1] + outside_times]
    )

    def difference(sample_times: FloatArray) -> float:
        curve_values = evaluate(sample_times)
        spline_values = np.array([spline.Eval(float(time)) for time in sample_times])
        return float(np.abs(spline_values - curve_values).max())

    seam = difference(times[-1:])
    if curves.post[0] in {Extrapolation.CYCLE, Extrapolation.OSCILLATE}:
        return difference(at), seam
    return max(difference(at), seam), 0.0

"""Writes scalar curves as USD splines (`Ts`), so that baked controls stay editable.

A control is a custom double attribute with a spline. Its segments become

========  ==============================================================
HOLD      held
LINEAR    linear
CUBIC     curve; both widths are h / 3 of a segment of duration h, with slopes
          dv / (h / 3)
BEZIER    curve; widths abs(dt), slopes dv / dt
========  ==============================================================

and its extrapolation becomes

============  ==========================================================
HOLD          held
LINEAR        sloped, with the slope of the curve at its end
CYCLE         loopReset
CYCLE_OFFSET  loopRepeat
OSCILLATE     loopOscillate
============  ==========================================================

At the end time of a cycle, USD evaluates the next cycle: its first value, or the value
held before the last key. Animtool evaluates the last key; `CurveReport.seam` is the
difference.

A handle longer than its segment is clamped to it with the same slope, as in USD's
``AntiRegressionContain``. A handle with dt = 0 and dv ≠ 0 has no slope, so the segment
is split close to that key. The part next to the key, of duration `MIN_SPLIT_TIME` of
the segment, is linear, with an error of about 1e-5 dv that `CurveReport.difference`
does not sample. The other part is the same curve, with handles that have slopes.
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

# Distance of a split from its key, relative to the segment duration. A smaller one
# would be lost if a shot shifts or scales time: time codes of 1e6 have a spacing of
# 1e-10.
MIN_SPLIT_TIME = 2.0**-30
# Samples per segment, and before and after all segments, to measure the error.
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

EvaluateCurve = Callable[[FloatArray], FloatArray]


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

    Control names that are illegal in USD become display names.
    """
    names = distinct_names(*[list(controls)] * 3)
    reports = []
    for name, (control, curves) in zip(names.names, controls.items(), strict=True):

        def evaluate_curve(times: FloatArray, curves: Curves = curves) -> FloatArray:
            values: FloatArray = evaluate(curves, times)[0]
            return values

        report = author_curve(
            layer, prim_path, CONTROL_NAMESPACE + name, curves, evaluate_curve
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
    evaluate: EvaluateCurve,
) -> CurveReport:
    """Write one curve as a spline on a custom attribute, and measure its error.

    ``evaluate`` returns the curve's values ``(F,)`` at times ``(F,)``.
    """
    if len(curves.pre) != 1 or not len(curves.times):
        raise ValueError("at least one curve needs a key")
    spline, attribute_path = Ts.Spline("double"), f"{prim_path}.{name}"
    segments_by_key = [_build_segments(curves, i) for i in range(len(curves.times) - 1)]
    segments = [
        segment for segment_parts in segments_by_key for segment in segment_parts
    ]
    with Ts.AntiRegressionAuthoringSelector(Ts.AntiRegressionContain):
        for knot in _build_knots(segments, curves, attribute_path):
            spline.SetKnot(knot)
        extrapolations = (curves.pre[0], -1), (curves.post[0], 1)
        pre_extrapolation, post_extrapolation = (
            _build_extrapolation(mode, curves, evaluate, side, attribute_path)
            for mode, side in extrapolations
        )
        spline.SetPreExtrapolation(pre_extrapolation)
        spline.SetPostExtrapolation(post_extrapolation)
    spec = layer.GetPrimAtPath(prim_path)
    attr = attribute_spec(spec, name, Sdf.ValueTypeNames.Double)
    attr.custom = True
    attr.SetSpline(spline)
    difference, seam = _measure_error(spline, curves, evaluate)
    split_count = sum(len(segment_parts) > 1 for segment_parts in segments_by_key)
    return CurveReport(name, len(spline.GetKnots()), split_count, difference, seam)


@dataclass(frozen=True, slots=True)
class _CurveSegment:
    """A curve segment, or one part of a split segment.

    The control points ``(4, 2)`` are (time from the segment's first key, value).
    """

    kind: SegmentKind
    start_time: float
    control_points: FloatArray


def _build_segments(curves: Curves, index: int) -> list[_CurveSegment]:
    kind = SegmentKind(int(curves.kinds[index]))
    end_points = np.stack(
        [curves.times[index : index + 2], curves.values[index : index + 2]], axis=1
    )
    duration = float(end_points[1, 0] - end_points[0, 0])
    out_handle, in_handle = (
        curves.out_handles[index].copy(),
        curves.in_handles[index + 1].copy(),
    )
    if kind is SegmentKind.CUBIC:
        out_handle[0], in_handle[0] = duration / 3, -duration / 3
    out_handle = _clamp_handle(out_handle, duration)
    in_handle = _clamp_handle(in_handle, duration)
    start_time = float(end_points[0, 0])
    control_points = np.stack(
        [
            end_points[0],
            end_points[0] + out_handle,
            end_points[1] + in_handle,
            end_points[1],
        ]
    )
    control_points[:, 0] = 0.0, out_handle[0], duration + in_handle[0], duration
    if kind is not SegmentKind.BEZIER:
        return [_CurveSegment(kind, start_time, control_points)]
    control_point_sets = [control_points]
    if _is_vertical(out_handle):
        control_point_sets = _split_bezier(
            control_points,
            _find_parameter(control_points[:, 0], duration * MIN_SPLIT_TIME),
        )
    if _is_vertical(in_handle):
        last_points = control_point_sets.pop()
        mirrored_points = last_points[::-1] * [-1.0, 1.0] + [duration, 0.0]
        near_points, far_points = _split_bezier(
            mirrored_points,
            _find_parameter(mirrored_points[:, 0], duration * MIN_SPLIT_TIME),
        )
        control_point_sets += [
            points[::-1] * [-1.0, 1.0] + [duration, 0.0]
            for points in (far_points, near_points)
        ]
    kinds = [SegmentKind.BEZIER] * len(control_point_sets)
    if _is_vertical(out_handle):
        kinds[0] = SegmentKind.LINEAR
    if _is_vertical(in_handle):
        kinds[-1] = SegmentKind.LINEAR
    return [
        _CurveSegment(kind, start_time, control_points)
        for kind, control_points in zip(kinds, control_point_sets, strict=True)
    ]


def _clamp_handle(handle: FloatArray, duration: float) -> FloatArray:
    """Return a handle clamped to the duration of its segment, with the same slope."""
    length = abs(handle[0])
    return handle * (duration / length) if length > duration else handle


def _is_vertical(handle: FloatArray) -> bool:
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        return bool(handle[1] != 0.0 and not np.isfinite(handle[1] / handle[0]))


def _find_parameter(control_times: FloatArray, time: float) -> float:
    """Return the parameter of a monotonic Bézier curve at a time, by bisection."""
    _, t1, t2, t3 = control_times.tolist()
    lower, upper = 0.0, 1.0
    while lower < (u := (lower + upper) / 2) < upper:
        v = 1.0 - u
        time_at_u = u * (3 * v * (v * t1 + u * t2) + u * u * t3)
        lower, upper = (u, upper) if time_at_u < time else (lower, u)
    return upper


def _split_bezier(points: FloatArray, parameter: float) -> list[FloatArray]:
    """Split a Bézier curve at a parameter into two (de Casteljau)."""
    levels = [points]
    while len(levels[-1]) > 1:
        levels.append(levels[-1][:-1] + parameter * (levels[-1][1:] - levels[-1][:-1]))
    return [
        np.stack([row[0] for row in levels]),
        np.stack([row[-1] for row in levels[::-1]]),
    ]


def _build_knots(
    segments: list[_CurveSegment], curves: Curves, attribute_path: str
) -> list[Any]:
    """Return the spline knots at the ends of all segments."""
    segment_starts = [
        (
            *(
                curve_segment.control_points[0] + [curve_segment.start_time, 0.0]
            ).tolist(),
            curve_segment,
        )
        for curve_segment in segments
    ]
    end_point = (float(curves.times[-1]), float(curves.values[-1]), None)
    knots = []
    previous: _CurveSegment | None = None
    for time, value, segment in [*segment_starts, end_point]:
        fields: dict[str, Any] = {"nextInterp": Ts.InterpHeld}
        if previous is not None and previous.kind >= SegmentKind.CUBIC:
            width, slope = _handle_tangent(
                previous.control_points[3] - previous.control_points[2]
            )
            fields |= {"preTanWidth": width, "preTanSlope": slope}
        if segment is not None:
            fields["nextInterp"] = _INTERPOLATION[segment.kind]
            if segment.kind >= SegmentKind.CUBIC:
                width, slope = _handle_tangent(
                    segment.control_points[1] - segment.control_points[0]
                )
                fields |= {"postTanWidth": width, "postTanSlope": slope}
        numbers = [n for n in (time, value, *fields.values()) if isinstance(n, float)]
        check_value(
            numbers, "d", ValueLabels(attribute_path, f"the knot at {time:.10g}")
        )
        knots.append(Ts.Knot("double", time=time, value=value, **fields))
        previous = segment
    return knots


def _handle_tangent(handle: FloatArray) -> tuple[float, float]:
    """Return width and slope of a handle from its time and value offsets."""
    width, value_offset = handle.tolist()
    return (width, value_offset / width) if width > 0 else (0.0, 0.0)


def _build_extrapolation(
    mode: Extrapolation,
    curves: Curves,
    evaluate: EvaluateCurve,
    direction: int,
    attribute_path: str,
) -> Any:
    extrapolation = Ts.Extrapolation(_EXTRAPOLATION[mode])
    if mode is Extrapolation.LINEAR:
        edge_time = float(curves.times[0 if direction < 0 else -1])
        magnitude = max(1.0, abs(edge_time), float(np.ptp(curves.times)))
        far_time = edge_time + direction * 1024.0 * magnitude
        edge_value, far_value = evaluate(np.array([edge_time, far_time])).tolist()
        slope = (far_value - edge_value) / (far_time - edge_time)
        check_value(
            slope, "d", ValueLabels(attribute_path, "the slope outside the keys")
        )
        extrapolation.slope = slope
    return extrapolation


def _measure_error(
    spline: Any, curves: Curves, evaluate: EvaluateCurve
) -> tuple[float, float]:
    """Return the largest error of a spline, and its error at the end of a cycle."""
    times = curves.times
    fractions = np.arange(SAMPLES_PER_SEGMENT) / SAMPLES_PER_SEGMENT
    segment_times = times[:-1, None] + np.diff(times)[:, None] * fractions
    span = float(np.ptp(times)) or 1.0
    outside_times = (
        span * (np.arange(3 * SAMPLES_PER_SEGMENT) + 0.5) / SAMPLES_PER_SEGMENT
    )
    all_times = np.concatenate(
        [times[0] - outside_times, segment_times.ravel(), times[-1] + outside_times]
    )

    def difference(sample_times: FloatArray) -> float:
        curve_values = evaluate(sample_times)
        spline_values = np.array([spline.Eval(float(time)) for time in sample_times])
        return float(np.abs(spline_values - curve_values).max())

    seam = difference(times[-1:])
    if curves.post[0] in {Extrapolation.CYCLE, Extrapolation.OSCILLATE}:
        return difference(all_times), seam
    return max(difference(all_times), seam), 0.0

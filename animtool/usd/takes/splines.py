"""Scalar curves as USD splines (`Ts`), so that a control stays editable after a bake.

A control is a custom double attribute with a spline. Its segments become

==========  ==================================================================
HOLD        held
LINEAR      linear
CUBIC       curve; both widths are a third of the segment h, slopes dv / (h / 3)
BEZIER      curve; widths abs(dt), slopes dv / dt
==========  ==================================================================

and what lies outside of the keys

============  ==============================================================
HOLD          held
LINEAR        sloped, by the slope that the curve itself has there
CYCLE         loopReset
CYCLE_OFFSET  loopRepeat
OSCILLATE     loopOscillate
============  ==============================================================

At the very end of a cycle USD is in the next one already (the first value again, or
the held value before the last key), we are still at the last key:
`CurveReport.seam`.

A handle that reaches beyond its segment is clamped to it, slope kept, as USD's
``AntiRegressionContain`` does. A handle with dt = 0 and dv ≠ 0 has no slope: the
segment is split close to that key. The piece behind the split is the same curve
exactly, with handles that have slopes; in the piece before it, ``NEAR`` of the
segment long, the spline is a line, off by the order of 1e-5 dv, which no sample of
`CurveReport.difference` meets.
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
from animtool.usd.layers.finite import Labels, check_value
from animtool.usd.layers.names import distinct_names
from animtool.usd.layers.sdf import attribute

# What the attributes of controls begin with.
CONTROL = "animtool:control:"

# Of a segment's length. Less would be lost where a shot shifts or stretches time:
# time codes of 1e6 are 1e-10 apart.
NEAR = 2.0**-30
# Samples a segment, and on either side, when the spline is measured.
SAMPLES = 16

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
    split: int  # segments that had to be split
    # Largest difference of the spline from the curve, over samples at the keys, within
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

        report = author_curve(layer, prim_path, CONTROL + name, curves, values)
        if name != control:
            path = f"{prim_path}.{CONTROL}{name}"
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

    evaluate: its values ``(F,)`` at times ``(F,)``, to measure against and to continue
    it by.
    """
    if len(curves.pre) != 1 or not len(curves.times):
        raise ValueError("at least one curve needs a key")
    spline, where = Ts.Spline("double"), f"{prim_path}.{name}"
    pieces = [
        piece for i in range(len(curves.times) - 1) for piece in _pieces(curves, i)
    ]
    with Ts.AntiRegressionAuthoringSelector(Ts.AntiRegressionContain):
        for knot in _knots(pieces, curves, where):
            spline.SetKnot(knot)
        outside = (curves.pre[0], -1), (curves.post[0], 1)
        before, after = (
            _extrapolation(mode, curves, evaluate, side, where)
            for mode, side in outside
        )
        spline.SetPreExtrapolation(before)
        spline.SetPostExtrapolation(after)
    spec = layer.GetPrimAtPath(prim_path)
    attr = attribute(spec, name, Sdf.ValueTypeNames.Double)
    attr.custom = True
    attr.SetSpline(spline)
    difference, seam = _measure(spline, curves, evaluate)
    split = len({piece.segment for piece in pieces if piece.part})
    return CurveReport(name, len(spline.GetKnots()), split, difference, seam)


@dataclass(frozen=True, slots=True)
class _Piece:
    """A segment of a curve, or a part of it.

    Its control points ``(4, 2)`` are (time from the segment's first key, value).
    """

    segment: int
    part: int
    kind: SegmentKind
    begin: float
    points: FloatArray


def _pieces(curves: Curves, i: int) -> list[_Piece]:
    kind = SegmentKind(int(curves.kinds[i]))
    ends = np.stack([curves.times[i : i + 2], curves.values[i : i + 2]], axis=1)
    h = float(ends[1, 0] - ends[0, 0])
    out, into = curves.outs[i].copy(), curves.ins[i + 1].copy()
    if kind is SegmentKind.CUBIC:
        out[0], into[0] = h / 3, -h / 3
    out, into = _contained(out, h), _contained(into, h)
    begin = float(ends[0, 0])
    points = np.stack([ends[0], ends[0] + out, ends[1] + into, ends[1]])
    points[:, 0] = 0.0, out[0], h + into[0], h
    if kind is not SegmentKind.BEZIER:
        return [_Piece(i, 0, kind, begin, points)]
    parts = [points]
    if _vertical(out):
        parts = _split(points, _parameter(points[:, 0], h * NEAR))
    if _vertical(into):
        last = parts.pop()
        mirrored = last[::-1] * [-1.0, 1.0] + [h, 0.0]
        near, rest = _split(mirrored, _parameter(mirrored[:, 0], h * NEAR))
        parts += [part[::-1] * [-1.0, 1.0] + [h, 0.0] for part in (rest, near)]
    kinds = [SegmentKind.BEZIER] * len(parts)
    if _vertical(out):
        kinds[0] = SegmentKind.LINEAR
    if _vertical(into):
        kinds[-1] = SegmentKind.LINEAR
    return [
        _Piece(i, part, kind, begin, points)
        for part, (kind, points) in enumerate(zip(kinds, parts, strict=True))
    ]


def _contained(handle: FloatArray, h: float) -> FloatArray:
    """Return a handle clamped to its segment, slope kept."""
    length = abs(handle[0])
    return handle * (h / length) if length > h else handle


def _vertical(handle: FloatArray) -> bool:
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        return bool(handle[1] != 0.0 and not np.isfinite(handle[1] / handle[0]))


def _parameter(times: FloatArray, at: float) -> float:
    """Return the parameter of a monotonic cubic from 0 at a time, by bisection."""
    _, a, b, c = times.tolist()
    low, high = 0.0, 1.0
    while low < (middle := (low + high) / 2) < high:
        rest = 1.0 - middle
        x = middle * (3 * rest * (rest * a + middle * b) + middle * middle * c)
        low, high = (middle, high) if x < at else (low, middle)
    return high


def _split(points: FloatArray, u: float) -> list[FloatArray]:
    """Return the two parts of a Bézier curve (de Casteljau)."""
    rows = [points]
    while len(rows[-1]) > 1:
        rows.append(rows[-1][:-1] + u * (rows[-1][1:] - rows[-1][:-1]))
    return [
        np.stack([row[0] for row in rows]),
        np.stack([row[-1] for row in rows[::-1]]),
    ]


def _knots(pieces: list[_Piece], curves: Curves, where: str) -> list[Any]:
    """Return the knots at the ends of all pieces."""
    ends = [(*(p.points[0] + [p.begin, 0.0]).tolist(), p) for p in pieces]
    last = (float(curves.times[-1]), float(curves.values[-1]), None)
    knots = []
    before: _Piece | None = None
    for time, value, piece in [*ends, last]:
        fields: dict[str, Any] = {"nextInterp": Ts.InterpHeld}
        if before is not None and before.kind >= SegmentKind.CUBIC:
            width, slope = _tangent(before.points[3] - before.points[2])
            fields |= {"preTanWidth": width, "preTanSlope": slope}
        if piece is not None:
            fields["nextInterp"] = _INTERPOLATION[piece.kind]
            if piece.kind >= SegmentKind.CUBIC:
                width, slope = _tangent(piece.points[1] - piece.points[0])
                fields |= {"postTanWidth": width, "postTanSlope": slope}
        numbers = [n for n in (time, value, *fields.values()) if isinstance(n, float)]
        check_value(numbers, "d", Labels(where, f"the knot at {time:.10g}"))
        knots.append(Ts.Knot("double", time=time, value=value, **fields))
        before = piece
    return knots


def _tangent(handle: FloatArray) -> tuple[float, float]:
    """Return width and slope of a handle from its time and value offsets."""
    width, rise = handle.tolist()
    return (width, rise / width) if width > 0 else (0.0, 0.0)


def _extrapolation(
    mode: Extrapolation, curves: Curves, evaluate: Evaluate, side: int, where: str
) -> Any:
    extrapolation = Ts.Extrapolation(_EXTRAPOLATION[mode])
    if mode is Extrapolation.LINEAR:
        edge = float(curves.times[0 if side < 0 else -1])
        reach = max(1.0, abs(edge), float(np.ptp(curves.times)))
        far = edge + side * 1024.0 * reach
        at_edge, away = evaluate(np.array([edge, far])).tolist()
        slope = (away - at_edge) / (far - edge)
        check_value(slope, "d", Labels(where, "the slope outside the keys"))
        extrapolation.slope = slope
    return extrapolation


def _measure(spline: Any, curves: Curves, evaluate: Evaluate) -> tuple[float, float]:
    """Return the largest error, and the error at the end of a cycle."""
    times = curves.times
    steps = np.arange(SAMPLES) / SAMPLES
    inside = times[:-1, None] + np.diff(times)[:, None] * steps
    span = float(np.ptp(times)) or 1.0
    away = span * (np.arange(3 * SAMPLES) + 0.5) / SAMPLES
    at = np.concatenate([times[0] - away, inside.ravel(), times[-1] + away])

    def difference(when: FloatArray) -> float:
        mine = evaluate(when)
        theirs = np.array([spline.Eval(float(time)) for time in when])
        return float(np.abs(theirs - mine).max())

    last = difference(times[-1:])
    if curves.post[0] in {Extrapolation.CYCLE, Extrapolation.OSCILLATE}:
        return difference(at), last
    return max(difference(at), last), 0.0

"""Curves as splines, against a plain evaluation of the curves."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from numpy.testing import assert_allclose
from pxr import Sdf, Ts, Usd

from animtool.maths.curves import Curves, Extrapolation, SegmentKind, fold_times
from animtool.usd.takes.splines import author_curve

Floats = npt.NDArray[np.float64]
PRIM = "/hero/Rig/Anim"
NAME = "animtool:control:smile"
TOLERANCE = 1e-12  # of the largest value


MODES = {
    Ts.ExtrapHeld: Extrapolation.HOLD,
    Ts.ExtrapLinear: Extrapolation.LINEAR,
    Ts.ExtrapSloped: Extrapolation.LINEAR,
    Ts.ExtrapLoopReset: Extrapolation.CYCLE,
    Ts.ExtrapLoopRepeat: Extrapolation.CYCLE_OFFSET,
    Ts.ExtrapLoopOscillate: Extrapolation.OSCILLATE,
}


def curve_of(attribute: Any) -> Curves:
    """Return the spline of an attribute; handles a third of a segment make it CUBIC."""
    spline = attribute.GetSpline()
    knots = list(spline.GetKnots().values())
    times = np.array([knot.GetTime() for knot in knots])
    before = np.array([[k.GetPreTanWidth(), k.GetPreTanSlope()] for k in knots])
    behind = np.array([[k.GetPostTanWidth(), k.GetPostTanSlope()] for k in knots])
    ins, outs = (
        np.stack([sign * tangents[:, 0], sign * tangents[:, 0] * tangents[:, 1]], 1)
        for sign, tangents in ((-1.0, before), (1.0, behind))
    )
    kinds = np.full(len(knots), int(SegmentKind.HOLD), np.int64)
    for i, knot in enumerate(knots[:-1]):
        third = (times[i + 1] - times[i]) / 3
        if knot.GetNextInterpolation() == Ts.InterpLinear:
            kinds[i] = SegmentKind.LINEAR
        elif knot.GetNextInterpolation() == Ts.InterpCurve:
            even = np.allclose([behind[i, 0], before[i + 1, 0]], third, rtol=1e-9)
            kinds[i] = SegmentKind.CUBIC if even else SegmentKind.BEZIER
    return Curves(
        np.array([0, len(knots)]),
        times,
        np.array([knot.GetValue() for knot in knots]),
        kinds,
        ins,
        outs,
        (MODES[spline.GetPreExtrapolation().mode],),
        (MODES[spline.GetPostExtrapolation().mode],),
    )


def curve(
    kind: SegmentKind,
    *,
    out: tuple[float, float] = (1.0, 2.0),
    into: tuple[float, float] = (-2.0, 0.5),
    outside: Extrapolation = Extrapolation.HOLD,
    at: float = 0.0,
) -> Curves:
    """Return three keys with the same handles at each."""
    return Curves(
        np.array([0, 3]),
        np.array([0.0, 4.0, 10.0]) + at,
        np.array([1.0, -0.5, 2.0]),
        np.full(3, int(kind)),
        np.tile(np.array(into), (3, 1)),
        np.tile(np.array(out), (3, 1)),
        (outside,),
        (outside,),
    )


def handles(curves: Curves, i: int) -> tuple[Floats, Floats, float]:
    h = float(curves.times[i + 1] - curves.times[i])
    out, into = curves.out_handles[i].copy(), curves.in_handles[i + 1].copy()
    if curves.kinds[i] == SegmentKind.CUBIC:
        out[0], into[0] = h / 3, -h / 3
    out *= h / max(h, abs(out[0]))
    into *= h / max(h, abs(into[0]))
    return out, into, h


def inside(curves: Curves, time: float) -> float:
    """Return the value within the keys, by bisection in the parameter."""
    times, values = curves.times, curves.values
    if time >= times[-1]:
        return float(values[-1])
    i = int(np.searchsorted(times, time, "right")) - 1
    kind = curves.kinds[i]
    v, w = float(values[i]), float(values[i + 1])
    out, into, h = handles(curves, i)
    x = float(time - times[i])
    if kind == SegmentKind.HOLD:
        return v
    if kind == SegmentKind.LINEAR:
        return v + (w - v) * x / h
    low, high = 0.0, 1.0
    while low < (u := (low + high) / 2) < high:
        r = 1 - u
        t = 3 * r * r * u * out[0] + 3 * r * u * u * (h + into[0]) + u**3 * h
        low, high = (u, high) if t < x else (low, u)
    r, u = 1 - high, high
    b, c = v + out[1], w + into[1]
    return float(r**3 * v + 3 * r * r * u * b + 3 * r * u * u * c + u**3 * w)


def slope(curves: Curves, i: int, into: bool) -> float:
    """Return the slope at the start or end of a segment."""
    out, back, h = handles(curves, i)
    if curves.kinds[i] == SegmentKind.HOLD:
        return 0.0
    if curves.kinds[i] == SegmentKind.LINEAR:
        return float(curves.values[i + 1] - curves.values[i]) / h
    handle = back if into else out
    return float(handle[1] / handle[0])


def reference(curves: Curves, times: Floats) -> Floats:
    pre, post = curves.pre[0], curves.post[0]
    found = fold_times(times, curves.times[0], curves.times[-1], pre, post)
    values = np.array([inside(curves, float(t)) for t in found.times])
    values += found.cycles * (curves.values[-1] - curves.values[0])
    last = len(curves.times) - 2
    for i, beyond in enumerate(found.overshoot):
        if beyond:
            at = (0, False) if beyond < 0 else (last, True)
            values[i] += beyond * slope(curves, *at)
    return values


def written(curves: Curves, **options: float) -> tuple[Any, Any]:
    """Author a curve beside a SkelAnimation; return the report and the stage."""
    layer = Sdf.Layer.CreateAnonymous(".usda")
    spec = Sdf.CreatePrimInLayer(layer, PRIM)
    spec.specifier, spec.typeName = Sdf.SpecifierDef, "SkelAnimation"
    report = author_curve(
        layer, PRIM, NAME, curves, lambda t: reference(curves, t), **options
    )
    stage = Usd.Stage.Open(layer)
    found = control(stage)
    assert found.HasSpline()
    assert found.IsCustom()
    return report, stage


def control(stage: Usd.Stage) -> Usd.Attribute:
    return stage.GetPrimAtPath(PRIM).GetAttribute(NAME)


@pytest.mark.parametrize("at", [0.0, 1001.0, 1e6])
@pytest.mark.parametrize("kind", list(SegmentKind))
def test_every_kind_of_segment(kind: SegmentKind, at: float) -> None:
    curves = curve(kind, at=at)
    report, stage = written(curves)
    attr = control(stage)
    assert (report.knots, report.split, report.seam) == (3, 0, 0.0)
    # Ts adds the widths to the knots' times, so it knows handles to an ulp of those.
    tolerance = TOLERANCE * 4 + 4 * float(np.spacing(at))
    assert report.difference <= tolerance
    times = np.linspace(at, at + 10, 101)
    found = np.array([attr.Get(float(t)) for t in times])
    assert_allclose(found, reference(curves, times), atol=tolerance, rtol=0)


@pytest.mark.parametrize("outside", list(Extrapolation))
@pytest.mark.parametrize("kind", list(SegmentKind))
def test_outside_the_keys(kind: SegmentKind, outside: Extrapolation) -> None:
    curves = curve(kind, outside=outside)
    report, stage = written(curves)
    attr = control(stage)
    times = np.concatenate([np.linspace(-29.9, -0.1, 50), np.linspace(10.1, 39.9, 50)])
    found = np.array([attr.Get(float(t)) for t in times])
    assert_allclose(found, reference(curves, times), atol=TOLERANCE * 50, rtol=0)
    assert report.difference <= TOLERANCE * 50
    seam = 1.0 if outside is Extrapolation.CYCLE else 0.0
    if outside is Extrapolation.OSCILLATE and kind is SegmentKind.HOLD:
        seam = 2.5
    assert report.seam == pytest.approx(seam, abs=TOLERANCE)


@pytest.mark.parametrize(
    ("out", "into"), [((30.0, 9.0), (-2.0, 1.0)), ((9.0, -3.0), (-50.0, 4.0))]
)
def test_overlong_handles(out: tuple[float, float], into: tuple[float, float]) -> None:
    report, stage = written(curve(SegmentKind.BEZIER, out=out, into=into))
    attr = control(stage)
    # Where both end up as long as the segment, its middle is as steep as a cube root.
    tolerance = 1e-4 if into[0] < -6 else TOLERANCE * 4
    assert report.difference <= tolerance
    assert not attr.GetSpline().HasRegressiveTangents()


@pytest.mark.parametrize("at", [0.0, 1001.0])
@pytest.mark.parametrize(
    ("out", "into"),
    [
        ((0.0, 3.0), (-2.0, 1.0)),
        ((1.0, 3.0), (0.0, 1.0)),
        ((0.0, 3.0), (0.0, -2.0)),
        ((0.0, 3.0), (-9.0, -2.0)),
    ],
)
def test_handles_straight_up(
    out: tuple[float, float], into: tuple[float, float], at: float
) -> None:
    curves = curve(SegmentKind.BEZIER, out=out, into=into, at=at)
    report, stage = written(curves)
    attr = control(stage)
    both = out[0] == into[0] == 0.0
    assert (report.split, report.knots) == (2, 7 if both else 5)
    assert report.difference <= 1e-11
    for time, value in zip(curves.times, curves.values, strict=True):
        assert attr.Get(float(time)) == value


def test_handles_without_length() -> None:
    curves = curve(SegmentKind.BEZIER, out=(0.0, 0.0), into=(0.0, 0.0))
    report, _ = written(curves)
    assert (report.split, report.knots) == (0, 3)
    assert report.difference <= TOLERANCE


@pytest.mark.parametrize("outside", list(Extrapolation))
@pytest.mark.parametrize("suffix", ["usda", "usdc"])
def test_a_curve_comes_back(
    tmp_path: Path, outside: Extrapolation, suffix: str
) -> None:
    curves = replace(
        curve(SegmentKind.BEZIER, outside=outside),
        kinds=np.array([SegmentKind.CUBIC, SegmentKind.BEZIER, SegmentKind.HOLD]),
    )
    _, stage = written(curves)
    path = str(tmp_path / f"o.{suffix}")
    stage.GetRootLayer().Export(path)
    opened = Usd.Stage.Open(path)
    back = curve_of(control(opened))
    assert_allclose(back.times, curves.times)
    assert_allclose(back.values, curves.values)
    assert back.kinds[:2].tolist() == curves.kinds[:2].tolist()
    assert (back.pre, back.post) == (curves.pre, curves.post)
    times = np.linspace(0, 10, 41)
    assert_allclose(reference(back, times), reference(curves, times), atol=1e-12)


def test_one_key_is_held() -> None:
    empty = np.zeros((1, 2))
    one = Curves(
        np.array([0, 1]),
        np.array([3.0]),
        np.array([0.7]),
        np.array([SegmentKind.BEZIER]),
        empty,
        empty,
        (Extrapolation.LINEAR,),
        (Extrapolation.CYCLE,),
    )
    layer = Sdf.Layer.CreateAnonymous(".usda")
    Sdf.CreatePrimInLayer(layer, PRIM)
    report = author_curve(layer, PRIM, NAME, one, lambda t: np.full(t.shape, 0.7))
    assert (report.knots, report.difference, report.seam) == (1, 0.0, 0.0)
    spline = layer.GetAttributeAtPath(f"{PRIM}.{NAME}").GetSpline()
    assert isinstance(spline, Ts.Spline)

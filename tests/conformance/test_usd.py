"""USD's own files and evaluators against ours."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.curves import one_curve
from support.data import data_files

from animtool.core.array_types import BoolArray, FloatArray
from animtool.maths.curves import Curves, Extrapolation, SegmentKind, evaluate

# Of the largest value: Ts evaluates in float64 too, in another way.
TS_TOLERANCE = 1e-13
# Maya's times and values are printed with seven decimals.
MAYA_TOLERANCE = 1e-7

MODES = {
    "held": Extrapolation.HOLD,
    "linear": Extrapolation.LINEAR,
    "repeat": Extrapolation.CYCLE_OFFSET,
    "reset": Extrapolation.CYCLE,
    "oscillate": Extrapolation.OSCILLATE,
}
KINDS = {"held": SegmentKind.HOLD, "linear": SegmentKind.LINEAR}

Spline = dict[str, Any]


def spline_curve(spline: Spline) -> Curves:
    """Return a Ts spline as ours; where it jumps at a knot, a key a rounding before."""
    hermite = spline["curve"] == "hermite"
    curved = SegmentKind.CUBIC if hermite else SegmentKind.BEZIER
    knots = [
        {**knot, **stored}
        for knot, stored in zip(spline["knots"], spline["stored"], strict=True)
    ]
    spans = np.diff([knot["time"] for knot in knots]) / 3
    keys = []
    for i, knot in enumerate(knots):
        before = spans[max(i - 1, 0)] if hermite else knot["preWidth"]
        behind = spans[min(i, len(spans) - 1)] if hermite else knot["postWidth"]
        time, value = knot["time"], knot["value"]
        kind = KINDS.get(knot["next"], curved)
        incoming = (-before, -before * knot["preSlope"])
        outgoing = (behind, behind * knot["postSlope"])
        if "preValue" in knot:
            earlier = np.nextafter(time, -np.inf)
            keys.append(
                (earlier, knot["preValue"], SegmentKind.HOLD, incoming, (0.0, 0.0))
            )
        keys.append((time, value, kind, incoming, outgoing))
    modes = (MODES.get(spline[side], Extrapolation.HOLD) for side in ("pre", "post"))
    return one_curve(*zip(*keys, strict=True), *modes)


def comparable(spline: Spline, times: FloatArray) -> BoolArray:
    """Return where ours says the same: it has no slope of its own outside."""
    start, end = spline["knots"][0]["time"], spline["knots"][-1]["time"]
    kept = np.ones(len(times), bool)
    if spline["pre"] == "sloped":
        kept &= times >= start
    if spline["post"] == "sloped":
        kept &= times <= end
    return kept


@pytest.mark.parametrize("path", data_files("usd", "ts_oracle_*.json"))
def test_splines_are_what_ts_makes_of_them(path: Path) -> None:
    oracle = json.loads(path.read_text("utf-8"))
    column = {name: i for i, name in enumerate(oracle["columns"])}
    for spline in oracle["cases"]:
        samples = np.array(spline["samples"])
        samples = samples[comparable(spline, samples[:, column["time"]])]
        found = evaluate(spline_curve(spline), samples[:, column["time"]])[0]
        scale = max(1.0, float(np.abs(samples[:, column["value"]]).max()))
        # Where cycles meet, either side will do.
        errors = np.minimum(
            np.abs(found - samples[:, column["value"]]),
            np.abs(found - samples[:, column["preValue"]]),
        )
        worst = int(errors.argmax())
        where = f"{spline['name']} at {samples[worst, 0]}"
        assert errors[worst] <= TS_TOLERANCE * scale, f"{where}: {errors[worst]:.2e}"


@pytest.mark.parametrize("path", data_files("usd", "ts_TwoKnotBezier_maya*.txt"))
def test_a_bezier_is_what_maya_makes_of_it(path: Path) -> None:
    rows = path.read_text("utf-8").split("-----")[1].split()
    samples = np.array(rows, np.float64).reshape(-1, 2)
    curve = one_curve(
        [1.0, 5.0],
        [1.0, 2.0],
        SegmentKind.BEZIER,
        [[0.0, 0.0], [-0.5, 0.0]],
        [[0.5, 0.5], [0.0, 0.0]],
    )
    error = np.abs(evaluate(curve, samples[:, 0])[0] - samples[:, 1]).max()
    assert error <= MAYA_TOLERANCE

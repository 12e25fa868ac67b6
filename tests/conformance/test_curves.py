"""Curves and tangents against values computed with 50 digits."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.curves import hermite_curve, one_curve
from support.data import data_files

from animtool.core.array_types import FloatArray
from animtool.maths import tangents
from animtool.maths.curves import SegmentKind, evaluate

TOLERANCE = 1e-14
# Beside a vertical tangent a rounding of the time moves the value by far more: by as
# much as so many roundings of the time do.
ROUNDINGS = 64

Case = dict[str, Any]


def _bezier(case: Case) -> tuple[FloatArray, float]:
    keys = case["keys"]
    curve = one_curve(
        [key["t"] for key in keys],
        [key["v"] for key in keys],
        SegmentKind.BEZIER,
        [key["in"] for key in keys],
        [key["out"] for key in keys],
    )
    handles = np.abs([*curve.in_handles[:, 1], *curve.out_handles[:, 1]]).max()
    return evaluate(curve, case["times"])[0], max(np.abs(curve.values).max(), handles)


def _hermite(case: Case) -> tuple[FloatArray, float]:
    times, values = case["t"], np.array(case["v"])[:, None]
    kind = case["kind"]
    if kind.startswith("tcb_"):
        ins, outs = tangents.tcb(times, values, case["tcb"])
    else:
        slopes = {"secant": "secant_slopes", "nonuniform": "parabola_slopes"}
        ins = outs = getattr(tangents, slopes.get(kind, kind))(times, values)
    curve = hermite_curve(times, case["v"], ins[:, 0], outs[:, 0])
    handles = np.abs([*curve.in_handles[:, 1], *curve.out_handles[:, 1]]).max()
    return evaluate(curve, case["times"])[0], max(np.abs(values).max(), handles)


Evaluator = Callable[[Case], tuple[FloatArray, float]]
EVALUATORS: dict[str, Evaluator] = {"bezier": _bezier, "hermite": _hermite}


@pytest.mark.parametrize("path", data_files("curves", "*.json"))
def test_values(path: Path) -> None:
    oracle = json.loads(path.read_text("utf-8"))
    evaluator = EVALUATORS.get(oracle["kind"])
    if evaluator is None:
        pytest.skip(f"{oracle['kind']} is no curve of numbers over time")
    for case in oracle["cases"]:
        if case.get("kind") == "tcb_kb84":
            continue  # clips have no such curves
        found, scale = evaluator(case)
        error = np.abs(found - np.array(case["values"], np.float64))
        bound = TOLERANCE * scale + _moved(evaluator, case, found)
        assert (error <= bound).all(), f"{case['name']}: {error.max() / scale:.2e}"


def _moved(evaluator: Evaluator, case: Case, found: FloatArray) -> FloatArray:
    """Return how far values move within some roundings of the times."""
    times = np.array(case["times"])
    off = ROUNDINGS * np.spacing(np.abs(times).max())
    moved = [evaluator({**case, "times": times + way})[0] for way in (-off, off)]
    return np.asarray(np.abs(np.array(moved) - found).max(axis=0))


@pytest.mark.parametrize("path", data_files("curves", "*.json"))
def test_controls_trace_the_same_path(path: Path) -> None:
    oracle = json.loads(path.read_text("utf-8"))
    if oracle["kind"] != "catmull_rom_spatial":
        pytest.skip(f"{oracle['kind']} has no controls")
    for case in oracle["cases"]:
        points = np.array(case["points"])
        ins, outs = tangents.catmull_rom_controls(points, case["alpha"])
        truth = np.array(case["values"], np.float64)
        for axis in range(points.shape[1]):
            before, behind = np.zeros((4, 2)), np.zeros((4, 2))
            before[:, 1], behind[:, 1] = ins[:, axis], outs[:, axis]
            kind = SegmentKind.CUBIC
            curve = one_curve([0, 1, 2, 3], points[:, axis], kind, before, behind)
            found = evaluate(curve, 1 + np.array(case["u"]))[0]
            error = np.abs(found - truth[:, axis]).max()
            assert error <= TOLERANCE * np.abs(points).max()

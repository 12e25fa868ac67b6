"""Rotation curves against values of fifty digits."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mpmath
import numpy as np
import pytest
from support.data import data_files

from animtool.core.array_types import FloatArray
from animtool.maths import so3
from animtool.maths.rotation_curves import RotationKind, evaluate_rotations

TOLERANCE = 1e-14
XYZW = [1, 2, 3, 0]

Curve = Callable[[FloatArray, FloatArray], FloatArray]
CURVES: dict[str, list[Curve]] = {
    "slerp_shortest": [
        lambda q, u: so3.slerp(*so3.normalize(q), u),
        lambda q, u: evaluate_rotations([0, 1], q, RotationKind.SLERP, u),
    ],
    "squad": [
        lambda q, u: evaluate_rotations(range(-1, 3), q, RotationKind.SQUAD, u),
    ],
}


def cases() -> list[Any]:
    """Return a parameter a case that this module knows."""
    found = []
    for file in data_files("curves", "*.json"):
        if not isinstance(path := file.values[0], Path):
            return [file]
        for case in json.loads(path.read_text("utf-8"))["cases"]:
            if case.get("kind") in CURVES:
                found.append(pytest.param(case, id=case["name"]))
    missing = pytest.mark.skip(reason="no rotation curves in ANIMTOOL_DATA/curves")
    return found or [pytest.param(None, marks=missing, id="no-data")]


def error(got: FloatArray, truth: list[str]) -> float:
    """Return the largest difference as rotations, with the truth's own digits."""
    with mpmath.workdps(40):
        pairs = [
            (mpmath.mpf(float(a)), mpmath.mpf(b))
            for a, b in zip(got, truth, strict=True)
        ]
        same = max(abs(a - b) for a, b in pairs)
        return float(min(same, max(abs(a + b) for a, b in pairs)))


@pytest.mark.parametrize("case", cases())
def test_values_of_fifty_digits(case: dict[str, Any]) -> None:
    keys = np.array(case["q"])[:, XYZW]
    for curve in CURVES[case["kind"]]:
        got = curve(keys, np.array(case["u"]))
        for q, truth in zip(got, case["values"], strict=True):
            assert error(q, [truth[i] for i in XYZW]) < TOLERANCE

"""Warnings about tolerances of a comparison that hide every difference."""

from __future__ import annotations

import math

import pytest

from animtool.report.tolerances import angle_warnings, length_warnings, weight_warnings


@pytest.mark.parametrize(
    ("tolerance", "largest", "size", "found"),
    [
        (20.0, 0.005, 1.7, True),  # 20 mm was meant
        (1.0, 0.005, 1.7, True),
        (0.01, 1e-3, 0.005, True),  # an insect
        (0.02, 0.005, 1.7, False),
        (20.0, 0.0, 1.7, False),  # nothing differs
        (20.0, 25.0, 1.7, False),  # different all the same
        (20.0, 5.0, 200.0, False),  # a ship
        (math.inf, 0.005, 1.7, False),  # on purpose
    ],
)
def test_lengths(tolerance: float, largest: float, size: float, found: bool) -> None:
    assert [one.code for one in length_warnings(tolerance, largest, size)] == (
        ["CLI107"] * found
    )


@pytest.mark.parametrize(
    ("tolerance", "largest", "found"),
    [(360.0, 5.0, True), (90.0, 5.0, False), (360.0, 0.0, False), (math.inf, 5, False)],
)
def test_angles(tolerance: float, largest: float, found: bool) -> None:
    assert [w.code for w in angle_warnings(tolerance, largest)] == ["CLI107"] * found


@pytest.mark.parametrize(
    ("tolerance", "largest", "found"),
    [(5.0, 0.2, True), (0.05, 0.2, False), (5.0, 0.0, False)],
)
def test_weights(tolerance: float, largest: float, found: bool) -> None:
    assert [w.code for w in weight_warnings(tolerance, largest)] == ["CLI107"] * found

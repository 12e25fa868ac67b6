"""Rows of zeros within a motion are found; poses and passes through zero are not."""

from __future__ import annotations

import numpy as np
import pytest

from animtool.core.array_types import FloatArray
from animtool.formats.zero_rows import ZeroRows


def motion() -> FloatArray:
    """Return rows of a slow motion far from zero."""
    return 50.0 + np.cumsum(np.ones((40, 9)), axis=0) * np.arange(1, 10)


def found(rows: FloatArray, per_block: int) -> list[tuple[int, ...]]:
    zero_rows = ZeroRows()
    lines = np.arange(len(rows)) + 100
    for i in range(0, len(rows), per_block):
        zero_rows.add(rows[i : i + per_block], lines[i : i + per_block])
    warnings = zero_rows.warnings("a.bvh")
    assert all(fault.code == "TAKE013" for fault in warnings)
    return [fault.lines for fault in warnings]


@pytest.mark.parametrize("per_block", [1, 2, 7, 40])
@pytest.mark.parametrize(
    ("spans", "lines"),
    [
        ([(10, 15)], [(110,)]),
        ([(10, 11)], [(110,)]),
        ([(10, 15), (20, 22)], [(110, 120)]),
        ([(35, 40)], [(135,)]),
        ([(39, 40)], []),  # a pose at the end
        ([(0, 5)], []),  # a pose at the start
    ],
)
def test_runs(
    spans: list[tuple[int, int]], lines: list[tuple[int, ...]], per_block: int
) -> None:
    rows = motion()
    for start, end in spans:
        rows[start:end] = 0.0
    assert found(rows, per_block) == lines


def test_a_motion_through_zero_and_a_wheel_are_silent() -> None:
    rows = np.outer(np.arange(-20.0, 20.0), np.ones(9))
    rows[18:23] = 0.0
    assert found(rows, 40) == []
    wheel = np.zeros((40, 9))
    wheel[:, 0] = np.arange(5.0, 405.0, 10.0) % 360.0
    wheel[36, 0] = 0.0
    assert found(wheel, 40) == []

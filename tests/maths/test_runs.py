"""Runs of masks."""

from __future__ import annotations

import numpy as np
import pytest

from animtool.maths.runs import merge_runs, runs


@pytest.mark.parametrize(
    ("mask", "found"),
    [
        ([], []),
        ([0, 0], []),
        ([1, 1], [(0, 2)]),
        ([1, 1, 0, 0, 1, 0, 1], [(0, 2), (4, 5), (6, 7)]),
        ([0, 1, 0], [(1, 2)]),
    ],
)
def test_runs_are_where_a_mask_holds(
    mask: list[int], found: list[tuple[int, int]]
) -> None:
    assert runs(np.array(mask, np.bool_)) == found


def test_runs_that_are_less_than_a_gap_apart_are_one() -> None:
    apart = [(0, 2), (4, 5), (9, 12), (12, 13)]
    assert merge_runs(apart, 2) == [(0, 2), (4, 5), (9, 13)]
    assert merge_runs(apart, 3) == [(0, 5), (9, 13)]
    assert merge_runs(apart, 5) == [(0, 13)]
    assert merge_runs([], 5) == []

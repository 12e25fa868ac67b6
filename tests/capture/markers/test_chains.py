"""Runs that are one marker: how much distances say so, and which are joined."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from animtool.capture.markers import chains
from animtool.capture.markers.chains import (
    chain_likelihoods,
    chain_runs,
    merge_chains,
    rest_evidence,
)
from animtool.capture.markers.geometry import MarkerDistances


@pytest.mark.parametrize(
    ("alike", "joined"),
    [
        ({(0, 1): 3.1}, [0, 0, 1, 2]),
        ({(0, 1): 3.0}, [0, 1, 2, 3]),
        # Run 2 is seen along with 0, and may be 1 as well.
        ({(0, 1): 9.0, (1, 2): 7.4}, [0, 0, 1, 2]),
        ({(0, 1): 9.0, (1, 2): 7.6}, [0, 1, 2, 3]),
        ({(0, 1): 9.0, (1, 3): 8.9}, [0, 0, 1, 0]),
        ({(0, 2): 99.0}, [0, 1, 2, 3]),
    ],
)
def test_runs_are_joined_that_are_surely_and_clearly_one(
    alike: dict[tuple[int, int], float],
    joined: list[int],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """More than 3 nat, and 1.5 more than any other that it could be."""
    table = np.zeros((4, 4))
    for (a, b), value in alike.items():
        table[a, b] = table[b, a] = value
    monkeypatch.setattr(chains, "chain_likelihoods", lambda *_: table.copy())
    overlap = np.eye(4)
    overlap[0, 2] = overlap[2, 0] = 5
    nothing = MarkerDistances(table, table)
    assert chain_runs(nothing, overlap).tolist() == joined


def test_distances_say_more_the_nearer_and_the_steadier_they_are() -> None:
    rest = np.array([0.3, 0.31, 0.5, np.nan])
    near, loose = rest_evidence(np.array([0.3, 0.3]), np.array([0.0005, 0.05]), rest)
    assert near[0] > near[1] > near[2]
    assert near[3] == loose[3] == 0
    assert near[0] > loose[0]
    assert near[2] < 0
    assert not rest_evidence(np.array([np.nan]), np.array([0.01]), rest).any()


def test_two_are_alike_by_all_that_is_seen_along_with_both() -> None:
    """Of half a minute's frames it is half as much; both ways have the mean."""
    mean = np.array([[np.nan, np.nan, 0.3], [np.nan, np.nan, 0.3], [0.3, 0.3, np.nan]])
    spread = np.full((3, 3), 0.001)
    overlap = np.array([[90.0, 0, 60], [0, 90, 60], [60, 60, 90]])
    whole = chain_likelihoods(MarkerDistances(mean, spread), overlap)
    own = rest_evidence(np.array([0.3]), np.array([0.001]), np.array([0.3]))[0, 0]
    assert_allclose(whole[0, 1], own)
    assert_allclose(whole, whole.T)
    overlap[0, 2] = overlap[2, 0] = 30
    assert_allclose(
        chain_likelihoods(MarkerDistances(mean, spread), overlap)[0, 1], own / 2
    )


def test_positions_of_a_chain_are_those_of_its_runs() -> None:
    points = np.full((3, 3, 3), np.nan)
    points[0, 0], points[2, 2], points[1, 1] = 1.0, 2.0, 3.0
    made = merge_chains(points, np.array([0, 1, 0]))
    assert made.shape == (3, 2, 3)
    assert_array_equal(made[:, 0, 0], [1, np.nan, 2])
    assert_array_equal(made[:, 1, 0], [np.nan, 3, np.nan])

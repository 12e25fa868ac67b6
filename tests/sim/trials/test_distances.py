"""How far simulations are apart."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from animtool.maths import so3
from animtool.sim.trials.trial import (
    ErrorMeasure,
    Snapshot,
    observed_order,
    points_extent,
    run_distances,
)

POINTS = arrays(np.float64, (5, 3), elements=st.floats(-100, 100, width=32))


@given(POINTS)
def test_nothing_is_away_from_itself(points: np.ndarray) -> None:
    found = run_distances([Snapshot(points)], [Snapshot(points.copy())])
    assert (found.largest, found.rms, found.median, found.unmatched) == (0, 0, 0, 0)


@given(POINTS, POINTS)
def test_distances_are_the_same_both_ways(a: np.ndarray, b: np.ndarray) -> None:
    there, back = (
        run_distances([Snapshot(a)], [Snapshot(b)]),
        run_distances([Snapshot(b)], [Snapshot(a)]),
    )
    assert there == back
    assert there.rms <= there.largest * (1 + 1e-12)
    assert there.median <= there.largest


@given(POINTS, st.integers(0, 4), st.integers(0, 4))
def test_points_are_told_by_their_ids(points: np.ndarray, i: int, j: int) -> None:
    ids = np.arange(5) * 7
    one, other = np.delete(np.arange(5), i), np.delete(np.arange(5), j)
    found = run_distances(
        [Snapshot(points[one], ids[one])], [Snapshot(points[other], ids[other])]
    )
    assert found.largest == 0
    assert found.unmatched == (0 if i == j else pytest.approx(2 / 5))


def test_all_times_count() -> None:
    still = Snapshot(np.zeros((2, 3)))
    moved = [Snapshot(np.array([[0, 0, 3.0], [0, 0, 0]])), still]
    found = run_distances([still, still], moved)
    assert found.largest == 3
    assert found.rms == pytest.approx(1.5)
    assert found.median == 0


def test_nobody_in_common_is_all_apart() -> None:
    a = Snapshot(np.zeros((1, 3)), np.array([1]))
    b = Snapshot(np.ones((1, 3)), np.array([2]))
    assert run_distances([a], [b]).unmatched == 1
    none = Snapshot(np.zeros((0, 3)), np.zeros(0, np.int64))
    assert run_distances([none], [none]).unmatched == 0


def test_orientations_differ_by_angles_told_by_ids() -> None:
    ids, points = np.array([3, 5, 8]), np.zeros((3, 3))
    turns = so3.exp(np.array([[0, 0, 0.1], [0, 0.2, 0], [0.3, 0, 0]]))
    one = Snapshot(points, ids, turns)
    assert run_distances([one], [Snapshot(points, ids, -turns)]).angle == 0
    other = Snapshot(points[:2], ids[1:], so3.exp(np.array([[0, 0.5, 0], [0.7, 0, 0]])))
    found = run_distances([one], [other])
    assert found.angle == pytest.approx(math.sqrt((0.3**2 + 0.4**2) / 2))
    assert found.scaled_by(2).angle == pytest.approx(2 * math.sqrt(0.125))
    assert found.error(ErrorMeasure.RMS, 2) == pytest.approx(2 * math.sqrt(0.125))
    assert run_distances([Snapshot(points)], [Snapshot(points)]).angle is None


def test_what_is_no_number_has_no_distance() -> None:
    here, lost = Snapshot(np.zeros((1, 3))), Snapshot(np.full((1, 3), np.nan))
    assert math.isnan(run_distances([here], [lost]).largest)


def test_extents_are_of_all_times() -> None:
    snapshots = [Snapshot(np.zeros((1, 3))), Snapshot(np.array([[3.0, 4.0, 0.0]]))]
    assert points_extent(snapshots) == 5
    assert points_extent([]) == 0


@given(st.floats(0.5, 6), st.floats(1e-9, 1e3))
def test_the_order_is_the_power_of_the_step(order: float, fine: float) -> None:
    assert observed_order(fine * 2**order, fine) == pytest.approx(order)


@pytest.mark.parametrize("gaps", [(0, 0), (1, 0), (0, 1), (math.nan, 1), (1e308, 0.1)])
def test_without_a_difference_there_is_no_order(gaps: tuple[float, float]) -> None:
    assert observed_order(*gaps) is None


def test_the_largest_is_at_its_shot_and_point() -> None:
    still = Snapshot(np.zeros((3, 3)))
    moved = Snapshot(np.array([[0, 0, 1.0], [0, 0, 4.0], [0, 0, 2.0]]))
    assert run_distances([still, still, still], [still, moved, still]).worst_at == (
        1,
        1,
    )
    few = Snapshot(np.zeros((2, 3)), np.array([3, 9]))
    other = Snapshot(np.array([[1.0, 0, 0], [0, 2.0, 0]]), np.array([4, 9]))
    # Points that only one has are at no place of the other.
    assert run_distances([few], [other]).worst_at == (0, 1)
    assert run_distances([few], [other]).error(ErrorMeasure.LARGEST, 5.0) == 2.0

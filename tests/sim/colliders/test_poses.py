"""Poses over time: one by one and many at once, held outside."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from support.suite import examples

from animtool.sim.colliders import Poses

SEEDS = st.integers(0, 2**32 - 1)


def wandering(seed: int, count: int) -> Poses:
    """Return a way through a few poses at random times of 0 to 1 s."""
    rng = np.random.default_rng(seed)
    times = np.sort(rng.choice(1000, count, replace=False)) / 1000
    return Poses(times, rng.normal(size=(count, 3)), rng.normal(size=(count, 4)))


@given(SEEDS, st.integers(1, 6), st.lists(st.floats(-1, 2), max_size=20))
@settings(max_examples=examples(50), deadline=None)
def test_many_times_are_each_as_it_is_alone(
    seed: int, count: int, times: list[float]
) -> None:
    poses = wandering(seed, count)
    found = poses.at_times(np.array(times))
    assert found.shape == (len(times), 7)
    for row, t in zip(found, times, strict=True):
        assert_array_equal(row, poses.at(t))
    assert_allclose(np.linalg.norm(found[:, 3:], axis=1), 1.0)


@given(SEEDS, st.integers(1, 6))
@settings(max_examples=examples(50), deadline=None)
def test_its_own_times_have_its_own_poses(seed: int, count: int) -> None:
    poses = wandering(seed, count)
    assert_allclose(poses.at_times(poses.sample_times), poses.rows, atol=1e-12)
    outside = np.array([poses.sample_times[-1] + 1, poses.sample_times[0] - 1])
    assert_array_equal(poses.at_times(outside), poses.rows[[-1, 0]])


@pytest.mark.parametrize("part", ["times", "origins", "rotations"])
def test_each_part_that_is_not_finite_is_named(part: str) -> None:
    parts = {"times": [0.0], "origins": np.zeros((1, 3)), "rotations": np.ones((1, 4))}
    wrong = np.array(parts[part])
    wrong.flat[0] = np.inf
    assert Poses(**{**parts, part: wrong}).faults() == [f"its {part} are not finite"]


def test_between_two_it_goes_straight_and_turns_evenly() -> None:
    half = np.sqrt(0.5)
    poses = Poses([1, 3], [[0, 0, 0], [2, 4, 0]], [[0, 0, 0, 1], [0, 0, half, half]])
    (row,) = poses.at_times(np.array([2.0]))
    assert_allclose(row[:3], [1, 2, 0], atol=1e-15)
    assert_allclose(row[3:], [0, 0, np.sin(np.pi / 8), np.cos(np.pi / 8)], atol=1e-15)

"""The least distance of members of a flock: braking and moving apart, in numbers."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from animtool import _kernels

OPEN = np.zeros((2, 3))


def braking(gap: float, speed: float, least: tuple[float, float] = (1.0, 3.0)) -> float:
    """Return the first one's acceleration away from the other, so far beyond 2 m."""
    x = np.array([[0.0, 0.0, 0.0], [0.0, 2.0 + gap, 0.0]])
    v = np.array([[0.3, speed / 4, 0.0], [0.7, -3 * speed / 4, 0.0]])
    found, _ = _kernels.flock_braking(x, v, np.array(least), 2.0, 0.1, OPEN, 1e6)
    assert_allclose(found[0], -found[1])
    assert_allclose(found[0, [0, 2]], 0)
    return -float(found[0, 1])


@pytest.mark.parametrize(
    ("gap", "speed", "expected"),
    [
        # Half of the square of how fast they close in over twice the room, as near.
        (1.0, 4.0, 0.5 * 16 / 4),
        (1.0, 2.0, 0.5 * 4 / 4),
        (0.5, 4.0, 0.75 * 16 / 2),
        (0.1, 4.0, 0.95 * 16 / 0.8),  # the room is a tenth of the distance at least
        (-0.5, 4.0, 16 / 0.8),
        (2.0, 4.0, 0.0),
        (1.0, -4.0, 0.0),
    ],
)
def test_two_that_close_in_brake_by_the_square_of_their_speed(
    gap: float, speed: float, expected: float
) -> None:
    assert braking(gap, speed) == pytest.approx(expected)


def test_who_keeps_no_distance_is_not_braked_for() -> None:
    assert braking(0.5, 4.0, (0.0, 3.0)) == 0


@pytest.mark.parametrize("period", [0.0, 10.0])
def test_two_that_overlap_are_moved_apart_alike(period: float) -> None:
    """Of 2 m they lack 0.5 m; a domain that wraps has them at its two ends."""
    x = np.array([[9.5 if period else -0.5, 1.0, 0.0], [1.0, 1.0, 0.0]])
    least, around = np.array([1.0, 3.0]), np.zeros((2, 3))
    around[1, 0] = period
    found, overlap, _ = _kernels.flock_separate(x, least, 1, 1.0, 0.01, around, 1e6)
    assert_allclose(found - x, [[-0.26, 0, 0], [0.26, 0, 0]], atol=1e-12)
    assert overlap == 0
    found, overlap, _ = _kernels.flock_separate(x, least, 1, 0.5, 0.0, around, 1e6)
    assert_allclose(found - x, [[-0.125, 0, 0], [0.125, 0, 0]], atol=1e-12)
    assert overlap == pytest.approx(0.25)
    found, overlap, _ = _kernels.flock_separate(x, least, 0, 1.0, 0.0, around, 1e6)
    assert_allclose(found, x)
    assert overlap == pytest.approx(0.5)


@pytest.mark.parametrize("length", [0.0, 100.0])
def test_as_many_pairs_as_are_allowed_are_looked_at_and_one_more_is_told(
    length: float,
) -> None:
    """Two groups of four far apart: as many as the first has are not all."""
    group = np.random.default_rng(2).uniform(10.2, 10.4, (4, 3))
    period = np.array([[0.0, 0, 0], [length] * 3])

    def looked(points: np.ndarray, most: float) -> float:
        least = np.ones(len(points))
        return float(
            _kernels.flock_separate(points, least, 0, 1.0, 0.1, period, most)[2]
        )

    alone = looked(group, np.inf)
    both = np.concatenate([group, group + 40.0])
    assert alone > 0
    assert looked(both, np.inf) == 2 * alone
    assert looked(both, 2 * alone) == 2 * alone
    for most in (alone, 2 * alone - 1):
        assert looked(both, most) > most
    assert looked(both, alone - 1) == alone

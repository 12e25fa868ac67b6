"""Distances of ways, and who slows down for whom."""

from __future__ import annotations

import numpy as np
import pytest

from animtool import _kernels

CELL = 0.25


def distances(free: np.ndarray, row: int, column: int) -> np.ndarray:
    seeds = np.array([row * free.shape[1] + column])
    return np.asarray(_kernels.travel_distances(free, CELL, seeds, np.zeros(1)))


def test_distances_are_alike_in_all_directions() -> None:
    """In a room with a wall, however it is turned and mirrored."""
    free = np.ones((9, 14), bool)
    free[2:7, 6] = False
    found = distances(free, 3, 4)
    assert np.isinf(found[~free]).all()
    for turn, row, column in (
        (np.flipud, 5, 4),
        (np.fliplr, 3, 9),
        (np.transpose, 4, 3),
    ):
        np.testing.assert_allclose(
            turn(distances(turn(free).copy(), row, column)), found, rtol=1e-12
        )


@pytest.mark.parametrize("cells", [20, 40, 80])
def test_distances_in_an_empty_room(cells: int) -> None:
    """Within what the method errs about a point: a cell and a half at these sizes."""
    found = distances(np.ones((cells, cells), bool), cells // 2, cells // 3)
    at = np.indices(found.shape) * CELL
    true = np.hypot(at[0] - cells // 2 * CELL, at[1] - cells // 3 * CELL)
    assert (found >= true - 1e-9).all()
    assert (found - true).max() < 1.5 * CELL


@pytest.mark.parametrize(
    ("most", "least", "preferred", "expected"),
    [
        (4.0, -0.5, (3.0, -2.0), (3.0, -0.5)),  # the wall alone
        (4.0, -0.5, (3.0, 1.0), (3.0, 1.0)),
        (4.0, 2.0, (3.9, 0.0), (12**0.5, 2.0)),  # both: where the line meets the disc
        (0.5, 0.3, (-0.5, 0.0), (-0.4, 0.3)),
        (0.5, -9.0, (-0.36, 0.48), (-0.3, 0.4)),  # the speed alone
    ],
)
def test_who_is_alone_goes_as_it_likes_as_far_as_walls_and_speed_let_it(
    most: float,
    least: float,
    preferred: tuple[float, float],
    expected: tuple[float, float],
) -> None:
    """The wall lets it go no slower along z than ``least`` [m/s]."""
    x, one = np.zeros((1, 2)), np.ones(1)
    points, velocities, overlap, _ = _kernels.crowd_step(
        x, x, np.array([preferred]), 0.3 * one, most * one, one, np.zeros((1, 2)), 0.1,
        np.full(1, -1, np.int32), np.zeros(1, np.uint8), np.array([0, 1], np.int32),
        np.array([[0.0, 1.0, least, -100.0]]), 5.0, 8, 2.0, 0.1, 0.5, 0.5, 0.0, 0.1, 9,
        0.001,
    )  # fmt: skip
    np.testing.assert_allclose(velocities, [expected], atol=1e-9)
    np.testing.assert_allclose(points, 0.1 * velocities, atol=1e-12)
    assert overlap == 0

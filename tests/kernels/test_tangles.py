"""Cloth that is limited in strain, and that comes free of itself."""

from __future__ import annotations

import numpy as np
import pytest
from support.piercing import pierced

from animtool import _kernels

CELL = 0.02
STILL = np.zeros((0, 3), np.int64)


def grid(size: int, offset: int) -> tuple[np.ndarray, np.ndarray]:
    """Return points of a square grid, and its triangles numbered from an offset."""
    row, column = np.mgrid[:size, :size]
    points = CELL * np.stack([column, row, 0 * row], axis=-1).reshape(-1, 3)
    corner = (row * size + column)[:-1, :-1].ravel() + offset
    first = np.stack([corner, corner + 1, corner + size + 1], axis=1)
    last = np.stack([corner, corner + size + 1, corner + size], axis=1)
    return points, np.concatenate([first, last])


def stiff_network(
    points: np.ndarray, triangles: np.ndarray, held: np.ndarray, path: np.ndarray
) -> tuple[_kernels.SpringNetwork, np.ndarray]:
    """Return a network whose sides of triangles do not give, and these sides."""
    sides = np.concatenate([triangles[:, [k, (k + 1) % 3]] for k in range(3)])
    ends = np.unique(np.sort(sides, axis=1), axis=0).astype(np.int64)
    rest = np.linalg.norm(points[ends[:, 0]] - points[ends[:, 1]], axis=1)
    inverse = np.full(len(points), 1e3)
    inverse[held] = 0.0
    none = np.zeros(len(ends))
    network = _kernels.SpringNetwork(
        inverse, np.zeros(len(points)), ends, rest, none + 1e9, none, none + np.inf,
        triangles.astype(np.int64), np.zeros(3), 0.0, 0.0, np.array([0.0, 1.0]),
        held.astype(np.int64), path, np.zeros(0, np.int64), np.zeros(0), np.zeros(0),
        np.zeros((1, 0, 3)), np.zeros((1, 1, 3)),
    )  # fmt: skip
    return network, ends


def poked() -> tuple[np.ndarray, np.ndarray]:
    """Return a flat sheet with a corner of another through its middle."""
    flat, below = grid(9, 0)
    other, above = grid(6, len(flat))
    turn = np.array([[1, -1, 0], [0, 0, np.sqrt(2)], [1, 1, 0]]) / np.sqrt(2)
    middle = np.array([4.3 * CELL, 4.2 * CELL, -0.55 * CELL])
    return np.concatenate([flat, other @ turn.T + middle]), np.concatenate(
        [below, above]
    )


@pytest.mark.parametrize("limit", [0.0, 0.05])
def test_a_corner_that_begins_pierced_comes_free_where_strain_is_limited(
    limit: float,
) -> None:
    points, triangles = poked()
    held = np.zeros(0, np.int64)
    network, ends = stiff_network(points, triangles, held, np.zeros((1, 0, 3)))
    layers = _kernels.SpringLayers(network, points, 0.004, 0.2, 0.2)
    assert pierced(points, triangles) == _kernels.pierced_edges(
        points, triangles.astype(np.int64)
    )
    state = np.stack([points, np.zeros_like(points)])
    middle = points.mean(axis=0)
    made = _kernels.project_springs(
        network, state, np.zeros(len(ends), np.uint8), 0.0, 0, 0.01, 30, 10, 0, 10, 10,
        1.0, None, layers, STILL, limit,
    )[0]  # fmt: skip
    assert pierced(points, triangles) > 0
    assert (pierced(made[0], triangles) == 0) == (limit > 0)
    # Coming free has no speed, and moves nothing as a whole.
    assert made[0].mean(axis=0) == pytest.approx(middle, abs=1e-9)
    if limit:
        assert np.abs(made[1]).max() < 0.3


def test_a_limit_keeps_strain_and_momentum() -> None:
    points, triangles = grid(7, 0)
    held = np.zeros(0, np.int64)
    network, ends = stiff_network(points, triangles, held, np.zeros((1, 0, 3)))
    speeds = np.random.default_rng(5).normal(size=points.shape)
    rest = np.linalg.norm(points[ends[:, 0]] - points[ends[:, 1]], axis=1)

    def strain(limit: float) -> tuple[float, np.ndarray]:
        made = _kernels.project_springs(
            network, np.stack([points, speeds]), np.zeros(len(ends), np.uint8), 0.0, 0,
            0.01, 4, 2, 0, 2, 2, 1.0, None, None, STILL, limit,
        )[0]  # fmt: skip
        lengths = np.linalg.norm(made[0, ends[:, 0]] - made[0, ends[:, 1]], axis=1)
        return float(np.abs(lengths / rest - 1).max()), made[1].mean(axis=0)

    free, limited = strain(0.0), strain(0.02)
    assert limited[0] < 0.05 < free[0]
    assert limited[1] == pytest.approx(speeds.mean(axis=0), abs=1e-12)


def test_no_step_leads_a_crumpled_sheet_through_itself() -> None:
    points, triangles = grid(10, 0)
    held = np.zeros(0, np.int64)
    network, ends = stiff_network(points, triangles, held, np.zeros((1, 0, 3)))
    layers = _kernels.SpringLayers(network, points, 0.003, 0.2, 0.2)
    random = np.random.default_rng(11)
    speeds = 4 * random.normal(size=points.shape)
    # It is pressed together, ten times as far in a step as it is thick.
    speeds[:, 0] -= 30 * (points[:, 0] - points[:, 0].mean()) / CELL

    def most_pierced(limit: float) -> int:
        state, passages, found = np.stack([points, speeds]), STILL, 0
        for k in range(20):
            made = _kernels.project_springs(
                network, state, np.zeros(len(ends), np.uint8), 0.0, k, 1 / 240, 1, 2, 0,
                2, 2, 1.0, None, layers, passages, limit,
            )  # fmt: skip
            state, passages = made[0], made[8]
            found = max(found, pierced(state[0], triangles))
        return found

    assert most_pierced(0.05) == 0
    assert most_pierced(0.0) > 0


def test_what_is_pressed_on_pins_that_sway_does_not_pierce_itself() -> None:
    """Gaps of what moves as one piece are widened: pins do not move rigidly."""
    size, limit = 4, 0.05
    points, triangles = grid(size, 0)
    held = np.arange(size)
    x = points[held, 0]
    swayed = 8 * np.stack(
        [0.1 * x, 0.02 * np.sin(40 * x), 0.05 * x * np.cos(50 * x)], 1
    )
    path = np.stack([points[held], points[held] + swayed])
    network, ends = stiff_network(points, triangles, held, path)
    layers = _kernels.SpringLayers(network, points, 0.003, 0.2, 0.2)
    speeds = 2 * np.random.default_rng(6).normal(size=points.shape)
    state, passages, found = np.stack([points, speeds]), STILL, 0
    for k in range(200):
        made = _kernels.project_springs(
            network, state, np.zeros(len(ends), np.uint8), 0.0, k, 1 / 240, 1, 2, 0,
            2, 8, 1.0, None, layers, passages, limit,
        )  # fmt: skip
        state, passages = made[0].copy(), made[8]
        found = max(found, pierced(state[0], triangles))
        # Press it together.
        state[1] -= 200 * (state[0] - state[0].mean(axis=0))
    assert found == 0

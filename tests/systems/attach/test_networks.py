"""What cloth becomes of faces."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from animtool.maths.faces import edges
from animtool.systems.attach.bodies import (
    RIGID_FREQUENCY,
    MassSpringNetwork,
    max_pin_hops,
)
from animtool.systems.springs.shapes import face_diagonals, hinge_pairs


def grid(size: int) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Return points, and counts and corners of faces."""
    across, down = np.meshgrid(np.arange(size), np.arange(size))
    points = np.stack([across, down, 0 * down], axis=-1).reshape(-1, 3).astype(float)
    row, column = np.mgrid[: size - 1, : size - 1]
    at = (row * size + column).ravel()
    corners = np.stack([at, at + 1, at + size + 1, at + size], axis=1)
    return points, (np.full(len(corners), 4), corners.ravel())


def test_springs_of_a_grid() -> None:
    size = 5
    points, faces = grid(size)
    sides = MassSpringNetwork(points, np.array([0]), edges(*faces))
    assert len(sides.rest_lengths) == 2 * size * (size - 1)
    assert_allclose(sides.rest_lengths, 1.0)
    assert len(face_diagonals(*faces)) == 2 * (size - 1) ** 2
    folds = MassSpringNetwork(points, np.array([0]), hinge_pairs(*faces))
    assert_allclose(folds.rest_lengths, 2.0)
    assert len(folds.rest_lengths) == 2 * size * (size - 2)


def test_the_farthest_particle() -> None:
    points, faces = grid(4)
    sides = edges(*faces)
    assert max_pin_hops(MassSpringNetwork(points, np.array([0]), sides)) == 6
    assert max_pin_hops(MassSpringNetwork(points, np.arange(4), sides)) == 3
    assert max_pin_hops(MassSpringNetwork(points, np.array([], np.int64), sides)) == 6


def test_another_size() -> None:
    points, faces = grid(3)
    network = MassSpringNetwork(2.5 * points, np.array([0]), edges(*faces))
    assert_allclose(network.rest_lengths, 2.5)
    springs = network.body(20.0, 0.0).springs
    assert_allclose(springs.rest, 2.5)
    assert len(springs.rest) == len(network.structural)
    assert_allclose(springs.stiffness, RIGID_FREQUENCY**2 * network.masses[0])

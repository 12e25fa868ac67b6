"""Distances of markers, and the rigid motion that brings a shape onto points."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

from animtool.capture.markers.geometry import (
    fit_shape,
    marker_distances,
    mean_shape,
    positions_by_column,
)
from animtool.maths import so3

SHAPE = np.array([[0.0, 0, 0], [0.3, 0, 0], [0, 0.2, 0], [0, 0, 0.1]])


def test_a_spread_is_one_standard_deviation() -> None:
    """Of distances even from 1 to 2 m: half of what 15.87 to 84.13 % of them span."""
    path = np.zeros((101, 3, 3))
    path[:, 1, 0] = 1 + np.arange(101) / 100
    path[:, 2, 1] = 3.0
    path[5:, 2] = np.nan  # seen too seldom to say anything
    found = marker_distances(path)
    assert_allclose(found.mean[0, 1], 1.5)
    assert_allclose(found.spread[0, 1], 0.3413)
    assert np.isnan(found.mean[2]).all()
    assert_allclose(found.mean[:2, :2], found.mean[:2, :2].T)


def test_a_shape_is_turned_and_never_mirrored() -> None:
    """Onto its own mirror image it goes by a turn, and is off by what that leaves."""
    turn, shift = so3.exp(np.array([0.4, -1.0, 0.3])), np.array([1.0, 2.0, -3.0])
    points = so3.rotate(turn, SHAPE) + shift
    mirrored = points * [-1.0, 1.0, 1.0]
    rotations, shifts = fit_shape(np.stack([points, mirrored]), SHAPE)
    assert_allclose(np.linalg.det(rotations), 1.0)
    assert_allclose(rotations[0], so3.to_matrix(turn), atol=1e-12)
    assert_allclose(shifts[0], shift, atol=1e-12)
    off = SHAPE @ rotations[1].T + shifts[1] - mirrored
    assert np.abs(off).max() > 0.02


def test_positions_by_the_column_of_their_id() -> None:
    ids = np.array([[1, 0], [2, -1], [0, 2]])
    positions = np.arange(18.0).reshape(3, 2, 3)
    found = positions_by_column(positions, ids, np.array([1, -1, 0]), 2)
    wanted = np.full((3, 2, 3), np.nan)
    wanted[0, 1], wanted[1, 0] = positions[0, 1], positions[1, 0]
    wanted[2] = positions[2, [1, 0]]
    assert_array_equal(found, wanted)


def test_the_mean_shape_is_that_of_the_median() -> None:
    turns = so3.exp(np.linspace([0.0, 0, 0], [0.2, 1.0, -0.5], 9))
    points = so3.rotate(turns[:, None], SHAPE[None])
    points[4, 1] += 0.05  # in one frame of nine
    made = mean_shape(points)
    apart = np.linalg.norm(made[:, None] - made[None], axis=-1)
    assert_allclose(apart, np.linalg.norm(SHAPE[:, None] - SHAPE, axis=-1), atol=1e-3)

"""Meshes whose points are not where joints have them."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

from animtool.motion import Channel
from animtool.rig.parts import Subdivision
from animtool.rig.surfaces import Surface
from animtool.skin.deform import Deformed, extents
from animtool.skin.displaced import displaced_points, vertex_normals


def square() -> Surface:
    points = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0]])
    counts, indices = np.array([4, 3]), np.array([0, 1, 2, 3, 1, 4, 2])
    normals = np.tile([0.0, 0.0, 1.0], (5, 1))
    return Surface(
        "s", points, counts, indices, normals, np.eye(4), None, (), Subdivision.NONE
    )


def test_normals_are_those_of_the_faces() -> None:
    surface = square()
    flat = surface.points[None]
    tilted = flat @ np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    assert_allclose(vertex_normals(surface, flat)[0], surface.normals)
    assert_allclose(
        vertex_normals(surface, tilted)[0], np.tile([0.0, -1.0, 0.0], (5, 1))
    )


def test_only_frames_that_differ_get_other_normals() -> None:
    surface = square()
    kept = np.tile([0.6, 0.0, 0.8], (3, 5, 1))
    still = np.repeat(surface.points[None], 3, axis=0)
    made = Deformed(still, extents(still), kept)
    values = still.copy()
    values[1, :, 2] += 1.0
    moved = Channel(values[0], np.arange(5), values)
    found = displaced_points(made, moved, slice(0, 3), surface, None)
    assert found.normals is not None
    assert_array_equal(found.normals[[0, 2]], kept[[0, 2]])
    assert_allclose(found.normals[1], surface.normals)
    assert_array_equal(found.points, values)


def test_velocities_look_beyond_the_block() -> None:
    times = np.arange(6) / 24
    values = np.sin(3 * times)[:, None, None] * np.ones((1, 2, 3))
    moved = Channel(values[0], np.arange(2), values)
    whole = np.gradient(values, times, axis=0)
    zero = np.zeros((2, 2, 3))
    made = Deformed(zero, extents(zero), None, zero)
    found = displaced_points(made, moved, slice(2, 4), None, times)
    assert_allclose(found.velocities, whole[2:4])

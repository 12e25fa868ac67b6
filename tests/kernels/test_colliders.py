"""How far points are from shapes, and the way out, in closed form and off the axes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from animtool.maths import so3
from animtool.sim.colliders import (
    Box,
    Capsule,
    Collider,
    Colliders,
    Plane,
    Poses,
    Sphere,
)

H = 0.5**0.5


@pytest.mark.parametrize(
    ("shape", "point", "distance", "way"),
    [
        (Sphere(2.0, (1, 2, 3)), (1, 5, 7), 3.0, (0, 0.6, 0.8)),
        (Sphere(2.0, (1, 2, 3)), (1, 2, 2), -1.0, (0, 0, -1)),
        (Capsule(0.5, 4.0, (1, 0, 0), (0, 1, 0)), (1.5, 4, 4), 4.5, (0, 0.6, 0.8)),
        (Capsule(0.5, 4.0, (1, 0, 0), (0, 1, 0)), (5, 5, 0), 4.5, (0.6, 0.8, 0)),
        (Capsule(0.5, 4.0, (1, 0, 0), (0, 1, 0)), (-5, 1, 4), 4.5, (-0.6, 0, 0.8)),
        (Capsule(0.5, 0.0, (1, 0, 0), (0, 1, 0)), (0, 1, 2), 1.5, (0, 0, 1)),
        (Box((2, 4, 6)), (4, 0, 7), 5.0, (0.6, 0, 0.8)),
        (Box((2, 4, 6)), (0.5, 1, 1), -0.5, (1, 0, 0)),
        (Box((2, 4, 6)), (-0.5, -1.9, 1), -0.1, (0, -1, 0)),
        (Box((2, 4, 6)), (0, 0, -5), 2.0, (0, 0, -1)),
        (Plane((0, 3, 4), 2.0), (7, 5, 5), 5.0, (0, 0.6, 0.8)),
    ],
)
@pytest.mark.parametrize("container", [False, True])
def test_distances_of_shapes(
    shape: Any, point: Any, distance: float, way: Any, container: bool
) -> None:
    """In a frame that is turned and off; of a container all is the other way."""
    turn = so3.exp(np.array([0.0, 0, np.pi / 2]))
    at = np.array([10.0, 20, 30])
    poses = Poses([0], [at], [turn])
    own = Colliders([Collider(shape, poses, container=container)])
    x = so3.rotate(turn, np.array([point], float)) + at
    found = own.as_solids.sample(x, 0.0)
    side = -1 if container else 1
    assert_allclose(found.distances, [[side * distance]], atol=1e-9)
    assert_allclose(
        found.normals[0], [side * so3.rotate(turn, np.array(way, float))], atol=1e-9
    )


def test_surfaces_go_as_fast_as_their_frames() -> None:
    """One metre off a frame that goes by 3 m/s along x and turns by 2 rad/s about z."""
    times = np.linspace(0, 1, 101)
    ways = np.stack([3 * times, 0 * times, 0 * times], axis=1)
    turns = so3.exp(np.stack([0 * times, 0 * times, 2 * times], axis=1))
    own = Colliders([Collider(Sphere(0.5), Poses(times, ways, turns))])
    x = np.array([[1.5, 1, 0], [2.5, 0, 0]])
    assert not own.sample(x, 0.5).velocities.any()  # of no step
    found = own.sample(x, 0.5, 0.51)
    assert_allclose(found.velocities[0], [[3 - 2, 0, 0], [3, 2, 0]], atol=0.03)


def test_linear_maps_are_a_turn_after_a_stretch() -> None:
    """Any turn, far ones too, after stretches of a hundredth, of one, and of 50."""
    from animtool import _kernels

    stretch = np.array([[0.9, 0.2, 0], [0.2, 1.1, 0.1], [0, 0.1, 0.7]])
    rng = np.random.default_rng(3)
    ways = rng.normal(size=(20, 3))
    ways *= (rng.uniform(0, np.pi, 20) / np.linalg.norm(ways, axis=1))[:, None]
    turns = np.concatenate([so3.exp(ways), np.eye(4)])
    for size in (0.01, 1.0, 50.0):
        linear = so3.to_matrix(turns) @ (size * stretch)
        found, stretched = _kernels.split_stretch(linear[:, None])
        assert so3.angle_between(found[:, 0], turns).max() < 1e-7
        assert_allclose(stretched[:, 0], [size * stretch] * 24, rtol=1e-9, atol=1e-12)
        found, stretched = _kernels.split_stretch(-linear[:, None])
        assert so3.angle_between(found[:, 0], turns).max() < 1e-7
        assert_allclose(stretched[:, 0], [-size * stretch] * 24, rtol=1e-9, atol=1e-12)
    flat = np.diag([1.0, 1, 0.9e-10])[None, None]
    found, stretched = _kernels.split_stretch(flat)
    assert not found.any()
    assert_allclose(stretched[0, 0], np.eye(3))
    assert _kernels.split_stretch(np.diag([1.0, 1, 1.1e-10])[None, None])[0].any()

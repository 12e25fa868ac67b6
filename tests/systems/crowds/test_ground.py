"""Heights of ground that triangles are, and where it may be walked on."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.testing import assert_allclose

from animtool.maths import so3
from animtool.motion.frames import MeshFrame
from animtool.sim.colliders import Poses
from animtool.systems.crowds.building import read_ground
from animtool.systems.crowds.ground import (
    GroundFrame,
    Terrain,
    find_walkable_nodes,
    rotations_about_y,
)

# A slope of 1 in 2 along x from (0, 0) to (4, 2), a floor over a part, and a wall.
SLOPE = [
    [[0, 0, 0], [4, 2, 0], [4, 2, 2]],
    [[0, 0, 0], [0, 0, 2], [4, 2, 2]],
    [[1, 5, 0], [3, 5, 0], [1, 5, 1]],
    [[2, 0, 0], [2, 9, 0], [2, 9, 2]],
]


def test_the_ground_is_the_highest_of_what_is_there() -> None:
    """Its edges are of it; beyond them there is none."""
    ground = Terrain(np.array(SLOPE, float))
    points = [[3.5, 1], [0, 0], [4, 2], [2, 1.5], [1.5, 0.25], [4.001, 1], [2, -0.1]]
    heights, normals = ground(np.array(points, float))
    assert_allclose(heights, [1.75, 0, 2, 1, 5, np.nan, np.nan])
    tilted = np.array([-1.0, 2, 0]) / np.sqrt(5)
    up = [0.0, 1.0, 0.0]
    assert_allclose(normals[[0, 1, 3]], [tilted] * 3, atol=1e-12)
    assert_allclose(normals[[4, 5, 6]], [up] * 3, atol=1e-12)
    assert_allclose(ground.bounds, [[0, 0], [4, 2]])
    assert not ground.is_plane
    assert Terrain().is_plane
    heights, normals = Terrain()(np.array([[7.0, -3]]))
    assert (heights.tolist(), normals.tolist()) == ([0], [up])


def test_many_triangles_are_found_by_their_cells() -> None:
    """A grid of thirty triangles of z²: each point is on its own."""
    x, z = np.arange(4.0), np.arange(6.0)
    made = []
    for i in range(3):
        for j in range(5):
            a, b, c, d = ([x[p], z[q] ** 2, z[q]] for p, q in
                          ((i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)))  # fmt: skip
            made += [[a, b, c], [a, c, d]]
    ground = Terrain(np.array(made))
    points = np.random.default_rng(4).uniform([0, 0], [3, 5], (200, 2))
    first = np.floor(points[:, 1])
    wanted = first**2 + (points[:, 1] - first) * (2 * first + 1)
    assert_allclose(ground(points)[0], wanted)
    rows, which = ground._candidate_pairs(points)
    assert set(rows.tolist()) == set(range(200))
    assert len(which) < 200 * 12
    assert not len(ground._candidate_pairs(np.array([[3.1, 1.0], [1.0, -0.1]]))[0])


def test_agents_walk_up_to_a_slope_and_not_where_there_is_no_ground() -> None:
    ground = Terrain(np.array(SLOPE[:2], float))
    nodes = np.array([[a, b] for a in range(6) for b in range(3)], float)
    for slope, free in ((0.47, True), (0.46, False)):
        heights, walked = find_walkable_nodes(ground, nodes, (6, 3), 1.0, slope)
        assert_allclose(heights[:5], [[k / 2] * 3 for k in range(5)], atol=1e-12)
        assert (walked[:5] == free).all()
        assert not walked[5].any()


def test_a_frame_turns_about_its_origin_and_back() -> None:
    frame = GroundFrame(np.array([1.0, 2, 3]), so3.exp(np.array([0, np.pi / 2, 0])))
    assert_allclose(frame.to_world(np.array([[1.0, 0, 0]])), [[1, 2, 2]], atol=1e-12)
    assert_allclose(frame.to_local(np.array([[1.0, 2, 2]])), [[1, 0, 0]], atol=1e-12)
    assert_allclose(frame.vector_to_world(np.array([0.0, 0, 1])), [1, 0, 0], atol=1e-12)
    assert_allclose(frame.vector_to_local(np.array([1.0, 0, 0])), [0, 0, 1], atol=1e-12)
    ahead = so3.rotate(rotations_about_y(np.array([0.5])), np.array([0.0, 0, 1]))
    assert_allclose(ahead, [[np.sin(0.5), 0, np.cos(0.5)]])


def test_the_ground_may_be_a_mesh_of_a_file() -> None:
    points = np.array([[0.0, 1, 0], [0, 1, 4], [4, 1, 4], [4, 1, 0]])
    mesh = MeshFrame(points, np.zeros((4, 3)), np.array([4]), np.arange(4))
    context: Any = SimpleNamespace(
        entry_data={"ground": {"poses": Poses(), "mesh": lambda: (mesh,)}}, begin=0.0
    )
    _, terrain = read_ground(context)
    heights, _ = terrain(np.array([[1.0, 2.0], [5.0, 2.0]]))
    assert heights[0] == 1
    assert np.isnan(heights[1])

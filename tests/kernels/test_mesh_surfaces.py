"""Meshes whose points move, as kernels take them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from animtool import _kernels
from animtool.sim.colliders import Colliders
from animtool.systems.springs import Body, Springs, SpringSystem

POINTS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
FACES = np.array([[0, 1, 2]], np.int32)
NUMBERS = (0.0, 0.0, 0.0, 1.0, 200.0)


def stepped(*surface: Any, cells: int = 4) -> Any:
    """Take a particle through cells of time."""
    body = Body(np.ones((1, 3)), np.ones(1), Springs.none(), np.zeros((0, 3), int))
    system = SpringSystem(body)
    poses = np.zeros((cells, 0, 2, 7))
    met = Colliders([]).kernel_arrays(0.0, 0.0), poses, 0.0, None, 1e-6, [surface]
    return _kernels.step_springs(
        system.network(0), system.state, np.zeros(0, np.uint8), 0.0, 0, 0.01, cells, 1,
        met,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("points", "faces"),
    [
        (POINTS, FACES + 1),
        (POINTS, FACES - 1),
        (POINTS, FACES[:0]),
        (POINTS[:, :2].copy(), FACES),
        (POINTS, FACES[:, :2].copy()),
    ],
)
def test_triangles_are_of_points(points: np.ndarray, faces: np.ndarray) -> None:
    with pytest.raises(ValueError, match=r"^(points|triangles): "):
        _kernels.MeshSurface(points, faces)


@pytest.mark.parametrize(
    ("knots", "lasts", "over", "fits"),
    [
        (5, 1, 0, True),
        (4, 1, 0, False),
        (3, 2, 0, True),
        (4, 2, 1, True),
        (3, 2, 1, False),
        (5, 0, 0, False),
        (3, 2, 2, False),
        (3, 2, -1, False),
    ],
)
def test_knots_are_as_many_as_cells_ask_for(
    knots: int, lasts: int, over: int, fits: bool
) -> None:
    made = _kernels.MeshSurface(POINTS, FACES)
    paths = np.tile(POINTS, (knots, 1, 1))
    if fits:
        assert np.isfinite(stepped(made, paths, NUMBERS, lasts, over)[0]).all()
        return
    with pytest.raises(ValueError, match="surfaces"):
        stepped(made, paths, NUMBERS, lasts, over)


def test_knots_have_the_points_of_the_mesh() -> None:
    made = _kernels.MeshSurface(POINTS, FACES)
    with pytest.raises(ValueError, match="surfaces"):
        stepped(made, np.zeros((5, 4, 3)), NUMBERS, 1, 0)


@pytest.mark.parametrize("corners", [[0, 0, 1], [0, 1, 1], [0, 1, 0]])
def test_a_triangle_without_area_is_as_far_as_its_sides(corners: list[int]) -> None:
    points = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    tree = _kernels.build_mesh_tree(points, np.array([corners], np.int32))
    still = np.array([[[0, 0, 0, 0, 0, 0, 1.0]] * 2])
    colliders = (np.array([[4, 0, 0]]), np.ones((1, 7)), np.zeros((1, 4)), still)
    places = np.array([[1.0, 3, 0], [-4, 3, 0], [5, 4, 0]])
    found = _kernels.sample_colliders((*colliders, points, *tree), places, 0.0, 0.1)
    assert found[0].tolist() == [[3, 5, 5]]

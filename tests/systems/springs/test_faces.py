"""Edges and faces of cloth against what is finer than its cells."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from animtool import _kernels
from animtool.sim.colliders import (
    Box,
    Capsule,
    Collider,
    Colliders,
    Mesh,
    Poses,
    Sphere,
)
from animtool.systems.springs import (
    Family,
    Pins,
    Solver,
    SpringMotion,
    SpringOptions,
    SpringSystem,
    sheet,
    simulate_springs,
)

COUNT, CELL = 11, 0.033
SOLVERS = [Solver.SYMPLECTIC_EULER, Solver.XPBD, Solver.BDF2]
LENGTH = 0.2


def pipe(radius: float, corners: int = 12) -> Mesh:
    """Return a closed tube along x."""
    angle = np.arange(corners) * 2 * np.pi / corners
    ring = radius * np.stack([0 * angle, np.cos(angle), np.sin(angle)], axis=1)
    shift = np.array([LENGTH / 2, 0, 0])
    points = np.concatenate([ring - shift, ring + shift, [-shift, shift]])
    faces = []
    for i in range(corners):
        j = (i + 1) % corners
        faces += [[i, j, i + corners], [j, j + corners, i + corners]]
        faces += [[2 * corners, j, i], [2 * corners + 1, i + corners, j + corners]]
    return Mesh(points, faces)


SHAPES: dict[str, Any] = {
    "sphere": Sphere(0.01),
    "capsule": Capsule(0.01, LENGTH, (1.0, 0, 0)),
    "box": Box((LENGTH, 0.02, 0.02)),
    "mesh": pipe(0.01),
}


def curtain(colliders: list[Collider]) -> SpringSystem:
    """Return a sheet of cells of 3.3 cm in the plane z = 0, held along its top."""
    size = (COUNT - 1) * CELL
    body = sheet(
        COUNT, COUNT, mass=0.05,
        structural=Family(300.0, 0.1), diagonals=Family(150.0, 0.1),
        corner=[-size / 2, -size / 2, 0], across=[size, 0, 0], up=[0, size, 0],
    )  # fmt: skip
    top = np.arange(COUNT) + COUNT * (COUNT - 1)
    pull = (0.0, -9.81, 0.0)
    return SpringSystem(body, pins=Pins(top), gravity=pull, colliders=colliders)


def thrust(shape: Any, speed: float, solver: Solver, y: float = 0.007) -> SpringMotion:
    """Push a collider from behind a curtain to before it."""
    way, x = 0.2, 0.004
    last = way / speed
    poses = Poses(
        [0, last], [[x, y, -way / 2], [x, y, way / 2]], ((0.0, 0.0, 0.0, 1.0),) * 2
    )
    system = curtain([Collider(shape, poses, friction=0.3)])
    times = np.linspace(0, last + 0.02, 9)
    return simulate_springs(system, times, SpringOptions(solver))


def behind(points: np.ndarray, place: np.ndarray) -> bool:
    """Return whether a face of the sheet is right behind a place, along z."""
    grid = np.arange(COUNT * COUNT).reshape(COUNT, COUNT)
    faces = np.stack(
        [grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]], axis=-1
    ).reshape(-1, 4)
    for corners in np.concatenate([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]]):
        a, b, c = points[corners]
        flat = np.stack([b - a, c - a], axis=1)[:2]
        if abs(np.linalg.det(flat)) < 1e-12:
            continue
        u, v = np.linalg.solve(flat, (place - a)[:2])
        if min(u, v, 1 - u - v) >= 0:
            z = a[2] + u * (b - a)[2] + v * (c - a)[2]
            if z < place[2]:
                return True
    return False


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("speed", [5.0, 20.0])
@pytest.mark.parametrize("shape", SHAPES)
def test_a_thin_rod_takes_cloth_along(shape: str, speed: float, solver: Solver) -> None:
    motion = thrust(SHAPES[shape], speed, solver)
    for time, points in zip(motion.times, motion.positions, strict=True):
        z = min(-0.1 + speed * time, 0.1)
        if z > 0.03:
            assert not behind(points, np.array([0.004, 0.007, z]))
    assert np.isfinite(motion.positions).all()
    assert motion.positions[-1, :, 2].max() > 0.09


def test_the_same_again() -> None:
    one, two = (thrust(SHAPES["mesh"], 20.0, Solver.XPBD) for _ in range(2))
    np.testing.assert_array_equal(one.positions, two.positions)


def test_cloth_without_anything_fine_is_as_without_faces() -> None:
    """A ball wider than cells is met by particles, faces or not."""
    ball = Collider(Sphere(0.1), Poses([0, 0.1], [[0, 0, -0.2], [0, 0, 0]],
                                       ((0.0, 0, 0, 1),) * 2))  # fmt: skip
    system = curtain([ball])
    body = replace(system.body, triangles=system.body.triangles[:0])
    top = np.arange(COUNT) + COUNT * (COUNT - 1)
    pull = (0.0, -9.81, 0.0)
    bare = SpringSystem(body, pins=Pins(top), gravity=pull, colliders=[ball])
    times = np.linspace(0, 0.2, 5)
    with_faces, without = (
        simulate_springs(one, times, SpringOptions(Solver.XPBD)).positions
        for one in (system, bare)
    )
    np.testing.assert_array_equal(with_faces, without)
    assert np.abs(with_faces[-1, :, 2]).max() > 0.02


def test_what_faces_gain_the_collider_loses() -> None:
    """A small ball amid a cell of a free sheet touches no particle."""
    size = (COUNT - 1) * CELL
    body = sheet(COUNT, COUNT, mass=0.05, structural=Family(300.0, 0.1),
                 across=[size, 0, 0], up=[0, size, 0])  # fmt: skip
    system = SpringSystem(body, gravity=(0.0, 0.0, 0.0))
    cells, cell, speed = 20, 0.001, 5.0
    at = system.body.positions[[0, 1, COUNT]].mean(axis=0)
    poses = np.zeros((cells, 1, 2, 7))
    poses[..., 6] = 1.0
    poses[..., :3] = at
    poses[:, 0, 0, 2] = speed * cell * np.arange(cells) - 0.05
    poses[:, 0, 1, 2] = poses[:, 0, 0, 2] + speed * cell
    met = (
        Colliders([Collider(Sphere(0.004))]).kernel_arrays(0.0, 0.0),
        poses,
        0.0,
        None,
        1e-6,
    )
    state, _, inside, pushes = _kernels.step_springs(
        system.network(0), system.state, system.untorn_flags, 0.0, 0, cell, cells, 8,
        (*met, []),
    )  # fmt: skip
    gained = (system.body.masses[:, None] * state[1]).sum(axis=0)
    turned = np.cross(state[0], system.body.masses[:, None] * state[1]).sum(axis=0)
    assert not inside
    assert gained[2] > 1e-3
    np.testing.assert_allclose(pushes[0, :3], -gained, atol=1e-3 * gained[2])
    np.testing.assert_allclose(pushes[0, 3:6], -turned, atol=2e-2 * gained[2] * size)

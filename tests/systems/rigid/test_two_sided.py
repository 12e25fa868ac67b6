"""Meshes of arrays are met from both sides, by bodies and particles of any speed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.rigid import Rigid, ball, box, capsule
from support.suite import some_quick

from animtool.core.errors import AnimtoolError
from animtool.maths import so3
from animtool.sim.colliders import Collider, Colliders, Mesh, Poses, collide
from animtool.systems.particles.setup import KillRegion

SQUARE = np.array([[0.0, -1, -1], [0, 1, -1], [0, 1, 1], [0, -1, 1]])
FACES = np.array([[0, 1, 2], [0, 2, 3]])
SPEEDS = (1.0, 10.0, 100.0, 300.0)
BODIES = {
    "ball": ball(0.05, mass=1), "box": box((0.1, 0.06, 0.08), mass=1),
    "capsule": capsule(0.03, 0.1, mass=1),
}  # fmt: skip
WALLS: dict[str, dict[str, Any]] = {
    "standing": {},
    "moving": {"moves": [[0, 0.2, 0, 0], [0.5, -1.8, 0, 0], [1, 0.2, 0, 0]]},
    "turning": {
        "turns": [[0, 0.9848, 0, 0, 0.1736], [1, 0.9848, 0, 0, -0.1736]],
    },
}  # fmt: skip


def wall(folder: Path, **keys: Any) -> dict[str, Any]:
    """Return a square across x, as the collider of a scene."""
    np.savez(folder / "wall.npz", points=SQUARE, triangles=FACES)
    return {"shape": {"mesh": {"points": "wall.npz", "triangles": "wall.npz"}}, **keys}


def poses_of(keys: dict[str, Any]) -> Poses:
    """Return where such a wall is."""
    if "moves" in keys:
        rows = np.array(keys["moves"])
        return Poses(rows[:, 0], rows[:, 1:], [[0, 0, 0, 1]] * len(rows))
    if "turns" in keys:
        rows = np.array(keys["turns"])
        return Poses(rows[:, 0], np.zeros((len(rows), 3)), rows[:, [2, 3, 4, 1]])
    return Poses()


@pytest.mark.slow
@pytest.mark.parametrize("motion", WALLS)
@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("body", some_quick(BODIES, 3))
def test_no_body_goes_through(
    tmp_path: Path, body: str, side: int, motion: str
) -> None:
    keys = WALLS[motion]
    poses = poses_of(keys)
    for speed in SPEEDS:
        own = {**BODIES[body], "at": [-side * 0.8, 0.013, 0.017]}
        own |= {"velocity": [side * speed, 0, 0], "restitution": 0.2}
        found = Rigid(tmp_path, own, colliders=[wall(tmp_path, **keys)], forces=[])
        for t in np.linspace(0.05, 1.0, 20):
            pose = poses.at(t)
            point = found.to(t)[0] - pose[:3]
            local = so3.rotate(so3.conjugate(pose[3:]), point)
            if np.abs(local[1:]).max() > 0.9:
                break
            assert local[0] * side < 0, (speed, t, local)


@pytest.mark.parametrize("motion", some_quick(WALLS, 3))
@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("radius", [0.0, 0.02])
def test_no_particle_goes_through(side: int, motion: str, radius: float) -> None:
    poses = poses_of(WALLS[motion])
    hard = Collider(Mesh(SQUARE, FACES), poses, restitution=0.3)
    rng = np.random.default_rng(7)
    h = 0.01
    for speed in SPEEDS:
        x = rng.uniform(-0.3, 0.3, (40, 3))
        x[:, 0] = -side * 0.8
        v = rng.normal(size=(40, 3)) * 0.1 * speed
        v[:, 0] = side * speed
        inside = np.ones(40, bool)
        for k in range(40):
            t, before = k * h, np.stack([x, v])
            gravity = np.array([side * 9.81, 0, 0])
            after = x + v * h + gravity * (h * h / 2)
            found = collide(after, v + gravity * h, before, [hard], t, t + h, radius)
            x, v = found.points, found.velocities
            pose = poses.at(t + h)
            local = so3.rotate(so3.conjugate(pose[3:]), x - pose[:3])
            inside &= np.abs(local[:, 1:]).max(axis=1) < 0.9
            assert (local[inside, 0] * side < 1e-9 - radius * 0.999).all(), (speed, k)


def test_who_rests_on_the_back_stays(tmp_path: Path) -> None:
    turn = {"rotate": [0.7071067811865476, 0, 0, 0.7071067811865476]}
    back = {"rotate": [0.7071067811865476, 0, 0, -0.7071067811865476]}
    for placed in (turn, back):
        crate = box((0.4, 0.2, 0.4), at=[0.3, 0.3, 0.3])
        found = Rigid(tmp_path, crate, colliders=[wall(tmp_path, **placed)])
        assert found.to(2.0)[0, 1] == pytest.approx(0.1, abs=2e-3)


def test_over_a_ridge_it_is_met_on_its_own_side(tmp_path: Path) -> None:
    """A box that reaches over the ridge of a roof is not behind the other slope."""
    points = np.array([[-1.0, -1, -1], [-1, -1, 1], [0, 0, -1], [0, 0, 1],
                       [0.3, -1, -1], [0.3, -1, 1]])  # fmt: skip
    triangles = np.array([[0, 1, 3], [0, 3, 2], [2, 3, 5], [2, 5, 4]])
    np.savez(tmp_path / "roof.npz", points=points, triangles=triangles)
    mesh = {"mesh": {"points": "roof.npz", "triangles": "roof.npz"}}
    turn = so3.exp(np.array([0, 0, np.pi / 4]))
    crate = box(
        (0.6, 0.2, 0.4), rotate=turn[[3, 0, 1, 2]].tolist(), friction=2,
        at=(np.array([-0.25, -0.25, 0]) + 0.1 * np.array([-1, 1, 0]) / 2**0.5 +
            np.array([0.1, 0.1, 0])).tolist(),
    )  # fmt: skip
    found = Rigid(tmp_path, crate, colliders=[{"shape": mesh, "friction": 2}])
    begin = found.to(0.0)[0]
    assert np.abs(found.to(1.0)[0] - begin).max() < 5e-3


def test_a_closed_mesh_is_met_from_outside_alone(tmp_path: Path) -> None:
    for closed in (False, True):
        entry = wall(tmp_path)
        entry["shape"]["mesh"]["closed"] = closed
        # The front looks along x: this one comes from behind.
        one = ball(0.05, mass=1, at=[-0.5, 0.1, 0], velocity=[5, 0, 0])
        found = Rigid(tmp_path, one, colliders=[entry], forces=[])
        assert (found.to(0.5)[0, 0] > 0) == closed


def test_closed_is_true_or_false(tmp_path: Path) -> None:
    entry = wall(tmp_path)
    entry["shape"]["mesh"]["closed"] = 3
    with pytest.raises(AnimtoolError) as error:
        Rigid(tmp_path, ball(0.05), colliders=[entry])
    assert error.value.code == "SCN002"


def test_who_begins_in_a_room_of_arrays_stays_in_it(tmp_path: Path) -> None:
    signs = np.indices((2, 2, 2)).reshape(3, 8).T * 2.0 - 1
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6],
                      [0, 2, 6, 4], [1, 5, 7, 3]])  # fmt: skip
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    np.savez(tmp_path / "room.npz", points=signs, triangles=faces)
    mesh = {"mesh": {"points": "room.npz", "triangles": "room.npz"}}
    thrown = {"velocity": [80, 47, -31], "restitution": 0.9}
    for one in (
        ball(0.1, **thrown),
        box((0.2, 0.1, 0.3), spin=[900, 400, 0], **thrown),
    ):
        found = Rigid(tmp_path, one, colliders=[{"shape": mesh}], forces=[])
        path = found.path(np.linspace(0.05, 3, 60))
        assert np.abs(path).max() < 1


def test_a_mesh_of_arrays_still_kills_inside() -> None:
    signs = np.indices((2, 2, 2)).reshape(3, 8).T * 1.0 - 0.5
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6],
                      [0, 2, 6, 4], [1, 5, 7, 3]])  # fmt: skip
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    region = Colliders([KillRegion(Collider(Mesh(signs, faces))).region.as_solid()])
    gaps = region.sample(np.array([[0.1, 0.2, 0.3], [0.7, 0, 0]]), 0.0).distances[0]
    assert (gaps < 0).tolist() == [True, False]

"""Meshes that are not convex, as convex pieces."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from support.rigid import FLOOR, Rigid, ball

from animtool.sim.colliders import Mesh
from animtool.systems.rigid import kind
from animtool.systems.rigid.cores import convex_pieces, excess_volume, mesh_solid

pytest.importorskip("coacd", reason="meshes are taken apart by coacd")

L_SHAPE = [(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)]
L_FACES = [[0, 2, 1], [0, 3, 2], [0, 5, 3], [3, 5, 4]]


def bracket() -> Mesh:
    """Return an L, a metre thick: three cubes of a metre."""
    count = len(L_SHAPE)
    points = np.array([[x, y, z] for z in (0, 1) for x, y in L_SHAPE], float)
    faces = [*L_FACES, *([a + count for a in face[::-1]] for face in L_FACES)]
    for k in range(count):
        j = (k + 1) % count
        faces += [[k, j, j + count], [k, j + count, k + count]]
    return Mesh(points, np.array(faces))


def cup() -> Mesh:
    """Return a box of 1 m with a square hole of .7 m to .2 m above its bottom."""
    outer, inner = 0.5, 0.35
    rings = [(outer, 0.0), (outer, 1.0), (inner, 1.0), (inner, 0.2)]
    points = np.array(
        [[x * s, y, z * s] for s, y in rings
         for x, z in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    )  # fmt: skip
    faces = [[0, 1, 2], [0, 2, 3], [12, 14, 13], [12, 15, 14]]
    for ring in range(3):
        for k in range(4):
            a, b = 4 * ring + k, 4 * ring + (k + 1) % 4
            faces += [[a, a + 4, b], [b, a + 4, b + 4]]
    return Mesh(points, np.array(faces))


def body(folder: Path, mesh: Mesh, **keys: Any) -> dict[str, Any]:
    np.savez(folder / "hollow.npz", points=mesh.points, triangles=mesh.triangles)
    shape = {"mesh": {"points": "hollow.npz", "triangles": "hollow.npz"}}
    return {"name": "hollow", "shape": shape, **keys}


def test_pieces_fill_the_mesh() -> None:
    mesh = bracket()
    assert mesh.is_watertight
    assert mesh_solid(mesh).volume == pytest.approx(3)
    made = convex_pieces(mesh)
    assert len(made) == 2
    assert abs(excess_volume(mesh, [core for _, core in made])) < 1e-3
    again = convex_pieces(mesh)
    for (one, _), (other, _) in zip(made, again, strict=True):
        assert (np.asarray(one.points) == np.asarray(other.points)).all()


def test_an_open_mesh_has_none() -> None:
    mesh = bracket()
    assert not convex_pieces(Mesh(mesh.points, np.asarray(mesh.triangles)[1:]))


def test_it_weighs_what_the_mesh_does(tmp_path: Path) -> None:
    found = Rigid(tmp_path, body(tmp_path, bracket(), density=10), forces=[])
    (own,) = found.simulation.bodies.kinds
    assert own.mass == pytest.approx(30)
    assert_allclose(own.centre, [5 / 6, 5 / 6, 0.5])
    assert "SIM198" in found.codes()
    assert "SIM125" not in found.codes()
    # It is shown as it is.
    assert_allclose(own.mesh.points.max(axis=0), [2, 2, 1])
    assert len(own.mesh.counts) == len(np.asarray(bracket().triangles))


@pytest.mark.slow
def test_a_cup_holds_a_ball(tmp_path: Path) -> None:
    held = ball(0.2, at=[0.05, 0.8, 0.02], density=100)
    found = Rigid(tmp_path, body(tmp_path, cup()), held, colliders=[FLOOR])
    assert found.to(2.0)[1, 1] == pytest.approx(0.4, abs=0.02)


def test_without_coacd_its_hull_is_met(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kind, "can_decompose", lambda: False)
    held = ball(0.2, at=[0.05, 1.3, 0.02], density=100)
    found = Rigid(tmp_path, body(tmp_path, cup()), held, colliders=[FLOOR])
    assert found.to(1.0)[1, 1] == pytest.approx(1.2, abs=0.01)
    (notice,) = [one for one in found.run.notices if one.code == "SIM125"]
    assert "animtool[convex]" in (notice.hint or "")

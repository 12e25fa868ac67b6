"""Bodies and particles on heights over a grid."""

from __future__ import annotations

import math
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial import ConvexHull
from support.rigid import GRAVITY, Rigid, ball, box
from support.simulated import Simulator

from animtool.core.errors import FormatError
from animtool.sim.colliders import Collider, Colliders, HeightField

# Of 8 m by 4 m, a height falls by a third of the way along x.
SIDES, FALL = (8.0, 4.0), 1 / 3
DOWN = np.array([3.0, -1.0, 0.0]) / math.sqrt(10)
UP = np.array([1.0, 3.0, 0.0]) / math.sqrt(10)


def hill(folder: Path, heights: Any, **keys: Any) -> dict[str, Any]:
    """Return a collider of heights ``(R, C)`` [m]."""
    np.savez(folder / "hill.npz", heights=heights)
    field = {"heights": "hill.npz#heights", "size": list(SIDES)}
    return {"shape": {"height_field": field}, **keys}


def slope(rows: int, columns: int) -> np.ndarray:
    return np.tile(-FALL * np.linspace(-4, 4, columns), (rows, 1))


def test_heights_are_over_the_middle_of_their_rectangle() -> None:
    x, z = np.meshgrid(np.linspace(-4, 4, 9), np.linspace(-2, 2, 5))
    shape = HeightField(SIDES).mesh(0.1 * x - 0.3 * z + 2)
    points = np.random.default_rng(1).uniform(-1, 1, (20, 3))
    points += np.array([0, 2, 0]) + np.outer(points[:, 0], [2, 0.2, 0])
    seen = Colliders([Collider(shape)]).sample(points, 0.0)
    normal = np.array([-0.1, 1.0, 0.3]) / np.linalg.norm([-0.1, 1.0, 0.3])
    assert_allclose(seen.normals[0], np.tile(normal, (20, 1)), atol=1e-12)
    assert_allclose(seen.distances[0], (points - [0, 2, 0]) @ normal, atol=1e-12)


@pytest.mark.parametrize("grid", [(2, 2), (9, 33)])
def test_a_ball_rolls_down_heights_as_down_a_plane(
    tmp_path: Path, grid: tuple[int, int]
) -> None:
    start = -2.5 * DOWN + 0.2 * UP
    body = ball(0.2, friction=1.0, at=start.tolist())
    ground = hill(tmp_path, slope(*grid))
    found = Rigid(tmp_path, body, colliders=[ground])
    way = found.to(1.0)[0] - start
    pull = 5 / 7 * GRAVITY / math.sqrt(10)
    assert way @ DOWN == pytest.approx(pull / 2, rel=2e-3)
    assert abs(way @ UP) < 2e-4
    assert found.velocities()[0] @ DOWN == pytest.approx(pull, rel=1e-3)


def test_a_box_rests_in_a_valley(tmp_path: Path) -> None:
    """It lies on its two lower edges, which touch both sides."""
    x = np.abs(np.linspace(-4, 4, 17))
    ground = hill(tmp_path, np.tile(0.5 * x, (3, 1)), friction=0.5)
    body = box((1, 0.4, 1), at=[0, 0.6, 0.3], friction=0.5)
    found = Rigid(tmp_path, body, colliders=[ground])
    place = found.to(1.5)[0]
    assert_allclose(place, [0, 0.25 + 0.2, 0.3], atol=2e-3)
    assert np.abs(found.velocities()).max() < 1e-3


SHAPES = {"box": box((1, 1, 1)), "ball": ball(0.5)}


@pytest.mark.parametrize("height", [-0.1, -0.45])
@pytest.mark.parametrize("shape", SHAPES)
def test_who_begins_with_his_centre_below_comes_out_slowly(
    tmp_path: Path, shape: str, height: float
) -> None:
    body = SHAPES[shape] | {"at": [0.1, height, 0.2]}
    found = Rigid(tmp_path, body, colliders=[hill(tmp_path, np.zeros((3, 5)))])
    assert found.to(0.1)[0, 1] == pytest.approx(height + 0.1, abs=5e-3)
    assert_allclose(found.to(1.5)[0], [0.1, 0.5, 0.2], atol=1e-3)
    assert found.codes() == ["SIM126"]


def test_who_looks_out_of_a_closed_mesh_comes_out_the_nearest_way(
    tmp_path: Path,
) -> None:
    points = np.array(list(product((-1.0, 1.0), repeat=3)))
    hull = ConvexHull(points)
    turned = np.cross(
        *(points[hull.simplices[:, k]] - points[hull.simplices[:, 0]] for k in (1, 2))
    )
    outside = (turned * hull.equations[:, :3]).sum(axis=1) > 0
    triangles = np.where(outside[:, None], hull.simplices, hull.simplices[:, ::-1])
    np.savez(tmp_path / "cube.npz", points=points, triangles=triangles)
    arrays = {"points": "cube.npz", "triangles": "cube.npz"}
    mesh = {"mesh": {**arrays, "closed": True}}
    found = Rigid(
        tmp_path, ball(0.2, at=[0.1, 0.2, 0.85]), colliders=[{"shape": mesh}], forces=[]
    )
    assert_allclose(found.to(1.0)[0], [0.1, 0.2, 1.2], atol=1e-2)
    assert np.abs(found.velocities()).max() < 1e-6


def test_particles_and_cloth_stay_above_heights(tmp_path: Path) -> None:
    ground = hill(tmp_path, slope(3, 5), at=[0, 0.5, 0])
    rain = {
        "name": "rain",
        "emitters": [{"rate": 100, "place": {"disc": {"radius": 1}}, "at": [0, 2, 0]}],
        "forces": [{"gravity": None}],
        "colliders": [ground],
    }
    cloth = {
        "name": "sheet",
        "corner": [-0.5, 1.2, -0.5],
        "across": [1, 0, 0],
        "up": [0, 0, 1],
        "resolution": [6, 6],
        "mass": 0.2,
        "springs": {"structural": {"stiffness": 300}},
        "colliders": [ground],
    }
    rows = Simulator(tmp_path).simulate(
        [{"particles": rain}, {"cloth": cloth}], [0.0, 0.9]
    )
    for name, count in (("rain", 80), ("sheet", 36)):
        above = (rows[name][-1].points - [0, 0.5, 0]) @ UP
        assert len(above) >= count
        assert above.min() > -1e-6
        assert (above < 0.05).sum() > count / 4


REFUSED: list[tuple[dict[str, Any], str, str]] = [
    ({"heights": 3}, "heights", "SCN002"),
    ({"heights": "hill.npz#none"}, "heights", "RIG018"),
    ({"heights": "hill.npz#line"}, "heights", "SIM020"),
    ({"heights": "hill.npz#thin"}, "heights", "SIM020"),
    ({"heights": "hill.npz#holes"}, "heights", "RIG018"),
    ({"heights": "hill.npz#number"}, "heights", "RIG018"),
    ({"heights": "hill.npz#far"}, "heights", "RIG018"),
    ({"size": [8, 0]}, "size", "SIM020"),
    ({"size": [8, 4, 2]}, "size", "SIM020"),
    ({"size": "8"}, "size", "SCN002"),
    ({"hights": "hill.npz"}, "hights", "SCN001"),
]


@pytest.mark.parametrize(("keys", "where", "code"), REFUSED)
def test_what_is_wrong_with_heights_is_told(
    tmp_path: Path, keys: dict[str, Any], where: str, code: str
) -> None:
    heights = {"heights": slope(2, 3), "line": np.zeros(3), "thin": np.zeros((1, 3))}
    heights |= {"number": np.array(2.0), "far": np.full((2, 3), 1e19)}
    np.savez(tmp_path / "hill.npz", **heights, holes=np.array([[0, np.nan], [1, 2]]))
    field = {"heights": "hill.npz#heights", "size": list(SIDES), **keys}
    with pytest.raises(FormatError) as error:
        Rigid(tmp_path, ball(1), colliders=[{"shape": {"height_field": field}}])
    (fault,) = error.value.faults
    assert fault.code == code
    at = "systems[0].rigid.colliders[0].shape.height_field"
    assert fault.where == f"{at}.{where}"

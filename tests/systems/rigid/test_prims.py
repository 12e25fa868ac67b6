"""Rigid bodies as prims of their own."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pxr import Gf, Usd, UsdGeom
from support.faults import raises
from support.rigid import FLOOR, box
from support.simulated import Simulator

from animtool import BakeOptions, bake
from animtool.cli.summary import BAKE_TEMPLATE
from animtool.core.errors import AnimtoolError
from animtool.core.units import LengthUnit, UpAxis
from animtool.report.compare_points import compare_points
from animtool.scene.bake.prims import BakeReport
from animtool.usd.caches.info import describe_points

BODIES = [
    box([0.4, 0.2, 0.2], at=[0, 1, 0], spin=[90, 200, 0])
    | {"name": "brick", "grid": {"count": [2, 1, 1], "spacing": [1, 0, 0]}},
    box([0.1, 0.1, 0.1], at=[0, 3, 0]) | {"name": "brick_1"},
    box([1, 1, 1], at=[4, 0, 0]) | {"name": "wall", "kinematic": True},
    box([1, 1, 1], at=[8, 0, 0])
    | {"name": "lift", "kinematic": True, "moves": [[0, 0, 0, 0], [1, 0, 2, 0]]},
]
NAMES = ["brick_0", "brick_1", "brick_1_2", "wall", "lift"]
FORMS: list[dict[str, Any]] = [
    {},
    {"chunk": 3},
    {"to_up": UpAxis.Z, "to_units": LengthUnit("cm")},
]
ROW: dict[str, Any] = {"name": "it", "step": 0.02, "bodies": BODIES}


def _stage(folder: Path, prims: str, **keys: Any) -> Usd.Stage:
    folder.mkdir()
    system = {"rigid": {**ROW, "colliders": [FLOOR], "prims": prims}}
    return Simulator(folder).baked([system], BakeOptions(**keys))[0]


def _worlds(stage: Usd.Stage, code: float) -> np.ndarray:
    """Return where the bodies of a stage are ``(B, 4, 4)``, in its unit."""
    cache = UsdGeom.XformCache(code)
    top = stage.GetPrimAtPath("/shot/it")
    if top.IsA(UsdGeom.PointInstancer):
        own = UsdGeom.PointInstancer(top).ComputeInstanceTransformsAtTime(code, code)
        above = np.array(cache.GetLocalToWorldTransform(top))
        return np.array(own) @ above
    paths = [f"/shot/it/{name}/mesh" for name in NAMES]
    prims = [stage.GetPrimAtPath(path) for path in paths]
    return np.array([cache.GetLocalToWorldTransform(prim) for prim in prims])


@pytest.mark.parametrize("keys", FORMS)
def test_bodies_as_xforms_are_where_copies_are(tmp_path: Path, keys: Any) -> None:
    copies = _stage(tmp_path / "a", "instancer", **keys)
    xforms = _stage(tmp_path / "b", "xforms", **keys)
    for code in (1.0, 4.0, 8.0):
        assert_allclose(_worlds(xforms, code), _worlds(copies, code), atol=2e-4)
    assert not np.allclose(_worlds(xforms, 1.0), _worlds(xforms, 8.0), atol=0.1)


def test_each_body_has_its_name_and_one_mesh(tmp_path: Path) -> None:
    stage = _stage(tmp_path / "a", "xforms")
    top = stage.GetPrimAtPath("/shot/it")
    assert [prim.GetName() for prim in top.GetChildren()] == NAMES
    meshes = [prim for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh)]
    assert [mesh.GetParent().GetName() for mesh in meshes] == NAMES
    sizes = [UsdGeom.Mesh(mesh).GetPointsAttr().Get() for mesh in meshes]
    assert_allclose(np.ptp(np.array(sizes[0]), axis=0), [0.4, 0.2, 0.2], rtol=1e-6)
    assert_allclose(np.ptp(np.array(sizes[2]), axis=0), 0.1, rtol=1e-6)
    wall, lift = (UsdGeom.Xformable(top.GetChild(name)) for name in ("wall", "lift"))
    assert wall.GetTimeSamples() == []
    assert lift.GetTimeSamples() == list(range(1, 10))
    assert wall.GetPrim().GetAttribute("xformOp:translate").Get() == Gf.Vec3d(4, 0, 0)


def test_diff_sees_where_bodies_go(tmp_path: Path) -> None:
    first = _stage(tmp_path / "a", "xforms")
    second = _stage(tmp_path / "b", "xforms", chunk=3)
    paths = [Path(s.GetRootLayer().realPath) for s in (first, second)]
    same = compare_points(*paths)
    assert same is not None
    assert same.samples == 4 * 9 + 1
    layer = first.GetRootLayer()
    at = "/shot/it/lift.xformOp:translate"
    layer.SetTimeSample(at, 8.0, layer.QueryTimeSample(at, 8.0) + Gf.Vec3d(0, 0.5, 0))
    layer.Export(str(tmp_path / "c.usdc"))
    other = compare_points(tmp_path / "c.usdc", paths[1])
    assert other is not None
    assert other.points.value == pytest.approx(0.5)


def test_info_counts_samples_of_what_places_a_mesh(tmp_path: Path) -> None:
    stage = _stage(tmp_path / "a", "xforms")
    found = describe_points(Path(stage.GetRootLayer().realPath))
    assert found is not None
    assert found.frames == 9
    assert [prim.samples for prim in found.prims] == [9, 9, 9, 0, 9]
    assert (found.prims[0].first, found.prims[0].last) == (1.0, 9.0)


def _bake(folder: Path, prims: str, bodies: Any = BODIES, **keys: Any) -> BakeReport:
    system = {"rigid": {"name": "it", "step": 0.02, "bodies": bodies, "prims": prims}}
    scene = Simulator(folder).scene([system])
    return bake(scene.path, folder / "shot.usdc", BakeOptions(**keys))


def test_names_that_become_one_are_warned_of(tmp_path: Path) -> None:
    (notice,) = _bake(tmp_path, "xforms").notices
    assert (notice.code, notice.where) == ("USD101", "systems[0].rigid")
    assert notice.message.startswith("'brick[1]' and 'brick_1' both become 'brick_1'")
    assert _bake(tmp_path, "instancer", overwrite=True).notices == []
    with raises(AnimtoolError, "USD101"):
        _bake(tmp_path, "xforms", overwrite=True, strict=True)


def test_the_largest_error_names_its_body(tmp_path: Path) -> None:
    lines = BAKE_TEMPLATE.text(_bake(tmp_path, "instancer"))
    assert any("(body 'brick_1', frame " in line for line in lines)

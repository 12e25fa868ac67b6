"""Workflows over rigs that others made, checked against what UsdSkel resolves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdSkel
from support.cli import animtool
from support.shapes_alone import write_face

from animtool import open_source

# Bound on the Skeleton itself; its SkelRoot is turned, scaled and moved.
RIG = """#usda 1.0
(
    defaultPrim = "Cat"
    timeCodesPerSecond = 24
    metersPerUnit = 0.01
    upAxis = "Y"
)
def Xform "Cat" (kind = "component")
{
    def SkelRoot "Geo"
    {
        double3 xformOp:translate = (5, 0, -2)
        float3 xformOp:rotateXYZ = (-90, 30, 10)
        float3 xformOp:scale = (2, 2, 2)
        uniform token[] xformOpOrder = [
            "xformOp:translate", "xformOp:rotateXYZ", "xformOp:scale"]
        def Skeleton "Skel" (prepend apiSchemas = ["SkelBindingAPI"])
        {
            uniform token[] joints = ["hips", "hips/chest", "hips/chest/head"]
            uniform matrix4d[] bindTransforms = [
                ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 30, 0, 1)),
                ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 50, 0, 1)),
                ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 60, 10, 1))]
            uniform matrix4d[] restTransforms = [
                ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 30, 0, 1)),
                ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 20, 0, 1)),
                ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 10, 10, 1))]
            rel skel:animationSource = </Cat/Geo/Skel/Rest>
            def SkelAnimation "Rest"
            {
                uniform token[] joints = ["hips"]
                float3[] translations = [(0, 30, 0)]
                quatf[] rotations = [(1, 0, 0, 0)]
                half3[] scales = [(1, 1, 1)]
            }
        }
    }
}
"""
CLIP = """clip: animtool/1
rig: cat.rig.yaml
fps: 24
range: [1, 9]
channels:
- {target: joint/hips.translation, keys: [{t: 1, v: [0, 0, 0]}, {t: 9, v: [9, 2, 0]}]}
- target: joint/hips.rotation
  interp: slerp
  keys: [{t: 1, v: [1, 0, 0, 0]}, {t: 9, v: [0.6, 0, 0.8, 0]}]
- target: joint/chest.rotation
  interp: slerp
  keys: [{t: 1, v: [1, 0, 0, 0]}, {t: 9, v: [0.8, 0.6, 0, 0]}]
controls: []
""".replace("controls: []\n", "")
SIDECAR = """rig: animtool/1
name: cat
units: {length: cm}
from: cat.usda
controls:
- {name: nod, range: [0, 1], drives: [{joint: head.rotation.x, expr: nod * 20}]}
"""


@pytest.fixture
def cat(tmp_path: Path) -> Path:
    (tmp_path / "cat.usda").write_text(RIG, "utf-8")
    (tmp_path / "cat.rig.yaml").write_text(SIDECAR, "utf-8")
    text = CLIP + "- {target: control/nod, keys: [{t: 1, v: 0}, {t: 9, v: 1}]}\n"
    (tmp_path / "cat.clip.yaml").write_text(text, "utf-8")
    return tmp_path


def resolved(folder: Path, layers: list[str], skeleton: str) -> Usd.Stage:
    path = folder / "shot.usda"
    names = ", ".join(f"@./{name}@" for name in layers)
    path.write_text(f"#usda 1.0\n(\n    subLayers = [{names}]\n)\n", "utf-8")
    stage = Usd.Stage.Open(str(path))
    assert stage.GetPrimAtPath(skeleton)
    return stage


def world_positions(stage: Usd.Stage, path: str, codes: list[float]) -> np.ndarray:
    """Return where UsdSkel puts the joints in the world ``(F, J, 3)``."""
    skeleton = UsdSkel.Skeleton(stage.GetPrimAtPath(path))
    cache = UsdSkel.Cache()
    cache.Populate(UsdSkel.Root.Find(skeleton.GetPrim()), Usd.PrimDefaultPredicate)
    query = cache.GetSkelQuery(skeleton)
    found = []
    for code in codes:
        xforms = UsdGeom.XformCache(Usd.TimeCode(code))
        matrices = query.ComputeJointWorldTransforms(xforms)
        found.append([matrix.ExtractTranslation() for matrix in matrices])
    return np.array(found)


def test_a_layer_over_a_rig_bound_on_its_skeleton_under_a_turned_skelroot(
    cat: Path,
) -> None:
    take = open_source(cat / "cat.clip.yaml").collect()
    for command in (
        "bake cat.clip.yaml -o layer.usda --rig-layer cat.usda",
        "bake cat.clip.yaml --split -o cut.usda",
        "bake cut.anim.usdc -o again.usda --rig-layer cat.usda",
        "bake layer.usda -o bare.usda --rig-layer cat.usda",
    ):
        done = animtool(*command.split(), "--strict", cwd=cat)
        assert done.code == 0, (command, done.stderr)
    for layer in ("layer.usda", "again.usda", "bare.usda"):
        stage = resolved(cat, [layer, "cat.usda"], "/Cat/Geo/Skel")
        wanted = take.world().positions / take.rig.meters_per_unit
        found = world_positions(stage, "/Cat/Geo/Skel", take.clock.times.tolist())
        np.testing.assert_allclose(found, wanted, atol=2e-4)
        # The whole is read as the take again, which is where the SkelRoot has it.
        again = open_source(cat / "shot.usda").collect()
        np.testing.assert_allclose(
            again.world().positions, take.world().positions, atol=2e-6
        )


def test_a_face_of_shapes_alone_is_baked_and_read_back(tmp_path: Path) -> None:
    face = write_face(tmp_path)
    wanted = open_source(face).collect()
    for command in (
        "bake face.usda -o stage.usda",
        "bake face.usda --rig face.usda -o whole.usda",
        "bake face.usda --rig face.usda --split -o parts.usdc",
        "convert face.usda face.clip.yaml --reduce 0.001mm",
        "bake face.clip.yaml -o keyed.usda",
        "bake face.usda -o layer.usda --rig-layer face.usda",
        "bake layer.usda -o again.usda",
    ):
        done = animtool(*command.split(), cwd=tmp_path)
        assert done.code == 0, (command, done.stderr)
    resolved(tmp_path, ["layer.usda", "face.usda"], "/Face/Skel")
    assert wanted.motion.weights is not None
    for name in (
        "stage.usda",
        "whole.usda",
        "parts.usdc",
        "face.clip.yaml",
        "keyed.usda",
        "layer.usda",
        "again.usda",
        "shot.usda",
    ):
        found = open_source(tmp_path / name).collect()
        assert found.clock == wanted.clock, name
        assert found.motion.weights is not None
        np.testing.assert_array_equal(
            found.motion.weights.dense(), wanted.motion.weights.dense(), name
        )
    deformed = animtool("bake", face, "--deform", "-o", tmp_path / "cache.usda")
    assert deformed.code == 0
    stage = Usd.Stage.Open(str(tmp_path / "cache.usda"))
    (mesh,) = [prim for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh)]
    points = np.array(UsdGeom.Mesh(mesh).GetPointsAttr().Get(3))
    np.testing.assert_allclose(points[2], [1, 2.625, 0])

"""Meshes that a transform moves, and no joint."""

from __future__ import annotations

from pathlib import Path

import pytest
from pxr import Usd, UsdGeom

from animtool.core.errors import Fault
from animtool.scene.bake.bake import bake
from animtool.scene.bake.options import BakeOptions

MESH = """
int[] faceVertexCounts = [3]
int[] faceVertexIndices = [0, 1, 2]
point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 2, 0)]
"""
SKIN = """
int[] primvars:skel:jointIndices = [0] (
    elementSize = 1
    interpolation = "constant"
)
float[] primvars:skel:jointWeights = [1] (
    elementSize = 1
    interpolation = "constant"
)
rel skel:skeleton = </hero/rig/skel>
"""
SMILE = """
uniform token[] skel:blendShapes = ["smile"]
rel skel:blendShapeTargets = <smile>
rel skel:skeleton = </hero/rig/skel>
def BlendShape "smile"
{
    uniform vector3f[] offsets = [(0, 0, 1), (0, 0, 1), (0, 0, 1)]
}
"""
API = '(prepend apiSchemas = ["SkelBindingAPI"])'
STAGE = f"""#usda 1.0
(
    defaultPrim = "hero"
    startTimeCode = 1
    endTimeCode = 5
    metersPerUnit = 0.01
    timeCodesPerSecond = 24
)
def Xform "hero"
{{
    HERO
    def SkelRoot "rig"
    {{
        def Skeleton "skel" {API}
        {{
            uniform token[] joints = ["hips"]
            uniform matrix4d[] bindTransforms = [ROW]
            uniform matrix4d[] restTransforms = [ROW]
            rel skel:animationSource = </hero/rig/anim>
        }}
        def SkelAnimation "anim"
        {{
            uniform token[] joints = ["hips"]
            float3[] translations.timeSamples = {{ 1: [(0, 9, 0)], 5: [(9, 9, 0)] }}
            quatf[] rotations = [(1, 0, 0, 0)]
            half3[] scales = [(1, 1, 1)]
        }}
        def Mesh "body" {API} {{ {MESH} {SKIN} }}
        def Xform "hand"
        {{
            HAND
            def Mesh "cup" {{ {MESH} }}
            def Mesh "face" {API} {{ {MESH} {SMILE} }}
        }}
    }}
}}
""".replace("ROW", "((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 9, 0, 1))")
MOVES = "double3 xformOp:translate.timeSamples = { 1: (0, 0, 0), 5: (0, 30, 40) }"
TURNS = "float xformOp:rotateZ.timeSamples = { 1: 0, 5: 180 }"
STILL = "double3 xformOp:translate = (0, 30, 40)"


def order(text: str) -> str:
    name = text.split()[1].removesuffix(".timeSamples")
    return f'{text}\nuniform token[] xformOpOrder = ["{name}"]'


def warnings(folder: Path, hero: str, hand: str, options: BakeOptions) -> list[Fault]:
    path = folder / "hero.usda"
    text = STAGE.replace("HERO", hero and order(hero))
    path.write_text(text.replace("HAND", hand and order(hand)))
    report = bake(path, folder / "cache.usda", options)
    return [notice for notice in report.notices if notice.code == "USD147"]


@pytest.mark.parametrize(
    ("hero", "hand", "choice", "far"),
    [
        ("", "", None, ""),
        ("", STILL, None, ""),
        (STILL, "", None, ""),
        ("", MOVES, None, "0.5 m"),
        ("", TURNS, None, "0.04472 m"),
        (MOVES, "", None, "0.5 m"),
        # What moves all of it is left out, and nothing moves beside it.
        (MOVES, "", "drop", ""),
    ],
)
def test_what_moves_without_skin_is_named(
    tmp_path: Path, hero: str, hand: str, choice: str | None, far: str
) -> None:
    options = BakeOptions(deform=True, placement=choice)
    found = warnings(tmp_path, hero, hand, options)
    assert len(found) == bool(far)
    for fault in found:
        assert "2 meshes" in fault.message
        assert far in fault.message
        assert "/hero/rig/hand/cup" in fault.message


def test_joints_alone_have_no_meshes_to_name(tmp_path: Path) -> None:
    assert not warnings(tmp_path, "", MOVES, BakeOptions())


def test_a_layer_leaves_them_to_their_stage(tmp_path: Path) -> None:
    path = tmp_path / "hero.usda"
    text = STAGE.replace("HERO", "").replace("HAND", order(MOVES))
    path.write_text(text.replace(SMILE, ""))
    options = BakeOptions(deform=True, rig_layer=path)
    report = bake(path, tmp_path / "layer.usda", options)
    assert "USD147" not in [notice.code for notice in report.notices]
    stage = Usd.Stage.CreateInMemory()
    stage.GetRootLayer().subLayerPaths = [str(tmp_path / "layer.usda"), str(path)]
    cup = stage.GetPrimAtPath("/hero/rig/hand/cup")
    world = UsdGeom.XformCache(5.0).GetLocalToWorldTransform(cup)
    assert world.ExtractTranslation() == (0.0, 30.0, 40.0)

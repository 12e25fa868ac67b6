"""Props and systems stay beside the character that they are of."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdSkel
from support.placed import (
    CODES,
    Floats,
    op_text,
    over,
    stage_text,
)
from support.suite import some_quick

from animtool.scene.bake.bake import bake
from animtool.scene.bake.options import BakeOptions

TOOL = """
def Xform "tool"
{
    double3 xformOp:translate.timeSamples = { 1: (4, 5, 6), 5: (9, -5, 7) }
    float3 xformOp:rotateXYZ = (10, 40, -20)
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateXYZ"]
}
"""
PATHS = {"Props/tool": "/set/Props/tool", "/Props/tool": "/Props/tool"}


def in_hips_frame(path: Path | Usd.Stage, prim: str) -> Floats:
    """Return a prim in the frame of the hips ``(F, 4, 4)``, lengths [m]."""
    stage = Usd.Stage.Open(str(path)) if isinstance(path, Path) else path
    rows = []
    for code in CODES:
        xforms = UsdGeom.XformCache(code)
        own = np.array(xforms.GetLocalToWorldTransform(stage.GetPrimAtPath(prim)))
        own = rigid(own, stage)
        rows.append(own @ np.linalg.inv(hips_matrix(stage, code)))
    return np.array(rows)


def hips_matrix(stage: Usd.Stage, code: float) -> Floats:
    """Return the root joint where pxr has it, row vectors, [m]."""
    skeleton = UsdSkel.Skeleton(
        next(p for p in stage.Traverse() if UsdSkel.Skeleton(p))
    )
    cache = UsdSkel.Cache()
    cache.Populate(UsdSkel.Root.Find(skeleton.GetPrim()), Usd.PrimDefaultPredicate)
    query = cache.GetSkelQuery(skeleton)
    joints = query.ComputeJointWorldTransforms(UsdGeom.XformCache(code))
    return rigid(np.array(joints[0]), stage)


def rigid(matrix: Floats, stage: Usd.Stage) -> Floats:
    """Return a matrix without its scale, lengths [m]."""
    matrix[:3, :3] /= np.cbrt(abs(np.linalg.det(matrix[:3, :3])))
    matrix[3, :3] *= UsdGeom.GetStageMetersPerUnit(stage)
    return matrix


def shot_of(source: Path, path: str) -> Path:
    """Return a scene of a stage whose tool goes along."""
    scene = source.with_suffix(".scene.yaml")
    entry = f"{{from: {source.name}, prim: /tool, path: {path}}}"
    scene.write_text(
        f"scene: animtool/1\nsource: {{file: {source.name}}}\nprops: [{entry}]\n"
        "output: {file: unused.usda}\n"
    )
    (source.parent / "animtool.toml").touch()
    return scene


SYSTEM = """systems:
- particles:
    name: dust
    emitters: [{bursts: [[0, 1]], at: [1, 2, 3], speed: 0}]
"""
PROP_CASES = list(
    zip(
        itertools.product(("set", "char", "skel"), (False, True)),
        itertools.cycle(itertools.product(PATHS, "YZ")),
        strict=False,
    )
)


@pytest.mark.slow
@pytest.mark.parametrize("case", some_quick(PROP_CASES, 3))
def test_props_of_a_source_keep_their_distance_to_its_character(
    tmp_path: Path, case: tuple[tuple[str, bool], tuple[str, str]]
) -> None:
    (where, moves), (path, up) = case
    source, plain, other = (tmp_path / f"{name}.usda" for name in ("s", "p", "o"))
    kind = "translate" if moves else "all"
    size = 1.0 if moves else 2.0
    ops = op_text(kind, moves, 0.01).replace("(90, 20, 10)", "(4, 20, 10)")
    source.write_text(stage_text(where, ops, up=up) + TOOL)
    plain.write_text(stage_text(up=up, size=size))
    ops = "double3 xformOp:translate = (7, 8, 9)\nfloat xformOp:rotateY = 35\n"
    ops += 'uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateY"]'
    other.write_text(stage_text("char", ops, up=up, size=size))
    truth = in_hips_frame(source, "/tool")
    scene = shot_of(source, path)
    for below, choice in itertools.product(
        (None, source, plain, other), (None, "keep", "drop")
    ):
        name = f"{below and below.stem} {choice}"
        output = tmp_path / f"{name}.usda"
        model = None if below else "/set"
        bake(
            scene,
            output,
            BakeOptions(rig_layer=below, placement=choice, prim_path=model),
        )
        stage = over(output, below) if below else Usd.Stage.Open(str(output))
        found = in_hips_frame(stage, PATHS[path])
        np.testing.assert_allclose(found, truth, atol=1e-5, err_msg=name)


@pytest.mark.parametrize("up", "YZ")
@pytest.mark.parametrize("where", some_quick(["set", "char", "skel"], 3))
def test_what_is_simulated_goes_where_its_rig_is(
    tmp_path: Path, where: str, up: str
) -> None:
    source, rig = tmp_path / "source.usda", tmp_path / "rig.usda"
    source.write_text(stage_text(up=up))
    for moves, kind in ((False, "all"), (True, "translate")):
        ops = op_text(kind, moves, 0.01).replace("(90, 20, 10)", "(4, 20, 10)")
        rig.write_text(stage_text(where, ops, up=up, size=1.0 if moves else 0.5))
        scene = tmp_path / f"{kind}.scene.yaml"
        text = f"scene: animtool/1\nsource: {{file: {source.name}}}\n{SYSTEM}"
        scene.write_text(f"{text}output: {{file: unused.usda}}\n")
        plain = tmp_path / f"{kind}-plain.usda"
        bake(scene, plain, BakeOptions(prim_path="/set"))
        truth = relative_dust(Usd.Stage.Open(str(plain)))
        for choice in ("keep", "drop"):
            output = tmp_path / f"{kind}-{choice}.usda"
            bake(scene, output, BakeOptions(rig_layer=rig, placement=choice))
            found = relative_dust(over(output, rig))
            np.testing.assert_allclose(
                found, truth, atol=1e-5, err_msg=f"{kind} {choice}"
            )


def relative_dust(stage: Usd.Stage) -> Floats:
    """Return where a particle is in the frame of the hips at the last frame [m]."""
    code = CODES[-1]
    prim = stage.GetPrimAtPath("/set/dust")
    point = np.array(prim.GetAttribute("points").Get(code)[0], float)
    world = np.array(UsdGeom.XformCache(code).GetLocalToWorldTransform(prim))
    point = point @ world[:3, :3] + world[3, :3]
    point *= UsdGeom.GetStageMetersPerUnit(stage)
    hips = np.linalg.inv(hips_matrix(stage, code))
    return point @ hips[:3, :3] + hips[3, :3]

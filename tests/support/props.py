"""A set in USD beside a character: a box that turns and slides, and a camera."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

__all__ = ["FRAMES", "prop_matrices", "write_props"]

FRAMES = range(1, 41)


def write_props(
    path: Path,
    *,
    fps: float = 24.0,
    unit: float = 0.01,
    up: str = "Y",
    first: int = 1,
    shear: bool = False,
) -> Path:
    """Write ``/Set`` that turns, a ``box`` and a ``camera`` in it, and what is still.

    Everything has a key at each of `FRAMES`, of which ``first`` is the first.
    """
    from pxr import Gf, Sdf, Usd, UsdGeom

    stage = Usd.Stage.CreateNew(str(path))
    shift = first - FRAMES[0]
    stage.SetTimeCodesPerSecond(fps)
    stage.SetStartTimeCode(first)
    stage.SetEndTimeCode(first + len(FRAMES) - 1)
    UsdGeom.SetStageMetersPerUnit(stage, unit)
    UsdGeom.SetStageUpAxis(stage, up)
    group = UsdGeom.Xform.Define(stage, "/Set")
    stage.SetDefaultPrim(group.GetPrim())
    group.AddTranslateOp().Set(Gf.Vec3d(10, 0, 5))
    turn = group.AddRotateXYZOp()
    if shear:
        group.AddScaleOp().Set(Gf.Vec3f(1, 3, 1))
    box = UsdGeom.Cube.Define(stage, "/Set/box")
    slide = box.AddTranslateOp()
    lean = box.AddRotateZOp()
    box.AddScaleOp().Set(Gf.Vec3f(2, 2, 3))
    state = box.GetPrim().CreateAttribute("state", Sdf.ValueTypeNames.Token)
    wetness = box.GetPrim().CreateAttribute("wetness", Sdf.ValueTypeNames.Color4f)
    camera = UsdGeom.Camera.Define(stage, "/Set/camera")
    dolly = camera.AddTransformOp()
    focal = camera.CreateFocalLengthAttr()
    camera.CreateHorizontalApertureAttr(24.0)
    camera.CreateVerticalApertureAttr(18.0)
    camera.CreateClippingRangeAttr(Gf.Vec2f(1, 5000))
    focus = camera.CreateFocusDistanceAttr()
    for frame in FRAMES:
        at, t = frame + shift, frame / 9
        turn.Set(Gf.Vec3f(0, 4 * frame, 0.3 * frame), at)
        slide.Set(Gf.Vec3d(30 * math.sin(t), 1.5 * frame, frame), at)
        lean.Set(20 * math.sin(t), at)
        pose = Gf.Matrix4d().SetRotate(Gf.Rotation(Gf.Vec3d(1, 2, 0), 3.0 * frame))
        pose.SetTranslateOnly(Gf.Vec3d(0, 150, 600 - 4 * frame))
        dolly.Set(pose, at)
        focal.Set(35 + frame / 10, at)
        focus.Set(600.0 - 4 * frame, at)
        wetness.Set(Gf.Vec4f(frame / 40, 0, 1, t), at)
    state.Set("dry", first)
    state.Set("wet", first + 19)
    still = UsdGeom.Xform.Define(stage, "/Post")
    still.AddTranslateOp().Set(Gf.Vec3d(1, 2, 3))
    bare = UsdGeom.Camera.Define(stage, "/Bare")
    bare.AddTranslateOp().Set(Gf.Vec3d(0, 1, 0))
    stage.DefinePrim("/Settings", "Scope").CreateAttribute(
        "level", Sdf.ValueTypeNames.Double
    ).Set(2.5)
    stage.GetPrimAtPath("/Settings").CreateAttribute(
        "many", Sdf.ValueTypeNames.FloatArray
    ).Set([1.0])
    stage.Save()
    return path


def prop_matrices(stage: Any, path: str, codes: Any) -> np.ndarray:
    """Return where a prim of a stage is, row vectors, file units ``(F, 4, 4)``."""
    from pxr import Usd, UsdGeom

    if isinstance(stage, Path):
        stage = Usd.Stage.Open(str(stage))
    cache, found = UsdGeom.XformCache(), []
    for code in codes:
        cache.SetTime(Usd.TimeCode(float(code)))
        found.append(cache.GetLocalToWorldTransform(stage.GetPrimAtPath(path)))
    return np.array(found, np.float64)

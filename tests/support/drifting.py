"""A USD animation of two joints with a sample at each of some time codes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt

__all__ = ["author_samples"]


def author_samples(path: Path, times: Sequence[float], rate: float = 24.0) -> Path:
    """Write a stage whose smooth animation is sampled at time codes; return its path.

    Args:
        path: A .usda file.
        times: Time codes, ascending.
        rate: Time codes a second of the stage.
    """
    layer = Sdf.Layer.CreateAnonymous(".usda")
    stage = Usd.Stage.Open(layer)
    UsdGeom.SetStageUpAxis(stage, "Y")
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetTimeCodesPerSecond(rate)
    stage.SetStartTimeCode(times[0])
    stage.SetEndTimeCode(times[-1])
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/hero").GetPrim())
    UsdSkel.Root.Define(stage, "/hero/Rig")
    skeleton = UsdSkel.Skeleton.Define(stage, "/hero/Rig/Skel")
    joints = ["hips", "hips/knee"]
    rest = [Gf.Matrix4d(1), Gf.Matrix4d(1).SetTranslate((0, 1, 0))]
    skeleton.CreateJointsAttr(joints)
    skeleton.CreateRestTransformsAttr(rest)
    skeleton.CreateBindTransformsAttr(rest)
    animation = UsdSkel.Animation.Define(stage, "/hero/Rig/Anim")
    animation.CreateJointsAttr(joints)
    animation.CreateScalesAttr([Gf.Vec3h(1)] * 2)
    moves = animation.CreateTranslationsAttr().GetPath()
    turns = animation.CreateRotationsAttr().GetPath()
    with Sdf.ChangeBlock():
        for time, (x, half) in zip(times, _motion(np.array(times)), strict=True):
            w, z = float(np.cos(half)), float(np.sin(half))
            places = Vt.Vec3fArray([(x, 0, 0), (0, 1, 0)])
            layer.SetTimeSample(moves, time, places)
            both = Vt.QuatfArray([Gf.Quatf(w, 0, 0, z), Gf.Quatf(1)])
            layer.SetTimeSample(turns, time, both)
    binding = UsdSkel.BindingAPI.Apply(skeleton.GetPrim())
    binding.CreateAnimationSourceRel().SetTargets([animation.GetPath()])
    layer.Export(str(path))
    return path


def _motion(times: np.ndarray) -> np.ndarray:
    """Return the hips' place [m] and half their rotation [rad] at times ``(F, 2)``."""
    return np.stack([np.sin(times / 10), times / 50], axis=1)

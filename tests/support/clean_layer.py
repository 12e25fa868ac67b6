"""A small skinned character that moves, as one layer without any finding."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt

__all__ = ["ANIMATION", "MESH", "ROOT", "SKELETON", "make_layer"]

ROOT = "/Hero/Rig"
SKELETON = f"{ROOT}/Skel"
ANIMATION = f"{ROOT}/Anim"
MESH = f"{ROOT}/Body"
JOINTS = ["hips", "hips/chest", "hips/chest/head"]


def make_layer(path: Path, frames: int = 12, *, mesh: bool = True) -> Path:
    """Write the layer: 24 frames a second from time code 1, unit samples.

    Args:
        path: Where to.
        frames: How many.
        mesh: Whether it has a skin.
    """
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    stage.SetFramesPerSecond(24)
    stage.SetTimeCodesPerSecond(24)
    stage.SetStartTimeCode(1)
    stage.SetEndTimeCode(frames)
    layer = stage.GetRootLayer()
    layer.comment = "made by hand"
    hero = UsdGeom.Xform.Define(stage, "/Hero").GetPrim()
    stage.SetDefaultPrim(hero)
    hero.SetCustomDataByKey("studio:note", "keep me")
    root = UsdSkel.Root.Define(stage, ROOT)
    skeleton = UsdSkel.Skeleton.Define(stage, SKELETON)
    skeleton.CreateJointsAttr(JOINTS)
    # At rest turned and off the origin; bound elsewhere, and turned otherwise.
    rest = [_placed((0.2, 0.5, -0.1 * i), (0, 30, 20 * i)) for i in range(3)]
    bind = [_placed((0.1 * i, 0.5 * (i + 1), 0.05), (40 * i, 0, -15)) for i in range(3)]
    skeleton.CreateRestTransformsAttr(rest)
    skeleton.CreateBindTransformsAttr(bind)
    _animate(stage, frames)
    binding = UsdSkel.BindingAPI.Apply(skeleton.GetPrim())
    binding.CreateAnimationSourceRel().SetTargets([ANIMATION])
    if mesh:
        _skin(stage)
    _author_extents(root, range(1, frames + 1))
    stage.Save()
    return path


def _placed(at: tuple[float, ...], turn: tuple[float, ...]) -> Gf.Matrix4d:
    """Return a matrix from a place and Euler angles [deg], in the order XYZ."""
    matrix = Gf.Matrix4d(1)
    for axis, angle in zip(np.eye(3).tolist(), turn, strict=True):
        matrix *= Gf.Matrix4d().SetRotate(Gf.Rotation(Gf.Vec3d(*axis), angle))
    return matrix * Gf.Matrix4d().SetTranslate(Gf.Vec3d(*at))


def rotations(frames: int) -> np.ndarray[Any, Any]:
    """Return rotations that swing about z ``(F, 3, 4)``, x y z w."""
    half = 0.4 * np.sin(np.arange(frames) * 0.3)[:, None] * np.array([1, 0.5, 0.25])
    q = np.zeros((frames, 3, 4), np.float32)
    q[..., 2], q[..., 3] = np.sin(half), np.cos(half)
    return q


def _animate(stage: Any, frames: int) -> None:
    animation = UsdSkel.Animation.Define(stage, ANIMATION)
    animation.CreateJointsAttr(JOINTS)
    animation.CreateTranslationsAttr([(0, 0.5, 0)] * 3)
    animation.CreateScalesAttr(Vt.Vec3hArray([(1, 1, 1)] * 3))
    attr = animation.CreateRotationsAttr()
    for i, row in enumerate(rotations(frames)):
        attr.Set(Vt.QuatfArray.FromNumpy(row), i + 1)


def _skin(stage: Any) -> None:
    mesh = UsdGeom.Mesh.Define(stage, MESH)
    mesh.CreatePointsAttr([(0, 0, 0), (0.1, 0.5, 0), (0.1, 1, 0), (0, 1.5, 0)])
    mesh.CreateFaceVertexCountsAttr([4])
    mesh.CreateFaceVertexIndicesAttr([0, 1, 2, 3])
    mesh.CreateSubdivisionSchemeAttr("none")
    mesh.CreateNormalsAttr([(0, 0, 1)] * 4)
    mesh.SetNormalsInterpolation("vertex")
    mesh.CreateExtentAttr([(0, 0, 0), (0.1, 1.5, 0)])
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateSkeletonRel().SetTargets([SKELETON])
    indices = [0, 1, 0, 1, 1, 2, 1, 2]
    binding.CreateJointIndicesPrimvar(False, 2).Set(indices)
    weights = [1, 0, 0.5, 0.5, 0.25, 0.75, 0, 1]
    binding.CreateJointWeightsPrimvar(False, 2).Set(weights)
    binding.CreateGeomBindTransformAttr(Gf.Matrix4d(1))


def _author_extents(root: Any, codes: Any) -> None:
    attr = root.CreateExtentAttr()
    for code in codes:
        attr.Set(UsdGeom.Boundable.ComputeExtentFromPlugins(root, code), code)


def attribute(layer: Any, path: str) -> Any:
    """Return the spec of an attribute."""
    found = layer.GetAttributeAtPath(Sdf.Path(path))
    assert found, path
    return found

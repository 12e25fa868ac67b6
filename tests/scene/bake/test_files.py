"""Takes in other formats: the meshes of a stage where its bind pose has them."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from pxr import Gf, Usd, UsdGeom, UsdSkel, Vt
from support.cli import animtool
from support.gltf_reference import Reference

JOINTS = ["hip", "hip/knee"]
CORNERS = [(-3, 0, 1), (3, 0, 1), (3, 90, 1), (-3, 90, 1)]
TO_Y_UP = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])


def matrix(move: tuple[float, float, float], turn: float) -> Gf.Matrix4d:
    """Return a transform that turns about X."""
    rotation = Gf.Rotation((1, 0, 0), turn)
    return Gf.Matrix4d().SetTransform(rotation, Gf.Vec3d(*move))


def posed_stage(path: Path, up: str) -> Usd.Stage:
    """Write a leg that was bound stretched, and rests and moves bent and elsewhere."""
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, up)
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    stage.SetTimeCodesPerSecond(24)
    stage.SetStartTimeCode(1)
    stage.SetEndTimeCode(2)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/leg").GetPrim())
    root = UsdSkel.Root.Define(stage, "/leg/Rig")
    root.AddTranslateOp().Set((40, 0, 7))
    skeleton = UsdSkel.Skeleton.Define(stage, "/leg/Rig/Skel")
    skeleton.CreateJointsAttr(JOINTS)
    skeleton.CreateBindTransformsAttr([matrix((0, 0, 0), 0), matrix((0, 45, 0), 0)])
    skeleton.CreateRestTransformsAttr([matrix((10, 5, 0), 30), matrix((0, 45, 0), 50)])
    animation = UsdSkel.Animation.Define(stage, "/leg/Rig/Anim")
    animation.CreateJointsAttr(JOINTS)
    for time in (1, 2):
        local = [matrix((10, 5, time), 30), matrix((0, 45, 0), 50 + 20 * time)]
        animation.SetTransforms(Vt.Matrix4dArray(local), time)
    mesh = UsdGeom.Mesh.Define(stage, "/leg/Rig/skin")
    mesh.CreatePointsAttr([Gf.Vec3f(*point) for point in CORNERS])
    mesh.CreateFaceVertexCountsAttr([4])
    mesh.CreateFaceVertexIndicesAttr([0, 1, 2, 3])
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateJointIndicesPrimvar(False, 1).Set([0, 0, 1, 1])
    binding.CreateJointWeightsPrimvar(False, 1).Set([1.0] * 4)
    binding.CreateGeomBindTransformAttr(matrix((0, 0, -1), 0))
    binding.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
    of_skeleton = UsdSkel.BindingAPI.Apply(skeleton.GetPrim())
    of_skeleton.CreateAnimationSourceRel().SetTargets([animation.GetPath()])
    stage.Save()
    return stage


def skinned_points(stage: Usd.Stage, time: float) -> npt.NDArray[np.float64]:
    """Return the world points of the skin, as UsdSkel has them [cm]."""
    cache, root = UsdSkel.Cache(), UsdSkel.Root.Get(stage, "/leg/Rig")
    cache.Populate(root, Usd.PrimDefaultPredicate)
    skeleton = cache.GetSkelQuery(UsdSkel.Skeleton.Get(stage, "/leg/Rig/Skel"))
    query = cache.GetSkinningQuery(stage.GetPrimAtPath("/leg/Rig/skin"))
    points = Vt.Vec3fArray(UsdGeom.Mesh(query.GetPrim()).GetPointsAttr().Get())
    assert query.ComputeSkinnedPoints(
        skeleton.ComputeSkinningTransforms(time), points, time
    )
    world = np.array(UsdGeom.XformCache(time).GetLocalToWorldTransform(root.GetPrim()))
    return np.asarray(np.array(points) @ world[:3, :3] + world[3, :3], np.float64)


@pytest.mark.parametrize(
    ("up", "options"),
    [("Y", ()), ("Z", ()), ("Y", ("--placement", "drop"))],
)
def test_a_skin_that_was_bound_in_another_pose_than_rest(
    tmp_path: Path, up: str, options: tuple[str, ...]
) -> None:
    stage = posed_stage(tmp_path / "leg.usda", up)
    output = tmp_path / "leg.glb"
    done = animtool("convert", tmp_path / "leg.usda", output, *options)
    assert done.code == 0, done.stderr
    content = output.read_bytes()
    (length,) = struct.unpack_from("<I", content, 12)
    reference = Reference(json.loads(content[20 : 20 + length]), content[28 + length :])
    for time in (1, 2):
        _, points, _ = reference.state(0, (time - 1) / 24)
        (found,) = points.values()
        expected = skinned_points(stage, time)
        if options:
            expected -= [40, 0, 7]
        if up == "Z":
            expected = expected @ TO_Y_UP.T
        np.testing.assert_allclose(found * 100, expected, atol=1e-4)

"""Takes in other formats: the meshes of a stage, in its bind pose and its shapes."""

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


def read_glb(path: Path) -> Reference:
    """Return the states of a glTF, as the specification has them."""
    content = path.read_bytes()
    (length,) = struct.unpack_from("<I", content, 12)
    return Reference(json.loads(content[20 : 20 + length]), content[28 + length :])


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
    reference = read_glb(output)
    for time in (1, 2):
        _, points, _ = reference.state(0, (time - 1) / 24)
        (found,) = points.values()
        expected = skinned_points(stage, time)
        if options:
            expected -= [40, 0, 7]
        if up == "Z":
            expected = expected @ TO_Y_UP.T
        np.testing.assert_allclose(found * 100, expected, atol=1e-4)


MESHES = ["face", "teeth"]
# What each mesh's first point moves by, in each of its shapes.
OFFSETS = {
    "face": {"smile": (1.0, 0.0, 0.0), "jaw": (0.0, 2.0, 0.0)},
    "teeth": {"jaw": (0.0, 0.0, 3.0), "smile": (0.0, 4.0, 0.0)},
}


def talking_stage(path: Path, animated: list[str]) -> None:
    """Write two meshes with shapes of equal names, at weights .25, .5 and so on."""
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, "Y")
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/hero").GetPrim())
    UsdSkel.Root.Define(stage, "/hero/Rig")
    skeleton = UsdSkel.Skeleton.Define(stage, "/hero/Rig/Skel")
    skeleton.CreateJointsAttr(["head"])
    skeleton.CreateRestTransformsAttr([Gf.Matrix4d(1)])
    skeleton.CreateBindTransformsAttr([Gf.Matrix4d(1)])
    animation = UsdSkel.Animation.Define(stage, "/hero/Rig/Anim")
    animation.CreateJointsAttr(["head"])
    animation.SetTransforms(Vt.Matrix4dArray([Gf.Matrix4d(1)]))
    animation.CreateBlendShapesAttr(animated)
    weights = [0.25 * (k + 1) for k in range(len(animated))]
    animation.CreateBlendShapeWeightsAttr().Set([0.0] * len(animated), 1)
    animation.CreateBlendShapeWeightsAttr().Set(weights, 2)
    for name in MESHES:
        mesh = UsdGeom.Mesh.Define(stage, f"/hero/Rig/{name}")
        mesh.CreatePointsAttr([(0, 0, 0), (1, 0, 0), (0, 1, 0)])
        mesh.CreateFaceVertexCountsAttr([3])
        mesh.CreateFaceVertexIndicesAttr([0, 1, 2])
        binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
        binding.CreateJointIndicesPrimvar(True, 1).Set([0])
        binding.CreateJointWeightsPrimvar(True, 1).Set([1.0])
        binding.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
        binding.CreateBlendShapesAttr(list(OFFSETS[name]))
        for shape_name, offset in OFFSETS[name].items():
            shape = UsdSkel.BlendShape.Define(stage, f"/hero/Rig/{name}/{shape_name}")
            shape.CreateOffsetsAttr([Gf.Vec3f(*offset)])
            shape.CreatePointIndicesAttr([0])
            binding.CreateBlendShapeTargetsRel().AddTarget(shape.GetPath())
    of_skeleton = UsdSkel.BindingAPI.Apply(skeleton.GetPrim())
    of_skeleton.CreateAnimationSourceRel().SetTargets([animation.GetPath()])
    stage.Save()


@pytest.mark.parametrize("animated", [["jaw"], ["smile", "jaw"], ["other", "jaw"]])
@pytest.mark.parametrize("onto", [False, True])
def test_meshes_that_share_the_name_of_a_shape(
    tmp_path: Path, animated: list[str], onto: bool
) -> None:
    path, output = tmp_path / "hero.usda", tmp_path / "hero.glb"
    talking_stage(path, animated)
    source = path
    if onto:
        # The motion alone, put on the rig again.
        assert animtool("bake", path, "-o", tmp_path / "take.usdc").code == 0
        source = tmp_path / "hero.scene.yaml"
        source.write_text(
            "scene: animtool/1\nrig: hero.usda\nsource: {file: take.usdc}\n"
        )
    done = animtool("bake", source, "-o", output)
    assert done.code == 0, done.stderr
    reference = read_glb(output)
    _, points, _ = reference.state(0, 1 / 24)
    found = {
        reference.json["meshes"][reference.nodes[node]["mesh"]]["name"]: rows
        for node, rows in points.items()
    }
    assert sorted(found) == MESHES
    for name, shapes in OFFSETS.items():
        expected = sum(
            0.25 * (k + 1) * np.array(shapes[shape])
            for k, shape in enumerate(animated)
            if shape in shapes
        )
        np.testing.assert_allclose(found[name][0], expected, atol=1e-6)


def test_a_layer_over_meshes_that_share_a_shape_has_no_warning(tmp_path: Path) -> None:
    talking_stage(tmp_path / "hero.usda", ["jaw"])
    (tmp_path / "talk.clip.yaml").write_text(
        "clip: animtool/1\nrig: hero.usda\nfps: 24\nchannels:\n"
        "- target: shape/smile\n  keys: [{t: 1, v: 0}, {t: 3, v: 1}]\n"
    )
    layer = tmp_path / "layer.usda"
    done = animtool(
        "bake", tmp_path / "talk.clip.yaml", "-o", layer,
        "--rig-layer", tmp_path / "hero.usda",
    )  # fmt: skip
    assert done.code == 0, done.stderr
    assert "USD114" not in done.stderr

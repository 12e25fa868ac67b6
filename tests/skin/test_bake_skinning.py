"""Whole meshes against `UsdSkel.BakeSkinning`, on stages made here."""

from __future__ import annotations

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt
from support.skel import skinned_prims
from support.skins import Array, affine, rigid

from animtool.skin.deform import DeformedMesh, deform
from animtool.skin.shapes import prepare_shapes
from animtool.skin.skinning import prepare_skin

JOINTS = ["hip", "hip/knee", "hip/knee/foot"]
TIMES = [1.0, 2.0, 3.0]
VERTICES = 12
# UsdSkel computes in float32 along the way.
TOLERANCE = 3e-6


def usd(matrices: Array) -> Vt.Matrix4dArray:
    return Vt.Matrix4dArray([Gf.Matrix4d(m.T.tolist()) for m in matrices])


def floats(rng: np.random.Generator, count: int = VERTICES) -> Vt.Vec3fArray:
    return Vt.Vec3fArray.FromNumpy(rng.normal(size=(count, 3)).astype(np.float32))


def make_stage(seed: int, method: str, *, scaled: bool) -> Usd.Stage:
    """Return a mesh with shapes and normals that follows two of three joints."""
    rng = np.random.default_rng(seed)
    stage = Usd.Stage.CreateInMemory()
    UsdSkel.Root.Define(stage, "/root")
    skeleton = UsdSkel.Skeleton.Define(stage, "/root/skeleton")
    skeleton.CreateJointsAttr(JOINTS)
    skeleton.CreateBindTransformsAttr(usd(rigid(rng, 3)))
    skeleton.CreateRestTransformsAttr(usd(rigid(rng, 3)))
    animation = UsdSkel.Animation.Define(stage, "/root/skeleton/motion")
    animation.CreateJointsAttr(JOINTS)
    animation.CreateBlendShapesAttr(["big", "small"])
    for time in TIMES:
        turns = rng.normal(size=(3, 4))
        turns /= np.linalg.norm(turns, axis=1, keepdims=True)
        scales = rng.uniform(0.7, 1.4, (3, 3)) if scaled else np.ones((3, 3))
        animation.CreateTranslationsAttr().Set(floats(rng, 3), time)
        quaternions = Vt.QuatfArray.FromNumpy(turns.astype(np.float32))
        animation.CreateRotationsAttr().Set(quaternions, time)
        halves = Vt.Vec3hArray.FromNumpy(scales.astype(np.float16))
        animation.CreateScalesAttr().Set(halves, time)
        weights = rng.uniform(-0.5, 1.5, 2).astype(np.float32)
        animation.CreateBlendShapeWeightsAttr().Set(
            Vt.FloatArray.FromNumpy(weights), time
        )
    UsdSkel.BindingAPI.Apply(skeleton.GetPrim()).CreateAnimationSourceRel().SetTargets(
        [animation.GetPath()]
    )
    bind_mesh(stage, rng, method)
    stage.SetStartTimeCode(TIMES[0])
    stage.SetEndTimeCode(TIMES[-1])
    return stage


def bind_mesh(stage: Usd.Stage, rng: np.random.Generator, method: str) -> None:
    mesh = UsdGeom.Mesh.Define(stage, "/root/mesh")
    mesh.CreatePointsAttr(floats(rng))
    mesh.CreateFaceVertexCountsAttr([3] * (VERTICES // 3))
    mesh.CreateFaceVertexIndicesAttr(list(range(VERTICES)))
    mesh.CreateNormalsAttr(floats(rng))
    mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateSkeletonRel().SetTargets(["/root/skeleton"])
    binding.CreateJointsAttr([JOINTS[2], JOINTS[0]])
    binding.CreateGeomBindTransformAttr(usd(affine(rng, 1))[0])
    weights = rng.uniform(0.1, 1, (VERTICES, 2))
    weights /= weights.sum(axis=1, keepdims=True)
    binding.CreateJointIndicesPrimvar(False, 2).Set([0, 1] * VERTICES)
    binding.CreateJointWeightsPrimvar(False, 2).Set(weights.ravel().tolist())
    token = Sdf.ValueTypeNames.Token
    name = "primvars:skel:skinningMethod"
    mesh.GetPrim().CreateAttribute(name, token).Set(method)
    for shape, count in (("big", VERTICES), ("small", 2)):
        prim = UsdSkel.BlendShape.Define(stage, f"/root/mesh/{shape}")
        prim.CreateOffsetsAttr(floats(rng, count))
        prim.CreatePointIndicesAttr(list(range(count)))
        between = prim.CreateInbetween("half")
        between.SetOffsets(floats(rng, count))
        between.SetWeight(0.4)
    binding.CreateBlendShapesAttr(["small", "big"])
    targets = ["/root/mesh/small", "/root/mesh/big"]
    binding.CreateBlendShapeTargetsRel().SetTargets(targets)


@pytest.mark.parametrize("method", ["classicLinear", "dualQuaternion"])
@pytest.mark.parametrize("scaled", [False, True])
@pytest.mark.parametrize("seed", [0, 1])
def test_a_mesh_is_where_usdskel_bakes_it(method: str, scaled: bool, seed: int) -> None:
    stage = make_stage(seed, method, scaled=scaled)
    (prim,) = skinned_prims(stage, TIMES)
    assert prim.binding is not None
    normals = np.array(UsdGeom.Mesh(prim.prim).GetNormalsAttr().Get(), np.float64)
    mesh = DeformedMesh(
        prim.points,
        prepare_shapes(prim.shapes, prim.points),
        prepare_skin(prim.binding, VERTICES),
        normals,
    )
    made = deform(mesh, prim.weights, prim.world, normals=True)
    assert UsdSkel.BakeSkinning(UsdSkel.Root(stage.GetPrimAtPath("/root")))
    baked = UsdGeom.Mesh(stage.GetPrimAtPath("/root/mesh"))
    points = np.array([baked.GetPointsAttr().Get(time) for time in TIMES])
    assert np.abs(made.points - points).max() <= TOLERANCE * np.abs(points).max()
    if not (scaled and method == "dualQuaternion"):
        # There UsdSkel splits sheared normals another way than points.
        turned = np.array([baked.GetNormalsAttr().Get(time) for time in TIMES])
        assert made.normals is not None
        assert np.abs(made.normals - turned).max() <= 1e-4

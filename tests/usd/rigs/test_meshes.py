"""Meshes and shapes of a rig in USD: as UsdSkel moves them, and as they come back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt
from support.surfaces import held, shaped_rig
from support.usd import open_stage, validation_errors

from animtool.formats.bvh.read import read_bvh
from animtool.maths import so3
from animtool.rig.file import load_rig
from animtool.rig.kinematics import (
    WorldTransforms,
    bind_matrices,
    bind_world,
    forward_kinematics,
)
from animtool.rig.parts import LoadedArray, Mesh
from animtool.rig.skeleton import Rig
from animtool.rig.surfaces import Surface, SurfaceInbetween, SurfaceShape, surfaces_of
from animtool.scene.bake.bake import bake
from animtool.scene.bake.options import BakeOptions
from animtool.skin.deform import DeformedMesh, deform
from animtool.skin.shapes import prepare_shapes
from animtool.skin.skinning import Binding, SkinMethod, prepare_skin
from animtool.usd.rigs.layer import write_rig_layer
from animtool.usd.rigs.meshes import bone_segments
from animtool.usd.rigs.stored import read_rig, read_rig_with_data

Floats = npt.NDArray[np.float64]


def skinning(stage: Any) -> dict[str, Any]:
    """Return the skinning query of each mesh, by its prim's name."""
    root = next(UsdSkel.Root(p) for p in stage.Traverse() if p.IsA(UsdSkel.Root))
    cache = UsdSkel.Cache()
    cache.Populate(root, Usd.PrimDefaultPredicate)
    (binding,) = cache.ComputeSkelBindings(root, Usd.PrimDefaultPredicate)
    return {q.GetPrim().GetName(): q for q in binding.GetSkinningTargets()}


def prepared(rig: Rig, surface: Surface) -> DeformedMesh:
    bind = bind_matrices(rig)
    shapes = prepare_shapes(
        [
            SurfaceShape(
                shape.name,
                shape.deltas,
                shape.vertices,
                shape.normals,
                tuple(SurfaceInbetween(s.at, s.deltas) for s in shape.inbetweens),
            )
            for shape in surface.shapes
        ],
        surface.points,
    )
    assert surface.skin is not None
    skin = Binding(
        surface.skin.indices,
        surface.skin.weights,
        bind,
        np.array([rig.index(name) for name in surface.skin.joints]),
        surface.geom_bind,
        SkinMethod(surface.skin.method),
    )
    made = prepare_skin(skin, len(surface.points))
    return DeformedMesh(surface.points, shapes, made)


def rows_of(world: WorldTransforms) -> Floats:
    """Return the first frame as row-vector matrices ``(J, 4, 4)``."""
    matrices = np.zeros((world.positions.shape[1], 4, 4))
    matrices[:, :3, :3] = world.linear[0].swapaxes(-1, -2)
    matrices[:, 3, :3], matrices[:, 3, 3] = world.positions[0], 1
    return matrices


@pytest.mark.parametrize("method", ["linear", "dual_quaternion"])
def test_usdskel_moves_them_as_we_do(tmp_path: Path, method: str) -> None:
    rig = shaped_rig(1, method)
    write_rig_layer(rig, tmp_path / "hero.usda")
    stage = open_stage(tmp_path / "hero.usda")
    assert validation_errors(stage) == []
    query = skinning(stage)["body"]
    rng = np.random.default_rng(2)
    turns = so3.multiply(
        rig.rest_rotations, so3.exp(rng.normal(0, 0.5, (1, len(rig.joints), 3)))
    )
    world = forward_kinematics(rig, rig.rest_translations[None], turns)
    weights = np.array([0.75, 0.25, 0.5])
    ours = deform(prepared(rig, surfaces_of(rig)[0]), weights[None], world)

    bound, moved = (rows_of(transforms) for transforms in (bind_world(rig), world))
    matrices = np.linalg.inv(bound) @ moved
    blends = UsdSkel.BlendShapeQuery(UsdSkel.BindingAPI(query.GetPrim()))
    parts = blends.ComputeSubShapeWeights(
        Vt.FloatArray.FromNumpy(weights.astype(np.float32))
    )
    points = UsdGeom.Mesh(query.GetPrim()).GetPointsAttr().Get()
    assert blends.ComputeDeformedPoints(
        *parts,
        blends.ComputeBlendShapePointIndices(),
        blends.ComputeSubShapePointOffsets(),
        points,
    )
    order = Vt.Matrix4dArray.FromNumpy(matrices)
    assert query.ComputeSkinnedPoints(order, points, Usd.TimeCode.Default())
    np.testing.assert_allclose(np.array(points), ours.points[0], rtol=0, atol=5e-7)


def same_arrays(one: Rig, other: Rig) -> None:
    """Assert that two rigs have the same surfaces."""
    for a, b in zip(surfaces_of(one), surfaces_of(other), strict=True):
        assert a.name == b.name
        assert a.subdivision is b.subdivision
        for name in ("points", "counts", "indices", "normals", "geom_bind"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
        assert (a.skin is None) is (b.skin is None)
        if a.skin is not None and b.skin is not None:
            assert a.skin.method == b.skin.method
            assert a.skin.joints == b.skin.joints
        assert [shape.name for shape in a.shapes] == [shape.name for shape in b.shapes]
        for x, y in zip(a.shapes, b.shapes, strict=True):
            count = len(a.points)
            np.testing.assert_array_equal(dense(x, count), dense(y, count))
            assert [s.at for s in x.inbetweens] == [s.at for s in y.inbetweens]
            for s, t in zip(x.inbetweens, y.inbetweens, strict=True):
                np.testing.assert_array_equal(s.deltas, t.deltas)


def dense(shape: Any, count: int) -> Floats:
    whole = np.zeros((count, 3))
    rows = np.arange(count) if shape.vertices is None else shape.vertices
    whole[rows] = shape.deltas
    return whole


def skin_matrix(mesh: Mesh, joints: list[str]) -> Floats:
    """Return the weights of every joint ``(V, J)``."""
    assert mesh.skin is not None
    indices = mesh.skin.indices.load().astype(int)
    weights = mesh.skin.weights.load()
    whole = np.zeros((len(indices), len(joints)))
    order = np.array([joints.index(name) for name in mesh.skin.joints])
    for i in range(indices.shape[1]):
        np.add.at(whole, (np.arange(len(indices)), order[indices[:, i]]), weights[:, i])
    return whole


@pytest.mark.parametrize("suffix", ["usda", "usdc"])
def test_they_come_back(tmp_path: Path, suffix: str) -> None:
    rig = shaped_rig(3)
    _, notices = write_rig_layer(rig, tmp_path / f"hero.{suffix}")
    assert notices == []
    found, said = read_rig_with_data(tmp_path / f"hero.{suffix}")
    assert said == []
    same_arrays(rig, found)
    a, b = (skin_matrix(r.meshes[0], rig.names) for r in (rig, found))
    np.testing.assert_allclose(a, b, rtol=0, atol=1e-7)
    assert [s.combine for s in found.shapes] == [s.combine for s in rig.shapes]
    bare = {"meshes": (), "shapes": ()}
    assert replace(found, **bare) == replace(rig, **bare)


def test_a_mesh_without_skin_stands_where_it_is_bound(tmp_path: Path) -> None:
    rig = shaped_rig()
    bind = (1.0, 0, 0, 3, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1)
    cap = replace(rig.meshes[1], geom_bind=bind)
    write_rig_layer(replace(rig, meshes=(cap,), shapes=()), tmp_path / "x.usda")
    stage = open_stage(tmp_path / "x.usda")
    prim = next(p for p in stage.Traverse() if p.IsA(UsdGeom.Mesh))
    placed = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(0)
    assert tuple(placed.ExtractTranslation()) == (3, 0, 0)


def test_a_mesh_with_shapes_alone_comes_back_to_its_place(tmp_path: Path) -> None:
    rig = shaped_rig()
    bind = (1.0, 0, 0, 3, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1)
    cap = replace(rig.meshes[1], geom_bind=bind)
    write_rig_layer(replace(rig, meshes=(rig.meshes[0], cap)), tmp_path / "x.usda")
    assert read_rig(tmp_path / "x.usda").meshes[1].geom_bind == bind


def test_an_open_mesh_is_visible_from_inside(tmp_path: Path) -> None:
    rig = shaped_rig()
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3.0]])
    one, other = (
        Mesh(name, held(np.vstack([np.zeros(3), np.eye(3)])), LoadedArray(some))
        for name, some in (("whole", faces), ("open", faces[:3]))
    )
    write_rig_layer(replace(rig, meshes=(one, other), shapes=()), tmp_path / "x.usda")
    stage = open_stage(tmp_path / "x.usda")
    sides = {
        prim.GetName(): UsdGeom.Gprim(prim).GetDoubleSidedAttr().Get()
        for prim in stage.Traverse()
        if prim.IsA(UsdGeom.Mesh)
    }
    assert sides == {"whole": False, "open": True}


def test_weights_are_normalised_and_it_is_said(tmp_path: Path) -> None:
    rig = shaped_rig()
    skin = rig.meshes[0].skin
    assert skin is not None
    weights = skin.weights.load().copy()
    weights[4] *= 1.5
    body = replace(rig.meshes[0], skin=replace(skin, weights=held(weights)))
    _, notices = write_rig_layer(
        replace(rig, meshes=(body,), shapes=()), tmp_path / "x.usda"
    )
    assert [notice.code for notice in notices] == ["SKIN101"]
    assert "vertex 4 was off by 0.5" in notices[0].message
    again = read_rig(tmp_path / "x.usda").meshes[0].skin
    assert again is not None
    np.testing.assert_allclose(again.weights.load().sum(axis=1), 1, atol=1e-6)


@pytest.mark.parametrize("name", ["bindTransforms", "restTransforms"])
def test_a_scale_that_rigs_do_not_hold_is_said(tmp_path: Path, name: str) -> None:
    path = tmp_path / "x.usda"
    write_rig_layer(shaped_rig(), path)
    assert read_rig(path).notices == ()
    layer = Sdf.Layer.FindOrOpen(str(path))
    spec = layer.GetAttributeAtPath(f"/hero/Rig/Skel.{name}")
    spec.default = Vt.Matrix4dArray(
        [Gf.Matrix4d().SetScale(2.0) * matrix for matrix in spec.default[:1]]
        + list(spec.default[1:])
    )
    del layer.GetPrimAtPath("/hero/Rig/Skel").customData["animtool"]
    layer.Save()
    (tmp_path / "x.rig.yaml").write_text("rig: animtool/1\nname: x\nfrom: x.usda\n")
    for rig in (read_rig(path), load_rig(tmp_path / "x.rig.yaml")):
        (notice,) = rig.notices
        assert notice.code == "USD120"
        assert "root" in notice.message


FAULTS = [
    ("body", "primvars:skel:jointIndices", Vt.IntArray([0]), "USD231"),
    ("body", "primvars:skel:jointIndices", Vt.IntArray([9] * 80), "USD230"),
    ("body", "primvars:skel:jointWeights", Vt.FloatArray([np.nan] * 80), "USD233"),
    ("body", "points", Vt.Vec3fArray(0), "USD017"),
    ("body", "points", Vt.Vec3fArray([(0, 0, np.inf)] * 40), "USD265"),
    ("body", "faceVertexCounts", Vt.IntArray([4]), "USD017"),
    ("body", "faceVertexCounts", Vt.IntArray(0), "USD017"),
    ("body", "faceVertexIndices", Vt.IntArray([99] * 111), "USD018"),
    ("body/jaw", "pointIndices", Vt.IntArray([77] * 10), "USD241"),
    ("body/jaw", "offsets", Vt.Vec3fArray([(0, 0, 0)]), "USD240"),
    ("body/jaw", "inbetweens:step_1", Vt.Vec3fArray([(0, 0, 0)]), "USD240"),
    ("body", "skel:blendShapes", Vt.TokenArray(["one"]), "USD245"),
]


@pytest.mark.parametrize(("prim", "name", "value", "code"), FAULTS)
def test_what_does_not_fit_is_refused(
    tmp_path: Path, prim: str, name: str, value: Any, code: str
) -> None:
    path = tmp_path / "x.usda"
    write_rig_layer(shaped_rig(), path)
    layer = Sdf.Layer.FindOrOpen(str(path))
    layer.GetAttributeAtPath(f"/hero/Rig/{prim}.{name}").default = value
    layer.Save()
    with pytest.raises(Exception) as caught:  # noqa: PT011 - its code says which
        read_rig(path)
    assert [fault.code for fault in caught.value.faults] == [code]  # type: ignore[attr-defined]


def test_bones_face_outwards_and_belong_to_one_joint(
    walk: Path, tmp_path: Path
) -> None:
    output = tmp_path / "walk.usda"
    bake(walk, output, BakeOptions(bones=True))
    stage = Usd.Stage.Open(str(output))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/walk/Rig/Bones"))
    # Viewers show the default purpose, and Blender imports it.
    assert UsdGeom.Imageable(mesh).ComputePurpose() == "default"
    points = np.array(mesh.GetPointsAttr().Get(), float)
    faces = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 8, 3)
    for bone in faces:
        center = points[np.unique(bone)].mean(axis=0)
        a, b, c = (points[bone[:, i]] for i in range(3))
        outward = np.sum(np.cross(b - a, c - a) * (a - center), axis=-1)
        assert (outward > 0).all()
    joints = np.array(mesh.GetPrim().GetAttribute("primvars:skel:jointIndices").Get())
    assert (joints.reshape(-1, 6) == joints.reshape(-1, 6)[:, :1]).all()


def test_every_length_is_a_bone(walk: Path) -> None:
    rig = read_bvh(walk).collect().rig
    segments, owners = bone_segments(rig)
    tips = sum(len(joint.tips) for joint in rig.joints)
    lengths = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=-1)
    zero = sum(not np.any(j.translation) for j in rig.joints if j.parent >= 0)
    assert len(segments) == len(rig.joints) - len(rig.roots) + tips - zero
    assert lengths.min() > 0
    assert set(owners.tolist()) <= set(range(len(rig.joints)))

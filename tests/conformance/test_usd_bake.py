"""Deformed meshes against what OpenUSD's own tests expect of its baking."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom
from support.data import data_files
from support.skel import SkinnedPrim, skinned_prims

from animtool.skin.deform import DeformedMesh, deform
from animtool.skin.shapes import prepare_shapes
from animtool.skin.skinning import PreparedSkin, prepare_skin

# What float32 points and weights leave, as a share of the size.
TOLERANCE = 1e-6

every_bake = pytest.mark.parametrize("path", data_files("usd/bake", "*.baked.usda"))


@dataclass
class Bake:
    """A baked stage, its source, its frames, and what the source deforms."""

    source: Usd.Stage
    baked: Usd.Stage
    times: list[float]
    prims: list[SkinnedPrim]


def opened(path: Path) -> Bake:
    source = Usd.Stage.Open(str(path).replace(".baked.usda", ".usda"))
    baked = Usd.Stage.Open(str(path))
    times = np.arange(source.GetStartTimeCode(), source.GetEndTimeCode() + 1).tolist()
    return Bake(source, baked, times, list(skinned_prims(source, times)))


def skin_of(prim: SkinnedPrim, vertices: int) -> PreparedSkin | None:
    return prim.binding and prepare_skin(prim.binding, vertices)


@every_bake
def test_points_are_those_of_the_baked_file(path: Path) -> None:
    bake = opened(path)
    meshes = [prim for prim in bake.prims if len(prim.points)]
    assert meshes
    for prim in meshes:
        shapes = prepare_shapes(prim.shapes, prim.points)
        mesh = DeformedMesh(prim.points, shapes, skin_of(prim, len(prim.points)))
        made = deform(mesh, prim.weights, prim.world)
        points = UsdGeom.PointBased(bake.baked.GetPrimAtPath(prim.path)).GetPointsAttr()
        truth = np.array([points.Get(time) for time in bake.times])
        assert np.abs(made.points - truth).max() <= TOLERANCE * np.abs(truth).max()


@every_bake
def test_normals_are_those_of_the_baked_file(path: Path) -> None:
    bake = opened(path)
    found = 0
    for prim in bake.prims:
        mesh = UsdGeom.Mesh(prim.prim)
        normals = mesh.GetNormalsAttr().Get() if mesh else None
        if not normals or prim.binding is None:
            continue
        found += 1
        points, skin = prim.points, skin_of(prim, len(prim.points))
        if mesh.GetNormalsInterpolation() == UsdGeom.Tokens.faceVarying:
            # Each corner of a face as a vertex.
            corners = np.array(mesh.GetFaceVertexIndicesAttr().Get(), np.int64)
            binding = prim.binding
            if len(np.asarray(binding.indices)) > 1:
                binding = replace(
                    binding,
                    indices=np.asarray(binding.indices)[corners],
                    weights=np.asarray(binding.weights)[corners],
                )
            points, skin = points[corners], prepare_skin(binding, len(corners))
        deformed = DeformedMesh(
            points,
            skin=skin,
            normals=np.array(normals, np.float64),
        )
        made = deform(deformed, None, prim.world, normals=True).normals
        truth = UsdGeom.Mesh(bake.baked.GetPrimAtPath(prim.path)).GetNormalsAttr()
        expected = np.array([truth.Get(time) for time in bake.times])
        assert made is not None
        assert np.abs(made - expected).max() <= TOLERANCE
    if not found:
        pytest.skip("no mesh with normals and a skin")


@every_bake
def test_rigid_prims_move_with_the_baked_transform(path: Path) -> None:
    bake = opened(path)
    rigid = [prim for prim in bake.prims if not len(prim.points)]
    if not rigid:
        pytest.skip("no prim without points")
    # The origin and the ends of the axes say what a transform is.
    frame = np.concatenate([np.zeros((1, 3)), np.eye(3)])
    for prim in rigid:
        made = deform(DeformedMesh(frame, skin=skin_of(prim, 4)), None, prim.world)
        xformable = UsdGeom.Xformable(bake.baked.GetPrimAtPath(prim.path))
        local = [xformable.GetLocalTransformation(time) for time in bake.times]
        truth = np.array(
            [[m.TransformAffine(p.tolist()) for p in frame] for m in local]
        )
        assert np.abs(made.points - truth).max() <= TOLERANCE * np.abs(truth).max()

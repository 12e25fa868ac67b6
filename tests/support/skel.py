"""Skinned prims of a stage as animtool's records, read with UsdSkel."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from pxr import Usd, UsdGeom, UsdSkel, Vt

from animtool.rig.kinematics import WorldTransforms
from animtool.rig.surfaces import SurfaceInbetween, SurfaceShape
from animtool.skin.skinning import Binding, SkinMethod

Array = npt.NDArray[np.float64]

METHODS = {
    "classicLinear": SkinMethod.LINEAR,
    "dualQuaternion": SkinMethod.DUAL_QUATERNION,
}


@dataclass(frozen=True)
class SkinnedPrim:
    """A prim that a skeleton or blend shapes deform, in the frames asked for."""

    prim: Usd.Prim
    points: Array
    shapes: list[SurfaceShape]
    weights: Array
    binding: Binding | None
    world: WorldTransforms

    @property
    def path(self) -> str:
        return str(self.prim.GetPath())


def columns(matrices: Any) -> Array:
    """Return row-vector matrices for column vectors."""
    return np.array(matrices, np.float64).swapaxes(-1, -2)


def world_transforms(matrices: Array) -> WorldTransforms:
    """Return matrices ``(F, J, 4, 4)`` for column vectors as kinematics has them."""
    return WorldTransforms(matrices[..., :3, 3].copy(), matrices[..., :3, :3].copy())


def skinned_prims(stage: Usd.Stage, times: list[float]) -> Iterator[SkinnedPrim]:
    """Yield what UsdSkel would deform."""
    cache = UsdSkel.Cache()
    for prim in stage.Traverse():
        if not prim.IsA(UsdSkel.Root):
            continue
        root = UsdSkel.Root(prim)
        cache.Populate(root, Usd.PrimDefaultPredicate)
        for bound in cache.ComputeSkelBindings(root, Usd.PrimDefaultPredicate):
            skeleton = cache.GetSkelQuery(bound.GetSkeleton())
            for query in bound.GetSkinningTargets():
                yield _read(skeleton, query, times)


def _read(
    skeleton: UsdSkel.SkeletonQuery, query: UsdSkel.SkinningQuery, times: list[float]
) -> SkinnedPrim:
    prim = query.GetPrim()
    points = UsdGeom.PointBased(prim).GetPointsAttr().Get() if prim else None
    joints = [skeleton.ComputeJointSkelTransforms(time) for time in times]
    shape = (len(times), len(skeleton.GetJointOrder()), 4, 4)
    matrices = columns(np.array(joints).reshape(shape))
    shapes, weights = _shapes(skeleton, query, times)
    return SkinnedPrim(
        prim,
        np.array(points or [], np.float64).reshape(-1, 3),
        shapes,
        weights,
        _binding(skeleton, query),
        world_transforms(matrices),
    )


def _binding(
    skeleton: UsdSkel.SkeletonQuery, query: UsdSkel.SkinningQuery
) -> Binding | None:
    if not query.HasJointInfluences():
        return None
    indices, weights = query.ComputeJointInfluences()
    shape = (-1, query.GetNumInfluencesPerComponent())
    own, order = query.GetJointOrder(), list(skeleton.GetJointOrder())
    return Binding(
        np.array(indices).reshape(shape),
        np.array(weights).reshape(shape),
        columns(skeleton.GetJointWorldBindTransforms()),
        None if own is None else np.array([order.index(name) for name in own]),
        columns(query.GetGeomBindTransform()),
        METHODS[query.GetSkinningMethod()],
    )


def _shapes(
    skeleton: UsdSkel.SkeletonQuery, query: UsdSkel.SkinningQuery, times: list[float]
) -> tuple[list[SurfaceShape], Array]:
    if not query.HasBlendShapes():
        return [], np.zeros((len(times), 0))
    blend = UsdSkel.BlendShapeQuery(UsdSkel.BindingAPI(query.GetPrim()))
    shapes = []
    for i in range(blend.GetNumBlendShapes()):
        shape = blend.GetBlendShape(i)
        indices = shape.GetPointIndicesAttr().Get()
        inbetweens = [
            SurfaceInbetween(between.GetWeight(), np.array(between.GetOffsets()))
            for between in shape.GetInbetweens()
        ]
        shapes.append(
            SurfaceShape(
                shape.GetPrim().GetName(),
                np.array(shape.GetOffsetsAttr().Get()),
                None if indices is None else np.array(indices, np.int64),
                inbetweens=tuple(inbetweens),
            )
        )
    mapper, animation = query.GetBlendShapeMapper(), skeleton.GetAnimQuery()
    weights = [
        mapper.Remap(Vt.FloatArray(animation.ComputeBlendShapeWeights(time)))
        for time in times
    ]
    return shapes, np.array(weights, np.float64)

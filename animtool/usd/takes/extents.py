"""Writes the extents of a SkelRoot over time, and checks its UsdSkel binding."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from pxr import Gf, Sdf

from animtool.core.array_types import Float32Array, FloatArray
from animtool.core.errors import Fault, OutputError
from animtool.usd.layers.finite import rounded_outwards
from animtool.usd.layers.jobs import UsdJob
from animtool.usd.layers.sdf import attribute_spec, prim_spec
from animtool.usd.layers.stderr import without_usd_warnings
from animtool.usd.takes.joint_writer import AnimationWriter


def shape_bounds(
    root: Any, shapes: Sequence[str], weights: Sequence[Float32Array]
) -> Float32Array | None:
    """Return bounds ``(2, 3)`` of meshes with shapes over all frames, SkelRoot space.

    ``weights`` are the shape weights ``(F, S)``, one array per block.

    Returns None if no mesh has points.
    """
    from pxr import Usd, UsdGeom

    from animtool.usd.caches.reader import PointReader, transform_points

    max_weights = np.zeros(len(shapes))
    for rows in weights:
        max_weights = np.maximum(max_weights, np.abs(rows).max(axis=0, initial=0.0))
    max_weight_by_shape = dict(zip(shapes, max_weights.tolist(), strict=True))
    cache = UsdGeom.XformCache(Usd.TimeCode.EarliestTime())
    lows: list[FloatArray] = []
    highs: list[FloatArray] = []
    for mesh in Usd.PrimRange(root, Usd.TraverseInstanceProxies()):
        if not mesh.IsA(UsdGeom.Mesh):
            continue
        points = PointReader(mesh).points_at(Usd.TimeCode.Default())
        if not len(points):
            continue
        root_from_mesh, _ = cache.ComputeRelativeTransform(mesh, root)
        matrix = np.array(root_from_mesh, np.float64)
        root_points = transform_points(points, matrix)
        padding = _shape_padding(mesh, max_weight_by_shape) * float(
            np.linalg.norm(matrix[:3, :3], 2)
        )
        lows.append(root_points.min(axis=0) - padding)
        highs.append(root_points.max(axis=0) + padding)
    if not lows:
        return None
    bounds = np.array([np.min(lows, axis=0), np.max(highs, axis=0)])
    return rounded_outwards(bounds)


def _shape_padding(prim: Any, max_weight_by_shape: dict[str, float]) -> float:
    """Return an upper bound on the displacement of a mesh's points by blend shapes."""
    from pxr import UsdSkel

    binding = UsdSkel.BindingAPI(prim)
    names = binding.GetBlendShapesAttr().Get() or ()
    targets = binding.GetBlendShapeTargetsRel().GetTargets()
    stage, padding = prim.GetStage(), 0.0
    for name, target in zip(names, targets, strict=False):
        weight = max_weight_by_shape.get(str(name), 0.0)
        shape = UsdSkel.BlendShape(stage.GetPrimAtPath(target))
        if not weight or not shape:
            continue
        inbetween_attrs = [inbetween.GetAttr() for inbetween in shape.GetInbetweens()]
        if inbetween_attrs:
            # A small weight may move points as far as an inbetween does.
            weight = max(weight, 1.0)
        padding += weight * max(
            map(_max_offset_length, (shape.GetOffsetsAttr(), *inbetween_attrs))
        )
    return padding


def _max_offset_length(attr: Any) -> float:
    offsets = np.array(attr.Get() or (), np.float64).reshape(-1, 3)
    return float(np.linalg.norm(offsets, axis=1).max(initial=0.0))


def author_extents(
    job: UsdJob,
    has_visible_geometry: bool,
    layers: Sequence[Any],
    writers: Sequence[tuple[str, AnimationWriter]],
) -> None:
    """Author the SkelRoot's extent as UsdSkel computes it, for every take.

    The extent is the bounds of the joints plus a padding that depends only on the
    meshes at rest, so that one frame determines it. UsdSkel computes every frame if the
    SkelRoot has several skeletons or transforms its skeleton.

    ``has_visible_geometry`` says whether there are visible bones or meshes.
    """
    is_invisible = job.target is None and not has_visible_geometry
    if is_invisible and job.joints:
        with Sdf.ChangeBlock():
            for _, writer in writers:
                writer.author_bounds(writer.padded_bounds(0.0))
        if not any(name for name, _ in writers):
            return
    # Without rest transforms, UsdSkel would warn at each frame.
    with without_usd_warnings():
        _author_composed(job, layers, writers, is_invisible=is_invisible)


def _author_composed(
    job: UsdJob,
    layers: Sequence[Any],
    writers: Sequence[tuple[str, AnimationWriter]],
    *,
    is_invisible: bool,
) -> None:
    """Author extents and check bindings that need a stage of the layers."""
    stage = _compose_stage(job, layers)
    for name, writer in writers:
        if name:
            from animtool.usd.takes.library import find_take_set, select_take

            takes = find_take_set(stage.GetPrimAtPath(job.paths.model))
            select_take(takes, name, "")
        if name or job.target is not None:
            _check_binding(job, stage, writer.paths.animation, is_library=bool(name))
        if not job.joints:
            _author_shape_bounds(job, stage, writer)
        elif not is_invisible:
            _author_bounds(job, stage, writer)
        if name:
            from animtool.usd.takes.library import check_variant

            check_variant(stage, layers[0], writer.paths, job.fault_path)


def _compose_stage(job: UsdJob, layers: Sequence[Any]) -> Any:
    """Compose the authored layers over the rig and return the stage."""
    from pxr import Usd

    if job.target is not None:
        from animtool.usd.rigs.target import compose_over_rig

        return compose_over_rig(job.target, layers[0])
    root_layer = Sdf.Layer.CreateAnonymous(".usda")
    root_layer.subLayerPaths = [layer.identifier for layer in layers]
    stage = Usd.Stage.Open(root_layer)
    stage.SetTimeCodesPerSecond(float(job.fps))
    return stage


def _author_bounds(job: UsdJob, stage: Any, writer: AnimationWriter) -> None:
    from pxr import UsdGeom

    root = UsdGeom.Boundable(stage.GetPrimAtPath(job.paths.root))
    skeleton = UsdGeom.Xformable(stage.GetPrimAtPath(job.paths.skeleton))
    is_direct_child = skeleton.GetPrim().GetParent() == root.GetPrim()
    is_simple = (
        is_direct_child
        and (job.target is None or job.target.skeleton_count == 1)
        and not skeleton.GetXformOpOrderAttr().Get()
    )

    bounds = (
        writer.padded_bounds(_bounds_padding(job, stage, root)) if is_simple else []
    )
    if not is_simple or not _match_usd_bounds(root, writer.codes, bounds):
        bounds = [
            np.stack([_computed_extent(root, code) for code in codes.tolist()])
            for codes in writer.codes
        ]
    with Sdf.ChangeBlock():
        writer.author_bounds(bounds)


def _computed_extent(root: Any, code: Any) -> Float32Array:
    """Return the extent that USD computes ``(2, 3)``."""
    from pxr import UsdGeom

    extent = UsdGeom.Boundable.ComputeExtentFromPlugins(root, code)
    return np.array(extent, np.float32).reshape(-1, 3)


def _match_usd_bounds(
    root: Any, codes: Sequence[FloatArray], bounds: Sequence[Float32Array]
) -> bool:
    """Return whether bounds are bit-identical to those that USD computes.

    Only the first, middle and last sample are compared.
    """
    times, stored_bounds = np.concatenate(codes), np.concatenate(bounds)
    return all(
        np.array_equal(stored_bounds[i], _computed_extent(root, float(times[i])))
        for i in {0, len(times) // 2, len(times) - 1}
    )


def _bounds_padding(job: UsdJob, stage: Any, root: Any) -> np.float32:
    """Return UsdSkel's padding of the joint bounds.

    It is the extent that UsdSkel computes with all joints at the origin.
    """
    from pxr import Usd, UsdSkel

    skeleton = UsdSkel.Skeleton(stage.GetPrimAtPath(job.paths.skeleton))
    joints = skeleton.GetJointsAttr().Get() or []
    collapsed_layer = Sdf.Layer.CreateAnonymous(".usda")
    animation_spec = prim_spec(collapsed_layer, job.paths.animation, is_over=True)
    types = Sdf.ValueTypeNames
    attribute_spec(animation_spec, "joints", types.TokenArray, joints, is_uniform=True)
    for name, value_type, value in (
        ("translations", types.Float3Array, (0, 0, 0)),
        ("rotations", types.QuatfArray, Gf.Quatf.GetIdentity()),
        ("scales", types.Half3Array, (1, 1, 1)),
    ):
        attribute_spec(animation_spec, name, value_type, [value] * len(joints))
    session = stage.GetSessionLayer()
    session.subLayerPaths.insert(0, collapsed_layer.identifier)
    extent = _computed_extent(root, Usd.TimeCode.Default())
    session.subLayerPaths.remove(collapsed_layer.identifier)
    return np.float32(extent[1].max())


def _author_shape_bounds(job: UsdJob, stage: Any, writer: AnimationWriter) -> None:
    """Author bounds of meshes deformed by shapes only.

    USD computes no bounds without joints. These bounds contain the points at rest,
    padded by the largest displacement in any frame.
    """
    root = stage.GetPrimAtPath(job.paths.root)
    bounds = shape_bounds(root, writer.shapes, writer.weights)
    if bounds is not None:
        with Sdf.ChangeBlock():
            writer.author_bounds(
                [np.repeat(bounds[None], len(codes), 0) for codes in writer.codes]
            )


def _check_binding(
    job: UsdJob, stage: Any, animation: str, *, is_library: bool
) -> None:
    """Refuse an animation binding that UsdSkel does not resolve (USD011)."""
    from animtool.usd.rigs.target import resolved_animation

    resolved_path = resolved_animation(stage, job.paths.skeleton)
    if resolved_path != animation:
        message = (
            f"UsdSkel resolves {resolved_path or 'no animation'} for "
            f"{job.paths.skeleton}, "
            f"not {animation}"
        )
        hint = "a binding in the rig is stronger than the layer"
        if is_library:
            from animtool.usd.takes.library import STRONGER_HINT

            hint = STRONGER_HINT
        if stage.GetPrimAtPath(job.paths.skeleton).IsInstanceProxy():
            hint = "the rig is instanced there, and a layer cannot reach into instances"
        raise OutputError(Fault("USD011", message, job.fault_path, (), hint))

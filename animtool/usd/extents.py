"""The bounds of a SkelRoot over time, and what UsdSkel resolves of what is authored."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from pxr import Sdf

from animtool._types import Float32Array
from animtool.errors import Fault, OutputError
from animtool.usd.animation import AnimationWriter
from animtool.usd.jobs import UsdJob

__all__ = ["author_extents"]


def author_extents(
    job: UsdJob,
    visible: bool,
    layers: Sequence[Any],
    writers: Sequence[tuple[str, AnimationWriter]],
) -> None:
    """Write the SkelRoot's extent as UsdSkel would compute it, for every take.

    That is the bounds of the joints and a padding which depends on the meshes at
    rest alone, so one frame tells it; where the SkelRoot holds several skeletons
    or moves its own within, UsdSkel computes every frame.

    Args:
        job: What is written.
        visible: Whether there are bones or meshes to see.
        layers: That of the animation first, all else authored.
        writers: The takes and their names.

    Raises:
        OutputError: UsdSkel would not resolve what was authored (USD011, USD032).
    """
    bare = job.target is None and not visible
    if bare:
        with Sdf.ChangeBlock():
            for _, writer in writers:
                writer.author_extents(0.0)
        if not any(name for name, _ in writers):
            return
    stage = _composed(job, layers)
    for name, writer in writers:
        if name:
            _select(stage, job, name)
        if name or job.target is not None:
            _check_resolved(job, stage, writer.paths.animation, library=bool(name))
        if not bare:
            _author_bounds(job, stage, writer)
        if name:
            from animtool.usd.library import check_variant

            where = None if job.output is None else str(job.output)
            check_variant(stage, layers[0], writer.paths, where)


def _composed(job: UsdJob, layers: Sequence[Any]) -> Any:
    """Return a stage of what is authored, over its rig."""
    from pxr import Usd

    if job.target is not None:
        from animtool.usd.target import compose_check

        return compose_check(job.target, layers[0])
    top = Sdf.Layer.CreateAnonymous(".usda")
    top.subLayerPaths = list(dict.fromkeys(layer.identifier for layer in layers))
    stage = Usd.Stage.Open(top)
    stage.SetTimeCodesPerSecond(float(job.fps))
    return stage


def _select(stage: Any, job: UsdJob, name: str) -> None:
    from animtool.usd.library import find_take_set, select_take

    select_take(find_take_set(stage.GetPrimAtPath(job.paths.model)), name, "")


def _author_bounds(job: UsdJob, stage: Any, writer: AnimationWriter) -> None:
    from pxr import Usd, UsdGeom

    root = UsdGeom.Boundable(stage.GetPrimAtPath(job.paths.root))
    skeleton = UsdGeom.Xformable(stage.GetPrimAtPath(job.paths.skeleton))
    within = skeleton.GetPrim().GetParent() == root.GetPrim()
    simple = (
        within
        and (job.target is None or job.target.skeletons == 1)
        and not skeleton.GetXformOpOrderAttr().Get()
    )

    def computed(code: float) -> Float32Array:
        extent = UsdGeom.Boundable.ComputeExtentFromPlugins(root, Usd.TimeCode(code))
        return np.array(extent, np.float32).reshape(-1, 3)

    if simple:
        pad = float(np.abs(computed(writer.codes[0][0]) - writer.first_extent).max())
        reach = float(np.abs(writer.first_extent).max())
        # Two roundings to float32 apart is no padding.
        pad = pad if pad > 2.5e-7 * reach else 0.0
        with Sdf.ChangeBlock():
            writer.author_extents(pad)
        return
    bounds = [np.stack([computed(c) for c in codes]) for codes in writer.codes]
    with Sdf.ChangeBlock():
        writer.author_bounds(bounds)


def _check_resolved(job: UsdJob, stage: Any, animation: str, *, library: bool) -> None:
    """Refuse a binding that UsdSkel does not follow.

    Raises:
        OutputError: It resolves another animation, or none (USD011).
    """
    from animtool.usd.target import resolved_animation

    found = resolved_animation(stage, job.paths.skeleton)
    if found != animation:
        path = None if job.output is None else str(job.output)
        message = (
            f"UsdSkel resolves {found or 'no animation'} for {job.paths.skeleton}, "
            f"not {animation}"
        )
        hint = "a binding in the rig is stronger than the layer"
        if library:
            from animtool.usd.library import STRONGER_HINT

            hint = STRONGER_HINT
        if stage.GetPrimAtPath(job.paths.skeleton).IsInstanceProxy():
            hint = "the rig is instanced there, and a layer cannot reach into instances"
        raise OutputError(Fault("USD011", message, path, (), hint))

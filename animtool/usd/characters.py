"""What a stage's Skeleton deforms, with its exact bind transforms."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from pxr import UsdSkel

from animtool._types import FloatArray
from animtool.errors import Fault, FormatError, counted
from animtool.rig.surfaces import Strands, Surface, strands_of, surfaces_of
from animtool.units import UpAxis
from animtool.usd.layers import usd_errors
from animtool.usd.mesh_read import read_meshes, read_strands
from animtool.usd.rig_prims import (
    SkeletonRig,
    find_skeletons,
    open_stage,
    prim_below,
    skeleton_rig,
)
from animtool.usd.target import RigTarget
from animtool.usd.values import numbers


@dataclass(frozen=True, slots=True, eq=False)
class StageMeshes:
    """Meshes and strands of a Skeleton."""

    surfaces: tuple[Surface, ...]  # the meshes [m]
    strands: tuple[Strands, ...]  # the curves that single joints carry [m]
    # World transforms of the Skeleton's J joints at bind time, scale and shear
    # included, for column vectors ``(J, 4, 4)`` [m].
    bind: FloatArray
    up: UpAxis  # up axis of all of it
    notices: list[Fault]  # what is left out


def source_meshes(path: Path, prim_path: str | None) -> StageMeshes:
    """Return the meshes of the character that a USD file is read as."""
    with usd_errors(path):
        stage = open_stage(path)
        skeletons = find_skeletons(stage, prim_below(stage, prim_path))
        if not skeletons:
            return StageMeshes((), (), np.zeros((0, 4, 4)), UpAxis.Y, [])
        return _meshes(skeletons[0], skeleton_rig(skeletons[0], path), path)


def target_meshes(target: RigTarget) -> StageMeshes:
    """Return the meshes of a rig layer."""
    with usd_errors(target.path):
        prim = target.stage.GetPrimAtPath(target.on_stage(target.paths.skeleton))
        return _meshes(UsdSkel.Skeleton(prim), target.skeleton, target.path)


def _meshes(skeleton: Any, found: SkeletonRig, path: Path) -> StageMeshes:
    meshes, shapes, notices = read_meshes(skeleton, found, str(path))
    strands = read_strands(skeleton, found, str(path))
    rig = replace(found.rig, meshes=meshes, shapes=shapes, attach=strands)
    if not meshes and not strands:
        return StageMeshes((), (), np.zeros((0, 4, 4)), rig.up, notices)
    bind = _bind(skeleton, len(rig.joints), f"{path}<{skeleton.GetPath()}>")
    bind[:, :3, 3] *= rig.meters_per_unit
    return StageMeshes(surfaces_of(rig), strands_of(rig), bind, rig.up, notices)


def _bind(skeleton: Any, joints: int, where: str) -> FloatArray:
    bind = numbers(skeleton.GetBindTransformsAttr(), 16).reshape(-1, 4, 4)
    if len(bind) != joints or not np.isfinite(bind).all():
        message = (
            f"{counted(len(bind), 'bindTransform')} for {counted(joints, 'joint')}"
        )
        if len(bind) == joints:
            message = "a bind transform is not finite"
        raise FormatError(Fault("USD019", message, where))
    return bind.swapaxes(-1, -2).copy()

"""The whole rig of a USD file: joints, what they move, and what is beyond USD."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from animtool._types import FloatArray
from animtool.errors import Fault, FormatError, Severity, listed
from animtool.maths import so3
from animtool.rig.skeleton import Pose, Rig
from animtool.usd.layers import usd_errors
from animtool.usd.mesh_read import read_meshes
from animtool.usd.rig_prims import (
    LARGEST_REST,
    SkeletonRig,
    check_moves,
    composition_notices,
    decompose,
    find_skeletons,
    open_stage,
    others_notice,
    prim_below,
    skeleton_rig,
)
from animtool.usd.stored_rig import joined_rig, with_attachments
from animtool.usd.strand_read import read_strands
from animtool.usd.values import array_value, numbers, stored_data

# A bind pose nearer to rest [rad], [1] is rest with the rounding of other tools.
BIND_TOLERANCE = 1e-6
# A scale this near to 1 is that, with the rounding of other tools.
SCALE_TOLERANCE = 1e-4


def read_rig(path: Path) -> Rig:
    """Return the rig of a USD file, with what there is to say of it as its notices."""
    rig, notices = read_whole_rig(path)
    return replace(rig, notices=tuple(notices))


def read_whole_rig(path: Path, prim_path: str | None = None) -> tuple[Rig, list[Fault]]:
    """Return the rig of a USD file's Skeleton, that of its default prim first.

    With bind pose, meshes, shapes and strands, and what its customData holds beyond
    USD.

    Args:
        path: The file.
        prim_path: The character, where there are several.

    Raises:
        FormatError: It is no USD file or holds no sound Skeleton there.
        OptionError: The path is no prim path.
    """
    with usd_errors(path):
        stage = open_stage(path)
        skeletons = find_skeletons(stage, prim_below(stage, prim_path))
        if not skeletons:
            below = "" if prim_path is None else f" at {prim_path}"
            message = f"holds no Skeleton{below}"
            raise FormatError(Fault("USD008", message, str(path)))
        found = skeleton_rig(skeletons[0], path)
        skeleton = skeletons[0]
        meshes, shapes, notices = read_meshes(skeleton, found, str(path))
        where = f"{path}<{skeleton.GetPath()}>"
        check_moves(len(found.rig.joints), len(shapes), where)
        notices += others_notice(skeletons, str(path), "--prim-path names one")
        notices += composition_notices(stage, str(path))
        bind, bind_scales = _bind_poses(skeleton, found)
        notices += _scale_notice(found, bind_scales, str(path))
        rig = replace(
            found.rig,
            bind=bind,
            meshes=meshes,
            shapes=shapes,
            attach=read_strands(skeleton, found, str(path)),
        )
        data = stored_data(skeleton.GetPrim())
        joined, edits = joined_rig(
            rig,
            data,
            found.tokens,
            array_value(skeleton.GetRestTransformsAttr()),
            array_value(skeleton.GetBindTransformsAttr()),
            path,
        )
        whole, losses = with_attachments(joined, rig, data, path)
        return whole, notices + edits + losses


def _bind_poses(
    skeleton: Any, found: SkeletonRig
) -> tuple[dict[str, Pose], FloatArray]:
    """Return the local bind transforms that are not those of rest, and their scales.

    The scales ``(J, 3)`` are no part of the poses.
    """
    rig = found.rig
    world = numbers(skeleton.GetBindTransformsAttr(), 16).reshape(-1, 4, 4)
    if (
        not rig.joints
        or len(world) != len(rig.joints)
        or not (np.abs(world) <= LARGEST_REST).all()
    ):
        return {}, np.ones((len(rig.joints), 3))
    above = np.where((rig.parents < 0)[:, None, None], np.eye(4), world[rig.parents])
    if (np.linalg.det(above) == 0).any():
        return {}, np.ones((len(rig.joints), 3))
    places, turns, scales = decompose(world @ np.linalg.inv(above))
    places = places * rig.meters_per_unit
    moved = np.abs(places - rig.rest_translations).max(axis=1)
    moved = moved > BIND_TOLERANCE * np.abs(rig.rest_translations).max()
    moved |= so3.angle_between(turns, rig.rest_rotations) > BIND_TOLERANCE
    poses = {
        rig.names[j]: Pose(tuple(places[j].tolist()), tuple(turns[j].tolist()))
        for j in np.flatnonzero(moved).tolist()
    }
    return poses, scales


def _scale_notice(found: SkeletonRig, bind: FloatArray, where: str) -> list[Fault]:
    """Name the joints whose scale at rest or at bind time a rig does not hold."""
    apart = np.abs(np.stack([found.rest_scales, bind]) - 1.0).max(axis=(0, 2))
    names = [found.rig.names[j] for j in np.flatnonzero(apart > SCALE_TOLERANCE)]
    if not names:
        return []
    message = f"the scale of rest or bind transforms is left out: {listed(names)}"
    hint = "a rig has none; a take of the file itself, and its meshes, keep it"
    return [Fault("USD120", message, where, (), hint, Severity.WARNING)]

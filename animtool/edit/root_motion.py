"""Giving the travel of the hips to a root joint above them, and taking it back."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from animtool.edit.signs import continuous
from animtool.errors import Fault, OptionError
from animtool.maths import so3
from animtool.passes import Pass, PassContext, Scope
from animtool.rig.skeleton import Joint
from animtool.take import Channel, Motion, Take
from animtool.units import UpAxis

__all__ = ["PASS", "RootMode", "RootMotionOptions", "extract_root", "recompose_root"]


class RootMode(StrEnum):
    """Which way the travel goes."""

    EXTRACT = "extract"
    RECOMPOSE = "recompose"


@dataclass(frozen=True, slots=True)
class RootMotionOptions:
    """What the root joint carries.

    Attributes:
        mode: ``extract`` adds the root joint, ``recompose`` folds it back.
        root: Name of the root joint.
        axes: World axes of the position that it carries, such as ``xz``; none is
            the ground.
        yaw: It carries the turn about the up axis too.
    """

    mode: RootMode = RootMode.EXTRACT
    root: str = "root"
    axes: str = ""
    yaw: bool = True


def extract_root(
    take: Take, root: str = "root", axes: str = "", *, yaw: bool = True
) -> Take:
    """Return the take with a new root joint above its first root, the hips.

    World transforms stay as they are. The yaw is undefined where the hips are
    upside down.

    Raises:
        OptionError: The name is taken, or an axis is none (SCN020).
    """
    rig = take.rig
    up = 2 if rig.up is UpAxis.Z else 1
    letters = axes.lower() or "xyz".replace("xyz"[up], "")
    if root in rig.names or not set(letters) <= set("xyz"):
        message = f"no root {root!r} with axes {axes!r} can be added"
        raise OptionError(Fault("SCN020", message, hint="the name must be new"))
    places, turns, scales = take.motion.dense()
    carried = np.array([axis in letters for axis in "xyz"])
    slide = np.where(carried, places[:, :1], 0.0)
    turn = np.tile(so3.IDENTITY, (len(turns), 1, 1))
    if yaw:
        whole = so3.multiply(turns[:, :1], so3.conjugate(rig.rest_rotations[0]))
        turn = so3.normalize(whole * np.where(np.isin(np.arange(4), [up, 3]), 1, 0))
    undo = so3.conjugate(turn)
    places[:, :1] = so3.rotate(undo, places[:, :1] - slide)
    turns[:, :1] = so3.multiply(undo, turns[:, :1])
    joints = tuple(
        replace(j, parent=j.parent + 1 if j.parent >= 0 else (0 if i == 0 else -1))
        for i, j in enumerate(rig.joints)
    )
    whole_scales = None
    if scales is not None:
        ones = np.ones((len(scales), 1, 3))
        whole_scales = Channel.from_dense(np.concatenate([ones, scales], axis=1))
    motion = replace(
        take.motion,
        translations=Channel.from_dense(np.concatenate([slide, places], axis=1)),
        rotations=Channel.from_dense(np.concatenate([turn, turns], axis=1)),
        scales=whole_scales,
    )
    return _finished(take, (Joint(root, -1), *joints), motion)


def recompose_root(take: Take, root: str = "root") -> Take:
    """Return the take without its first joint, whose motion its children take over.

    Raises:
        OptionError: The first joint has another name, or is scaled (SCN020).
    """
    rig = take.rig
    places, turns, scales = take.motion.dense()
    scaled = scales is not None and bool((scales[:, 0] != 1).any())
    if rig.names[0] != root or len(rig.joints) < 2 or scaled:
        message = f"{root!r} is not the first joint, unscaled and with joints below"
        raise OptionError(Fault("SCN020", message))
    below = rig.parents == 0
    slide, turn = places[:, :1], turns[:, :1]
    places[:, below] = slide + so3.rotate(turn, places[:, below])
    turns[:, below] = so3.multiply(turn, turns[:, below])
    joints = tuple(replace(j, parent=max(-1, j.parent - 1)) for j in rig.joints[1:])
    motion = replace(
        take.motion,
        translations=Channel.from_dense(places[:, 1:]),
        rotations=Channel.from_dense(turns[:, 1:]),
        scales=None if scales is None else Channel.from_dense(scales[:, 1:]),
    )
    return _finished(take, joints, motion)


def _finished(take: Take, joints: tuple[Joint, ...], motion: Motion) -> Take:
    return replace(
        take, rig=replace(take.rig, joints=joints), motion=continuous(motion)
    )


def _run(take: Take, options: RootMotionOptions, _: PassContext) -> Take:
    if options.mode is RootMode.RECOMPOSE:
        return recompose_root(take, options.root)
    return extract_root(take, options.root, options.axes, yaw=options.yaw)


PASS = Pass(
    "root_motion", "Move travel to a root joint", RootMotionOptions, Scope.CLIP, _run
)

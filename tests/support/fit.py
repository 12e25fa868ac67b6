"""One rig with other rest poses, and with other joint frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from animtool.maths import so3
from animtool.rig.kinematics import rest_world
from animtool.rig.skeleton import Rig

__all__ = ["along_x", "below", "bent", "with_rest"]


def with_rest(
    rig: Rig,
    rotations: npt.NDArray[np.float64],
    translations: npt.NDArray[np.float64] | None = None,
) -> Rig:
    """Return a rig with another rest pose."""
    places = rig.rest_translations if translations is None else translations
    joints = zip(rig.joints, places.tolist(), rotations.tolist(), strict=True)
    return replace(
        rig,
        joints=tuple(
            replace(j, translation=tuple(t), rotation=tuple(r)) for j, t, r in joints
        ),
    )


def below(rig: Rig, joint: int) -> list[int]:
    """Return a joint and all below it."""
    found = {joint}
    for i, parent in enumerate(rig.parents.tolist()):
        if parent in found:
            found.add(i)
    return sorted(found)


def bent(rig: Rig, name: str, turn: npt.NDArray[np.float64]) -> Rig:
    """Return a rig whose joints below one rest turned, as BVH writes: in offsets."""
    moved, chosen = rig.rest_translations.copy(), below(rig, rig.index(name))
    moved[chosen] = so3.rotate(turn, moved[chosen])
    return with_rest(rig, rig.rest_rotations, moved)


def along_x(rig: Rig) -> Rig:
    """Return a rig in the same pose, the x axis of each joint along its first bone."""
    world = rest_world(rig)
    frames = world.rotations[0].copy()
    for i in range(len(rig.joints)):
        children = np.flatnonzero(rig.parents == i)
        bone = np.array([0.0, 0.0, 0.0])
        if len(children):
            bone = world.positions[0, children[0]] - world.positions[0, i]
        length = float(np.linalg.norm(bone))
        if length > 0:
            axis = np.cross([1.0, 0, 0], bone / length)
            angle = float(np.arctan2(np.linalg.norm(axis), bone[0] / length))
            axis = axis if axis.any() else np.array([0.0, 0.0, 1.0])
            frames[i] = so3.from_axis_angle(axis / np.linalg.norm(axis), angle)
    parents = np.where(rig.parents < 0, 0, rig.parents)
    above = np.where((rig.parents < 0)[:, None], so3.IDENTITY, frames[parents])
    start = np.where((rig.parents < 0)[:, None], 0.0, world.positions[0, parents])
    offsets = so3.rotate(so3.conjugate(above), world.positions[0] - start)
    return with_rest(rig, so3.multiply(so3.conjugate(above), frames), offsets)

"""Chains of joints that point where they were moved, and colliders of joints."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.maths import so3
from animtool.rig.kinematics import WorldTransforms, bind_world
from animtool.rig.limits import BallLimit, RangeLimit
from animtool.rig.skeleton import Joint, JointType, Rig
from animtool.sim.colliders import Capsule, Collider, Colliders
from animtool.sim.colliders.on_joints import Capsules
from animtool.systems.framework.meter import ClosedSurface, closed_surfaces, depths_of
from animtool.systems.springs.contacts import (
    CellColliders,
    Cells,
    PosedColliders,
    cell_colliders,
)

# Bones shorter than this [m] point nowhere.
SHORTEST = 1e-9
# A particle that begins inside a collider is moved out at this speed [m/s].
DEPENETRATION = 1.0
# What is deeper than this after every push [m] is left inside.
UNRESOLVED = 1e-3


def shortest_rotations(before: FloatArray, after: FloatArray) -> FloatArray:
    """Return the shortest rotations ``(F, 4)`` from directions to others ``(F, 3)``.

    Identity where either has no length; half a turn about some axis across where they
    are opposed.

    >>> least_turns(np.array([[1.0, 0, 0]]), np.array([[2.0, 0, 0]])).tolist()
    [[0.0, 0.0, 0.0, 1.0]]
    """
    lengths = [np.linalg.norm(part, axis=-1, keepdims=True) for part in (before, after)]
    solid = (lengths[0] > SHORTEST) & (lengths[1] > SHORTEST)
    a = before / np.where(solid, lengths[0], 1.0)
    b = after / np.where(solid, lengths[1], 1.0)
    dots = (a * b).sum(axis=-1, keepdims=True)
    across = np.cross(a, b)
    rotations = so3.normalize(np.concatenate([across, 1.0 + dots], axis=-1))
    opposed = solid[:, 0] & (dots[:, 0] < -1 + 1e-12)
    if opposed.any():
        least = np.eye(3)[np.abs(a[opposed]).argmin(axis=-1)]
        axes = np.cross(a[opposed], least)
        axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
        rotations[opposed] = np.concatenate([axes, np.zeros((len(axes), 1))], axis=-1)
    return np.where(solid, rotations, so3.IDENTITY)


def chain_rotations(
    rig: Rig,
    joints: IntArray,
    rotations: FloatArray,
    animated: FloatArray,
    moved: FloatArray,
) -> FloatArray:
    """Return local rotations ``(F, C, 4)`` that point a chain's bones where they moved.

    Each joint is carried along by those above it, and then turned by the least turn
    that points its bone: it does not twist. Joints stay within their limits: a pin
    keeps to its axis, and the bones below go on from where that leaves it. Under
    scales that differ by axis, directions hold only roughly. Rotations are those of all
    joints as animated ``(F, J, 4)``; ends of bones ``(F, C + 1, 3)`` [m].
    """
    world = _above(rig, int(joints[0]), rotations)
    inherited = np.tile(so3.IDENTITY, (len(rotations), 1))
    result = np.zeros((len(rotations), len(joints), 4))
    for k, joint in enumerate(joints.tolist()):
        source = rotations[:, joint]
        parent = so3.multiply(inherited, world)
        bone = animated[:, k + 1] - animated[:, k]
        swing = shortest_rotations(
            so3.rotate(inherited, bone), moved[:, k + 1] - moved[:, k]
        )
        goal = so3.multiply(swing, so3.multiply(parent, source))
        local = so3.normalize(so3.multiply(so3.conjugate(parent), goal))
        result[:, k] = _allowed(rig.joints[joint], local, source)
        world = so3.multiply(world, source)
        # What the joints so far have turned the animation by, in the world.
        inherited = so3.multiply(
            so3.multiply(parent, result[:, k]), so3.conjugate(world)
        )
    return result


def _above(rig: Rig, joint: int, rotations: FloatArray) -> FloatArray:
    """Return the rotation of what carries a joint, in the world ``(F, 4)``."""
    rotation = np.tile(so3.IDENTITY, (len(rotations), 1))
    parent = rig.joints[joint].parent
    while parent >= 0:
        rotation = so3.multiply(rotations[:, parent], rotation)
        parent = rig.joints[parent].parent
    return rotation


def _allowed(joint: Joint, local: FloatArray, fallback: FloatArray) -> FloatArray:
    """Return rotations that a joint can have ``(F, 4)``; its own where it has none."""
    rest = np.array(joint.rotation)
    motion = so3.multiply(so3.conjugate(rest), local)
    if joint.type is JointType.PIN:
        along = (motion[:, :3] * np.array(joint.axis)).sum(axis=-1)
        angle = 2 * np.arctan2(along, motion[:, 3])
        angle = np.remainder(angle + np.pi, 2 * np.pi) - np.pi
        if isinstance(joint.limits, RangeLimit):
            angle = joint.limits.clamped(angle)
        return so3.multiply(rest, so3.from_axis_angle(joint.axis, angle))
    if joint.type in {JointType.FIXED, JointType.PRISMATIC}:
        return fallback
    if isinstance(joint.limits, BallLimit):
        return so3.multiply(rest, joint.limits.clamped(motion))
    return local


def depth(
    points: FloatArray, ends: FloatArray, radius: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return how far points ``(N, 3)`` are outside a capsule ``(N,)`` [m], and where.

    That is the way out ``(N, 3)``, none of a point on the axis, and the share of the
    axis ``(N,)`` [1]. Its ends are ``(2, 3)`` [m]; distances are negative inside.
    """
    axis = ends[1] - ends[0]
    square = float((axis * axis).sum())
    away = points - ends[0]
    fractions = np.zeros(len(points))
    if square > 0:
        fractions = np.clip((away * axis).sum(axis=1) / square, 0.0, 1.0)
    radial = away - fractions[:, None] * axis
    length = np.sqrt((radial * radial).sum(axis=1))[:, None]
    out = np.divide(radial, length, out=np.zeros_like(radial), where=length > 0)
    return length[:, 0] - radius, out, fractions


def depth_at_bind(
    capsules: Capsules, rig: Rig, points: FloatArray, margin: float
) -> FloatArray:
    """Return how deep points are in capsules at bind ``(C, N)`` [m], at most 0.

    Capsules are thicker than the body here and there, and what lies on the body is in
    them from the start: there they let it be.
    """
    placed = capsules.placed(bind_world(rig))[0]
    depths = np.zeros((len(capsules), len(points)))
    for c, radius in enumerate((capsules.radii + margin).tolist()):
        depths[c] = np.minimum(depth(points, placed[c], radius)[0], 0.0)
    return depths


class CharacterColliders:
    """Capsules and skins of a character, and what of the world is met with them."""

    def __init__(
        self,
        capsules: Capsules,
        radii: FloatArray,
        depths: tuple[FloatArray, Sequence[FloatArray]],
        radius: float,
        friction: float,
        world: Colliders | None = None,
    ) -> None:
        """Make what does not change from frame to frame.

        Radii ``(C,)`` [m] are in the size of the character; depths, at most 0, are how
        deep particles may be in capsules ``(C, N)``, and in each skin ``(N,)`` [m].
        """
        self._capsules, self._radius = capsules, radius
        self._world = world = Colliders(()) if world is None else world
        like = Collider(
            Capsule(1.0, 0.0), friction=friction, depenetration=DEPENETRATION
        )
        every = [*world, *([like] * len(capsules))]
        self._colliders = Colliders(every, world.sheets, world.bodies)
        first = len(world)
        self._sizes = self._colliders.arrays(0.0, 0.0)[1][first : len(every)].copy()
        self._sizes[:, 6] = radii
        self._allowed, skins = depths
        rigid = np.zeros((self._colliders.rigid, self._allowed.shape[1]))
        rigid[first : len(every)] = self._allowed
        self._depths = np.concatenate([rigid, *(one[None] for one in skins)])

    def depths(
        self, world: WorldTransforms, points: FloatArray, t: float
    ) -> FloatArray:
        """Return how much deeper than they may be points are at the last pose ``(N,)``.

        In the collider that they are deepest in, as that is at a time [s] [m]; below 0
        outside of all.
        """
        deepest = depths_of(self._world, points, t)
        radii, allowed = self._sizes[:, 6], self._allowed + self._radius
        for c, ends in enumerate(self._capsules.placed(world)[-1]):
            inside = np.minimum(allowed[c], 0.0) - depth(points, ends, radii[c])[0]
            np.maximum(deepest, inside, out=deepest)
        return deepest

    def solids(self, t: float) -> list[ClosedSurface]:
        """Return the closed surfaces of the world at a time [s]."""
        return closed_surfaces(self._world, t)

    def over(
        self, world: WorldTransforms, cells: Cells, skins: Sequence[Any] = ()
    ) -> CellColliders:
        """Return what kernels take for the cells between K poses; None without any.

        With it skins in motion, as kernels take these.
        """
        rows, ends = self._capsules.turned(world)
        sizes = self._sizes.copy()
        sizes[:, :6] = ends.reshape(-1, 6)
        poses = np.stack([rows[:-1], rows[1:]], axis=2)
        posed = PosedColliders(sizes, poses, self._depths, skins, UNRESOLVED)
        return cell_colliders(self._colliders, self._radius, cells, posed)

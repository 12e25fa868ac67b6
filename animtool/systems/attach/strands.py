"""Rotations of simulated joint chains, and colliders of joints."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.maths import so3
from animtool.rig.kinematics import WorldTransforms, bind_world
from animtool.rig.limits import BallLimit, RangeLimit
from animtool.rig.skeleton import Joint, JointType, Rig
from animtool.sim.colliders import Capsule, Collider, Colliders, Sheet
from animtool.sim.colliders.on_joints import JointCapsules
from animtool.systems.framework.meter import (
    ClosedSurface,
    closed_surfaces,
    collider_depths,
)
from animtool.systems.springs.contacts import (
    CellColliders,
    Cells,
    PosedColliders,
    cell_colliders,
)

# Bones shorter than this have no direction [m].
MIN_BONE_LENGTH = 1e-9
# Speed at which particles that start inside a collider are moved out [m/s].
DEPENETRATION_SPEED = 1.0
# Particles that stay deeper than this count as unresolved [m].
UNRESOLVED_DEPTH = 1e-3


def shortest_rotations(before: FloatArray, after: FloatArray) -> FloatArray:
    """Return the shortest rotations from directions to other directions ``(F, 4)``.

    Directions are ``(F, 3)``.
    Identity if either has no length; 180° about a perpendicular axis if they are
    opposite.

    >>> shortest_rotations(np.array([[1.0, 0, 0]]), np.array([[2.0, 0, 0]])).tolist()
    [[0.0, 0.0, 0.0, 1.0]]
    """
    lengths = [
        np.linalg.norm(vectors, axis=-1, keepdims=True) for vectors in (before, after)
    ]
    has_length = (lengths[0] > MIN_BONE_LENGTH) & (lengths[1] > MIN_BONE_LENGTH)
    a = before / np.where(has_length, lengths[0], 1.0)
    b = after / np.where(has_length, lengths[1], 1.0)
    dots = (a * b).sum(axis=-1, keepdims=True)
    cross = np.cross(a, b)
    rotations = so3.normalize(np.concatenate([cross, 1.0 + dots], axis=-1))
    is_opposite = has_length[:, 0] & (dots[:, 0] < -1 + 1e-12)
    if is_opposite.any():
        smallest_axes = np.eye(3)[np.abs(a[is_opposite]).argmin(axis=-1)]
        axes = np.cross(a[is_opposite], smallest_axes)
        axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
        rotations[is_opposite] = np.concatenate(
            [axes, np.zeros((len(axes), 1))], axis=-1
        )
    return np.where(has_length, rotations, so3.IDENTITY)


def chain_rotations(
    rig: Rig,
    joints: IntArray,
    rotations: FloatArray,
    animated: FloatArray,
    simulated: FloatArray,
) -> FloatArray:
    """Return local rotations ``(F, C, 4)`` that align bones with simulated points.

    Each joint inherits the rotation of its parents and gets the shortest rotation
    that aligns its bone, without twist. Joint limits apply: a pin keeps its axis, and
    the bones below continue from there. With non-uniform scales, directions are
    approximate. Rotations of all animated joints are ``(F, J, 4)``; bone ends are
    ``(F, C + 1, 3)`` [m].
    """
    world = _parent_rotations(rig, int(joints[0]), rotations)
    relative_rotation = np.tile(so3.IDENTITY, (len(rotations), 1))
    result = np.zeros((len(rotations), len(joints), 4))
    for k, joint in enumerate(joints.tolist()):
        animated_local = rotations[:, joint]
        parent = so3.multiply(relative_rotation, world)
        animated_bone = animated[:, k + 1] - animated[:, k]
        swing = shortest_rotations(
            so3.rotate(relative_rotation, animated_bone),
            simulated[:, k + 1] - simulated[:, k],
        )
        goal_rotation = so3.multiply(swing, so3.multiply(parent, animated_local))
        local = so3.normalize(so3.multiply(so3.conjugate(parent), goal_rotation))
        result[:, k] = _clamp_to_limits(rig.joints[joint], local, animated_local)
        world = so3.multiply(world, animated_local)
        # World rotation of the joints so far relative to the animation.
        relative_rotation = so3.multiply(
            so3.multiply(parent, result[:, k]), so3.conjugate(world)
        )
    return result


def _parent_rotations(rig: Rig, joint: int, rotations: FloatArray) -> FloatArray:
    """Return the world rotations of a joint's parent ``(F, 4)``."""
    rotation = np.tile(so3.IDENTITY, (len(rotations), 1))
    parent = rig.joints[joint].parent
    while parent >= 0:
        rotation = so3.multiply(rotations[:, parent], rotation)
        parent = rig.joints[parent].parent
    return rotation


def _clamp_to_limits(
    joint: Joint, local: FloatArray, fallback: FloatArray
) -> FloatArray:
    """Return rotations clamped to joint limits ``(F, 4)``; ``fallback`` if fixed."""
    rest_rotation = np.array(joint.rotation)
    rotation = so3.multiply(so3.conjugate(rest_rotation), local)
    if joint.type is JointType.PIN:
        projection = (rotation[:, :3] * np.array(joint.axis)).sum(axis=-1)
        angle = 2 * np.arctan2(projection, rotation[:, 3])
        angle = np.remainder(angle + np.pi, 2 * np.pi) - np.pi
        if isinstance(joint.limits, RangeLimit):
            angle = joint.limits.clamped(angle)
        return so3.multiply(rest_rotation, so3.from_axis_angle(joint.axis, angle))
    if joint.type in {JointType.FIXED, JointType.PRISMATIC}:
        return fallback
    if isinstance(joint.limits, BallLimit):
        return so3.multiply(rest_rotation, joint.limits.clamped(rotation))
    return local


def capsule_distances(
    points: FloatArray, ends: FloatArray, radius: float
) -> FloatArray:
    """Return signed distances of points ``(N, 3)`` from a capsule ``(N,)`` [m].

    The ends of the capsule are ``(2, 3)`` [m].
    """
    axis = ends[1] - ends[0]
    square = float((axis * axis).sum())
    offsets = points - ends[0]
    fractions = np.zeros(len(points))
    if square > 0:
        fractions = np.clip((offsets * axis).sum(axis=1) / square, 0.0, 1.0)
    radial = offsets - fractions[:, None] * axis
    return np.asarray(np.sqrt((radial * radial).sum(axis=1)) - radius)


def bind_depths(
    capsules: JointCapsules, rig: Rig, points: FloatArray, margin: float
) -> FloatArray:
    """Return signed distances of points from capsules at bind ``(C, N)`` [m].

    Distances are at most 0.
    Capsules may be thicker than the body, so that points on the body start inside. They
    may stay that deep.
    """
    bind_ends = capsules.world_ends(bind_world(rig))[0]
    depths = np.zeros((len(capsules), len(points)))
    for c, radius in enumerate((capsules.radii + margin).tolist()):
        depths[c] = np.minimum(capsule_distances(points, bind_ends[c], radius), 0.0)
    return depths


class CharacterColliders:
    """Capsules and skins of a character, together with colliders of the world."""

    def __init__(
        self,
        capsules: JointCapsules,
        radii: FloatArray,
        depths: tuple[FloatArray, Sequence[FloatArray]],
        radius: float,
        friction: float,
        world: Colliders | None = None,
        layers: Sequence[Sheet] = (),
    ) -> None:
        """Set up the constants of all frames.

        Radii ``(C,)`` [m] have the scale of the character. Depths, at most 0, are the
        allowed signed distances from capsules ``(C, N)`` and each skin ``(N,)`` [m].
        Layers are cloth of other attachments.
        """
        self._capsules, self._radius = capsules, radius
        self._world = world = Colliders(()) if world is None else world
        capsule_collider = Collider(
            Capsule(1.0, 0.0), friction=friction, depenetration=DEPENETRATION_SPEED
        )
        rigid_colliders = [*world, *([capsule_collider] * len(capsules))]
        self._colliders = Colliders(
            rigid_colliders, [*world.sheets, *layers], world.bodies
        )
        first_capsule = len(world)
        # First index and count of the character's rigid colliders.
        self.character_range = first_capsule, len(capsules)
        self._sizes = self._colliders.arrays(0.0, 0.0)[1][
            first_capsule : len(rigid_colliders)
        ].copy()
        self._sizes[:, 6] = radii
        self._allowed_depths, skin_depths = depths
        rigid_depths = np.zeros((self._colliders.rigid, self._allowed_depths.shape[1]))
        rigid_depths[first_capsule : len(rigid_colliders)] = self._allowed_depths
        self._depths = np.concatenate(
            [rigid_depths, *(distances[None] for distances in skin_depths)]
        )

    def depths(
        self, world: WorldTransforms, points: FloatArray, t: float
    ) -> FloatArray:
        """Return penetration depths of points beyond the allowed depths ``(N,)`` [m].

        Depths are in the deepest collider at a time [s]; below 0 is outside.
        """
        depths = collider_depths(self._world, points, t)
        radii, allowed_depths = self._sizes[:, 6], self._allowed_depths + self._radius
        for c, ends in enumerate(self._capsules.world_ends(world)[-1]):
            distances = capsule_distances(points, ends, radii[c])
            penetration = np.minimum(allowed_depths[c], 0.0) - distances
            np.maximum(depths, penetration, out=depths)
        return depths

    def solids(self, t: float) -> list[ClosedSurface]:
        """Return the closed surfaces of the world at a time [s]."""
        return closed_surfaces(self._world, t)

    def kernel_arguments(
        self, world: WorldTransforms, cells: Cells, skins: Sequence[Any] = ()
    ) -> CellColliders:
        """Return kernel arguments for the cells between K poses.

        ``skins`` are kernel surfaces in motion. Returns None without any collider.
        """
        rows, ends = self._capsules.joint_poses_and_ends(world)
        sizes = self._sizes.copy()
        sizes[:, :6] = ends.reshape(-1, 6)
        poses = np.stack([rows[:-1], rows[1:]], axis=2)
        posed = PosedColliders(sizes, poses, self._depths, skins, UNRESOLVED_DEPTH)
        return cell_colliders(self._colliders, self._radius, cells, posed)

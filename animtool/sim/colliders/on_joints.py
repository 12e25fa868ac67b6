"""Colliders that a rig's joints carry."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from animtool.core.array_types import ArrayLike, BoolArray, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.rig.kinematics import WorldTransforms
from animtool.rig.skeleton import Rig
from animtool.sim.colliders.collider import Collider, Poses
from animtool.sim.colliders.shapes import Capsule


@dataclass(frozen=True, slots=True, eq=False)
class Capsules:
    """C capsules attached to joints.

    Attributes:
        joints: What carries each ``(C,)``.
        ends: Both ends of their axes, in the frames of the joints ``(C, 2, 3)`` [m].
        radii: ``(C,)`` [m].
    """

    joints: IntArray
    ends: FloatArray
    radii: FloatArray

    @staticmethod
    def of(rig: Rig) -> Capsules:
        """Return the capsules of a rig."""
        ends = []
        for collider in rig.colliders:
            capsule = collider.capsule
            half = np.array(capsule.axis) * (capsule.length / 2)
            ends.append([np.array(capsule.offset) + side * half for side in (-1, 1)])
        return Capsules(
            np.array([rig.index(one.joint) for one in rig.colliders], np.int64),
            np.array(ends, np.float64).reshape(-1, 2, 3),
            np.array([one.capsule.radius for one in rig.colliders], np.float64),
        )

    @staticmethod
    def none() -> Capsules:
        """Return an empty set."""
        return Capsules(np.zeros(0, np.int64), np.zeros((0, 2, 3)), np.zeros(0))

    def select(self, kept: BoolArray) -> Capsules:
        """Return the selected ones ``(C,)``."""
        return Capsules(self.joints[kept], self.ends[kept], self.radii[kept])

    def __len__(self) -> int:
        """Return the number of capsules."""
        return len(self.joints)

    def placed(self, world: WorldTransforms) -> FloatArray:
        """Return both ends in the world ``(K, C, 2, 3)`` [m]."""
        linear = world.linear[:, self.joints]
        turned = (linear[:, :, None] * self.ends[None, :, :, None, :]).sum(axis=-1)
        return np.asarray(turned + world.positions[:, self.joints, None])

    def turned(self, world: WorldTransforms) -> tuple[FloatArray, FloatArray]:
        """Return poses of the joints, and ends scaled as in the first pose.

        Returns:
            Origins and quaternions ``(K, C, 7)``; ends in those frames ``(C, 2, 3)``.
        """
        linear = world.linear[:, self.joints]
        rotations = so3.align_signs(so3.split_scale(linear)[0])
        poses = np.concatenate([world.positions[:, self.joints], rotations], axis=-1)
        ends = (linear[0, :, None] * self.ends[:, :, None]).sum(axis=-1)
        return poses, so3.rotate(so3.conjugate(rotations[0])[:, None], ends)

    def sizes(self, world: WorldTransforms) -> FloatArray:
        """Return the radii in the world ``(C,)`` [m], as the first pose scales them."""
        volumes = np.abs(np.linalg.det(world.linear[0, self.joints]))
        return np.asarray(self.radii * np.cbrt(volumes))


def joint_poses(world: WorldTransforms, joint: int, times: ArrayLike) -> Poses:
    """Return the poses of a joint over time.

    Args:
        world: Of all joints of a rig over F frames.
        joint: Its index.
        times: Of the frames ``(F,)`` [s].
    """
    return Poses(times, world.positions[:, joint], world.rotations[:, joint])


def rig_colliders(
    rig: Rig,
    world: WorldTransforms,
    times: ArrayLike,
    like: Collider | None = None,
) -> list[Collider]:
    """Return the colliders of a moving rig, named after their joints.

    They have the size that the first frame gives them.

    Args:
        rig: Its capsules.
        world: Of its joints over F frames.
        times: Of the frames ``(F,)`` [s].
        like: What touching them does; the usual where None.
    """
    capsules = Capsules.of(rig)
    rows, ends = capsules.turned(world)
    colliders = []
    for c, radius in enumerate(capsules.sizes(world).tolist()):
        entry, (a, b) = rig.colliders[c], ends[c]
        length = float(np.linalg.norm(b - a))
        axis = (b - a) / length if length else entry.capsule.axis
        shape = Capsule(radius, length, tuple(axis), tuple((a + b) / 2))
        poses = Poses(times, rows[:, c, :3], rows[:, c, 3:])
        one = Collider(shape) if like is None else like
        colliders.append(replace(one, shape=shape, poses=poses, name=entry.joint))
    return colliders

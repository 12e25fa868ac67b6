"""Colliders attached to the joints of a rig."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from animtool.core.array_types import ArrayLike, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.maths.rows import Rows
from animtool.rig.kinematics import WorldTransforms
from animtool.rig.skeleton import Rig
from animtool.sim.colliders.collider import Collider, Poses
from animtool.sim.colliders.shapes import Capsule


@dataclass(frozen=True, slots=True, eq=False)
class JointCapsules(Rows):
    """C capsules attached to joints."""

    joints: IntArray  # index of the joint of each capsule (C,)
    ends: FloatArray  # both ends of the axes, in the frames of the joints (C, 2, 3) [m]
    radii: FloatArray  # radii (C,) [m]

    @staticmethod
    def from_rig(rig: Rig) -> JointCapsules:
        """Return the capsules of a rig."""
        joints, ends, radii = [], [], []
        for collider in rig.colliders:
            capsule = collider.capsule
            offset = np.array(capsule.offset)
            half_axis = np.array(capsule.axis) * (capsule.length / 2)
            joints.append(rig.index(collider.joint))
            ends.append([offset - half_axis, offset + half_axis])
            radii.append(capsule.radius)
        return JointCapsules(
            np.array(joints, np.int64),
            np.array(ends, np.float64).reshape(-1, 2, 3),
            np.array(radii, np.float64),
        )

    @staticmethod
    def empty() -> JointCapsules:
        """Return an empty set of capsules."""
        return JointCapsules(np.zeros(0, np.int64), np.zeros((0, 2, 3)), np.zeros(0))

    def __len__(self) -> int:
        """Return the number of capsules."""
        return len(self.joints)

    def world_ends(self, world: WorldTransforms) -> FloatArray:
        """Return both ends of each capsule in world space ``(K, C, 2, 3)`` [m]."""
        linear = world.linear[:, self.joints]
        offsets = (linear[:, :, None] * self.ends[None, :, :, None, :]).sum(axis=-1)
        return np.asarray(offsets + world.positions[:, self.joints, None])

    def joint_poses_and_ends(
        self, world: WorldTransforms
    ) -> tuple[FloatArray, FloatArray]:
        """Return joint poses, and capsule ends at the joint scales of the first frame.

        Returns:
            Origins and quaternions ``(K, C, 7)``; ends in those frames ``(C, 2, 3)``.
        """
        linear = world.linear[:, self.joints]
        rotations = so3.align_signs(so3.split_scale(linear)[0])
        poses = np.concatenate([world.positions[:, self.joints], rotations], axis=-1)
        ends = (linear[0, :, None] * self.ends[:, :, None]).sum(axis=-1)
        return poses, so3.rotate(so3.conjugate(rotations[0])[:, None], ends)

    def world_radii(self, world: WorldTransforms) -> FloatArray:
        """Return world-space radii at the joint scales of the first frame ``(C,)``."""
        volumes = np.abs(np.linalg.det(world.linear[0, self.joints]))
        return np.asarray(self.radii * np.cbrt(volumes))


def joint_poses(world: WorldTransforms, joint: int, times: ArrayLike) -> Poses:
    """Return the poses of a joint over time.

    Args:
        world: World transforms of a rig's joints over F frames.
        joint: Index of the joint.
        times: Times of the frames ``(F,)`` [s].
    """
    return Poses(times, world.positions[:, joint], world.rotations[:, joint])


def rig_colliders(
    rig: Rig, world: WorldTransforms, times: ArrayLike, template: Collider | None = None
) -> list[Collider]:
    """Return the colliders of a moving rig, named after their joints.

    The size of each collider is constant: that of the first frame.

    Args:
        rig: Rig with capsules.
        world: World transforms of the rig's joints over F frames.
        times: Times of the frames ``(F,)`` [s].
        template: Collider that provides the contact material; None for the default.
    """
    capsules = JointCapsules.from_rig(rig)
    capsule_poses, ends = capsules.joint_poses_and_ends(world)
    colliders = []
    for capsule_index, radius in enumerate(capsules.world_radii(world).tolist()):
        rig_collider, (a, b) = rig.colliders[capsule_index], ends[capsule_index]
        length = float(np.linalg.norm(b - a))
        axis = (b - a) / length if length else rig_collider.capsule.axis
        shape = Capsule(radius, length, tuple(axis), tuple((a + b) / 2))
        poses_over_time = capsule_poses[:, capsule_index]
        poses = Poses(times, poses_over_time[:, :3], poses_over_time[:, 3:])
        base = Collider(shape) if template is None else template
        name = rig_collider.joint
        colliders.append(replace(base, shape=shape, poses=poses, name=name))
    return colliders

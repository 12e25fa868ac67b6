"""The capsules of a rig, where its joints take them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from animtool._types import FloatArray, IntArray
from animtool.rig.kinematics import WorldTransforms
from animtool.rig.skeleton import Rig

__all__ = ["Capsules"]


@dataclass(frozen=True, slots=True, eq=False)
class Capsules:
    """C capsules that joints carry.

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
        """Return none."""
        return Capsules(np.zeros(0, np.int64), np.zeros((0, 2, 3)), np.zeros(0))

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self.joints)

    def placed(self, world: WorldTransforms) -> FloatArray:
        """Return both ends in the world ``(K, C, 2, 3)`` [m]."""
        linear = world.linear[:, self.joints]
        turned = (linear[:, :, None] * self.ends[None, :, :, None, :]).sum(axis=-1)
        return np.asarray(turned + world.positions[:, self.joints, None])

    def sizes(self, world: WorldTransforms) -> FloatArray:
        """Return the radii in the world ``(C,)`` [m], as the first pose scales them."""
        volumes = np.abs(np.linalg.det(world.linear[0, self.joints]))
        return np.asarray(self.radii * np.cbrt(volumes))

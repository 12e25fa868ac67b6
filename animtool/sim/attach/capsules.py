"""The capsules of a rig, where its joints take them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from animtool._types import FloatArray, IntArray
from animtool.rig.kinematics import WorldTransforms, bind_world
from animtool.rig.skeleton import Rig

__all__ = ["Capsules", "depth", "depth_at_bind"]


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


def depth(
    points: FloatArray, ends: FloatArray, radius: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return how far points are outside a capsule, the way out, and where on its axis.

    A point on the axis has no way out.

    Args:
        points: ``(N, 3)`` [m].
        ends: Of the axis ``(2, 3)`` [m].
        radius: [m]

    Returns:
        Distances ``(N,)`` [m], negative inside; directions ``(N, 3)``; shares of the
        axis ``(N,)`` [1].
    """
    axis = ends[1] - ends[0]
    square = float((axis * axis).sum())
    away = points - ends[0]
    share = np.zeros(len(points))
    if square > 0:
        share = np.clip((away * axis).sum(axis=1) / square, 0.0, 1.0)
    apart = away - share[:, None] * axis
    length = np.sqrt((apart * apart).sum(axis=1))[:, None]
    out = np.divide(apart, length, out=np.zeros_like(apart), where=length > 0)
    return length[:, 0] - radius, out, share


def depth_at_bind(
    capsules: Capsules, rig: Rig, points: FloatArray, margin: float
) -> FloatArray:
    """Return how deep points are in capsules at bind ``(C, N)`` [m], at most 0.

    Capsules are thicker than the body here and there, and what lies on the body is in
    them from the start: there they let it be.
    """
    placed = capsules.placed(bind_world(rig))[0]
    found = np.zeros((len(capsules), len(points)))
    for c, radius in enumerate((capsules.radii + margin).tolist()):
        found[c] = np.minimum(depth(points, placed[c], radius)[0], 0.0)
    return found

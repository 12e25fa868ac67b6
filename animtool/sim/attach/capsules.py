"""What is attached to a rig meets the capsules of this."""

from __future__ import annotations

from typing import Any

import numpy as np

from animtool._types import FloatArray
from animtool.rig.kinematics import WorldTransforms, bind_world
from animtool.rig.skeleton import Rig
from animtool.sim.colliders import Capsule, Collider, Colliders
from animtool.sim.colliders.on_joints import Capsules

# A particle that begins inside a collider is moved out at this speed [m/s].
DEPENETRATION = 1.0
# What is deeper than this after every push [m] is left inside.
UNRESOLVED = 1e-3


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


class CapsuleContacts:
    """Capsules as kernels meet them, frame by frame."""

    def __init__(
        self,
        capsules: Capsules,
        radii: FloatArray,
        depths: FloatArray,
        radius: float,
        friction: float,
    ) -> None:
        """Make what does not change from frame to frame.

        Args:
            capsules: C of them.
            radii: Theirs, in the size of the character ``(C,)`` [m].
            depths: How deep particles may be in them ``(C, N)`` [m], at most 0.
            radius: Distance kept from them [m].
            friction: Coulomb's coefficient [1].
        """
        self._capsules = capsules
        like = Collider(
            Capsule(1.0, 0.0), friction=friction, depenetration=DEPENETRATION
        )
        kinds, sizes, *others = Colliders([like] * len(capsules)).arrays(0.0, 0.0)
        sizes[:, 6] = radii
        self._kinds, self._sizes, self._others = kinds, sizes, others
        self._rest = radius, depths, UNRESOLVED, ()

    def over(self, world: WorldTransforms) -> tuple[Any, ...] | None:
        """Return what kernels take for the cells between K poses; None without any."""
        if not len(self._capsules):
            return None
        rows, ends = self._capsules.turned(world)
        sizes = self._sizes.copy()
        sizes[:, :6] = ends.reshape(-1, 6)
        poses = np.stack([rows[:-1], rows[1:]], axis=2)
        return (self._kinds, sizes, *self._others), poses, *self._rest

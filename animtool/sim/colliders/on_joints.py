"""Colliders that joints carry."""

from __future__ import annotations

from dataclasses import replace

from animtool._types import ArrayLike
from animtool.rig.kinematics import WorldTransforms
from animtool.rig.skeleton import Rig
from animtool.sim.colliders.collider import Collider
from animtool.sim.colliders.poses import Poses
from animtool.sim.colliders.shapes import Capsule

__all__ = ["joint_poses", "rig_colliders"]


def joint_poses(world: WorldTransforms, joint: int, times: ArrayLike) -> Poses:
    """Return where a joint is over time.

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
    """Return the colliders of a rig in motion, named after their joints.

    Scale of joints is left out.

    Args:
        rig: Its capsules.
        world: Of its joints over F frames.
        times: Of the frames ``(F,)`` [s].
        like: What touching them does; the usual where None.
    """
    indices = {joint.name: i for i, joint in enumerate(rig.joints)}
    made = []
    for entry in rig.colliders:
        given = entry.capsule
        shape = Capsule(given.radius, given.length, given.axis, given.offset)
        poses = joint_poses(world, indices[entry.joint], times)
        one = Collider(shape) if like is None else like
        made.append(replace(one, shape=shape, poses=poses, name=entry.joint))
    return made

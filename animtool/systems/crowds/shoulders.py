"""Shoulder yaw of agents, so that they pass each other in a jam.

Angles are yaws of the shoulder line relative to the heading; positive is to the left.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.systems.crowds.ground import rotations_about_y

if TYPE_CHECKING:
    from animtool.retarget.roled_skeleton import RoledSkeleton

# Largest yaw [rad].
MAX_YAW = 0.9
# Depth of agents relative to their shoulder width.
DEPTH_RATIO = 0.6
# Time constants of yaw, and of its return [s].
YAW_TIME, RETURN_TIME = 0.25, 0.6
# Yaws below this fraction of the largest count as 0.
NEGLIGIBLE_YAW = 0.02


def shoulder_vectors(headings: FloatArray, shoulders: FloatArray) -> FloatArray:
    """Return vectors along the shoulders, with length yaw / `MAX_YAW` ``(N, 2)``.

    Headings and shoulder yaws are ``(N,)`` [rad].
    """
    angles = headings + shoulders
    axes = np.stack([np.cos(angles), -np.sin(angles)], axis=1)
    return np.asarray(axes * (np.abs(shoulders) / MAX_YAW)[:, None])


def step_shoulders(shoulders: FloatArray, targets: FloatArray, dt: float) -> FloatArray:
    """Return shoulder yaws after a step ``(N,)`` [rad].

    ``targets`` ``(N,)`` are relative to the largest yaw; negative is to the right.
    Shoulders that are already rotated keep their sign.
    """
    sign = np.where(shoulders != 0, np.sign(shoulders), np.sign(targets))
    target_yaws = MAX_YAW * sign * np.abs(targets)
    is_growing = np.abs(target_yaws) > np.abs(shoulders)
    time_constant = np.where(is_growing, YAW_TIME, RETURN_TIME)
    next_yaws = shoulders + (target_yaws - shoulders) * -np.expm1(-dt / time_constant)
    has_returned = (targets == 0) & (np.abs(next_yaws) < NEGLIGIBLE_YAW * MAX_YAW)
    return np.where(has_returned, 0.0, next_yaws)


@dataclass(frozen=True)
class Trunk:
    """Joints that rotate the shoulders: spine joints, and opposite neck joints."""

    spine: tuple[int, ...]
    neck: tuple[int, ...]  # neck and head joints

    @staticmethod
    def from_skeleton(skeleton: RoledSkeleton) -> Trunk:
        """Return the trunk of a skeleton; it is not rotated if there is no spine."""
        joints_by_role = {
            role: tuple(
                j for j, joint_role in enumerate(skeleton.roles) if joint_role == role
            )
            for role in ("spine", "neck", "head")
        }
        neck = joints_by_role["neck"] + joints_by_role["head"]
        return Trunk(joints_by_role["spine"], neck)

    @property
    def joints(self) -> IntArray:
        """All joints that the trunk rotates: spine and neck."""
        return np.array([*self.spine, *self.neck], np.int64)

    def rotate_shoulders(
        self, parents: IntArray, rotations: FloatArray, angles: FloatArray
    ) -> None:
        """Rotate the shoulders of poses by angles ``(N,)`` [rad], in place.

        ``rotations`` ``(N, J, 4)`` are local; the head keeps facing forward.
        """
        rotated_agents = np.flatnonzero(angles)
        if not len(rotated_agents) or not self.spine:
            return
        agent_rotations, agent_angles = (
            rotations[rotated_agents],
            angles[rotated_agents],
        )
        joint_fractions = [(j, 1 / len(self.spine)) for j in self.spine]
        joint_fractions += [(j, -1 / len(self.neck)) for j in self.neck]
        for joint, fraction in joint_fractions:
            parent_rotation = np.broadcast_to(so3.IDENTITY, (len(rotated_agents), 4))
            for j in _ancestors(parents, joint):
                parent_rotation = so3.multiply(parent_rotation, agent_rotations[:, j])
            yaw = rotations_about_y(fraction * agent_angles)
            to_parent = so3.conjugate(parent_rotation)
            yaw = so3.multiply(to_parent, so3.multiply(yaw, parent_rotation))
            agent_rotations[:, joint] = so3.multiply(yaw, agent_rotations[:, joint])
        rotations[rotated_agents] = agent_rotations


def _ancestors(parents: IntArray, joint: int) -> list[int]:
    """Return the ancestors of a joint, root first."""
    ancestors: list[int] = []
    while (joint := int(parents[joint])) >= 0:
        ancestors.insert(0, joint)
    return ancestors

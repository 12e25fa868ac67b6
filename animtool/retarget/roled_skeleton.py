"""A skeleton with roles: rest positions and rotations, and its limbs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.retarget.roles import END, TWIST, base_role
from animtool.rig.kinematics import forward_kinematics, rest_world
from animtool.rig.skeleton import Rig

# Bones shorter than this fraction of the skeleton have no direction [1].
MIN_BONE_LENGTH = 1e-4
# Fraction of a leg by which a foot is below the hip if the skeleton stands at rest [1].
MIN_LEG_DROP = 0.7
# Heights of hands that are on the ground, and that hang or are stretched out, in
# heights of the hips. Quadrupeds have at most 0.1, bipeds with hanging arms 0.87.
LOW_HAND_HEIGHT, HIGH_HAND_HEIGHT = 0.35, 0.6
# Role at the end of each role's bone.
_NEXT_ROLES = {
    "upper_arm": "forearm",
    "forearm": "hand",
    "thigh": "shin",
    "shin": "foot",
    "hand": "middle_1",
}


@dataclass(frozen=True, slots=True)
class Ball:
    """The point that a foot rolls over."""

    toe: int  # index of the first joint of that toe; -1 for none
    offset: FloatArray  # vector from the ankle in the foot's frame (3,) [m]


@dataclass(frozen=True, slots=True)
class RoledSkeleton:
    """A skeleton at rest, with the role of each joint."""

    rig: Rig
    roles: tuple[str, ...]  # role of each joint (J,)
    positions: FloatArray  # world positions at rest (J, 3) [m]
    rotations: FloatArray  # world rotations at rest (J, 4)
    # Balls of the feet by side, for a pair of skeletons.
    balls: Mapping[str, Ball] = field(default_factory=dict)

    @staticmethod
    def of(
        rig: Rig, roles: tuple[str, ...], pose: FloatArray | None = None
    ) -> RoledSkeleton:
        """Return the skeleton of a rig at rest, or posed by rotations ``(J, 4)``."""
        rest = rest_world(rig)
        if pose is not None:
            rest = forward_kinematics(rig, rig.rest_translations[None], pose[None])
        return RoledSkeleton(rig, roles, rest.positions[0], rest.rotations[0])

    def last_joint(self, role: str) -> int:
        """Return the last joint of a role; -1 if there is none."""
        joints = [j for j, joint_role in enumerate(self.roles) if joint_role == role]
        return max(joints, default=-1)

    def first_joint(self, role: str) -> int:
        """Return the first joint of a role; -1 if there is none."""
        return self.roles.index(role) if role in self.roles else -1

    def children_with_role(self, joint: int) -> list[int]:
        """Return the children of a joint that have a role in the body."""
        children = [k for k, parent in enumerate(self.rig.parents) if parent == joint]
        return [k for k in children if self.roles[k] not in {"", TWIST, END}]

    def bone_direction(self, joint: int) -> FloatArray | None:
        """Return the rest direction of a joint's bone, a unit vector ``(3,)``.

        Return None for a joint without a bone.
        """
        end_joint, role = -1, self.roles[joint]
        side_suffix, role_without_side = role[len(base_role(role)) :], base_role(role)
        if role_without_side in _NEXT_ROLES:
            end_joint = self.first_joint(_NEXT_ROLES[role_without_side] + side_suffix)
        if end_joint < 0:
            children = [k for k, p in enumerate(self.rig.parents) if p == joint]
            end_joint = children[0] if len(children) == 1 else -1
        ball = self.balls.get(role[-1:]) if role_without_side == "foot" else None
        if end_joint < 0 and ball is not None:
            bone = so3.rotate(self.rotations[joint], ball.offset)
            return np.asarray(bone / np.linalg.norm(bone))
        if end_joint < 0 or not self.are_distinct(joint, end_joint):
            return None
        bone = self.positions[end_joint] - self.positions[joint]
        return np.asarray(bone / np.linalg.norm(bone))

    def offset(self, joint: int, lower_joint: int) -> FloatArray:
        """Return the rest vector to a lower joint in a joint's frame ``(3,)`` [m]."""
        offset = self.positions[lower_joint] - self.positions[joint]
        return so3.rotate(so3.conjugate(self.rotations[joint]), offset)

    def are_distinct(self, joint: int, other_joint: int) -> bool:
        """Return whether two joints are at distinct positions at rest."""
        offset = self.positions[other_joint] - self.positions[joint]
        return float(np.linalg.norm(offset)) > MIN_BONE_LENGTH * self.size

    def stands_on_hands(self) -> bool | None:
        """Return whether the hands are on the ground at rest; None if unclear."""
        limb_joints = [
            [self.last_joint(f"{role}_{side}") for side in "lr"]
            for role in ("thigh", "foot", "hand")
        ]
        if min(map(min, limb_joints)) < 0:
            return None
        heights = self.positions @ self.rig.up.vector
        hips, feet, hands = (heights[joints] for joints in limb_joints)
        hip_drop, lengths = float(hips.min() - feet.max()), self.chain_lengths
        leg_lengths = lengths[limb_joints[1]] - lengths[limb_joints[0]]
        if hip_drop < MIN_LEG_DROP * float(leg_lengths.min()):
            return None
        tiny = np.finfo(float).tiny
        hand_height = float(hands.min() - feet.min()) / max(hip_drop, tiny)
        if LOW_HAND_HEIGHT < hand_height < HIGH_HAND_HEIGHT:
            return None
        return hand_height <= LOW_HAND_HEIGHT

    @property
    def size(self) -> float:
        """Longest edge of the bounding box of the joints at rest [m]."""
        return float(np.ptp(self.positions, axis=0).max())

    @property
    def chain_lengths(self) -> FloatArray:
        """Rest length of the chain from the hips to each joint ``(J,)`` [m]."""
        lengths = np.zeros(len(self.rig.joints))
        hips = self.first_joint("hips")
        for j, parent in enumerate(self.rig.parents.tolist()):
            if parent >= 0 and j != hips:
                bone = self.positions[j] - self.positions[parent]
                lengths[j] = lengths[parent] + np.linalg.norm(bone)
        return lengths

    @property
    def facing_axes(self) -> FloatArray | None:
        """Left, up and forward axes of the upright body as rows ``(3, 3)``, or None."""
        directions = []
        for pair in (("thigh_l", "thigh_r"), ("upper_arm_l", "upper_arm_r")):
            left_side, right_side = map(self.first_joint, pair)
            if left_side >= 0 and right_side >= 0:
                left, right = self.positions[left_side], self.positions[right_side]
                directions.append(left - right)
        hips, head = self.first_joint("hips"), self.first_joint("head")
        head = head if head >= 0 else self.last_joint("spine")
        if not directions or hips < 0 or head < 0:
            return None
        left_axis = directions[0] / (np.linalg.norm(directions[0]) or 1.0)
        up = self.positions[head] - self.positions[hips]
        up = up - (up @ left_axis) * left_axis
        height = float(np.linalg.norm(up))
        if not np.linalg.norm(directions[0]) or height <= MIN_BONE_LENGTH * self.size:
            return None
        return np.stack([left_axis, up / height, np.cross(left_axis, up / height)])

    def leg(self, side: str) -> tuple[int, int, int, int] | None:
        """Return thigh, shin, foot and toe (-1 for none) of a side, if it has a leg."""
        thigh, shin, foot = (
            self.first_joint(f"{role}_{side}") for role in ("thigh", "shin", "foot")
        )
        toe = self.first_joint(f"toe_{side}")
        return None if min(thigh, shin, foot) < 0 else (thigh, shin, foot, toe)

    def leg_length(self, side: str) -> float:
        """Return the length of thigh and shin [m]."""
        leg = self.leg(side)
        if leg is None:
            return 0.0
        points = self.positions[list(leg[:3])]
        return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())

    def leg_bone_lengths(self, side: str) -> FloatArray:
        """Return the lengths of thigh, shin and, if known, foot ``(2 or 3,)`` [m]."""
        leg = self.leg(side)
        assert leg is not None
        points = self.positions[list(leg[:3])]
        bones = np.linalg.norm(np.diff(points, axis=0), axis=1)
        if side in self.balls:
            bones = np.append(bones, np.linalg.norm(self.balls[side].offset))
        return np.asarray(bones)

"""Transfer of poses between skeletons: world rotations and root motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.core.units import up_from_up
from animtool.maths import so3
from animtool.retarget.balls import find_balls
from animtool.retarget.map import JointMap
from animtool.retarget.roled_skeleton import MIN_BONE_LENGTH, RoledSkeleton
from animtool.retarget.roles import base_role
from animtool.retarget.standing import MIN_STANDING_COSINE
from animtool.rig.skeleton import Rig

# Roles whose bones point along the source's bones, whatever their rest pose.
_AIMED_ROLES = {"upper_arm", "forearm", "hand", "thigh", "shin"}
# Deviations from rest below this fraction of the skeleton are rounding [1].
MIN_DEVIATION = 1e-9
# Bones whose lengths differ by less than this fraction of the leg are equal [1].
LENGTH_TOLERANCE = 1e-6


@dataclass(frozen=True, slots=True)
class Transfer:
    """Maps poses of a source skeleton to a target: joints, rest alignment and scale."""

    source: RoledSkeleton
    target: RoledSkeleton
    # Rotation from the source's up axis to the target's (4,).
    up_rotation: FloatArray
    # Length ratio of the target to the source.
    scale: float
    # For each target joint (K,): the source joint that it follows, -1 for none; the
    # next one in its chain, and the weight of that.
    source_joints: IntArray
    next_source_joints: IntArray
    next_weights: FloatArray
    # World rotations of the target at the source's rest pose (K, 4).
    rest_alignment: FloatArray
    # Target joint that takes a fraction of a bone's twist, the next joint with a role
    # below that bone, and the fraction.
    twists: Sequence[tuple[int, int, float]] = ()

    @staticmethod
    def of(
        source: RoledSkeleton,
        target: RoledSkeleton,
        joint_map: JointMap,
        *,
        has_same_rest: bool = False,
    ) -> Transfer:
        """Build the transfer between two skeletons from a joint map.

        ``has_same_rest``: whether the source's rest pose equals the target's.
        """
        balls = find_balls(source, target), find_balls(target, source)
        source = replace(source, balls=balls[0])
        target = replace(target, balls=balls[1])
        rotation = up_from_up(target.rig.up, source.rig.up)
        up_rotation = so3.IDENTITY if rotation is None else np.array(rotation)
        joint_count = len(target.rig.joints)
        source_joints, next_source_joints = np.full((2, joint_count), -1)
        next_weights = np.zeros(joint_count)
        for pair in joint_map.pairs:
            source_joints[pair.target] = next_source_joints[pair.target] = pair.source
        for chain in joint_map.chains:
            if len(chain.source) == len(chain.target):
                for joint, source_joint in zip(chain.target, chain.source, strict=True):
                    source_joints[joint] = next_source_joints[joint] = source_joint
                continue
            middles = _fraction_middles(chain.source_fractions)
            for joint, position in zip(
                chain.target, _fraction_middles(chain.target_fractions), strict=True
            ):
                k = int(np.searchsorted(middles, position))
                lower_index, upper_index = max(k - 1, 0), min(k, len(middles) - 1)
                spacing = middles[upper_index] - middles[lower_index]
                source_joints[joint] = chain.source[lower_index]
                next_source_joints[joint] = chain.source[upper_index]
                if spacing > 0:
                    next_weights[joint] = (position - middles[lower_index]) / spacing
        for joint, source_joint in equal_name_pairs(
            source.rig, target.rig, source_joints
        ):
            source_joints[joint] = next_source_joints[joint] = source_joint
        rest_alignment = _rest_alignment(
            source, target, source_joints, up_rotation, has_same_rest=has_same_rest
        )
        twists = []
        for twist in joint_map.twists:
            # The next joint below with a role twists the bone.
            next_joints = target.children_with_role(twist.bone)
            if next_joints:
                twists.append((twist.target, next_joints[0], twist.fraction))
        scale = _leg_ratio(source, target, source_joints)
        joints = source_joints, next_source_joints, next_weights
        return Transfer(
            source, target, up_rotation, scale, *joints, rest_alignment, twists
        )

    @property
    def has_similar_legs(self) -> bool:
        """Whether legs and feet of both skeletons are the same up to scale."""
        leg_sides = [s for s in "lr" if self.target.leg(s) and self.source.leg(s)]
        skeletons = self.target, self.source
        for side in leg_sides:
            balls = [skeleton.balls.get(side) for skeleton in skeletons]
            # Feet with other toes roll differently, even if they are equally long.
            if len({ball is not None and ball.toe >= 0 for ball in balls}) > 1:
                return False
            bones = [skeleton.leg_bone_lengths(side) for skeleton in skeletons]
            if len(bones[0]) != len(bones[1]):
                return False
            length_errors = np.abs(bones[0] - self.scale * bones[1])
            if (length_errors > LENGTH_TOLERANCE * bones[0].sum()).any():
                return False
        return bool(leg_sides)

    def rotations(self, source_rotations: FloatArray) -> FloatArray:
        """Return world rotations of the target ``(F, K, 4)``.

        They follow world rotations of the source ``(F, J, 4)``. Joints that follow no
        source joint move with their parents.
        """
        rig = self.target.rig
        rotations_from_rest = so3.multiply(
            source_rotations, so3.conjugate(self.source.rotations)
        )
        if (self.up_rotation != so3.IDENTITY).any():
            rotations_from_rest = so3.multiply(self.up_rotation, rotations_from_rest)
            inverse = so3.conjugate(self.up_rotation)
            rotations_from_rest = so3.multiply(rotations_from_rest, inverse)
        world_rotations = np.zeros((len(source_rotations), len(rig.joints), 4))
        for j, parent in enumerate(rig.parents.tolist()):
            source_joint = self.source_joints[j]
            if source_joint < 0:
                rest_rotation = rig.rest_rotations[j]
                parent_rotations = (
                    world_rotations[:, parent] if parent >= 0 else so3.IDENTITY
                )
                world_rotations[:, j] = so3.multiply(parent_rotations, rest_rotation)
                continue
            rotation = rotations_from_rest[:, source_joint]
            if self.next_source_joints[j] != source_joint:
                fraction = np.full(len(source_rotations), self.next_weights[j])
                next_rotation = rotations_from_rest[:, self.next_source_joints[j]]
                rotation = so3.slerp(rotation, next_rotation, fraction)
            world_rotations[:, j] = so3.multiply(rotation, self.rest_alignment[j])
        return world_rotations

    def bones(
        self,
        source_rotations: FloatArray,
        translations: FloatArray,
        rotations: FloatArray,
    ) -> FloatArray:
        """Return local translations of the target ``(F, K, 3)`` [m].

        They are the rest translations plus the scaled deviations of the source from its
        rest; ``(1, K, 3)`` without deviations. ``source_rotations`` ``(F, J, 4)`` and
        ``translations`` ``(F, J, 3)`` [m] are world rotations and local translations of
        the source, ``rotations`` ``(F, K, 4)`` world rotations of the target.
        """
        source_rig, target_rig = self.source.rig, self.target.rig
        deviations = translations - source_rig.rest_translations
        largest_deviations = np.abs(deviations).max(axis=(0, 2))
        is_moving = largest_deviations > MIN_DEVIATION * self.source.size
        local_translations = target_rig.rest_translations[None]
        hips = self.target.first_joint("hips")
        for joint, source_joint in enumerate(self.source_joints.tolist()):
            target_parent = int(target_rig.parents[joint])
            source_parent = int(source_rig.parents[max(source_joint, 0)])
            if (
                source_joint < 0
                or not is_moving[source_joint]
                or min(target_parent, source_parent) < 0
                or joint == hips
            ):
                continue
            if len(local_translations) == 1:
                frame_count = len(rotations)
                local_translations = np.repeat(local_translations, frame_count, axis=0)
            offset = so3.rotate(
                source_rotations[:, source_parent], deviations[:, source_joint]
            )
            offset = so3.rotate(self.up_rotation, offset)
            inverse_rotations = so3.conjugate(rotations[:, target_parent])
            offset = so3.rotate(inverse_rotations, offset)
            local_translations[:, joint] += self.scale * offset
        return np.asarray(local_translations)

    def hips(self, positions: FloatArray) -> FloatArray:
        """Return the middle between the thighs of the target ``(F, 3)`` [m].

        It is scaled from the positions of the source's joints ``(F, J, 3)`` [m].
        """
        return self.scale * self.to_target_axes(middle_of_hips(self.source, positions))

    def to_target_axes(self, points: FloatArray) -> FloatArray:
        """Rotate points ``(..., 3)`` from the source's up axis to the target's."""
        if (self.up_rotation == so3.IDENTITY).all():
            return points
        return so3.rotate(self.up_rotation, points)


def middle_of_hips(skeleton: RoledSkeleton, positions: FloatArray) -> FloatArray:
    """Return the middle of the thigh joints ``(F, 3)``; the root if there are none."""
    thighs = [skeleton.first_joint(f"thigh_{side}") for side in "lr"]
    thighs = [j for j in thighs if j >= 0]
    joints = thighs if len(thighs) == 2 else [max(skeleton.first_joint("hips"), 0)]
    return np.asarray(positions[:, joints].mean(axis=1))


def equal_name_pairs(
    source: Rig, target: Rig, source_joints: IntArray
) -> list[tuple[int, int]]:
    """Return pairs of otherwise unmapped joints with equal names, such as tails."""
    used_joints = {*source_joints.tolist()}
    joint_by_name = {name: j for j, name in enumerate(source.names)}
    return [
        (joint, joint_by_name[name])
        for joint, name in enumerate(target.names)
        if source_joints[joint] < 0
        and name in joint_by_name
        and joint_by_name[name] not in used_joints
    ]


def _fraction_middles(start_fractions: Sequence[float]) -> FloatArray:
    """Return the midpoint of each bone of a chain, as fractions of its length."""
    boundaries = np.append(start_fractions, 1.0)
    return np.asarray((boundaries[1:] + boundaries[:-1]) / 2)


def _rest_alignment(
    source: RoledSkeleton,
    target: RoledSkeleton,
    source_joints: IntArray,
    up_rotation: FloatArray,
    *,
    has_same_rest: bool,
) -> FloatArray:
    """Return world rotations of the target in the source's rest pose ``(K, 4)``.

    Headings agree; limbs point along the source's limbs, feet along the ground, unless
    the rest poses are equal.
    """
    up = np.array(target.rig.up.vector)
    heading_rotation = _heading_alignment(source, target, up_rotation, up)
    rotations = so3.multiply(heading_rotation, target.rotations)
    for j, source_joint in enumerate(source_joints.tolist()):
        role = base_role(target.roles[j])
        if has_same_rest or source_joint < 0:
            continue
        bone = target.bone_direction(j)
        source_bone = source.bone_direction(source_joint)
        if bone is None or source_bone is None:
            continue
        bone = so3.rotate(heading_rotation, bone)
        source_bone = so3.rotate(up_rotation, source_bone)
        if role == "foot":
            bone, source_bone = (
                direction - (direction @ up) * up for direction in (bone, source_bone)
            )
            lengths = np.linalg.norm(bone), np.linalg.norm(source_bone)
            if min(lengths) < MIN_BONE_LENGTH:
                continue
            bone, source_bone = bone / lengths[0], source_bone / lengths[1]
        elif role not in _AIMED_ROLES and role[:-2] not in _FINGER_NAMES:
            continue
        swing = so3.shortest_rotation(bone, source_bone)
        rotations[j] = so3.multiply(swing, rotations[j])
    return rotations


def _heading_alignment(
    source: RoledSkeleton,
    target: RoledSkeleton,
    up_rotation: FloatArray,
    up: FloatArray,
) -> FloatArray:
    """Return the rotation from the target's rest heading to the source's ``(4,)``.

    A standing body rotates about the vertical alone, so that soles stay level.
    """
    source_facing, target_facing = source.facing_axes, target.facing_axes
    if source_facing is None or target_facing is None:
        return so3.IDENTITY
    source_facing = so3.rotate(up_rotation, source_facing)
    if min(source_facing[1] @ up, target_facing[1] @ up) < MIN_STANDING_COSINE:
        return so3.from_matrix(source_facing.T @ target_facing)
    target_forward, source_forward = (
        forward - (forward @ up) * up
        for forward in (target_facing[2], source_facing[2])
    )
    angle = np.arctan2(
        np.cross(target_forward, source_forward) @ up, target_forward @ source_forward
    )
    return so3.from_axis_angle(up, angle)


# Roles whose chain from the hips measures body size, independent of arms.
BODY_ROLES = {"neck", "head", "upper_arm", "thigh", "shin"}
_FINGER_NAMES = {"thumb", "index", "middle", "ring", "pinky"}


def _leg_ratio(
    source: RoledSkeleton, target: RoledSkeleton, source_joints: IntArray
) -> float:
    """Return the ratio of target leg length to source leg length.

    Without legs, chain lengths from the hips to the other body joints are compared;
    without a body, those to all target joints that follow a source joint.
    """
    leg_lengths = [
        (target.leg_length(side), source.leg_length(side))
        for side in "lr"
        if target.leg(side) and source.leg(side)
    ]
    if not leg_lengths:
        chain_lengths = target.chain_lengths, source.chain_lengths
        joint_pairs = [
            (target.first_joint(role), source.first_joint(role))
            for role in dict.fromkeys(source.roles)
            if base_role(role) in BODY_ROLES and role in target.roles
        ] or [
            (j, source_joints[j]) for j in np.flatnonzero(source_joints >= 0).tolist()
        ]
        leg_lengths = [
            (float(chain_lengths[0][j]), float(chain_lengths[1][k]))
            for j, k in joint_pairs
        ]
    target_length, source_length = (
        sum(lengths) for lengths in zip((0.0, 0.0), *leg_lengths, strict=True)
    )
    has_lengths = source_length > 0 and target_length > 0
    return target_length / source_length if has_lengths else 1.0

"""Converts world rotations to local ones within joint types and limits."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.retarget.roled_skeleton import RoledSkeleton
from animtool.retarget.transfer import Transfer, middle_of_hips
from animtool.rig.limits import BallLimit, RangeLimit, swing_twist
from animtool.rig.skeleton import Joint, JointType, Rig

# Sine of the bend below which a limb is straight, and above which it is bent.
BEND_SINES = (0.05, 0.2)
# Cosine above which a pin's axis is along its bone, so that it twists the bone.
MIN_BONE_COSINE = 0.9
# Limit violations below this are rounding.
LIMIT_ROUNDING = 1e-6


def relative_to_hips(
    target: RoledSkeleton,
    rotations: FloatArray,
    bones: FloatArray,
    joints: Collection[int],
) -> FloatArray:
    """Return joint positions relative to the hips' middle ``(F, K, 3)`` [m].

    Only the given joints and their ancestors are computed; the others stay at the root.
    """
    rig = target.rig
    positions = np.zeros((len(rotations), len(rig.joints), 3))
    needed_joints = set(joints)
    for j in range(len(rig.joints) - 1, -1, -1):
        if j in needed_joints:
            needed_joints.add(int(rig.parents[j]))
    for j, parent in enumerate(rig.parents.tolist()):
        if parent >= 0 and j in needed_joints:
            bone = so3.rotate(rotations[:, parent], bones[:, j])
            positions[:, j] = positions[:, parent] + bone
    return np.asarray(positions - middle_of_hips(target, positions)[:, None])


def twist_to_hinge_axes(transfer: Transfer, rotations: FloatArray) -> FloatArray:
    """Twist limbs so that they bend about the axes of their pins ``(F, K, 4)``.

    The joint above twists about its bone, so that the bone below the pin keeps its
    direction; a straight limb keeps its twist.
    """
    target = transfer.target
    rig = target.rig
    for j, joint in enumerate(rig.joints):
        parent = int(rig.parents[j])
        if joint.type is not JointType.PIN or parent < 0:
            continue
        # Joints that follow none stay at rest.
        is_ball = rig.joints[parent].type is JointType.BALL
        bone = target.bone_direction(j)
        if not is_ball or transfer.source_joints[j] < 0 or bone is None:
            continue
        upper_bone = _normalize(rig.rest_translations[j])
        upper_direction = so3.rotate(rotations[:, parent], upper_bone)
        bone_local = so3.rotate(so3.conjugate(target.rotations[j]), bone)
        direction = so3.rotate(rotations[:, j], bone_local)
        rest_axis = so3.rotate(rig.rest_rotations[j], np.array(joint.axis, np.float64))
        hinge_axis = so3.rotate(rotations[:, parent], rest_axis)
        bend_normal = np.cross(upper_direction, direction)
        sine = np.linalg.norm(bend_normal, axis=1)
        bend_normal = bend_normal / np.maximum(sine, 1e-12)[:, None]
        # It bends as its limits allow, else towards the axis.
        bend_sign = np.where((bend_normal * hinge_axis).sum(axis=1) < 0, -1.0, 1.0)[
            :, None
        ]
        if isinstance(joint.limits, RangeLimit):
            bends_forward = joint.limits.low + joint.limits.high >= 0
            bend_sign = np.full_like(bend_sign, 1.0 if bends_forward else -1.0)
        along_bone = (hinge_axis * upper_direction).sum(axis=1)[:, None]
        perpendicular = hinge_axis - along_bone * upper_direction
        cross_product = np.cross(perpendicular, bend_normal * bend_sign)
        angle = np.arctan2(
            (cross_product * upper_direction).sum(axis=1),
            (perpendicular * bend_normal * bend_sign).sum(axis=1),
        )
        bend_weight = (sine - BEND_SINES[0]) / (BEND_SINES[1] - BEND_SINES[0])
        bend_weight = np.clip(bend_weight, 0.0, 1.0)
        angle = angle * bend_weight * bend_weight * (3 - 2 * bend_weight)
        twist = so3.from_axis_angle(upper_direction, angle)
        rotations[:, parent] = so3.multiply(twist, rotations[:, parent])
    return rotations


def _normalize(vector: FloatArray) -> FloatArray:
    """Return a vector ``(3,)`` with length 1; the Y axis for a zero vector."""
    norm = float(np.linalg.norm(vector))
    return vector / norm if norm > 0 else np.array([0.0, 1.0, 0.0])


@dataclass(frozen=True, slots=True)
class LocalRotations:
    """Local and world rotations within the limits of the joints."""

    local: FloatArray  # local rotations (F, K, 4)
    world: FloatArray  # world rotations (F, K, 4)
    # Masks of the frames in which limits clamp a joint (F,), by joint.
    clamped_frames: dict[int, BoolArray]

    def select(self, frames: IntArray) -> LocalRotations:
        """Return a copy of the rotations in the frames of these indices."""
        clamped_frames = {j: mask[frames] for j, mask in self.clamped_frames.items()}
        return LocalRotations(self.local[frames], self.world[frames], clamped_frames)

    def replace_frames(self, frames: IntArray, replacement: LocalRotations) -> None:
        """Overwrite rotations and clamp masks in the frames of these indices."""
        self.local[frames], self.world[frames] = replacement.local, replacement.world
        for j in {*self.clamped_frames, *replacement.clamped_frames}:
            no_frames = np.zeros(len(self.local), np.bool_)
            mask = self.clamped_frames.setdefault(j, no_frames)
            mask[frames] = replacement.clamped_frames.get(j, False)


def local_rotations(
    transfer: Transfer,
    rotations: FloatArray,
    previous: LocalRotations | None = None,
    changed_joints: Collection[int] = (),
) -> LocalRotations:
    """Return local rotations within limits, from world rotations ``(F, K, 4)``.

    Child joints compensate for the rotation that a limit removes; joints that follow no
    source joint stay at rest. With ``previous`` rotations, only ``changed_joints`` and
    their descendants are recomputed.
    """
    target = transfer.target
    rig = target.rig
    if previous is None:
        local, world = np.zeros_like(rotations), np.zeros_like(rotations)
        clamped_frames: dict[int, BoolArray] = {}
        outdated_joints = set(range(len(rig.joints)))
    else:
        local, world = previous.local.copy(), previous.world.copy()
        clamped_frames = dict(previous.clamped_frames)
        outdated_joints = set(changed_joints)
    for j, joint in enumerate(rig.joints):
        parent, rest_rotation = int(rig.parents[j]), rig.rest_rotations[j]
        if parent in outdated_joints:
            outdated_joints.add(j)
        if j not in outdated_joints:
            continue
        parent_rotation = world[:, parent] if parent >= 0 else None
        inverse_parent = so3.IDENTITY
        if parent_rotation is not None:
            inverse_parent = so3.conjugate(parent_rotation)
        joint_local = rest_rotation[None]
        if transfer.source_joints[j] >= 0:
            joint_local = so3.multiply(inverse_parent, rotations[:, j])
            twisted_joint = _twist_joint(target, j)
            if twisted_joint >= 0:
                twisted_rest = so3.conjugate(rig.rest_rotations[twisted_joint])
                untwisted = so3.multiply(rotations[:, twisted_joint], twisted_rest)
                joint_local = so3.multiply(inverse_parent, untwisted)
        joint_local, is_clamped = _clamp_to_limits(joint, rest_rotation, joint_local)
        clamped_frames.pop(j, None)
        if is_clamped.any():
            clamped_frames[j] = np.broadcast_to(is_clamped, len(local)).copy()
        local[:, j] = joint_local
        world[:, j] = joint_local
        if parent_rotation is not None:
            world[:, j] = so3.multiply(parent_rotation, joint_local)
    return LocalRotations(local, world, clamped_frames)


def _twist_joint(target: RoledSkeleton, j: int) -> int:
    """Return the child whose twist a pin along its bone takes over, or -1."""
    joint, rig = target.rig.joints[j], target.rig
    if joint.type is not JointType.PIN:
        return -1
    children = target.children_with_role(j)
    if len(children) != 1 or target.roles[children[0]] == target.roles[j]:
        return -1
    bone = _normalize(rig.rest_translations[children[0]])
    is_along_bone = abs(float(bone @ np.array(joint.axis))) > MIN_BONE_COSINE
    return children[0] if is_along_bone else -1


def _clamp_to_limits(
    joint: Joint, rest: FloatArray, local: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Clamp rotations ``(F, 4)`` to a joint's limits; also return clamped frames."""
    is_clamped = np.zeros(len(local), np.bool_)
    limits = joint.limits
    if joint.type is JointType.FREE or (
        joint.type is JointType.BALL and limits is None
    ):
        return local, is_clamped
    rotation_from_rest = so3.multiply(so3.conjugate(rest), local)
    if joint.type is JointType.PIN:
        angle = swing_twist(rotation_from_rest, joint.axis)[1]
        if isinstance(limits, RangeLimit):
            is_clamped = np.abs(limits.excess(angle)) > LIMIT_ROUNDING
            angle = limits.clamped(angle)
        rotation_from_rest = so3.from_axis_angle(
            np.array(joint.axis, np.float64), angle
        )
    elif isinstance(limits, BallLimit):
        clamped_rotations = limits.clamped(rotation_from_rest)
        angles = so3.angle_between(clamped_rotations, rotation_from_rest)
        is_clamped = angles > LIMIT_ROUNDING
        rotation_from_rest = clamped_rotations
    else:
        rotation_from_rest = np.broadcast_to(so3.IDENTITY, rotation_from_rest.shape)
    return so3.multiply(rest, rotation_from_rest), is_clamped


def world_rotations(rig: Rig, local: FloatArray) -> FloatArray:
    """Compute world rotations from local rotations, both ``(F, K, 4)``."""
    world = local.copy()
    for j, parent in enumerate(rig.parents.tolist()):
        if parent >= 0:
            world[:, j] = so3.multiply(world[:, parent], local[:, j])
    return world


def distribute_twist(
    transfer: Transfer, local: FloatArray, previous_angles: FloatArray | None
) -> FloatArray:
    """Distribute the twist at a bone's end among the twist joints along the bone.

    Local rotations ``(F, K, 4)`` are changed in place. Return the angles of the last
    frame ``(T,)`` [rad], which are the ``previous_angles`` of the next block, for
    continuity; at the beginning of a take, these are None.
    """
    rig = transfer.target.rig
    last_angles = np.zeros(len(transfer.twists))
    for k, (joint, next_joint, fraction) in enumerate(transfer.twists):
        twist_axis = _normalize(rig.rest_translations[next_joint])
        inverse_rest = so3.conjugate(rig.rest_rotations[next_joint])
        rotation_from_rest = so3.multiply(inverse_rest, local[:, next_joint])
        next_axis = so3.rotate(inverse_rest, twist_axis)
        angle = swing_twist(rotation_from_rest, tuple(next_axis))[1]
        if previous_angles is None:
            angle = np.unwrap(angle)
        else:
            angle = np.unwrap(np.concatenate([previous_angles[k : k + 1], angle]))[1:]
        last_angles[k] = angle[-1]
        rotation = so3.from_axis_angle(twist_axis, fraction * angle)
        local[:, joint] = so3.multiply(rotation, rig.rest_rotations[joint])
    return last_angles


def root_translations(
    target: RoledSkeleton,
    hips: FloatArray,
    rotations: FloatArray,
    bones: FloatArray,
    relative: FloatArray,
) -> tuple[int, FloatArray]:
    """Return the joint that moves the hips, and its local translations ``(F, 3)`` [m].

    ``hips`` is the middle between the thighs ``(F, 3)`` [m]. ``rotations``
    ``(F, K, 4)`` are those of all joints in the world, ``bones`` ``(F or 1, K, 3)``
    their local translations [m], and ``relative`` ``(F, K, 3)`` their positions from
    the middle of the hips [m].
    """
    rig = target.rig
    root = max(target.first_joint("hips"), 0)
    position = hips + relative[:, root]
    parent = int(rig.parents[root])
    if parent < 0:
        return root, position
    parent_positions = np.zeros((len(hips), 3))
    for j in reversed(rig.upwards(parent)):
        ancestor, bone = int(rig.parents[j]), bones[:, j]
        if ancestor >= 0:
            bone = so3.rotate(rotations[:, ancestor], bone)
        parent_positions = parent_positions + bone
    offset = position - parent_positions
    return root, so3.rotate(so3.conjugate(rotations[:, parent]), offset)

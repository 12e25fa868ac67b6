"""Legs of a retargeted skeleton: stance, foot placement and ankle goals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.record import dataclass
from animtool.core.units import UpAxis
from animtool.maths import so3
from animtool.maths.rows import Rows
from animtool.motion.contacts import find_contacts
from animtool.retarget.bending import bend_at_pin, bend_limb
from animtool.retarget.feet import Foot
from animtool.retarget.roled_skeleton import RoledSkeleton
from animtool.retarget.standing import MIN_STANDING_COSINE
from animtool.retarget.transfer import Transfer
from animtool.rig.limits import RangeLimit, swing_twist
from animtool.rig.skeleton import JointType, Rig


@dataclass(frozen=True, slots=True)
class LegTracks(Rows):
    """Motion of a target leg relative to the hips, and of the source's leg.

    It contains all frames, since planting depends on the complete contacts.
    """

    hip: FloatArray  # of the target, relative to the middle of its hips (F, 3) [m]
    ankle: FloatArray  # (F, 3) [m]
    toe: FloatArray  # the ball of the foot (F, 3) [m]; the ankle if it is unknown
    knee: FloatArray  # (F, 3) [m]
    # World rotations of the thigh's parent, thigh, shin and foot (F, 4, 4).
    rotations: FloatArray
    # hip, ankle and toe of the source in the target's axes (F, 9)
    source_points: FloatArray

    @staticmethod
    def of(
        transfer: Transfer,
        side: str,
        source_positions: FloatArray,
        source_ball: FloatArray,
        rotations: FloatArray,
        offsets: FloatArray,
    ) -> LegTracks:
        """Return the leg tracks of a block of frames.

        ``source_positions`` ``(F, J, 3)`` are those of the source in the target's axes,
        ``source_ball`` ``(F, 3)`` is its ball of the foot, or its ankle, in these axes,
        and ``offsets`` ``(F, K, 3)`` are those of the target from the middle of its
        hips, all [m]; ``rotations`` ``(F, K, 4)`` are the target's in the world.
        """
        target = transfer.target
        thigh, shin, foot, _ = leg_joints(target, side)
        thigh_parent = int(target.rig.parents[thigh])
        source_thigh, _, ankle, _ = leg_joints(transfer.source, side)
        source_points = np.concatenate(
            [source_positions[:, [source_thigh, ankle]], source_ball[:, None]], axis=1
        )
        return LegTracks(
            offsets[:, thigh],
            offsets[:, foot],
            ball_of_foot(target, side, offsets, rotations),
            offsets[:, shin],
            rotations[:, [max(thigh_parent, 0), thigh, shin, foot]],
            source_points.reshape(len(source_points), 9),
        )

    def foot(self, transfer: Transfer, side: str, fps: float) -> Foot:
        """Return the target's foot, with the contacts of the source's foot."""
        leg = leg_joints(transfer.target, side)
        up = up_index(transfer.target.rig)
        hip = self.source_points[:, :3]
        ankle = self.source_points[:, 3:6]
        toe = self.source_points[:, 6:]
        length = transfer.source.leg_length(side)
        tip = toe if side in transfer.source.balls else None
        contacts = find_contacts(ankle, tip, fps, length, up)
        straightness = np.ones(len(ankle))
        if length > 0:
            straightness = np.linalg.norm(ankle - hip, axis=1) / length
        shortest_reach, longest_reach = _leg_reach(transfer.target, leg)
        return Foot(
            contacts,
            self.hip,
            self.ankle,
            self.toe if side in transfer.target.balls else None,
            self.rotations[:, 3],
            None if transfer.has_similar_legs else _flat_rotation(transfer, leg[2]),
            _planted_ankle_height(transfer, side, contacts.ground, up),
            longest_reach,
            shortest_reach,
            transfer.scale * (ankle[:, up] - contacts.ground),
            np.minimum(straightness, 1.0),
        )


def up_index(rig: Rig) -> int:
    """Return the index of a rig's up axis in a vector: 1 for Y, 2 for Z."""
    return 1 if rig.up is UpAxis.Y else 2


def leg_joints(skeleton: RoledSkeleton, side: str) -> tuple[int, int, int, int]:
    """Return thigh, shin, foot and toe (-1 for none) of an existing leg."""
    leg = skeleton.leg(side)
    assert leg is not None
    return leg


def ball_of_foot(
    skeleton: RoledSkeleton, side: str, positions: FloatArray, rotations: FloatArray
) -> FloatArray:
    """Return the positions of a foot's ball, else of its ankle ``(F, 3)`` [m].

    ``positions`` ``(F, J, 3)`` [m] and ``rotations`` ``(F, J, 4)`` are those of all
    joints in the world.
    """
    foot, ball = leg_joints(skeleton, side)[2], skeleton.balls.get(side)
    if ball is None:
        return positions[:, foot]
    if ball.toe >= 0:
        return positions[:, ball.toe]
    return np.asarray(positions[:, foot] + so3.rotate(rotations[:, foot], ball.offset))


def _leg_reach(
    target: RoledSkeleton, leg: tuple[int, int, int, int]
) -> tuple[float, float]:
    """Return the smallest and largest hip-ankle distance within pin limits [m]."""
    rig, (_, shin, foot, _) = target.rig, leg
    joint, rest_rotation = rig.joints[shin], rig.rest_rotations[shin]
    thigh_bone, shin_bone = rig.rest_translations[shin], rig.rest_translations[foot]
    if joint.type is not JointType.PIN:
        a, b = np.linalg.norm(thigh_bone), np.linalg.norm(shin_bone)
        return float(abs(a - b)), float(a + b)
    lower_limit, upper_limit = -np.pi, np.pi
    if isinstance(joint.limits, RangeLimit):
        lower_limit, upper_limit = joint.limits.low, joint.limits.high
    # The squared distance varies with the cosine of the angle about that of its
    # maximum.
    pin_axis = np.array(joint.axis, np.float64)
    local_thigh_bone = so3.rotate(so3.conjugate(rest_rotation), thigh_bone)
    cosine = local_thigh_bone @ shin_bone - (local_thigh_bone @ pin_axis) * (
        shin_bone @ pin_axis
    )
    straight_angle = np.arctan2(
        local_thigh_bone @ np.cross(pin_axis, shin_bone), cosine
    )
    extreme_angles = straight_angle + np.pi * np.arange(-4, 5)
    angles = np.append(
        extreme_angles[(extreme_angles > lower_limit) & (extreme_angles < upper_limit)],
        [lower_limit, upper_limit],
    )
    rotations = so3.from_axis_angle(pin_axis, angles)
    tips = thigh_bone + so3.rotate(so3.multiply(rest_rotation, rotations), shin_bone)
    distances = np.linalg.norm(tips, axis=1)
    return float(distances.min()), float(distances.max())


def _flat_rotation(transfer: Transfer, foot: int) -> FloatArray:
    """Return the rotation of a foot planted flat at rest ``(4,)``.

    A source whose rest pose lies down does not define that rotation.
    """
    target = transfer.target
    facing_axes, up = target.facing_axes, up_index(target.rig)
    if facing_axes is None or facing_axes[1, up] < MIN_STANDING_COSINE:
        return np.asarray(transfer.rest_alignment[foot])
    return np.asarray(target.rotations[foot])


def _planted_ankle_height(
    transfer: Transfer, side: str, ground: float, up: int
) -> float:
    """Return the height of a planted ankle above the ground [m]."""
    target, source = transfer.target, transfer.source
    leg = leg_joints(target, side)
    if transfer.has_similar_legs:
        return transfer.scale * ground
    lowest = float(target.positions[:, up].min())
    ankle = float(target.positions[leg[2], up])
    # A rig that stands on the ground at rest defines the height of its ankles.
    if abs(lowest) < 0.1 * target.leg_length(side):
        return ankle
    balls = target.balls.get(side), source.balls.get(side)
    if balls[0] is None or balls[1] is None:
        return ground * transfer.scale
    foot_length, source_foot_length = (
        float(np.linalg.norm(ball.offset)) for ball in balls if ball is not None
    )
    has_length = source_foot_length > 0
    return ground * (foot_length / source_foot_length if has_length else transfer.scale)


def ankle_rotations(
    target: RoledSkeleton,
    side: str,
    joint_positions: FloatArray,
    goal: FloatArray,
    rotations: tuple[FloatArray, FloatArray],
    swivel: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Return world rotations of thigh and shin that bring the ankle to its goal.

    ``joint_positions`` are the starts of thigh, shin and foot ``(F, 3, 3)`` [m], and
    ``rotations`` the current ones of thigh and shin ``(F, 4)``. ``swivel`` rotates the
    knee about the line from hip to ankle ``(F,)`` [rad].
    """
    leg = leg_joints(target, side)[:3]
    bone_rotations = limb_rotations(
        target, leg, joint_positions, goal, rotations, _knee_axis(target, leg[1])
    )
    if swivel is None:
        return bone_rotations
    return swivel_leg(bone_rotations, goal - joint_positions[:, 0], swivel)


def limb_rotations(
    target: RoledSkeleton,
    limb: Sequence[int],
    joint_positions: FloatArray,
    goal: FloatArray,
    rotations: tuple[FloatArray, FloatArray],
    hinge_axis: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return world rotations of a limb's two bones that bring its end to a goal.

    ``limb`` and ``joint_positions`` ``(F, 3, 3)`` [m] are its first joint, its middle
    and its end, ``rotations`` the current ones of both bones ``(F, 4)``. ``hinge_axis``
    is the axis of a straight limb's middle joint, in the frame of that joint ``(3,)``.
    """
    if target.rig.joints[limb[1]].type is JointType.PIN:
        return _bend_pin_limb(target, limb, joint_positions[:, 0], goal, rotations)
    start, middle, end = (joint_positions[:, i] for i in range(3))
    straight_axis = so3.rotate(rotations[1], hinge_axis)
    return bend_limb(start, (middle, end), goal, rotations, straight_axis)


def swivel_leg(
    rotations: tuple[FloatArray, FloatArray], line: FloatArray, angle: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Swivel thigh and shin rotations about a line ``(F, 3)`` by an angle ``(F,)``."""
    axis = line / np.maximum(np.linalg.norm(line, axis=1), 1e-12)[:, None]
    rotation = so3.from_axis_angle(axis, angle)
    return so3.multiply(rotation, rotations[0]), so3.multiply(rotation, rotations[1])


def _bend_pin_limb(
    target: RoledSkeleton,
    limb: Sequence[int],
    start: FloatArray,
    goal: FloatArray,
    rotations: tuple[FloatArray, FloatArray],
) -> tuple[FloatArray, FloatArray]:
    """Return world rotations of both bones of a limb whose middle joint is a pin."""
    rig, (_, middle, end_joint) = target.rig, limb
    joint, rest_rotation = rig.joints[middle], rig.rest_rotations[middle]
    local_rotation = so3.multiply(so3.conjugate(rotations[0]), rotations[1])
    pin_axis = np.array(joint.axis, np.float64)
    rotation_from_rest = so3.multiply(so3.conjugate(rest_rotation), local_rotation)
    angle = swing_twist(rotation_from_rest, joint.axis)[1]
    lower_bone = so3.rotate(rest_rotation, target.offset(middle, end_joint))
    bones = rig.rest_translations[middle], lower_bone
    limits = joint.limits if isinstance(joint.limits, RangeLimit) else None
    axis = so3.rotate(rest_rotation, pin_axis)
    pin_state = bones, axis, angle, limits
    upper_rotation, pin_angle = bend_at_pin(start, goal, rotations[0], *pin_state)
    local_bend = so3.multiply(rest_rotation, so3.from_axis_angle(pin_axis, pin_angle))
    return upper_rotation, so3.multiply(upper_rotation, local_bend)


def _knee_axis(target: RoledSkeleton, shin: int) -> FloatArray:
    """Return a knee's hinge axis in the knee's frame ``(3,)``."""
    joint = target.rig.joints[shin]
    if joint.type is JointType.PIN:
        return np.array(joint.axis, np.float64)
    facing_axes = target.facing_axes
    left_axis = np.eye(3)[0] if facing_axes is None else facing_axes[0]
    return so3.rotate(so3.conjugate(target.rotations[shin]), left_axis)

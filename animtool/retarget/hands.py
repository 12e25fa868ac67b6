"""Keeps contacts of hands in retargeting: with each other, the ground and props."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.maths.rows import Rows
from animtool.maths.runs import runs
from animtool.motion.contacts import find_contacts, gaussian_smooth, remove_short_runs
from animtool.retarget.feet import fill_between
from animtool.retarget.legs import limb_rotations, up_index
from animtool.retarget.props import PropMotion
from animtool.retarget.roled_skeleton import RoledSkeleton
from animtool.retarget.transfer import Transfer

# Hands hold each other if their wrists are nearer than this fraction of an arm length,
MAX_JOINED_DISTANCE_RATIO = 0.4
# and the vector between them changes by less than this fraction of an arm length per
# second.
MAX_JOINED_SPEED_RATIO = 0.25
# Gaussian width of smoothing before speeds are computed [s].
SMOOTHING_SECONDS = 0.03
# A hand touches the ground below this fraction of an arm length; below half of that it
# keeps the source's height.
MAX_GROUND_CONTACT_RATIO = 0.3
# Hands slow down below this fraction of an arm length above the ground.
MAX_SLOWING_RATIO = 0.25
# Hand contacts fade in and out within about this time [s].
FADE_SECONDS = 0.15
# Arms of joined hands stay slightly bent: they reach this fraction of their length; and
# the maximum iterations for moving the hands within reach.
REACH_FRACTION, MAX_REACH_ITERATIONS = 0.99, 20


@dataclass(frozen=True, slots=True)
class ArmTracks(Rows):
    """Motion of a target arm relative to the hips, and of the source's wrist."""

    joint_positions: FloatArray  # shoulder, elbow, wrist from mid-hips (F, 3, 3) [m]
    rotations: FloatArray  # world rotations of upper arm and forearm (F, 2, 4)
    source_wrist: FloatArray  # the source's wrist in the target's axes (F, 3) [m]

    @staticmethod
    def of(
        transfer: Transfer,
        side: str,
        source_positions: FloatArray,
        rotations: FloatArray,
        offsets: FloatArray,
    ) -> ArmTracks:
        """Return the arm tracks of a block of frames.

        ``source_positions`` ``(F, J, 3)`` are those of the source in the target's axes,
        ``offsets`` ``(F, K, 3)`` those of the target from the middle of its hips, both
        [m]; ``rotations`` ``(F, K, 4)`` are the target's in the world.
        """
        target_arm, source_arm = (
            arm_joints(skeleton, side)
            for skeleton in (transfer.target, transfer.source)
        )
        assert target_arm is not None
        assert source_arm is not None
        bone_rotations = rotations[:, target_arm[:2]]
        source_wrist = source_positions[:, source_arm[2]]
        return ArmTracks(offsets[:, target_arm], bone_rotations, source_wrist)


@dataclass(frozen=True, slots=True)
class HandContact:
    """Wrist goals of a hand in contact, and the arm rotations that reach them."""

    side: str
    goal: FloatArray  # goal of the wrist while in contact (F, 3) [m]
    is_active: BoolArray  # mask of the frames in contact (F,)
    # World rotation vectors applied to upper arm and forearm (F, 2, 3) [rad].
    bone_rotations: FloatArray
    props: frozenset[int]  # indices of the prop tracks that the hand holds


@dataclass(frozen=True, slots=True)
class AnkleHeights:
    """Heights of planted ankles above the origin [m]."""

    source: float
    target: float

    @staticmethod
    def ground_offset(
        ankle_heights: AnkleHeights | None, scale: float, up: int
    ) -> FloatArray:
        """Return the offset that puts the scaled source on the ground ``(3,)`` [m]."""
        offset = np.zeros(3)
        if ankle_heights is not None:
            offset[up] = ankle_heights.target - scale * ankle_heights.source
        return offset


def arm_joints(skeleton: RoledSkeleton, side: str) -> list[int] | None:
    """Return shoulder, elbow and wrist of an arm; None if the skeleton lacks one."""
    roles = [f"{role}_{side}" for role in ("upper_arm", "forearm", "hand")]
    arm = list(map(skeleton.first_joint, roles))
    return arm if min(arm) >= 0 else None


def hand_contacts(
    transfer: Transfer,
    sides: str,
    tracks: Sequence[ArmTracks],
    hips: FloatArray,
    ankle_heights: AnkleHeights | None,
    fps: float,
    props: Sequence[PropMotion] = (),
) -> list[HandContact]:
    """Return the goals of hands that keep the source's contacts.

    Hands that hold each other keep the source's separation, scaled by arm length, and
    their midpoint. Hands on the ground stay in place; hands on props keep their grip.
    Corrections fade in and out as smoothly as possible.

    Args:
        transfer: The transfer between the skeletons.
        sides: Sides of the arms.
        tracks: Tracks of each arm.
        hips: Middle of the target's hips ``(F, 3)`` [m].
        ankle_heights: Ground height; None if there are no feet to determine it.
        fps: Frames a second.
        props: Props that the hands may grip.
    """
    up = up_index(transfer.target.rig)
    ground_offset = AnkleHeights.ground_offset(ankle_heights, transfer.scale, up)
    wrists = [hips + arm.joint_positions[:, 2] for arm in tracks]
    arm_lengths = [_arm_length(transfer.source, side) for side in sides]
    scales = [
        _arm_length(transfer.target, side) / arm_length if arm_length > 0 else 1.0
        for side, arm_length in zip(sides, arm_lengths, strict=True)
    ]
    frame_count = len(hips)
    shoulders = [hips + arm.joint_positions[:, 0] for arm in tracks]
    goals = [wrist.copy() for wrist in wrists]
    is_active = [np.zeros(frame_count, np.bool_) for _ in tracks]
    if len(tracks) == 2:
        separation = tracks[0].source_wrist - tracks[1].source_wrist
        is_joined = _are_hands_joined(separation, min(arm_lengths), fps)
        middle = (wrists[0] + wrists[1]) / 2
        pair_goals = [
            middle + sign * float(np.mean(scales)) * separation for sign in (0.5, -0.5)
        ]
        reaches = [REACH_FRACTION * _arm_length(transfer.target, s) for s in sides]
        for k, goal in enumerate(_shift_into_reach(pair_goals, shoulders, reaches)):
            goals[k][is_joined] = goal[is_joined]
            is_active[k] |= is_joined
    contacts = []
    for k, side in enumerate(sides):
        source_wrist, arm_length, ground_level = (
            tracks[k].source_wrist,
            arm_lengths[k],
            None,
        )
        is_gripping, prop_tracks = np.zeros(frame_count, np.bool_), frozenset[int]()
        for prop in props:
            is_gripped = prop.find_gripped_frames(source_wrist, arm_length, fps)
            is_gripped &= ~is_gripping
            if not is_gripped.any():
                continue
            grip_offset = so3.rotate(prop.rotations, prop.in_prop_frame(source_wrist))
            prop_origin = transfer.scale * prop.positions + ground_offset
            goals[k][is_gripped] = (prop_origin + grip_offset)[is_gripped]
            is_active[k] |= is_gripped
            is_gripping |= is_gripped
            prop_tracks |= {prop.track}
        if ankle_heights is not None:
            height = source_wrist[:, up] - ankle_heights.source
            kept_height = np.minimum(height, MAX_GROUND_CONTACT_RATIO / 2 * arm_length)
            ground_level = ankle_heights.target + transfer.scale * kept_height
            is_slow = find_contacts(source_wrist, None, fps, arm_length, up).ankle
            is_free = is_slow & ~is_gripping & ~is_active[k]
            for start, end in runs(
                is_free & (height < MAX_GROUND_CONTACT_RATIO * arm_length)
            ):
                goals[k][start:end] = wrists[k][start:end].mean(axis=0)
                goals[k][start:end, up] = float(ground_level[start:end].mean())
                is_active[k][start:end] = True
        is_contact = is_active[k].copy()
        if ground_level is not None:
            height_above_ground = wrists[k][:, up] - ground_level
            soft_height = MAX_SLOWING_RATIO * arm_length * transfer.scale
            is_low = ~is_contact & (height_above_ground < soft_height)
            soft_goal = ground_level + _soften_heights(height_above_ground, soft_height)
            goals[k][is_low, up] = soft_goal[is_low]
            is_contact |= is_low
        rotation_vectors = _arm_rotations(
            transfer.target, side, tracks[k], shoulders[k], goals[k], is_contact, fps
        )
        contacts.append(
            HandContact(side, goals[k], is_active[k], rotation_vectors, prop_tracks)
        )
    return contacts


def _arm_rotations(
    target: RoledSkeleton,
    side: str,
    tracks: ArmTracks,
    shoulder: FloatArray,
    goal: FloatArray,
    is_contact: BoolArray,
    fps: float,
) -> FloatArray:
    """Return rotations of both arm bones that bring the hand to its goal ``(F, 2, 3)``.

    The rotations are solved in frames with a contact, and fade around these frames.
    Positions do not fade, because a nearly straight arm bends a lot for a small motion
    of its hand.
    """
    rotation_vectors = np.zeros((len(is_contact), 2, 3))
    arm, frames = arm_joints(target, side), np.flatnonzero(is_contact)
    if arm is None or not len(frames):
        return rotation_vectors
    joints = (
        shoulder[frames, None]
        + (tracks.joint_positions - tracks.joint_positions[:, :1])[frames]
    )
    bone_rotations = tracks.rotations[frames, 0], tracks.rotations[frames, 1]
    hinge = elbow_hinge(target, arm)
    bent_rotations = limb_rotations(
        target, arm, joints, goal[frames], bone_rotations, hinge
    )
    for k in (0, 1):
        inverse = so3.conjugate(bone_rotations[k])
        rotation_vectors[frames, k] = so3.log(so3.multiply(bent_rotations[k], inverse))
    flat_vectors = rotation_vectors.reshape(len(rotation_vectors), 6)
    fill_between(flat_vectors, is_contact, fps, FADE_SECONDS)
    return flat_vectors.reshape(rotation_vectors.shape)


def _soften_heights(heights: FloatArray, depth: float) -> FloatArray:
    """Return heights eased quadratically to 0 from ``depth`` above to below ground."""
    return np.asarray(np.clip(heights + depth, 0.0, None) ** 2 / (4 * depth))


def _shift_into_reach(
    goals: Sequence[FloatArray],
    shoulders: Sequence[FloatArray],
    reaches: Sequence[float],
) -> list[FloatArray]:
    """Shift the goals of both hands by one offset until both arms reach.

    ``goals`` are those of each wrist ``(F, 3)`` [m], from ``shoulders`` ``(F, 3)`` [m]
    that are at most ``reaches`` [m] away.
    """
    reachable_goals = list(goals)
    for _ in range(MAX_REACH_ITERATIONS):
        excess = np.zeros_like(reachable_goals[0])
        for goal, shoulder, reach in zip(
            reachable_goals, shoulders, reaches, strict=True
        ):
            offset = goal - shoulder
            distance = np.maximum(np.linalg.norm(offset, axis=1), 1e-12)[:, None]
            excess += offset * np.maximum(1 - reach / distance, 0.0)
        if not excess.any():
            break
        reachable_goals = [goal - excess for goal in reachable_goals]
    return reachable_goals


def _are_hands_joined(separation: FloatArray, length: float, fps: float) -> BoolArray:
    """Return a mask of frames in which hands are near and move together ``(F,)``."""
    if len(separation) < 3 or length <= 0:
        return np.zeros(len(separation), np.bool_)
    smooth_separation = gaussian_smooth(separation, SMOOTHING_SECONDS * fps)
    speed = np.linalg.norm(np.gradient(smooth_separation, axis=0), axis=1) * fps
    is_near = np.linalg.norm(separation, axis=1) < MAX_JOINED_DISTANCE_RATIO * length
    return remove_short_runs(is_near & (speed < MAX_JOINED_SPEED_RATIO * length), fps)


def _arm_length(skeleton: RoledSkeleton, side: str) -> float:
    """Return the rest length of upper arm plus forearm [m]."""
    arm = arm_joints(skeleton, side)
    if arm is None:
        return 0.0
    bones = np.diff(skeleton.positions[arm], axis=0)
    return float(np.linalg.norm(bones, axis=1).sum())


def elbow_hinge(skeleton: RoledSkeleton, arm: Sequence[int]) -> FloatArray:
    """Return an elbow's hinge axis for a straight arm, in the elbow's frame ``(3,)``.

    It is perpendicular to the upper arm and as level as possible.
    """
    bone = skeleton.bone_direction(arm[0])
    facing_axes = skeleton.facing_axes
    up = np.array([0.0, 1.0, 0.0]) if facing_axes is None else facing_axes[1]
    axis = np.cross(up, np.array([1.0, 0.0, 0.0]) if bone is None else bone)
    norm = float(np.linalg.norm(axis))
    axis = axis / norm if norm > 0 else np.array([0.0, 0.0, 1.0])
    return so3.rotate(so3.conjugate(skeleton.rotations[arm[1]]), axis)

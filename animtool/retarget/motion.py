"""Retargeting of takes from one skeleton onto another.

A take is read twice, so that a long take never has to fit into memory: foot contacts
depend on all frames but need little data per frame; joints follow in the second pass.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.errors import Fault, listed
from animtool.core.files.spool import Spool
from animtool.core.loaded import check_loaded
from animtool.core.quantities import plain_number
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.motion.driving import drive_take
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import Take
from animtool.retarget.feet import Foot, PlacedFeet, plant_feet
from animtool.retarget.hands import AnkleHeights, ArmTracks, arm_joints, hand_contacts
from animtool.retarget.implausible_motion import GroundCheck
from animtool.retarget.legs import (
    LegTracks,
    ankle_rotations,
    ball_of_foot,
    leg_joints,
    up_index,
)
from animtool.retarget.legs_in_limits import solve_within_limits
from animtool.retarget.map import JointMap
from animtool.retarget.poses import (
    LocalRotations,
    distribute_twist,
    local_rotations,
    relative_to_hips,
    root_translations,
    twist_to_hinge_axes,
    world_rotations,
)
from animtool.retarget.props import PropTracks
from animtool.retarget.report import ContactFrames, FitMeter, RetargetReport
from animtool.retarget.roled_skeleton import RoledSkeleton
from animtool.retarget.transfer import Transfer
from animtool.retarget.verdict import Verdict, VerdictReason, is_likely_scale
from animtool.rig.kinematics import WorldTransforms, forward_kinematics
from animtool.rig.skeleton import Rig

# Fraction of the frames at limits that only a wrong rest pose explains [1].
MIN_STOPPED_FRACTION = 0.95

# Frames of a block: its arrays fit into the processor's cache. Blocks begin at the
# first frame of a take, whatever the blocks of the input are.
BLOCK_FRAMES = 1024
# Maximum iterations of ankle compliance, and the tolerated error relative to the
# skeleton's size: each iteration leaves about a tenth.
MAX_ANKLE_ITERATIONS, ANKLE_TOLERANCE = 5, 1e-5
# Motions below this fraction of the skeleton's size, or rotations about its root below
# this in radians, count as static [1].
STATIC_TOLERANCE = 1e-6
# Numbers that differ by less are equal up to rounding [1], [m].
ROUNDING_TOLERANCE = 1e-13


@dataclass(frozen=True, slots=True)
class _PosedFrames:
    """The target's pose in F frames as transferred, before its feet are planted."""

    source_positions: FloatArray  # in the target's axes (F, J, 3) [m]
    # Balls of the source's feet, or ankles, in these axes (F, L, 3) [m].
    balls: FloatArray
    rotations: LocalRotations
    bones: FloatArray  # local translations (F or 1, K, 3) [m]
    # joints relative to the middle of the hips (F, K, 3) [m]
    relative_positions: FloatArray
    hips: FloatArray  # the middle of the hips (F, 3) [m]


class Retargeting:
    """A take being retargeted onto another rig.

    Attributes:
        transfer: The transfer between the skeletons.
        contact_frames: Which feet are planted, and when.
        moving_joints: Moving joints of the source.
        max_bone_lengths: Largest distance of the source's joints from their parents
            ``(J,)`` [m].
        ignored_errors: Errors ignored on request.
    """

    def __init__(
        self,
        transfer: Transfer,
        joint_map: JointMap,
        motions: Iterable[Motion],
        fps: float,
        *,
        lock: bool = True,
        plants_similar_legs: bool = False,
        hands: bool = False,
        props: PropTracks | None = None,
    ) -> None:
        """Read the take once to find its contacts: the first pass.

        Args:
            transfer: The transfer between the skeletons.
            joint_map: Which joints follow which.
            motions: Motion of the source, block by block.
            fps: Frames a second.
            lock: Whether planted feet stay in place.
            plants_similar_legs: Whether ``lock`` also applies to legs like those of the
                source; else such legs move as the source's do.
            hands: Whether hands keep their contacts.
            props: Tracks of the take that hands may grip.
        """
        self.transfer, self._is_animated = transfer, False
        self.ignored_errors: list[Fault] = []
        # Frame of the source that is its rest pose; None for another one.
        self.rest_frame: int | None = None
        self.ground_check: GroundCheck | None = None
        self._first_pose: tuple[FloatArray, FloatArray] | None = None
        self.moving_joints: set[int] = set()
        self.max_bone_lengths: FloatArray = np.zeros(len(transfer.source.rig.joints))
        self._spool = Spool()
        self._clamped_blocks: list[dict[int, BoolArray]] = []
        skeletons = transfer.target, transfer.source
        legs = "".join(s for s in "lr" if all(k.leg(s) for k in skeletons))
        arms = ""
        if hands:
            arms = "".join(s for s in "lr" if all(arm_joints(k, s) for k in skeletons))
        leg_tracks, arm_tracks = self._read_tracks(motions, legs, arms)
        feet = [
            tracks.foot(transfer, side, fps)
            for tracks, side in zip(leg_tracks, legs, strict=True)
        ]
        placed_feet = None
        if legs and lock and (plants_similar_legs or not transfer.has_similar_legs):
            placed_feet = self._plant_feet(legs, leg_tracks, feet, fps)
        are_planted = placed_feet is not None
        ankle_heights = _ankle_heights(transfer, feet, are_planted=are_planted)
        hand_goals = hand_contacts(
            transfer,
            arms,
            arm_tracks,
            self._hips,
            ankle_heights,
            fps,
            props.moving_props(transfer) if props is not None and arms else (),
        )
        # Offset of gripped props (3,) [m].
        ground_arguments = ankle_heights, transfer.scale, up_index(transfer.target.rig)
        self.ground_offset = AnkleHeights.ground_offset(*ground_arguments)
        contacts = tuple(foot.contacts for foot in feet)
        self.contact_frames = ContactFrames(legs, contacts, placed_feet, hand_goals)
        self._meter = FitMeter(transfer, joint_map, self.contact_frames)
        self._clamped_counts: Counter[int] = Counter()
        self._frame_count = 0

    def _read_tracks(
        self, motions: Iterable[Motion], legs: str, arms: str
    ) -> tuple[list[LegTracks], list[ArmTracks]]:
        """Read the take and return the motion of its legs and arms over all frames."""
        transfer = self.transfer
        leg_tracks: list[list[LegTracks]] = []
        arm_tracks: list[list[ArmTracks]] = []
        hips = []
        for motion in split_blocks(motions, BLOCK_FRAMES):
            for channel in (motion.rotations, motion.translations):
                self._is_animated |= len(channel.animated) > 0
            self._record_moving_joints(motion)
            block = self._pose_frames(motion, legs)
            rotations = block.rotations
            source, target = (
                block.source_positions,
                (rotations.world, block.relative_positions),
            )
            block_legs = [
                LegTracks.of(transfer, side, source, block.balls[:, k], *target)
                for k, side in enumerate(legs)
            ]
            leg_tracks.append(block_legs)
            block_arms = [ArmTracks.of(transfer, s, source, *target) for s in arms]
            arm_tracks.append(block_arms)
            hips.append(block.hips)
            arrays = [
                block.source_positions,
                rotations.local,
                rotations.world,
                block.bones,
            ]
            self._spool.append([*arrays, block.relative_positions, block.balls])
            self._clamped_blocks.append(rotations.clamped_frames)
        self._hips = np.concatenate(hips)
        return (
            [LegTracks.concatenate(blocks) for blocks in zip(*leg_tracks, strict=True)],
            [ArmTracks.concatenate(blocks) for blocks in zip(*arm_tracks, strict=True)],
        )

    def _record_moving_joints(self, motion: Motion) -> None:
        """Record the joints that move away from their pose in the first frame."""
        values = motion.translations.dense(), motion.rotations.dense()
        if self._first_pose is None:
            self._first_pose = values[0][0].copy(), values[1][0].copy()
        start = self._first_pose
        bone_lengths = np.linalg.norm(values[0], axis=2).max(axis=0)
        self.max_bone_lengths = np.maximum(self.max_bone_lengths, bone_lengths)
        max_displacement = np.abs(values[0] - start[0]).max(axis=(0, 2))
        quaternion_dots = np.abs((values[1] * start[1]).sum(axis=2)).min(axis=0)
        is_moving = max_displacement > STATIC_TOLERANCE * self.transfer.source.size
        is_moving |= quaternion_dots < 1 - STATIC_TOLERANCE
        self.moving_joints.update(np.flatnonzero(is_moving).tolist())

    def _plant_feet(
        self, legs: str, tracks: Sequence[LegTracks], feet: Sequence[Foot], fps: float
    ) -> PlacedFeet:
        """Return planted feet; store hip positions and knee swivels that reach them."""
        transfer = self.transfer
        up = up_index(transfer.target.rig)
        # The target's ground is the source's, scaled.
        ground_offsets = [
            foot.height - transfer.scale * foot.contacts.ground for foot in feet
        ]
        self._hips[:, up] += float(np.mean(ground_offsets))
        placed_feet = plant_feet(self._hips, feet, fps, up)
        self._hips, self._swivels = solve_within_limits(
            transfer.target, legs, tracks, placed_feet, fps
        )
        return placed_feet

    def _pose_frames(self, motion: Motion, legs: str) -> _PosedFrames:
        """Transfer frames to the target rig, before feet are planted."""
        transfer = self.transfer
        source, target = transfer.source, transfer.target
        local = motion.translations.dense(), motion.rotations.dense()
        positions = forward_kinematics(source.rig, *local).positions
        world = world_rotations(source.rig, local[1])
        rotations = twist_to_hinge_axes(transfer, transfer.rotations(world))
        limited_rotations = local_rotations(transfer, rotations)
        world_limited = limited_rotations.world
        bones = transfer.bones(world, local[0], world_limited)
        relative = relative_to_hips(target, world_limited, bones, limb_joints(target))
        hips = transfer.hips(positions)
        balls = np.zeros((len(positions), len(legs), 3))
        for k, side in enumerate(legs):
            balls[:, k] = ball_of_foot(source, side, positions, world)
        source_positions = transfer.to_target_axes(positions)
        balls = transfer.to_target_axes(balls)
        return _PosedFrames(
            source_positions, balls, limited_rotations, bones, relative, hips
        )

    @property
    def clamped_fractions(self) -> Mapping[int, float]:
        """Fraction of the frames so far in which limits clamp each joint."""
        counts = self._clamped_counts
        return {j: count / self._frame_count for j, count in counts.items()}

    def report(self) -> RetargetReport:
        """Return the fit report of the frames so far."""
        return self._meter.report(self.clamped_fractions)

    def verdict(self) -> Verdict:
        """Return whether the frames so far are usable, and which ones to check."""
        verdict = self._meter.verdict(self.clamped_fractions, self.ignored_errors)
        reasons = []
        if joints := self.stopped_by_rest_frame:
            reasons.append(VerdictReason("stopped by their limits", listed(joints)))
        scale = self.transfer.scale
        if not is_likely_scale(scale):
            text = f"{plain_number(scale)} times that of the take"
            reasons.append(VerdictReason("size", text))
        return verdict.with_reasons(reasons)

    @property
    def stopped_by_rest_frame(self) -> list[str]:
        """Names of joints at limits because the rest pose is a frame of the take."""
        if self.rest_frame is None:
            return []
        names = self.transfer.target.rig.names
        fractions = self.clamped_fractions
        return [names[j] for j in fractions if fractions[j] >= MIN_STOPPED_FRACTION]

    def blocks(self) -> Iterator[Motion]:
        """Yield the target's motion block by block; it can be read once."""
        rig = self.transfer.target.rig
        first_values: tuple[FloatArray, FloatArray] | None = None
        last_rotations: FloatArray | None = None
        twist_angles: FloatArray | None = None
        for clamped_frames, arrays in zip(
            self._clamped_blocks, self._spool.drain(), strict=True
        ):
            begin, count = self._frame_count, len(arrays[0])
            hips = self._hips[begin : begin + count]
            source, local, world, bones, relative_positions, balls = arrays
            rotations = LocalRotations(local, world, clamped_frames)
            rotations = self._solve_legs(rotations, hips, relative_positions, begin)
            rotations = self._solve_arms(rotations, begin)
            self._frame_count += count
            for j, is_clamped in rotations.clamped_frames.items():
                self._clamped_counts[j] += int(is_clamped.sum())
            local = rotations.local
            twist_angles = distribute_twist(self.transfer, local, twist_angles)
            root, root_path = root_translations(
                self.transfer.target, hips, rotations.world, bones, relative_positions
            )
            translations = np.broadcast_to(bones, (count, *bones.shape[1:])).copy()
            translations[:, root] = root_path
            local = so3.align_signs(local, last_rotations)
            last_rotations = local[-1]
            if first_values is None:
                first_values = translations[0].copy(), local[0].copy()
            # Motion from rounding alone is removed.
            for values, first_value in zip(
                (translations, local), first_values, strict=True
            ):
                is_static = np.abs(values - first_value) < ROUNDING_TOLERANCE
                np.copyto(values, first_value, where=is_static)
            world_pose = forward_kinematics(rig, translations, local)
            self._meter.add_frames(begin, world_pose, source, balls)
            yield Motion(
                self._animated_channel(translations, first_values[0]),
                self._animated_channel(local, first_values[1]),
            )

    def _animated_channel(
        self, values: FloatArray, first_values: FloatArray
    ) -> Channel:
        """Return a channel: static if the source is, else with all joints animated."""
        if not self._is_animated:
            return Channel.static(first_values, len(values))
        return Channel(first_values, np.arange(values.shape[1]), values)

    def _solve_legs(
        self,
        rotations: LocalRotations,
        hips: FloatArray,
        relative_positions: FloatArray,
        begin: int,
    ) -> LocalRotations:
        """Return rotations with legs that bring the feet to their placed positions."""
        target, placed_feet = self.transfer.target, self.contact_frames.placed_feet
        if placed_feet is None:
            return rotations
        legs = [leg_joints(target, side) for side in self.contact_frames.sides]
        frames = slice(begin, begin + len(hips))
        goals = [ankle[frames].copy() for ankle in placed_feet.ankles]
        rows = np.arange(len(hips))
        solution = self._solve_ankles(
            rotations, hips, relative_positions, goals, rows + begin
        )
        for _ in range(MAX_ANKLE_ITERATIONS - 1):
            # If a limit stops the foot, the ankle yields so that the toe stays.
            largest_error = np.zeros(len(rows))
            output_frames = rows + begin
            for k, (_, _, foot, _) in enumerate(legs):
                ball = target.balls.get(self.contact_frames.sides[k])
                if foot not in solution.clamped_frames or ball is None:
                    continue
                bone = ball.offset
                if ball.toe >= 0:
                    inverse_rotation = so3.conjugate(rotations.world[rows, foot])
                    toe = relative_positions[rows, ball.toe]
                    tip = toe - relative_positions[rows, foot]
                    bone = so3.rotate(inverse_rotation, tip)
                goal_rotations = placed_feet.rotations[k][output_frames]
                solved_rotations = solution.world[rows, foot]
                toe_error = so3.rotate(goal_rotations, bone)
                toe_error -= so3.rotate(solved_rotations, bone)
                toe_roll = placed_feet.toe_rolls[k][output_frames, None]
                goal = placed_feet.ankles[k][output_frames] + toe_roll * toe_error
                error = np.abs(goal - goals[k][rows]).max(axis=1)
                largest_error = np.maximum(largest_error, error)
                goals[k][rows] = goal
            rows = rows[largest_error > ANKLE_TOLERANCE * target.size]
            if not len(rows):
                break
            frame_goals = [goal[rows] for goal in goals]
            frame_state = rotations.select(rows), hips[rows], relative_positions[rows]
            correction = self._solve_ankles(*frame_state, frame_goals, rows + begin)
            solution.replace_frames(rows, correction)
        return solution

    def _solve_ankles(
        self,
        rotations: LocalRotations,
        hips: FloatArray,
        relative_positions: FloatArray,
        goals: Sequence[FloatArray],
        frames: IntArray,
    ) -> LocalRotations:
        """Return rotations with ankles at their goals and planted feet held."""
        target, placed_feet = self.transfer.target, self.contact_frames.placed_feet
        assert placed_feet is not None
        world = rotations.world.copy()
        changed_joints: set[int] = set()
        for k, side in enumerate(self.contact_frames.sides):
            leg = leg_joints(target, side)
            joints = hips[:, None] + relative_positions[:, leg[:3]]
            bone_rotations = world[:, leg[0]], world[:, leg[1]]
            world[:, leg[0]], world[:, leg[1]] = ankle_rotations(
                target, side, joints, goals[k], bone_rotations, self._swivels[k][frames]
            )
            world[:, leg[2]] = placed_feet.rotations[k][frames]
            changed_joints.update(leg[:3])
        return local_rotations(self.transfer, world, rotations, changed_joints)

    def _solve_arms(self, rotations: LocalRotations, begin: int) -> LocalRotations:
        """Return rotations with arms that bring the hands to their contacts."""
        changed_joints: set[int] = set()
        world = rotations.world.copy()
        frames = slice(begin, begin + len(world))
        for hand in self.contact_frames.hands:
            arm = arm_joints(self.transfer.target, hand.side)
            vectors = hand.bone_rotations[frames]
            if arm is None or not vectors.any():
                continue
            world[:, arm[:2]] = so3.multiply(so3.exp(vectors), world[:, arm[:2]])
            changed_joints.update(arm[:2])
        if not changed_joints:
            return rotations
        return local_rotations(self.transfer, world, rotations, changed_joints)


def _ankle_heights(
    transfer: Transfer, feet: Sequence[Foot], *, are_planted: bool
) -> AnkleHeights | None:
    """Return the mean ankle heights of planted feet; None if there are no feet."""
    if not feet:
        return None
    ground = float(np.mean([foot.contacts.ground for foot in feet]))
    if not are_planted:
        return AnkleHeights(ground, transfer.scale * ground)
    return AnkleHeights(ground, float(np.mean([foot.height for foot in feet])))


def split_blocks(motions: Iterable[Motion], block_size: int) -> Iterator[Motion]:
    """Yield a motion in blocks of a size [frames]; the last has the remainder."""
    buffered_blocks: list[Motion] = []
    frame_count = 0
    for motion in motions:
        start = 0
        while start < motion.frames:
            end = min(start + block_size - frame_count, motion.frames)
            buffered_blocks.append(motion.select(slice(start, end)))
            frame_count += end - start
            start = end
            if frame_count == block_size:
                yield Motion.concatenate(buffered_blocks)
                buffered_blocks, frame_count = [], 0
    if buffered_blocks:
        yield Motion.concatenate(buffered_blocks)


@dataclass(frozen=True, slots=True)
class Retargeted:
    """A retargeted take, with its fit report and the transfer and contacts used."""

    take: Take
    transfer: Transfer
    standing: ContactFrames
    report: RetargetReport

    @property
    def world(self) -> WorldTransforms:
        """World transforms of the target's joints."""
        return self.take.world()


def limb_joints(skeleton: RoledSkeleton) -> set[int]:
    """Return the joints that determine hips, legs and arms."""
    joints = {max(skeleton.first_joint("hips"), 0)}
    for side in "lr":
        joints.update(skeleton.leg(side) or (), arm_joints(skeleton, side) or ())
        joints.add(skeleton.first_joint(f"thigh_{side}"))
    return {joint for joint in joints if joint >= 0}


def build_transfer(
    source: Rig,
    target: Rig,
    joint_map: JointMap,
    rest: FloatArray | None = None,
    *,
    has_same_rest: bool = False,
) -> Transfer:
    """Return the transfer of poses from the rig of takes to a target rig.

    ``rest`` ``(J, 4)`` are local rotations of the source in its rest pose; None uses
    the rest pose of its rig. With ``has_same_rest``, both rigs rest in the same pose,
    whatever the bones look like.
    """
    skeletons = (
        RoledSkeleton.of(source, joint_map.source.roles, rest),
        RoledSkeleton.of(target, joint_map.target.roles),
    )
    return Transfer.of(*skeletons, joint_map, has_same_rest=has_same_rest)


def retarget_take(
    take: Take,
    rig: Rig,
    joint_map: JointMap,
    *,
    rest: FloatArray | None = None,
    lock: bool = True,
    hands: bool = False,
) -> Retargeted:
    """Retarget a take onto another rig, and report its fit.

    Args:
        take: The source.
        rig: The target.
        joint_map: Which joints follow which.
        rest: Local rotations of the source's joints in its rest pose ``(J, 4)``; None
            uses its rig's.
        lock: Whether planted feet stay in place.
        hands: Whether hands keep their contacts.
    """
    check_loaded(take, Take, "take")
    check_loaded(rig, Rig, "rig")
    transfer = build_transfer(take.rig, rig, joint_map, rest)
    fps = float(take.clock.rate)
    retargeting = Retargeting(
        transfer, joint_map, [take.motion], fps, lock=lock, hands=hands
    )
    motion = Motion.concatenate(list(retargeting.blocks())).map(Channel.compact)
    result = drive_take(replace(take, rig=rig, motion=motion))
    return Retargeted(
        result, transfer, retargeting.contact_frames, retargeting.report()
    )

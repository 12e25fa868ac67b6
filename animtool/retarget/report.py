"""Fit report: how well a take fits the rig it was retargeted onto."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.errors import Fault
from animtool.core.record import dataclass
from animtool.maths.runs import runs
from animtool.motion.contacts import FootContacts
from animtool.motion.scores import PassScores, Score, ScoreUnit
from animtool.retarget.feet import PlacedFeet
from animtool.retarget.hands import HandContact, arm_joints
from animtool.retarget.legs import ball_of_foot, leg_joints, up_index
from animtool.retarget.map import JointMap
from animtool.retarget.roled_skeleton import RoledSkeleton
from animtool.retarget.roles import FINGER_ROLES, MITTEN_ROLE, base_role
from animtool.retarget.transfer import Transfer
from animtool.retarget.verdict import Verdict, assess_take
from animtool.rig.kinematics import WorldTransforms

# Roles whose bones are compared, with the role at the end of each bone.
BONE_ENDS = {"upper_arm": "forearm", "forearm": "hand", "thigh": "shin", "shin": "foot"}


# Largest values of a good take; above these, viewers notice or the map is wrong.
MAX_DRIFT = 1e-3  # [m]
MAX_SOLE_ERROR = 1e-3  # [m]
MAX_REACH_ERROR = 0.01  # of the arm
MAX_BONE_ANGLE = np.radians(3.0)  # [rad]
MAX_ACCELERATION = 1.25  # of the source's
MAX_CLAMPED_FRACTION = 0.05  # of frames
# A heel farther from its goal than this fraction of the size has yielded [1].
MIN_HEEL_ERROR = 1e-4
MAX_UNMAPPED_FRACTION = 0.2  # of the source's joints


@dataclass(frozen=True, slots=True)
class RetargetReport:
    """Scores of how well a take fits its rig; NaN where a score has no data."""

    frames: int
    scale: float  # leg length of the target over that of the source
    pairs: int  # joints that follow a source joint
    contacts: float  # fraction of frames in which a foot is planted
    # Distance of planted feet from the middle of their contact [m].
    drift_mean: float
    drift_max: float
    source_drift_max: float  # largest drift of the source, scaled [m]
    sole_error: float  # largest height error of planted feet [m]
    penetration: float  # deepest sole below its planted height [m]
    # Largest error of the hands' distance from the shoulders, over the arm length.
    reach_error: float
    # Largest distance of hands in contact from their goal [m].
    hand_error: float
    # Angles between bones of both skeletons, without planted legs [rad].
    bone_angle_mean: float
    bone_angle_max: float
    # Largest acceleration over that of the source, scaled by the legs, or by the path
    # from the hips to the joint if that is longer.
    acceleration: float
    lowered: float  # largest distance that the hips sank so that legs reach [m]
    held: Mapping[str, float]  # fraction of frames in which limits stop each joint
    held_mean: float  # mean of these fractions over paired joints except fingers
    unmapped_source: tuple[str, ...]
    unmapped_target: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class ContactFrames:
    """Feet and hands in contact, and the frames of each contact."""

    sides: str  # sides of the legs that both skeletons have, such as "lr"
    contacts: Sequence[FootContacts]  # contacts of each of these feet
    placed_feet: PlacedFeet | None  # None if feet are not planted
    hands: Sequence[HandContact] = ()  # hands that keep their contacts


class FitMeter:
    """Measures how well a take fits its rig, block by block.

    ``contact_frames`` are the feet and hands in contact in all frames.
    """

    def __init__(
        self, transfer: Transfer, joint_map: JointMap, contact_frames: ContactFrames
    ) -> None:
        self._transfer, self._joint_map = transfer, joint_map
        self._contact_frames = contact_frames
        self._up = up_index(transfer.target.rig)
        self._frame_count = 0
        # Ankle and ball of each foot, of the target and of the source, scaled; the ball
        # is the ankle if it is unknown (F, 2, 2, 3).
        self._foot_blocks: list[list[FloatArray]] = [[] for _ in contact_frames.sides]
        self._angle_statistics = 0.0, 0, 0.0  # sum, count and largest [rad]
        self._reach_error, self._hand_error = math.nan, 0.0
        # Per-frame values by score.
        self._frame_values_by_score: dict[str, list[FloatArray]] = {}
        self._worst_by_frame: dict[str, FloatArray] = {}
        # Largest accelerations of both so far, and the last frames of both.
        self._max_accelerations = np.zeros(2)
        self._last_frames: list[FloatArray] = []
        pairs = joint_map.pairs
        target_lengths = transfer.target.chain_lengths[[pair.target for pair in pairs]]
        source_lengths = transfer.source.chain_lengths[[pair.source for pair in pairs]]
        source_lengths = np.maximum(source_lengths, transfer.source.size * 0.01)
        # A source without offsets has no lengths.
        path_ratios, is_known = np.zeros_like(target_lengths), source_lengths > 0
        np.divide(target_lengths, source_lengths, out=path_ratios, where=is_known)
        # Hands of arms that are longer relative to the legs move faster by that ratio.
        self._path_ratios = np.maximum(path_ratios, transfer.scale)[:, None]

    def add_frames(
        self, begin: int, world: WorldTransforms, source: FloatArray, balls: FloatArray
    ) -> None:
        """Measure the fit of the next block of frames, which starts at index ``begin``.

        ``world`` are the positions of the target's K joints in F frames, ``source``
        ``(F, J, 3)`` those of the source in the target's axes, and ``balls``
        ``(F, L, 3)`` those of the source's feet in these axes, all [m].
        """
        target = world.positions
        self._frame_count += len(target)
        frames = slice(begin, begin + len(target))
        for k, side in enumerate(self._contact_frames.sides):
            ball = ball_of_foot(self._transfer.target, side, target, world.rotations)
            foot_points = []
            for (skeleton, points, scale_factor), tip_position in zip(
                self._both_skeletons(target, source), (ball, balls[:, k]), strict=True
            ):
                ankle = points[:, leg_joints(skeleton, side)[2]]
                ankle_and_tip = np.stack([ankle, tip_position], axis=1)
                foot_points.append(scale_factor * ankle_and_tip)
            self._foot_blocks[k].append(np.stack(foot_points, axis=1))
        self._add_angles(frames, target, source)
        reach_errors = _reach_errors(self._both_skeletons(target, source))
        largest_error = np.fmax.reduce(reach_errors)
        self._reach_error = float(np.fmax(self._reach_error, largest_error))
        self._add_score("hands", reach_errors)
        for hand in self._contact_frames.hands:
            wrist = target[:, self._transfer.target.first_joint(f"hand_{hand.side}")]
            hand_errors = np.linalg.norm(wrist - hand.goal[frames], axis=1)
            largest_error = hand_errors[hand.is_active[frames]].max(initial=0.0)
            self._hand_error = max(self._hand_error, float(largest_error))
        pairs = self._joint_map.pairs
        joint_paths = [
            target[:, [pair.target for pair in pairs]],
            self._path_ratios * source[:, [pair.source for pair in pairs]],
        ]
        if self._last_frames:
            joint_paths = [
                np.concatenate(frame_blocks)
                for frame_blocks in zip(self._last_frames, joint_paths, strict=True)
            ]
        self._last_frames = [points[-2:].copy() for points in joint_paths]
        if len(joint_paths[0]) > 2:
            accelerations = [
                np.linalg.norm(np.diff(points, 2, axis=0), axis=2).max(
                    axis=1, initial=0
                )
                for points in joint_paths
            ]
            largest_of_block = [values.max(initial=0.0) for values in accelerations]
            maxima = np.maximum(self._max_accelerations, largest_of_block)
            self._max_accelerations = maxima
            self._add_score("acceleration", accelerations[0])

    def _add_score(self, score: str, values: FloatArray) -> None:
        """Append the per-frame values ``(F,)`` of a score in one block."""
        self._frame_values_by_score.setdefault(score, []).append(values)

    def _both_skeletons(
        self, target: FloatArray, source: FloatArray
    ) -> list[tuple[RoledSkeleton, FloatArray, float]]:
        """Return target and source skeleton, each with joint positions and scale."""
        transfer = self._transfer
        scaled_source = (transfer.source, source, transfer.scale)
        return [(transfer.target, target, 1.0), scaled_source]

    def _add_angles(
        self, frames: slice, target: FloatArray, source: FloatArray
    ) -> None:
        """Add the angles between corresponding bones, except those of planted legs."""
        contact_frames = self._contact_frames
        angle_sum, angle_count, largest_angle = self._angle_statistics
        angle_sums, angle_counts = np.zeros((2, len(target)))
        for side in "lr":
            for role, end_role in BONE_ENDS.items():
                directions = []
                for skeleton, points, _ in self._both_skeletons(target, source):
                    start_joint = skeleton.first_joint(f"{role}_{side}")
                    end_joint = skeleton.first_joint(f"{end_role}_{side}")
                    if min(start_joint, end_joint) >= 0 and skeleton.are_distinct(
                        start_joint, end_joint
                    ):
                        directions.append(points[:, end_joint] - points[:, start_joint])
                if len(directions) < 2:
                    continue
                a, b = directions
                cross_length = np.linalg.norm(np.cross(a, b), axis=1)
                cosine = (a * b).sum(axis=1)
                angle = np.arctan2(cross_length, cosine)
                frame_mask: BoolArray | slice = slice(None)
                if role in {"thigh", "shin"} and side in contact_frames.sides:
                    k = contact_frames.sides.index(side)
                    frame_mask = ~contact_frames.contacts[k].any[frames]
                angle = angle[frame_mask]
                angle_sums[frame_mask] += angle
                angle_counts[frame_mask] += 1
                angle_sum += float(angle.sum())
                angle_count += len(angle)
                largest_angle = max(largest_angle, float(angle.max(initial=0.0)))
        self._angle_statistics = angle_sum, angle_count, largest_angle
        self._add_score("limbs", angle_sums / np.maximum(angle_counts, 1))

    def _is_heel_raised(self, foot_index: int, ankle: FloatArray) -> BoolArray:
        """Return a mask of frames in which limits lift a planted heel ``(F,)``."""
        placed_feet = self._contact_frames.placed_feet
        contacts = self._contact_frames.contacts[foot_index]
        if placed_feet is None or not contacts.toe.any():
            return np.zeros(len(ankle), np.bool_)
        heel_distance = np.linalg.norm(ankle - placed_feet.ankles[foot_index], axis=1)
        min_distance = MIN_HEEL_ERROR * self._transfer.target.size
        return np.asarray(contacts.toe & (heel_distance > min_distance))

    def _keep_worst(self, score: str, values: FloatArray) -> None:
        """Merge per-frame values into a score; keep the larger value of each frame."""
        previous = self._worst_by_frame.get(score, values)
        self._worst_by_frame[score] = np.fmax(previous, values)

    def verdict(
        self, clamped_fractions: Mapping[int, float], ignored_errors: Sequence[Fault]
    ) -> Verdict:
        """Return whether the frames so far are usable, and which ones to check.

        ``clamped_fractions``: in which fraction of frames limits clamp each joint.
        Ignored errors were accepted on request.
        """
        report = self.report(clamped_fractions)
        values_by_score = {
            name: np.concatenate(blocks)
            for name, blocks in self._frame_values_by_score.items()
        } | self._worst_by_frame
        if "acceleration" in values_by_score:
            # Second differences belong to their middle frame.
            source_max_acceleration = max(float(self._max_accelerations[1]), 1e-300)
            acceleration_ratios = (
                values_by_score["acceleration"] / source_max_acceleration
            )
            values_by_score["acceleration"] = np.pad(acceleration_ratios, 1)
        source_values = {"drift": report.source_drift_max}
        return assess_take(
            fit_scores(report), values_by_score, source_values, ignored_errors
        )

    def report(self, clamped_fractions: Mapping[int, float]) -> RetargetReport:
        """Return the fit scores of the frames so far.

        ``clamped_fractions``: in which fraction of frames limits clamp each joint.
        """
        transfer, joint_map = self._transfer, self._joint_map
        contact_frames = self._contact_frames
        self._worst_by_frame.clear()
        all_drifts, source_drifts = [np.zeros(0)], [np.zeros(0)]
        max_sole_errors: list[float] = []
        depths: list[float] = []
        planted_fraction = 0.0
        for k, side in enumerate(contact_frames.sides):
            feet = np.concatenate(self._foot_blocks[k])
            contacts = contact_frames.contacts[k]
            planted_fraction += float(contacts.any.mean()) / len(contact_frames.sides)
            has_toe = side in transfer.target.balls
            has_both_balls = has_toe and side in transfer.source.balls
            is_heel_planted = contacts.ankle & ~self._is_heel_raised(k, feet[:, 0, 0])
            for joint, is_planted in enumerate((is_heel_planted, contacts.toe)):
                if joint == 0 or has_both_balls:
                    drift = _drift_in_contacts(feet[:, 0, joint], is_planted, self._up)
                    all_drifts.append(drift)
                    self._keep_worst("drift", drift)
                    source_mask = contacts.toe if joint else contacts.ankle
                    source_drifts.append(
                        _drift_in_contacts(feet[:, 1, joint], source_mask, self._up)
                    )
            sole_height = feet[:, 0, 1, self._up]
            is_flat = contacts.toe if has_toe else contacts.any
            if is_flat.any():
                ground_level = float(np.median(sole_height[is_flat]))
                if contact_frames.placed_feet is not None:
                    ground_level = contact_frames.placed_feet.sole_heights[k]
                sole_errors = np.where(is_flat, np.abs(sole_height - ground_level), 0.0)
                max_sole_errors.append(float(sole_errors.max()))
                self._keep_worst("soles", sole_errors)
                depths.append(ground_level - float(sole_height.min()))
        drift, source_drift = (
            values[~np.isnan(values)]
            for values in map(np.concatenate, (all_drifts, source_drifts))
        )
        angle_sum, angle_count, max_angle = self._angle_statistics
        acceleration, source_acceleration = self._max_accelerations.tolist()
        target_names, source_names = (
            transfer.target.rig.names,
            transfer.source.rig.names,
        )
        joints = transfer.target.rig.joints
        placed_feet = contact_frames.placed_feet
        return RetargetReport(
            self._frame_count,
            transfer.scale,
            len(joint_map.pairs),
            planted_fraction,
            float(drift.mean()) if len(drift) else math.nan,
            float(drift.max()) if len(drift) else math.nan,
            float(source_drift.max()) if len(source_drift) else math.nan,
            max(max_sole_errors, default=math.nan),
            max([0.0, *depths]) if depths else math.nan,
            self._reach_error,
            self._hand_error,
            angle_sum / angle_count if angle_count else math.nan,
            max_angle if angle_count else math.nan,
            acceleration / source_acceleration if source_acceleration > 0 else math.nan,
            0.0 if placed_feet is None else placed_feet.max_lowering,
            {target_names[j]: fraction for j, fraction in clamped_fractions.items()},
            _mean_clamped(joint_map, clamped_fractions),
            tuple(source_names[j] for j in joint_map.unmapped_source),
            tuple(
                target_names[j]
                for j in joint_map.unmapped_target
                if joints[j].driven is None
            ),
        )


def fit_scores(report: RetargetReport) -> PassScores:
    """Return the scores of a report, and the joints that they concern."""
    length, fraction = ScoreUnit.LENGTH, ScoreUnit.FRACTION
    unmapped_count, mean_clamped = len(report.unmapped_source), report.held_mean
    unmapped_fraction = unmapped_count / max(unmapped_count + report.pairs, 1)
    score_rows = (
        ("drift", report.drift_max, length, MAX_DRIFT, 0.0),
        ("soles", report.sole_error, length, MAX_SOLE_ERROR, 0.0),
        ("hands", report.reach_error, fraction, MAX_REACH_ERROR, 0.0),
        ("limbs", report.bone_angle_mean, ScoreUnit.ANGLE, MAX_BONE_ANGLE, 0.0),
        ("acceleration", report.acceleration, ScoreUnit.RATIO, MAX_ACCELERATION, 1.0),
        ("limits", mean_clamped, fraction, MAX_CLAMPED_FRACTION, 0.0),
        ("not mapped", unmapped_fraction, fraction, MAX_UNMAPPED_FRACTION, 0.0),
    )
    joints_by_description = {
        "stopped by their limits": tuple(report.held),
        "not mapped, of the source": report.unmapped_source,
        "not mapped, of the rig": report.unmapped_target,
    }
    return PassScores(
        tuple(Score(*value) for value in score_rows),
        {
            score_name: joints
            for score_name, joints in joints_by_description.items()
            if joints
        },
    )


def _mean_clamped(joint_map: JointMap, clamped_fractions: Mapping[int, float]) -> float:
    """Return the mean clamped fraction of frames over paired joints except fingers."""
    fingers = {*FINGER_ROLES, MITTEN_ROLE}
    joints = [p.target for p in joint_map.pairs if base_role(p.role) not in fingers]
    return sum(clamped_fractions.get(j, 0.0) for j in joints) / max(len(joints), 1)


def _drift_in_contacts(
    foot_positions: FloatArray, is_planted: BoolArray, up: int
) -> FloatArray:
    """Return ground distances from the middle of each contact ``(F,)`` [m].

    The distance is NaN while the foot is not planted.
    """
    ground_axes = [k for k in range(3) if k != up]
    drift = np.full(len(foot_positions), math.nan)
    for start, end in runs(is_planted):
        path = foot_positions[start:end][:, ground_axes]
        drift[start:end] = np.linalg.norm(path - path.mean(axis=0), axis=1)
    return drift


def _reach_errors(
    skeletons: Sequence[tuple[RoledSkeleton, FloatArray, float]],
) -> FloatArray:
    """Return the error of the hands' relative distance from the shoulders ``(F,)``.

    It is NaN unless both skeletons have a pair of arms.
    """
    largest_errors = np.full(len(skeletons[0][1]), math.nan)
    for side in "lr":
        arm_fractions = []
        for skeleton, points, _ in skeletons:
            arm = arm_joints(skeleton, side)
            if arm is None:
                continue
            arm_positions = points[:, arm]
            length = np.linalg.norm(np.diff(arm_positions[0], axis=0), axis=1).sum()
            if length > 0:
                arm_vectors = arm_positions[:, 2] - arm_positions[:, 0]
                arm_fractions.append(np.linalg.norm(arm_vectors, axis=1) / length)
        if len(arm_fractions) == 2:
            errors = np.abs(arm_fractions[0] - arm_fractions[1])
            largest_errors = np.fmax(largest_errors, errors)
    return largest_errors

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
from animtool.retarget.feet import Placed
from animtool.retarget.hands import HandContact
from animtool.retarget.legs import ball_of_foot, leg_of, up_index
from animtool.retarget.map import JointMap
from animtool.retarget.roled_skeleton import RoledSkeleton
from animtool.retarget.roles import FINGERS, MITTEN, base_role
from animtool.retarget.transfer import Transfer
from animtool.retarget.verdict import Verdict, verdict_of
from animtool.rig.kinematics import WorldTransforms

# Roles whose bones are compared, with the role that each ends at.
BONES = {
    "upper_arm": "forearm",
    "forearm": "hand",
    "thigh": "shin",
    "shin": "foot",
}


ARM = ("upper_arm", "forearm", "hand")

# Largest values of a good take; above, viewers notice or the map is wrong.
MAX_DRIFT = 1e-3  # [m]
MAX_SOLE_ERROR = 1e-3  # [m]
MAX_REACH_ERROR = 0.01  # of the arm
MAX_ANGLE = np.radians(3.0)  # [rad]
MAX_ACCELERATION = 1.25  # of the source's
MAX_CLAMPED = 0.05  # of frames
# A heel farther from its goal than this has yielded, over the size [1].
YIELDED_HEEL = 1e-4
MAX_UNMAPPED = 0.2  # of the source's joints


@dataclass(frozen=True, slots=True)
class RetargetReport:
    """How well a take fits its rig; a score without data is NaN."""

    frames: int
    scale: float  # lengths of the target's legs over those of the source's
    pairs: int  # joints that follow one of the source
    contacts: float  # fraction of frames in which a foot is planted
    # Distance of planted feet from the middle of their contact [m].
    drift_mean: float
    drift_max: float
    source_drift_max: float  # of the source, scaled
    sole_error: float  # largest height error of planted feet [m]
    penetration: float  # deepest sole below its planted height [m]
    # Of the distance of hands from shoulders, over the length of the arms, at most.
    reach_error: float
    # How far hands that hold each other, or stand, are from where they are to be, at
    # most [m].
    hand_error: float
    # Between bones of both, without planted feet [rad].
    bone_angle_mean: float
    bone_angle_max: float
    # The largest acceleration over that of the source, scaled as legs are, or as the
    # way from the hips to the joint where that is more.
    acceleration: float
    lowered: float  # most that the hips sank so that legs reach [m]
    held: Mapping[str, float]  # fraction of frames in which limits stop a joint
    held_mean: float  # its mean over the paired joints without fingers
    unmapped_source: tuple[str, ...]
    unmapped_target: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Standing:
    """Which feet and hands are in contact, and when."""

    sides: str  # of the legs that both skeletons have, such as "lr"
    contacts: Sequence[FootContacts]  # of each
    placed: Placed | None  # None if feet are not planted
    hands: Sequence[HandContact] = ()  # that keep their contacts


class FitMeter:
    """Accumulates the fit of a take, block by block.

    Args:
        transfer: How the rig follows.
        joint_map: Which joints follow which.
        standing: Which feet are planted, in all frames.
    """

    def __init__(
        self, transfer: Transfer, joint_map: JointMap, standing: Standing
    ) -> None:
        self._transfer, self._joint_map, self._standing = transfer, joint_map, standing
        self._up = up_index(transfer.target.rig)
        self._frames = 0
        # Ankle and ball of each foot, of the target and of the source, scaled; the ball
        # is the ankle where none is known (F, 2, 2, 3).
        self._feet: list[list[FloatArray]] = [[] for _ in standing.sides]
        self._angles = 0.0, 0, 0.0  # sum, count and largest [rad]
        self._reach, self._hand = math.nan, 0.0
        # Of each frame, by score.
        self._values: dict[str, list[FloatArray]] = {}
        self._worst: dict[str, FloatArray] = {}
        # The largest accelerations of both so far, and the last frames of both.
        self._fastest = np.zeros(2)
        self._last: list[FloatArray] = []
        target_lengths = transfer.target.path_lengths[
            [pair.target for pair in joint_map.pairs]
        ]
        source_lengths = transfer.source.path_lengths[
            [pair.source for pair in joint_map.pairs]
        ]
        source_lengths = np.maximum(source_lengths, transfer.source.size * 0.01)
        # A source without offsets has no lengths.
        ratios = np.divide(
            target_lengths,
            source_lengths,
            out=np.zeros_like(target_lengths),
            where=source_lengths > 0,
        )
        # Hands of arms that are longer, over the legs, go that much faster.
        self._sizes = np.maximum(ratios, transfer.scale)[:, None]

    def add(
        self, begin: int, world: WorldTransforms, source: FloatArray, balls: FloatArray
    ) -> None:
        """Add the next block of frames.

        Args:
            begin: The first of them.
            world: Of the target's F frames and K joints [m].
            source: Joints of the source, in the target's axes ``(F, J, 3)`` [m].
            balls: Those of the source's feet, in these axes ``(F, L, 3)`` [m].
        """
        target = world.positions
        self._frames += len(target)
        part = slice(begin, begin + len(target))
        for k, side in enumerate(self._standing.sides):
            ball = ball_of_foot(self._transfer.target, side, target, world.rotations)
            tips, rows = (ball, balls[:, k]), []
            for (skeleton, points, size), tip in zip(
                self._both(target, source), tips, strict=True
            ):
                ankle = points[:, leg_of(skeleton, side)[2]]
                rows.append(size * np.stack([ankle, tip], axis=1))
            self._feet[k].append(np.stack(rows, axis=1))
        self._add_angles(part, target, source)
        reach = _reach_errors(self._both(target, source))
        self._reach = float(np.fmax(self._reach, np.fmax.reduce(reach)))
        self._note("hands", reach)
        for hand in self._standing.hands:
            wrist = target[:, self._transfer.target.first(f"hand_{hand.side}")]
            off = np.linalg.norm(wrist - hand.goal[part], axis=1)[hand.active[part]]
            self._hand = max(self._hand, float(off.max(initial=0.0)))
        pairs = self._joint_map.pairs
        now = [
            target[:, [pair.target for pair in pairs]],
            self._sizes * source[:, [pair.source for pair in pairs]],
        ]
        if self._last:
            now = [np.concatenate(each) for each in zip(self._last, now, strict=True)]
        self._last = [each[-2:].copy() for each in now]
        if len(now[0]) > 2:
            sizes = [
                np.linalg.norm(np.diff(each, 2, axis=0), axis=2).max(axis=1, initial=0)
                for each in now
            ]
            self._fastest = np.maximum(
                self._fastest, [each.max(initial=0.0) for each in sizes]
            )
            self._note("acceleration", sizes[0])

    def _note(self, score: str, values: FloatArray) -> None:
        self._values.setdefault(score, []).append(values)

    def _both(
        self, target: FloatArray, source: FloatArray
    ) -> list[tuple[RoledSkeleton, FloatArray, float]]:
        """Return both skeletons with their positions and scale factors."""
        transfer = self._transfer
        return [
            (transfer.target, target, 1.0),
            (transfer.source, source, transfer.scale),
        ]

    def _add_angles(self, part: slice, target: FloatArray, source: FloatArray) -> None:
        """Add angles between bones of both skeletons; planted legs are left out."""
        standing = self._standing
        total, count, most = self._angles
        bends, counts = np.zeros((2, len(target)))
        for side in "lr":
            for role, end in BONES.items():
                directions = []
                for skeleton, points, _ in self._both(target, source):
                    first = skeleton.first(f"{role}_{side}")
                    last = skeleton.first(f"{end}_{side}")
                    if min(first, last) >= 0 and skeleton.separate(first, last):
                        directions.append(points[:, last] - points[:, first])
                if len(directions) < 2:
                    continue
                across = np.linalg.norm(np.cross(directions[0], directions[1]), axis=1)
                angle = np.arctan2(across, (directions[0] * directions[1]).sum(axis=1))
                if role in {"thigh", "shin"} and side in standing.sides:
                    k = standing.sides.index(side)
                    free = ~standing.contacts[k].any[part]
                    bends[free] += angle[free]
                    counts[free] += 1
                    angle = angle[free]
                else:
                    bends += angle
                    counts += 1
                total, count = total + float(angle.sum()), count + len(angle)
                most = max(most, float(angle.max(initial=0.0)))
        self._angles = total, count, most
        self._note("limbs", bends / np.maximum(counts, 1))

    def _raised(self, k: int, ankle: FloatArray) -> BoolArray:
        """Return where limits lift a heel whose toe is planted ``(F,)``."""
        placed, contacts = self._standing.placed, self._standing.contacts[k]
        if placed is None or not contacts.toe.any():
            return np.zeros(len(ankle), np.bool_)
        off = np.linalg.norm(ankle - placed.ankles[k], axis=1)
        return np.asarray(
            contacts.toe & (off > YIELDED_HEEL * self._transfer.target.size)
        )

    def _keep_worst(self, score: str, values: FloatArray) -> None:
        """Add per-frame values of a score; the worst of several is kept."""
        before = self._worst.get(score)
        self._worst[score] = values if before is None else np.fmax(before, values)

    def verdict(
        self, clamped: Mapping[int, float], forced: Sequence[Fault] = ()
    ) -> Verdict:
        """Return whether the frames so far are usable; see `report`.

        Args:
            clamped: Fraction of frames in which limits clamp each joint.
            forced: Errors ignored on request.
        """
        report = self.report(clamped)
        values = {
            name: np.concatenate(blocks) for name, blocks in self._values.items()
        } | self._worst
        if "acceleration" in values:
            # Second differences stand at the frame in their middle.
            fast = values["acceleration"] / max(float(self._fastest[1]), 1e-300)
            values["acceleration"] = np.pad(fast, 1)
        least = {"drift": report.source_drift_max}
        return verdict_of(scores_of(report), values, least, forced)

    def report(self, clamped: Mapping[int, float]) -> RetargetReport:
        """Return the fit of the frames so far.

        Args:
            clamped: Fraction of frames in which limits clamp each joint.
        """
        transfer, joint_map, standing = self._transfer, self._joint_map, self._standing
        self._worst.clear()
        drifts, others = [np.zeros(0)], [np.zeros(0)]
        soles: list[float] = []
        below: list[float] = []
        stands = 0.0
        for k, side in enumerate(standing.sides):
            feet, contacts = np.concatenate(self._feet[k]), standing.contacts[k]
            stands += float(contacts.any.mean()) / len(standing.sides)
            has_toe = side in transfer.target.balls
            both = has_toe and side in transfer.source.balls
            heel = contacts.ankle & ~self._raised(k, feet[:, 0, 0])
            for joint, mask in enumerate((heel, contacts.toe)):
                if joint == 0 or both:
                    drifts.append(_drift(feet[:, 0, joint], mask, self._up))
                    stood = contacts.toe if joint else contacts.ankle
                    others.append(_drift(feet[:, 1, joint], stood, self._up))
                    self._keep_worst("drift", drifts[-1])
            sole = feet[:, 0, 1, self._up]
            flat = contacts.toe if has_toe else contacts.any
            if flat.any():
                level = float(np.median(sole[flat]))
                if standing.placed is not None:
                    level = standing.placed.soles[k]
                soles.append(float(np.abs(sole[flat] - level).max()))
                self._keep_worst("soles", np.where(flat, np.abs(sole - level), 0.0))
                below.append(level - float(sole.min()))
        drift, source_drift = (
            each[~np.isnan(each)]
            for each in (np.concatenate(drifts), np.concatenate(others))
        )
        total, count, max_angle = self._angles
        fastest, source_fastest = self._fastest.tolist()
        names, source_names = transfer.target.rig.names, transfer.source.rig.names
        joints = transfer.target.rig.joints
        driven = {j for j, joint in enumerate(joints) if joint.driven is not None}
        placed = standing.placed
        return RetargetReport(
            self._frames,
            transfer.scale,
            len(joint_map.pairs),
            stands,
            float(drift.mean()) if len(drift) else math.nan,
            float(drift.max()) if len(drift) else math.nan,
            float(source_drift.max()) if len(source_drift) else math.nan,
            max(soles, default=math.nan),
            max([0.0, *below]) if below else math.nan,
            self._reach,
            self._hand,
            total / count if count else math.nan,
            max_angle if count else math.nan,
            fastest / source_fastest if source_fastest > 0 else math.nan,
            0.0 if placed is None else placed.lowered,
            {names[j]: fraction for j, fraction in clamped.items()},
            _mean_clamped(joint_map, clamped),
            tuple(source_names[j] for j in joint_map.unmapped_source),
            tuple(names[j] for j in joint_map.unmapped_target if j not in driven),
        )


def scores_of(report: RetargetReport) -> PassScores:
    """Return the scores by which takes are compared, and the joints they concern."""
    length, fraction = ScoreUnit.LENGTH, ScoreUnit.FRACTION
    lost, stopped = len(report.unmapped_source), report.held_mean
    values = (
        ("drift", report.drift_max, length, MAX_DRIFT, 0.0),
        ("soles", report.sole_error, length, MAX_SOLE_ERROR, 0.0),
        ("hands", report.reach_error, fraction, MAX_REACH_ERROR, 0.0),
        ("limbs", report.bone_angle_mean, ScoreUnit.ANGLE, MAX_ANGLE, 0.0),
        ("acceleration", report.acceleration, ScoreUnit.RATIO, MAX_ACCELERATION, 1.0),
        ("limits", stopped, fraction, MAX_CLAMPED, 0.0),
        ("not mapped", lost / max(lost + report.pairs, 1), fraction, MAX_UNMAPPED, 0.0),
    )
    names = {
        "stopped by their limits": tuple(report.held),
        "not mapped, of the source": report.unmapped_source,
        "not mapped, of the rig": report.unmapped_target,
    }
    return PassScores(
        tuple(Score(*value) for value in values),
        {what: joints for what, joints in names.items() if joints},
    )


def _mean_clamped(joint_map: JointMap, clamped: Mapping[int, float]) -> float:
    """Return the mean fraction of frames with a clamped joint, without fingers."""
    fingers = {*FINGERS, MITTEN}
    joints = [p.target for p in joint_map.pairs if base_role(p.role) not in fingers]
    return sum(clamped.get(j, 0.0) for j in joints) / max(len(joints), 1)


def _drift(points: FloatArray, stands: BoolArray, up: int) -> FloatArray:
    """Return ground distances from the middle of each contact ``(F,)`` [m].

    NaN while nothing is planted.
    """
    flat = [k for k in range(3) if k != up]
    drift = np.full(len(points), math.nan)
    for start, end in runs(stands):
        path = points[start:end][:, flat]
        drift[start:end] = np.linalg.norm(path - path.mean(axis=0), axis=1)
    return drift


def _reach_errors(
    both: Sequence[tuple[RoledSkeleton, FloatArray, float]],
) -> FloatArray:
    """Return how much relative hand distance from the shoulder differs ``(F,)``.

    NaN without a pair of arms.
    """
    worst = np.full(len(both[0][1]), math.nan)
    for side in "lr":
        shares = []
        for skeleton, points, _ in both:
            arm = [skeleton.first(f"{role}_{side}") for role in ARM]
            if min(arm) < 0:
                continue
            arms = points[:, arm]
            length = np.linalg.norm(np.diff(arms[0], axis=0), axis=1).sum()
            if length > 0:
                shares.append(np.linalg.norm(arms[:, 2] - arms[:, 0], axis=1) / length)
        if len(shares) == 2:
            worst = np.fmax(worst, np.abs(shares[0] - shares[1]))
    return worst

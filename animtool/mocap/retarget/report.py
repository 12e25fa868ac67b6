"""How well a take fits the skeleton that it was brought onto."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from animtool._types import BoolArray, FloatArray
from animtool.mocap.contacts import intervals
from animtool.mocap.retarget.map import JointMap
from animtool.mocap.retarget.motion import Retargeted
from animtool.scores import PassScores, Score, ScoreUnit
from animtool.units import UpAxis

# Roles whose bones are compared, with the role that each ends at.
BONES = {
    "upper_arm": "forearm",
    "forearm": "hand",
    "thigh": "shin",
    "shin": "foot",
}


ARM = ("upper_arm", "forearm", "hand")

# The most that a good take has; above these a viewer sees it, or the map is wrong.
USUAL_DRIFT = 1e-3  # [m]
USUAL_SOLE = 1e-3  # [m]
USUAL_REACH = 0.01  # of the arm
USUAL_ANGLE = np.radians(3.0)  # [rad]
USUAL_ACCELERATION = 1.25  # of the source's
USUAL_HELD = 0.2  # of frames
USUAL_UNMAPPED = 0.2  # of the source's joints


@dataclass(frozen=True, slots=True)
class RetargetReport:
    """What became of a take; of what there is none, values are 0."""

    frames: int
    scale: float  # lengths of the target's legs over those of the source's
    pairs: int  # joints that follow one of the source
    contacts: float  # share of frames in which a foot stands
    # How far what stands goes from the middle of where it stands [m].
    drift_mean: float
    drift_max: float
    source_drift_max: float  # of the source, scaled
    sole_error: float  # of the height of what stands, at most [m]
    penetration: float  # how far soles come below where they stand, at most [m]
    # Of the distance of hands from shoulders, over the length of the arms, at most.
    reach_error: float
    # Between bones of both, feet that stand apart [rad].
    bone_angle_mean: float
    bone_angle_max: float
    # The largest acceleration over that of the source, scaled.
    acceleration: float
    lowered: float  # how far the hips came down so that legs reach, at most [m]
    held: Mapping[str, float]  # share of frames in which limits stop a joint
    unmapped_source: tuple[str, ...]
    unmapped_target: tuple[str, ...]


def report_of(made: Retargeted, found: JointMap) -> RetargetReport:
    """Return how well a take fits."""
    transfer, world, source = made.transfer, made.world.positions, made.source.positions
    rig = made.take.rig
    up = 1 if rig.up is UpAxis.Y else 2
    drifts, others, soles, below = [np.zeros(0)], [np.zeros(0)], [0.0], [0.0]
    stands = np.zeros((len(world), 0), np.bool_)
    for k, side in enumerate(made.sides):
        leg, like = transfer.target.leg(side), transfer.source.leg(side)
        assert leg is not None
        assert like is not None
        contacts = made.contacts[k]
        stands = np.concatenate([stands, contacts.any[:, None]], axis=1)
        for own, other, mask in (
            (leg[2], like[2], contacts.ankle),
            (leg[3], like[3], contacts.toe),
        ):
            if own < 0 or other < 0:
                continue
            points, scaled = world[:, own], transfer.scale * source[:, other]
            drifts.append(_drift(points, mask, up))
            others.append(_drift(scaled, mask, up))
        sole = world[:, leg[3] if leg[3] >= 0 else leg[2], up]
        flat = contacts.toe if leg[3] >= 0 else contacts.any
        if flat.any():
            level = float(np.median(sole[flat]))
            if made.placed is not None:
                level = made.placed.soles[k]
            soles.append(float(np.abs(sole[flat] - level).max()))
            below.append(level - float(sole.min()))
    drift, theirs = np.concatenate(drifts), np.concatenate(others)
    angles = _angles(made, stands)
    names, ours = rig.names, transfer.source.rig.names
    return RetargetReport(
        len(world),
        transfer.scale,
        len(found.pairs),
        float(stands.mean()) if stands.size else 0.0,
        float(drift.mean()) if len(drift) else 0.0,
        float(drift.max(initial=0.0)),
        float(theirs.max(initial=0.0)),
        max(soles),
        max(below),
        _reach_error(made),
        float(angles.mean()) if len(angles) else 0.0,
        float(angles.max(initial=0.0)),
        _acceleration(made, found),
        0.0 if made.placed is None else made.placed.lowered,
        {names[j]: share for j, share in made.clamped.items()},
        tuple(ours[j] for j in found.unmapped_source),
        tuple(names[j] for j in found.unmapped_target),
    )


def scores_of(report: RetargetReport) -> PassScores:
    """Return the numbers by which takes are compared, and the joints they concern."""
    length, share = ScoreUnit.LENGTH, ScoreUnit.SHARE
    lost, most = len(report.unmapped_source), max(report.held.values(), default=0.0)
    values = (
        ("drift", report.drift_max, length, USUAL_DRIFT, 0.0),
        ("soles", report.sole_error, length, USUAL_SOLE, 0.0),
        ("hands", report.reach_error, share, USUAL_REACH, 0.0),
        ("limbs", report.bone_angle_mean, ScoreUnit.ANGLE, USUAL_ANGLE, 0.0),
        ("acceleration", report.acceleration, ScoreUnit.RATIO, USUAL_ACCELERATION, 1.0),
        ("limits", most, share, USUAL_HELD, 0.0),
        ("not mapped", lost / max(lost + report.pairs, 1), share, USUAL_UNMAPPED, 0.0),
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


def _drift(points: FloatArray, stands: BoolArray, up: int) -> FloatArray:
    """Return distances on the ground from the middle of each contact [m]."""
    flat = [k for k in range(3) if k != up]
    rows = [np.zeros(0)]
    for start, end in intervals(stands):
        own = points[start:end][:, flat]
        rows.append(np.linalg.norm(own - own.mean(axis=0), axis=1))
    return np.concatenate(rows)


def _angles(made: Retargeted, stands: BoolArray) -> FloatArray:
    """Return angles between bones of both, legs that stand left out [rad]."""
    transfer, rows = made.transfer, [np.zeros(0)]
    for side in "lr":
        for role, end in BONES.items():
            ways = []
            for person, points in (
                (transfer.target, made.world.positions),
                (transfer.source, made.source.positions),
            ):
                first = person.first(f"{role}_{side}")
                last = person.first(f"{end}_{side}")
                if min(first, last) >= 0:
                    ways.append(points[:, last] - points[:, first])
            if len(ways) < 2:
                continue
            across = np.linalg.norm(np.cross(ways[0], ways[1]), axis=1)
            angle = np.arctan2(across, (ways[0] * ways[1]).sum(axis=1))
            if role in {"thigh", "shin"} and side in made.sides:
                angle = angle[~stands[:, made.sides.index(side)]]
            rows.append(angle)
    return np.concatenate(rows)


def _reach_error(made: Retargeted) -> float:
    """Return how far the share of the arm that a hand is off differs, at most."""
    worst = 0.0
    for side in "lr":
        shares = []
        for person, points in (
            (made.transfer.target, made.world.positions),
            (made.transfer.source, made.source.positions),
        ):
            arm = [person.first(f"{role}_{side}") for role in ARM]
            if min(arm) < 0:
                continue
            own = points[:, arm]
            length = np.linalg.norm(np.diff(own[0], axis=0), axis=1).sum()
            if length > 0:
                shares.append(np.linalg.norm(own[:, 2] - own[:, 0], axis=1) / length)
        if len(shares) == 2:
            worst = max(worst, float(np.abs(shares[0] - shares[1]).max(initial=0.0)))
    return worst


def _acceleration(made: Retargeted, found: JointMap) -> float:
    """Return the largest acceleration of joints over that of the source, scaled."""
    if len(made.world.positions) < 3:
        return 0.0
    own = made.world.positions[:, [pair.target for pair in found.pairs]]
    other = made.source.positions[:, [pair.source for pair in found.pairs]]
    sizes = [
        float(np.linalg.norm(np.diff(each, 2, axis=0), axis=2).max())
        for each in (own, made.transfer.scale * other)
    ]
    return sizes[0] / sizes[1] if sizes[1] > 0 else 0.0

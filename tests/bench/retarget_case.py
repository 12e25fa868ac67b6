"""What a tool is to retarget: two skeletons, a take, and targets in each frame.

Skeletons face the same way, Y up. The targets are those of a plain copy: limbs at rest
are aligned, rotations in the world follow the source, and hips and ankles go where
those of the source are, scaled by the length of the legs.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from animtool import open_source
from animtool.maths import so3
from animtool.retarget import JointPair, map_joints
from animtool.rig.file import load_rig
from animtool.rig.kinematics import WorldTransforms, forward_kinematics, rest_world
from animtool.rig.limits import RangeLimit
from animtool.rig.skeleton import JointType, Rig

# Bones of these roles point as those of the source do, and end at the joint of a role.
LIMBS = {
    "upper_arm": "forearm",
    "forearm": "hand",
    "thigh": "shin",
    "shin": "foot",
}
# A rig whose lowest point is nearer to the ground rests on it [m].
GROUNDED = 0.01


@dataclass(frozen=True)
class Case:
    """What is asked of a tool.

    Attributes:
        source: Rig of the take.
        target: Rig that it goes onto.
        follows: Joint of the source for each of the target's, or -1 ``(K,)``.
        aligned: Rotations of the target in the world as the source rests ``(K, 4)``.
        scale: Length of the target's legs over that of the source's.
        ankles, toes: Joints of the target, left and right.
        toe_height: Of a toe above the ground where the foot stands [m].
        rotations: Of the source, local ``(F, J, 4)``.
        root: Translations of its root ``(F, 3)`` [m].
        source_positions: Of its joints ``(F, J, 3)`` [m].
        turns: Targets in the world ``(F, K, 4)``.
        fps: Frames a second.
    """

    source: Rig
    target: Rig
    follows: np.ndarray
    aligned: np.ndarray
    scale: float
    ankles: list[int]
    toes: list[int]
    toe_height: float
    rotations: np.ndarray
    root: np.ndarray
    source_positions: np.ndarray
    turns: np.ndarray
    fps: float

    def lists(self) -> dict[str, Any]:
        """Return the case for JSON."""
        arrays = {
            "follows": self.follows,
            "aligned": self.aligned,
            "rotations": self.rotations,
            "root": self.root,
            "turns": self.turns,
            "hips": self.scale * self.source_positions[:, self.follows[0]],
            "feet": self.scale * self.source_positions[:, self.follows[self.ankles]],
        }
        return {
            **{name: array.tolist() for name, array in arrays.items()},
            "source": _skeleton(self.source),
            "target": _skeleton(self.target),
            "ankles": self.ankles,
            "scale": self.scale,
            "fps": self.fps,
        }


def _skeleton(rig: Rig) -> list[dict[str, Any]]:
    """Return each joint of a rig: parent, offset, rest rotation, and how it turns."""
    return [
        {
            "parent": int(rig.parents[j]),
            "offset": rig.rest_translations[j].tolist(),
            "rest": rig.rest_rotations[j].tolist(),
            "pin": list(joint.axis) if joint.type is JointType.PIN else None,
            "limits": [joint.limits.low, joint.limits.high]
            if isinstance(joint.limits, RangeLimit)
            else None,
        }
        for j, joint in enumerate(rig.joints)
    ]


def case_of(path: Path, target: Path) -> Case:
    """Return the case of a take and a target, a rig file or a BVH."""
    take = open_source(path).collect()
    bvh = target.suffix == ".bvh"
    rig = open_source(target).collect().rig if bvh else load_rig(target)
    source, motion = take.rig, take.motion
    pairs = map_joints(source, rig)
    follows = np.full(len(rig.joints), -1)
    for pair in pairs.pairs:
        follows[pair.target] = pair.source
    ours, theirs = rest_world(source), rest_world(rig)
    legs, roles = [], {pair.role: pair for pair in pairs.pairs}
    aligned = theirs.rotations[0].copy()
    for side in "lr":
        for role, end in LIMBS.items():
            first, last = roles[f"{role}_{side}"], roles[f"{end}_{side}"]
            bone = theirs.positions[0, last.target] - theirs.positions[0, first.target]
            other = ours.positions[0, last.source] - ours.positions[0, first.source]
            if role in {"thigh", "shin"}:
                legs.append([np.linalg.norm(bone), np.linalg.norm(other)])
            change = so3.shortest_rotation(
                bone / np.linalg.norm(bone), other / np.linalg.norm(other)
            )
            # A hand and its fingers go with the forearm.
            for j in _below(rig, first.target) if role == "forearm" else [first.target]:
                aligned[j] = so3.multiply(change, theirs.rotations[0, j])
    own, others = np.sum(legs, axis=0)
    rotations, translations = motion.rotations.dense(), motion.translations.dense()
    world = forward_kinematics(source, translations, rotations)
    moved = so3.multiply(world.rotations, so3.conjugate(ours.rotations[0]))
    feet = [roles[f"foot_{side}"] for side in "lr"]
    toes = [roles[f"toe_{side}"] for side in "lr"]
    return Case(
        source,
        rig,
        follows,
        aligned,
        float(own / others),
        [pair.target for pair in feet],
        [pair.target for pair in toes],
        _toe_height(rig, world.positions, feet[0], toes[0], ours, theirs),
        rotations,
        translations[:, 0],
        world.positions,
        so3.multiply(moved[:, np.maximum(follows, 0)], aligned),
        float(take.clock.fps),
    )


def _toe_height(
    rig: Rig,
    positions: np.ndarray,
    foot: JointPair,
    toe: JointPair,
    source: WorldTransforms,
    target: WorldTransforms,
) -> float:
    """Return how high a toe of the target is where the foot stands [m].

    A rig that rests on the ground shows it. Else it is that of the source, lowest in
    the take, by the lengths of the feet.
    """
    rest, turns = target.positions[0], target.rotations[0]
    tips = [
        rest[j] + so3.rotate(turns[j], np.array(tip))
        for j, joint in enumerate(rig.joints)
        for tip in joint.tips
    ]
    low = min(float(point[1]) for point in [*rest, *tips])
    if abs(low) < GROUNDED:
        return float(rest[toe.target, 1])
    own = np.linalg.norm(rest[toe.target] - rest[foot.target])
    bone = source.positions[0, toe.source] - source.positions[0, foot.source]
    return float(positions[:, toe.source, 1].min() * own / np.linalg.norm(bone))


def _below(rig: Rig, joint: int) -> list[int]:
    """Return a joint and all below it."""
    joints = [joint]
    for j, parent in enumerate(rig.parents.tolist()):
        if parent in joints:
            joints.append(j)
    return joints


def measures(
    case: Case, contacts: np.ndarray, positions: np.ndarray
) -> dict[str, float]:
    """Return what feet and joints of a result do.

    Args:
        case: What was asked.
        contacts: When each foot stands ``(F, 2)``.
        positions: Of joints ``(F, K, 3)`` [m].
    """
    drifts, soles = [], []
    for stands, ankle, toe in zip(contacts.T, case.ankles, case.toes, strict=True):
        edges = np.flatnonzero(np.diff(np.concatenate([[0], stands, [0]]).astype(int)))
        for first, last in edges.reshape(-1, 2):
            ground = positions[first:last, ankle][:, [0, 2]]
            drifts.append(np.linalg.norm(ground - ground.mean(axis=0), axis=1))
        soles.append(positions[stands, toe, 1] - case.toe_height)
    drift, sole = np.concatenate(drifts), np.concatenate(soles)
    # Of the joints that follow one: others have no measure of their own.
    follows = case.follows >= 0
    bent = np.diff(positions[:, follows], 2, axis=0)
    source = np.diff(case.source_positions[:, case.follows[follows]], 2, axis=0)
    most = [np.linalg.norm(each, axis=2).max() for each in (bent, source)]
    return {
        "mean drift [mm]": 1e3 * float(drift.mean()),
        "largest drift [mm]": 1e3 * float(drift.max()),
        "mean sole height [mm]": 1e3 * float(sole.mean()),
        "largest sole height [mm]": 1e3 * float(np.abs(sole).max()),
        "acceleration / source [x]": float(most[0] / (most[1] * case.scale)),
    }

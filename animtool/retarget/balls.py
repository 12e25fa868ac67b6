"""Finds the balls of feet, which feet roll over, for any number of toes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.retarget.roled_skeleton import Ball, RoledSkeleton
from animtool.retarget.roles import END

# Feet shorter than this fraction of the leg are ignored [1].
MIN_FOOT_LENGTH = 0.04
# Cosine to the shin above which the end of a foot is its heel or the ground [1].
MIN_SHIN_COSINE = 0.97
# A toe chain that begins within this fraction of its length of the ankle has a
# metatarsal [1].
METATARSAL_START = 0.15


def find_balls(
    skeleton: RoledSkeleton, other_skeleton: RoledSkeleton
) -> dict[str, Ball]:
    """Return the ball of each foot of a skeleton, by side.

    The ball is where the toes begin: the middle of the foremost toe joints. A foot
    without toes ends in its ball or in its toe tip, whichever fits the other skeleton's
    foot better. A foot without an end joint takes the other skeleton's ball, scaled.
    A foot is left out if neither skeleton shows its ball.
    """
    ball_by_side = {}
    for side in "lr":
        leg, other_leg = skeleton.leg(side), other_skeleton.leg(side)
        if leg is None:
            continue
        foot, toes = leg[2], _first_toe_joints(skeleton, side)
        if toes:
            ankle_to_ball = _ankle_to_ball(skeleton, foot, toes)
        else:
            other_shape = (
                None if other_leg is None else _foot_shape(other_skeleton, side)
            )
            leg_ratio = skeleton.leg_length(side) / (
                other_skeleton.leg_length(side) or 1.0
            )
            toeless_ball = _toeless_ball(skeleton, side, other_shape, leg_ratio)
            if toeless_ball is None:
                continue
            ankle_to_ball = toeless_ball
        offset = so3.rotate(so3.conjugate(skeleton.rotations[foot]), ankle_to_ball)
        ball_by_side[side] = Ball(toes[0] if len(toes) == 1 else -1, offset)
    return ball_by_side


def _first_toe_joints(skeleton: RoledSkeleton, side: str) -> list[int]:
    """Return the first joint of each toe of a foot."""
    joints = {j for j, role in enumerate(skeleton.roles) if role == f"toe_{side}"}
    parents = skeleton.rig.parents
    first_joints = []
    for first_joint in sorted(j for j in joints if int(parents[j]) not in joints):
        toe_chain = [j for j in joints if first_joint in skeleton.rig.upwards(j)]
        foot = skeleton.positions[skeleton.first_joint(f"foot_{side}")]
        length = float(np.linalg.norm(skeleton.positions[max(toe_chain)] - foot))
        distance = float(np.linalg.norm(skeleton.positions[first_joint] - foot))
        next_joints = [j for j in toe_chain if int(parents[j]) == first_joint]
        has_metatarsal = next_joints and distance < METATARSAL_START * length
        first_joints.append(next_joints[0] if has_metatarsal else first_joint)
    return first_joints


def _ankle_to_ball(
    skeleton: RoledSkeleton, foot: int, toes: Sequence[int]
) -> FloatArray:
    """Return the vector from the ankle to the ball of the toe joints ``(3,)`` [m]."""
    offsets = skeleton.positions[list(toes)] - skeleton.positions[foot]
    facing_axes = skeleton.facing_axes
    if len(offsets) == 1 or facing_axes is None:
        return np.asarray(offsets.mean(axis=0))
    foremost_offset = offsets[int(np.argmax(offsets @ facing_axes[2]))]
    sideways_offset = float((offsets.mean(axis=0) - foremost_offset) @ facing_axes[0])
    return np.asarray(foremost_offset + sideways_offset * facing_axes[0])


@dataclass(frozen=True, slots=True)
class _FootShape:
    """Vectors from the ankle of a foot at rest; components left, up, forward [m]."""

    ball: FloatArray | None  # where toes begin (3,); None if it has no toes
    tip: FloatArray | None  # the farthest end of the foot (3,)


def _foot_shape(skeleton: RoledSkeleton, side: str) -> _FootShape | None:
    """Return the shape of a foot; None if the skeleton's facing is unknown."""
    facing_axes = skeleton.facing_axes
    foot = skeleton.first_joint(f"foot_{side}")
    toes = _first_toe_joints(skeleton, side)
    if facing_axes is None:
        return None
    ankle = skeleton.positions[foot]
    tip = _vector_to_tip(skeleton, toes or [foot], ankle)
    ball = _ankle_to_ball(skeleton, foot, toes) if toes else None
    return _FootShape(
        *(None if offset is None else facing_axes @ offset for offset in (ball, tip))
    )


def _vector_to_tip(
    skeleton: RoledSkeleton, joints: Sequence[int], ankle: FloatArray
) -> FloatArray | None:
    """Return the vector from an ankle to the farthest end of a joint chain, or None."""
    rig = skeleton.rig
    all_joints, top_joints = range(len(rig.joints)), {*joints}
    descendants = [j for j in all_joints if not top_joints.isdisjoint(rig.upwards(j))]
    end_offsets = [skeleton.positions[j] - ankle for j in descendants]
    for j in descendants:
        end_offsets += [
            skeleton.positions[j]
            + so3.rotate(skeleton.rotations[j], np.asarray(tip))
            - ankle
            for tip in rig.joints[j].tips
        ]
    return max(end_offsets, key=lambda offset: float(offset @ offset), default=None)


def _toeless_ball(
    skeleton: RoledSkeleton, side: str, other_shape: _FootShape | None, leg_ratio: float
) -> FloatArray | None:
    """Return the vector from the ankle to the ball of a foot without toes ``(3,)``."""
    leg = skeleton.leg(side)
    assert leg is not None
    ankle = skeleton.positions[leg[2]]
    tip = _foot_end(skeleton, leg, ankle)
    facing_axes = skeleton.facing_axes
    if facing_axes is None or other_shape is None or other_shape.ball is None:
        return tip
    if tip is None:
        return np.asarray(leg_ratio * (other_shape.ball @ facing_axes))
    if other_shape.tip is None:
        return tip
    other_lengths = [
        float(np.linalg.norm(v)) for v in (other_shape.ball, other_shape.tip)
    ]
    if not 0 < other_lengths[0] < other_lengths[1]:
        return tip
    geometric_mean = leg_ratio * float(np.sqrt(other_lengths[0] * other_lengths[1]))
    if float(np.linalg.norm(tip)) <= geometric_mean:
        return tip
    # It ends where the other foot's toes end.
    tip_in_axes = facing_axes @ tip
    fractions = [
        a / b if abs(b) > MIN_FOOT_LENGTH * other_lengths[1] else 1.0
        for a, b in zip(other_shape.ball, other_shape.tip, strict=True)
    ]
    return np.asarray((tip_in_axes * np.clip(fractions, 0.0, 1.0)) @ facing_axes)


def _foot_end(
    skeleton: RoledSkeleton, leg: tuple[int, int, int, int], ankle: FloatArray
) -> FloatArray | None:
    """Return the vector from the ankle to the end of a toeless foot, or None."""
    rig, (_, shin, foot, _) = skeleton.rig, leg
    rotation = skeleton.rotations[foot]
    offsets = [so3.rotate(rotation, np.asarray(tip)) for tip in rig.joints[foot].tips]
    offsets += [
        skeleton.positions[j] - ankle
        for j, parent in enumerate(rig.parents.tolist())
        if parent == foot and skeleton.roles[j] == END
    ]
    farthest_offset = max(
        offsets, key=lambda offset: float(offset @ offset), default=None
    )
    shin_bone = ankle - skeleton.positions[shin]
    if farthest_offset is None:
        return None
    length, shin_length = map(float, map(np.linalg.norm, (farthest_offset, shin_bone)))
    if length < MIN_FOOT_LENGTH * shin_length:
        return None
    cosine = float(farthest_offset @ shin_bone) / (length * shin_length)
    return None if cosine > MIN_SHIN_COSINE else np.asarray(farthest_offset)

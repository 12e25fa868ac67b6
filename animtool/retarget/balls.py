"""Balls of feet: where a foot rolls, for any number of toes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.retarget.roled_skeleton import Ball, RoledSkeleton
from animtool.retarget.roles import END

# A foot end nearer to its ankle than this fraction of the leg is ignored [1].
SHORT = 0.04
# Cosine to the shin above which a foot's end is its heel, or the ground [1].
ALONG_SHIN = 0.97
# A toe that begins this near to the ankle, over its length, has a metatarsal [1].
AT_ANKLE = 0.15


def balls_of(skeleton: RoledSkeleton, other: RoledSkeleton) -> dict[str, Ball]:
    """Return the ball of each foot of a skeleton, by side.

    It is where the toes begin: the middle of the foremost ones. A foot without toes
    ends in its ball or in its toe tip, whichever fits the other skeleton's foot better.
    A foot without a visible end takes the other's ball, scaled. Feet without any data
    have none.
    """
    balls = {}
    for side in "lr":
        leg, theirs = skeleton.leg(side), other.leg(side)
        if leg is None:
            continue
        foot, toes = leg[2], _toes(skeleton, side)
        if toes:
            vector = _roll(skeleton, foot, toes)
        else:
            known = None if theirs is None else _shape(other, side)
            size = skeleton.leg_length(side) / (other.leg_length(side) or 1.0)
            end = _toeless(skeleton, side, known, size)
            if end is None:
                continue
            vector = end
        offset = so3.rotate(so3.conjugate(skeleton.rotations[foot]), vector)
        balls[side] = Ball(toes[0] if len(toes) == 1 else -1, offset)
    return balls


def ball_positions(
    ball: Ball, foot: int, positions: FloatArray, rotations: FloatArray
) -> FloatArray:
    """Return the ball's position ``(F, 3)`` [m] from world joints ``(F, J, …)``."""
    if ball.toe >= 0:
        return positions[:, ball.toe]
    return np.asarray(positions[:, foot] + so3.rotate(rotations[:, foot], ball.offset))


def _toes(skeleton: RoledSkeleton, side: str) -> list[int]:
    """Return the first joint of each toe of a foot."""
    joints = {j for j, role in enumerate(skeleton.roles) if role == f"toe_{side}"}
    parents = skeleton.rig.parents
    starts = []
    for top in sorted(j for j in joints if int(parents[j]) not in joints):
        ends = [j for j in joints if top in skeleton.rig.upwards(j)]
        foot = skeleton.positions[_foot(skeleton, side)]
        length = float(np.linalg.norm(skeleton.positions[max(ends)] - foot))
        near = float(np.linalg.norm(skeleton.positions[top] - foot))
        below = [j for j in ends if int(parents[j]) == top]
        starts.append(below[0] if below and near < AT_ANKLE * length else top)
    return starts


def _roll(skeleton: RoledSkeleton, foot: int, toes: Sequence[int]) -> FloatArray:
    """Return the vector from the ankle to the ball, from toe joints ``(3,)`` [m]."""
    offsets = skeleton.positions[list(toes)] - skeleton.positions[foot]
    facing = skeleton.facing
    if len(offsets) == 1 or facing is None:
        return np.asarray(offsets.mean(axis=0))
    first = offsets[int(np.argmax(offsets @ facing[2]))]
    across = float((offsets.mean(axis=0) - first) @ facing[0])
    return np.asarray(first + across * facing[0])


def _foot(skeleton: RoledSkeleton, side: str) -> int:
    return skeleton.first(f"foot_{side}")


@dataclass(frozen=True, slots=True)
class _Shape:
    """A foot at rest: left, up and forward components from the ankle [m]."""

    ball: FloatArray | None  # where toes begin (3,)
    tip: FloatArray | None  # where the last of it ends (3,)


def _shape(skeleton: RoledSkeleton, side: str) -> _Shape | None:
    """Return the known shape of a foot; None if the skeleton's facing is unknown."""
    facing, foot, toes = skeleton.facing, _foot(skeleton, side), _toes(skeleton, side)
    if facing is None:
        return None
    start = skeleton.positions[foot]
    tip = _tip(skeleton, toes or [foot], start)
    ball = _roll(skeleton, foot, toes) if toes else None
    return _Shape(
        *(None if offset is None else facing @ offset for offset in (ball, tip))
    )


def _tip(
    skeleton: RoledSkeleton, joints: Sequence[int], start: FloatArray
) -> FloatArray | None:
    """Return the vector to the farthest end of a joint chain ``(3,)``."""
    rig = skeleton.rig
    count, tops = len(rig.joints), {*joints}
    below = [j for j in range(count) if not tops.isdisjoint(rig.upwards(j))]
    offsets = [skeleton.positions[j] - start for j in below]
    for j in below:
        offsets += [
            skeleton.positions[j]
            + so3.rotate(skeleton.rotations[j], np.asarray(tip))
            - start
            for tip in rig.joints[j].tips
        ]
    return max(offsets, key=lambda offset: float(offset @ offset), default=None)


def _toeless(
    skeleton: RoledSkeleton, side: str, other: _Shape | None, size: float
) -> FloatArray | None:
    """Return the vector from the ankle to the ball of a foot without toes ``(3,)``."""
    leg = skeleton.leg(side)
    assert leg is not None
    start = skeleton.positions[leg[2]]
    tip = _foot_end(skeleton, leg, start)
    facing = skeleton.facing
    if facing is None or other is None or other.ball is None:
        return tip
    if tip is None:
        return np.asarray(size * (other.ball @ facing))
    if other.tip is None:
        return tip
    lengths = [float(np.linalg.norm(offset)) for offset in (other.ball, other.tip)]
    if not 0 < lengths[0] < lengths[1]:
        return tip
    between = size * float(np.sqrt(lengths[0] * lengths[1]))
    if float(np.linalg.norm(tip)) <= between:
        return tip
    # It ends where the other foot's toes do.
    end = facing @ tip
    shares = [
        a / b if abs(b) > SHORT * lengths[1] else 1.0
        for a, b in zip(other.ball, other.tip, strict=True)
    ]
    return np.asarray((end * np.clip(shares, 0.0, 1.0)) @ facing)


def _foot_end(
    skeleton: RoledSkeleton, leg: tuple[int, int, int, int], start: FloatArray
) -> FloatArray | None:
    """Return the vector to the end of a foot without toes ``(3,)``; None if unknown."""
    rig, (_, shin, foot, _) = skeleton.rig, leg
    rotation = skeleton.rotations[foot]
    offsets = [so3.rotate(rotation, np.asarray(tip)) for tip in rig.joints[foot].tips]
    offsets += [
        skeleton.positions[j] - start
        for j, parent in enumerate(rig.parents.tolist())
        if parent == foot and skeleton.roles[j] == END
    ]
    end = max(offsets, key=lambda offset: float(offset @ offset), default=None)
    bone = start - skeleton.positions[shin]
    length = 0.0 if end is None else float(np.linalg.norm(end))
    if end is None or length < SHORT * float(np.linalg.norm(bone)):
        return None
    cosine = float(end @ bone) / (length * float(np.linalg.norm(bone)))
    return None if cosine > ALONG_SHIN else np.asarray(end)

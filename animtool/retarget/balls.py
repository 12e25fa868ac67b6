"""Where feet roll: the balls of feet, whatever toes a skeleton has."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.retarget.person import Ball, Person
from animtool.retarget.roles import END

# The end of a foot nearer to its ankle than this share of the leg is none [1].
SHORT = 0.04
# Cosine to the shin from which on the end of a foot is its heel, or the ground [1].
ALONG_SHIN = 0.97
# A toe that begins this near to the ankle, over its length, has a metatarsal [1].
AT_ANKLE = 0.15


def balls_of(person: Person, other: Person) -> dict[str, Ball]:
    """Return the balls of the feet of a skeleton, by side.

    That is where its toes begin, of several the foremost, in their middle. A foot
    without toes ends in its ball, or in the tip of its toes: whichever the foot of the
    other skeleton is nearer to. A foot that shows no end has the other's, scaled. Feet
    of which nothing is known have none.
    """
    made = {}
    for side in "lr":
        leg, theirs = person.leg(side), other.leg(side)
        if leg is None:
            continue
        foot, toes = leg[2], _toes(person, side)
        if toes:
            way = _roll(person, foot, toes)
        else:
            known = None if theirs is None else _shape(other, side)
            size = person.leg_length(side) / (other.leg_length(side) or 1.0)
            found = _toeless(person, side, known, size)
            if found is None:
                continue
            way = found
        offset = so3.rotate(so3.conjugate(person.turns[foot]), way)
        made[side] = Ball(toes[0] if len(toes) == 1 else -1, offset)
    return made


def ball_places(
    ball: Ball, foot: int, positions: FloatArray, turns: FloatArray
) -> FloatArray:
    """Return where a ball is ``(F, 3)`` [m], of joints ``(F, J, …)`` in the world."""
    if ball.joint >= 0:
        return positions[:, ball.joint]
    return np.asarray(positions[:, foot] + so3.rotate(turns[:, foot], ball.offset))


def _toes(person: Person, side: str) -> list[int]:
    """Return the joints in which the toes of a foot begin."""
    joints = {j for j, role in enumerate(person.roles) if role == f"toe_{side}"}
    parents = person.rig.parents
    found = []
    for top in sorted(j for j in joints if int(parents[j]) not in joints):
        ends = [j for j in joints if top in person.rig.upwards(j)]
        foot = person.positions[_foot(person, side)]
        length = float(np.linalg.norm(person.positions[max(ends)] - foot))
        near = float(np.linalg.norm(person.positions[top] - foot))
        below = [j for j in ends if int(parents[j]) == top]
        found.append(below[0] if below and near < AT_ANKLE * length else top)
    return found


def _roll(person: Person, foot: int, toes: Sequence[int]) -> FloatArray:
    """Return the way from an ankle to where its foot rolls over toes ``(3,)`` [m]."""
    ways = person.positions[list(toes)] - person.positions[foot]
    facing = person.facing
    if len(ways) == 1 or facing is None:
        return np.asarray(ways.mean(axis=0))
    first = ways[int(np.argmax(ways @ facing[2]))]
    across = float((ways.mean(axis=0) - first) @ facing[0])
    return np.asarray(first + across * facing[0])


def _foot(person: Person, side: str) -> int:
    return person.first(f"foot_{side}")


@dataclass(frozen=True, slots=True)
class _Shape:
    """A foot at rest: left, up and ahead of who stands, from the ankle on [m]."""

    ball: FloatArray | None  # where toes begin (3,)
    tip: FloatArray | None  # where the last of it ends (3,)


def _shape(person: Person, side: str) -> _Shape | None:
    """Return what is known of a foot; None of who faces nowhere."""
    facing, foot, toes = person.facing, _foot(person, side), _toes(person, side)
    if facing is None:
        return None
    start = person.positions[foot]
    tip = _tip(person, toes or [foot], start)
    ball = _roll(person, foot, toes) if toes else None
    return _Shape(*(None if way is None else facing @ way for way in (ball, tip)))


def _tip(person: Person, joints: Sequence[int], start: FloatArray) -> FloatArray | None:
    """Return the way to the farthest end of joints and what is below them ``(3,)``."""
    rig = person.rig
    count, tops = len(rig.joints), {*joints}
    below = [j for j in range(count) if not tops.isdisjoint(rig.upwards(j))]
    ways = [person.positions[j] - start for j in below]
    for j in below:
        ways += [
            person.positions[j] + so3.rotate(person.turns[j], np.asarray(tip)) - start
            for tip in rig.joints[j].tips
        ]
    return max(ways, key=lambda way: float(way @ way), default=None)


def _toeless(
    person: Person, side: str, other: _Shape | None, size: float
) -> FloatArray | None:
    """Return the way from the ankle to the ball of a foot without toes ``(3,)``."""
    leg = person.leg(side)
    assert leg is not None
    start = person.positions[leg[2]]
    tip = _foot_end(person, leg, start)
    facing = person.facing
    if facing is None or other is None or other.ball is None:
        return tip
    if tip is None:
        return np.asarray(size * (other.ball @ facing))
    if other.tip is None:
        return tip
    lengths = [float(np.linalg.norm(way)) for way in (other.ball, other.tip)]
    if not 0 < lengths[0] < lengths[1]:
        return tip
    between = size * float(np.sqrt(lengths[0] * lengths[1]))
    if float(np.linalg.norm(tip)) <= between:
        return tip
    # It ends where the other's toes do.
    own = facing @ tip
    shares = [
        a / b if abs(b) > SHORT * lengths[1] else 1.0
        for a, b in zip(other.ball, other.tip, strict=True)
    ]
    return np.asarray((own * np.clip(shares, 0.0, 1.0)) @ facing)


def _foot_end(
    person: Person, leg: tuple[int, int, int, int], start: FloatArray
) -> FloatArray | None:
    """Return the way to where a foot without toes ends ``(3,)``, if that shows."""
    rig, (_, shin, foot, _) = person.rig, leg
    turn = person.turns[foot]
    ways = [so3.rotate(turn, np.asarray(tip)) for tip in rig.joints[foot].tips]
    ways += [
        person.positions[j] - start
        for j, parent in enumerate(rig.parents.tolist())
        if parent == foot and person.roles[j] == END
    ]
    end = max(ways, key=lambda way: float(way @ way), default=None)
    bone = start - person.positions[shin]
    length = 0.0 if end is None else float(np.linalg.norm(end))
    if end is None or length < SHORT * float(np.linalg.norm(bone)):
        return None
    cosine = float(end @ bone) / (length * float(np.linalg.norm(bone)))
    return None if cosine > ALONG_SHIN else np.asarray(end)

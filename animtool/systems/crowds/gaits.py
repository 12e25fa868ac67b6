"""Gaits of a rig that walks: one cycle each, by phase, with its steps."""

from __future__ import annotations

from dataclasses import field

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, OptionError
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.retarget.anatomy import anatomy
from animtool.retarget.roled_skeleton import RoledSkeleton
from animtool.rig.skeleton import Rig
from animtool.systems.crowds.ground import about_up

# Phases at which a cycle is known; between two it goes straight.
PHASES = 64
SIDES = "lr"
UP = np.array([0.0, 1.0, 0.0])


@dataclass(frozen=True)
class Walker:
    """A rig that walks.

    Attributes:
        rig: With y up.
        legs: Thigh, shin, foot and toe (-1 for none) of the left and the right leg.
        ahead: Heading of its rest pose [rad].
        level: How each foot is turned in the world where it stands ``(2, 4)``.
        ankle: How high ankles are where feet stand ``(2,)`` [m].
        ball: From each ankle to the toe's joint, or to the ground where there is none,
            level and heading along z ``(2, 3)`` [m].
        leg: Length of thigh and shin [m].
    """

    person: RoledSkeleton
    legs: tuple[tuple[int, int, int, int], tuple[int, int, int, int]]
    ahead: float
    level: FloatArray
    ankle: FloatArray
    ball: FloatArray
    leg: float

    @property
    def rig(self) -> Rig:
        """Return the rig."""
        return self.person.rig

    @staticmethod
    def of(rig: Rig) -> Walker:
        """Return a rig that stands at rest (SIM149 where it has no two legs)."""
        person = RoledSkeleton.of(rig, anatomy(rig).roles)
        left, right, facing = person.leg("l"), person.leg("r"), person.facing
        if left is None or right is None or facing is None:
            message = f"{rig.name!r} does not have two legs with thigh, shin and foot"
            raise OptionError(Fault("SIM149", message, where="gaits"))
        ahead = float(np.arctan2(facing[2, 0], facing[2, 2]))
        back = about_up(np.array([-ahead]))[0]
        ground = _ground(person)
        feet = [left[2], right[2]]
        balls = []
        for leg in (left, right):
            toe = leg[3] if leg[3] >= 0 else leg[2]
            ball = so3.rotate(back, person.positions[toe] - person.positions[leg[2]])
            sole = ground - person.positions[leg[2], 1]
            balls.append([ball[0], ball[1] if leg[3] >= 0 else sole, ball[2]])
        return Walker(
            person,
            (left, right),
            ahead,
            so3.multiply(back, person.rotations[feet]),
            person.positions[feet, 1] - ground,
            np.array(balls),
            person.leg_length("l"),
        )


def _ground(person: RoledSkeleton) -> float:
    """Return how high the ground is that a rig stands on at rest [m].

    Below its lowest joint, or where the bone of one ends, such as that of a toe.
    """
    ends = [
        person.positions[joint] + so3.rotate(person.rotations[joint], np.array(tip))
        for joint, own in enumerate(person.rig.joints)
        for tip in own.tips
    ]
    return float(np.vstack([person.positions, *ends])[:, 1].min())


@dataclass(frozen=True)
class Gait:
    """One cycle of a clip: the left foot lands first, the right in the middle.

    Of the frame of the body: on the ground below the hips, which go evenly along z and
    turn evenly about y.

    Attributes:
        turns: Local rotations of joints ``(P, J, 4)``.
        hips: Of the first joint ``(P, 3)`` [m].
        period: Of the cycle [s].
        velocity: x and z of the body in its frame ``(2,)`` [m/s].
        turning: Of the body [rad/s].
        stands: For which share of the cycle each foot stands ``(2,)``.
        steps: Where each foot lands in the frame of the body: x, z and how far it is
            turned ``(2, 3)`` [m], [rad].
        pitches: How far each foot is turned about its own x over its stance, at even
            shares ``(2, P)``; more than 0 has the heel up [rad].
        swings: How it is turned over its swing, as seen from a place that goes from one
            to the next by `eased` shares ``(2, P, 4)``.
        lifts: Where its ankle is then, over the ground of that place ``(2, P, 3)`` [m].
    """

    name: str
    turns: FloatArray
    hips: FloatArray
    period: float
    velocity: FloatArray
    turning: float
    stands: FloatArray = field(default_factory=lambda: np.ones(2))
    steps: FloatArray = field(default_factory=lambda: np.zeros((2, 3)))
    pitches: FloatArray = field(default_factory=lambda: np.zeros((2, 0)))
    swings: FloatArray = field(default_factory=lambda: np.zeros((2, 0, 4)))
    lifts: FloatArray = field(default_factory=lambda: np.zeros((2, 0, 3)))

    @property
    def speed(self) -> float:
        """Return how fast it goes ahead [m/s]."""
        return float(self.velocity[1])


@dataclass(frozen=True)
class Gaits:
    """What agents of a rig play.

    Attributes:
        moving: Cycles that go somewhere, the slowest first; never none.
        idle: What they do as they stand.
        reactions: What they do once, as they are hit.
        notices: What is missing, and what is done instead.
    """

    walker: Walker
    moving: tuple[Gait, ...]
    idle: Gait
    reactions: tuple[Gait, ...]
    notices: tuple[Fault, ...]


def eased(share: FloatArray) -> FloatArray:
    """Return how far a foot is on its way to its next place, of its swing."""
    return share**3 * (10 - 15 * share + 6 * share * share)


def about_side(angles: FloatArray) -> FloatArray:
    """Return turns about x ``(…, 4)`` by angles [rad]."""
    made = np.zeros((*angles.shape, 4))
    made[..., 0], made[..., 3] = np.sin(angles / 2), np.cos(angles / 2)
    return made


def standing_ankle(walker: Walker, k: int, pitched: FloatArray) -> FloatArray:
    """Return ankles over the places of feet that stand ``(K, 3)`` [m].

    They turn by ``pitched`` ``(K, 4)`` about the ball where the heel is up, else about
    the heel.
    """
    ankle, ball = np.array([0.0, walker.ankle[k], 0.0]), walker.ball[k]
    on_heel = so3.rotate(pitched, ankle)
    on_ball = ankle + ball - so3.rotate(pitched, ball)
    return np.where(pitched[..., :1] > 0, on_ball, on_heel)


def rows(table: FloatArray, at: FloatArray, *, again: bool = False) -> FloatArray:
    """Return rows of a table ``(P, …)``; `again`: its first is behind its last."""
    count = len(table)
    low = np.clip(at.astype(np.int64), 0, count - 1)
    high = (low + 1) % count if again else np.minimum(low + 1, count - 1)
    share = (at - low).reshape(-1, *[1] * (table.ndim - 1))
    first, last = table[low], table[high]
    if table.shape[-1] == 4:
        flipped = (first * last).sum(axis=-1, keepdims=True) < 0
        last = np.where(flipped, -last, last)
    return np.asarray(first + share * (last - first))

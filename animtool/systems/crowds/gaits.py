"""Gaits of a biped: one cycle each by phase, with its steps."""

from __future__ import annotations

from dataclasses import field

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, OptionError
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.retarget.anatomy import find_anatomy
from animtool.retarget.roled_skeleton import RoledSkeleton
from animtool.rig.skeleton import Rig
from animtool.systems.crowds.ground import rotations_about_y

# Number of phases at which a cycle is sampled; interpolated in between.
PHASE_COUNT = 64
SIDES = "lr"
UP = np.array([0.0, 1.0, 0.0])


@dataclass(frozen=True)
class Walker:
    """A biped rig with its leg measures.

    Attributes:
        person: Skeleton with y up.
        legs: Joints of the left and right leg: thigh, shin, foot and toe (-1 for none).
        heading: Heading of its rest pose [rad].
        level: World rotation of each planted foot ``(2, 4)``.
        ankle: Height of the ankles of planted feet ``(2,)`` [m].
        ball: From each ankle to the toe joint, or to the ground without one; level,
            heading along z ``(2, 3)`` [m].
        leg: Length of thigh and shin [m].
    """

    person: RoledSkeleton
    legs: tuple[tuple[int, int, int, int], tuple[int, int, int, int]]
    heading: float
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
        """Return a biped from its rest pose (SIM149 if it lacks two legs)."""
        person = RoledSkeleton.of(rig, find_anatomy(rig).roles)
        left, right, facing = person.leg("l"), person.leg("r"), person.facing
        if left is None or right is None or facing is None:
            message = f"{rig.name!r} does not have two legs with thigh, shin and foot"
            raise OptionError(Fault("SIM149", message, where="gaits"))
        heading = float(np.arctan2(facing[2, 0], facing[2, 2]))
        to_forward = rotations_about_y(np.array([-heading]))[0]
        ground = _rest_ground_height(person)
        feet = [left[2], right[2]]
        toe_offsets = []
        for leg in (left, right):
            toe = leg[3] if leg[3] >= 0 else leg[2]
            offset = so3.rotate(
                to_forward, person.positions[toe] - person.positions[leg[2]]
            )
            ground_offset = ground - person.positions[leg[2], 1]
            toe_offsets.append(
                [offset[0], offset[1] if leg[3] >= 0 else ground_offset, offset[2]]
            )
        return Walker(
            person,
            (left, right),
            heading,
            so3.multiply(to_forward, person.rotations[feet]),
            person.positions[feet, 1] - ground,
            np.array(toe_offsets),
            person.leg_length("l"),
        )


def _rest_ground_height(person: RoledSkeleton) -> float:
    """Return the height of the ground below a rig at rest [m].

    At its lowest joint or bone end, such as that of a toe.
    """
    ends = [
        person.positions[joint] + so3.rotate(person.rotations[joint], np.array(tip))
        for joint, settings in enumerate(person.rig.joints)
        for tip in settings.tips
    ]
    return float(np.vstack([person.positions, *ends])[:, 1].min())


@dataclass(frozen=True)
class Gait:
    """One cycle of a clip: the left foot lands first, the right in the middle.

    In the frame of the body: on the ground below the hips, at constant speed along z
    and constant yaw rate.

    Attributes:
        rotations: Local rotations of joints ``(P, J, 4)``.
        hips: Positions of the first joint ``(P, 3)`` [m].
        period: Length of the cycle [s].
        velocity: Velocity of the body in its frame, x and z ``(2,)`` [m/s].
        turning: Yaw rate of the body [rad/s].
        stance_fractions: Fraction of the cycle that each foot is planted ``(2,)``.
        steps: Landing of each foot in the frame of the body: x, z and yaw ``(2, 3)``
            [m], [rad].
        pitches: Pitch of each foot about its local x over its stance, at equal
            intervals ``(2, P)``; positive is heel up [rad].
        swings: Rotation of each foot over its swing, relative to a point that moves
            from one foothold to the next by `swing_progress` ``(2, P, 4)``.
        lifts: Ankle of each foot over its swing, relative to that point ``(2, P, 3)``
            [m].
    """

    name: str
    rotations: FloatArray
    hips: FloatArray
    period: float
    velocity: FloatArray
    turning: float
    stance_fractions: FloatArray = field(default_factory=lambda: np.ones(2))
    steps: FloatArray = field(default_factory=lambda: np.zeros((2, 3)))
    pitches: FloatArray = field(default_factory=lambda: np.zeros((2, 0)))
    swings: FloatArray = field(default_factory=lambda: np.zeros((2, 0, 4)))
    lifts: FloatArray = field(default_factory=lambda: np.zeros((2, 0, 3)))

    @property
    def speed(self) -> float:
        """Return its forward speed [m/s]."""
        return float(self.velocity[1])


@dataclass(frozen=True)
class Gaits:
    """The clips of a rig's agents: moving, idle, reactions.

    Attributes:
        moving: Locomotion cycles, the slowest first; at least one.
        idle: Clip of standing agents.
        reactions: Clips played once when hit.
        notices: Warnings about missing clips, and the fallback.
    """

    walker: Walker
    moving: tuple[Gait, ...]
    idle: Gait
    reactions: tuple[Gait, ...]
    notices: tuple[Fault, ...]


def swing_progress(fraction: FloatArray) -> FloatArray:
    """Return the eased progress of a foot over its swing."""
    return fraction**3 * (10 - 15 * fraction + 6 * fraction * fraction)


def rotations_about_x(angles: FloatArray) -> FloatArray:
    """Return rotations about x ``(…, 4)`` by angles [rad]."""
    rotations = np.zeros((*angles.shape, 4))
    rotations[..., 0], rotations[..., 3] = np.sin(angles / 2), np.cos(angles / 2)
    return rotations


def standing_ankle(walker: Walker, k: int, pitches: FloatArray) -> FloatArray:
    """Return ankles above planted feet ``(K, 3)`` [m].

    Feet are rotated by ``pitches`` ``(K, 4)`` about the ball if the heel is up, else
    about the heel.
    """
    ankle, ball = np.array([0.0, walker.ankle[k], 0.0]), walker.ball[k]
    on_heel = so3.rotate(pitches, ankle)
    on_ball = ankle + ball - so3.rotate(pitches, ball)
    return np.where(pitches[..., :1] > 0, on_ball, on_heel)


def sample_rows(
    table: FloatArray, at: FloatArray, *, cyclic: bool = False
) -> FloatArray:
    """Sample a table ``(P, …)`` at fractional rows; ``cyclic`` wraps around."""
    count = len(table)
    low = np.clip(at.astype(np.int64), 0, count - 1)
    high = (low + 1) % count if cyclic else np.minimum(low + 1, count - 1)
    fraction = (at - low).reshape(-1, *[1] * (table.ndim - 1))
    first, last = table[low], table[high]
    if table.shape[-1] == 4:
        is_opposite = (first * last).sum(axis=-1, keepdims=True) < 0
        last = np.where(is_opposite, -last, last)
    return np.asarray(first + fraction * (last - first))

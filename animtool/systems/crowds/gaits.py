"""Gaits of a biped, each a cycle sampled by phase, with its steps."""

from __future__ import annotations

from collections.abc import Sequence
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

# Number of phases at which a cycle is sampled.
PHASE_COUNT = 64
SIDE_LETTERS = "lr"
UP = np.array([0.0, 1.0, 0.0])


@dataclass(frozen=True)
class Walker:
    """A biped rig, with the dimensions of its legs."""

    skeleton: RoledSkeleton  # skeleton with y up
    # Joints of the left and right leg: thigh, shin, foot and toe (-1 for none).
    legs: tuple[tuple[int, int, int, int], tuple[int, int, int, int]]
    heading: float  # heading of its rest pose [rad]
    level_rotations: FloatArray  # world rotation of each planted foot (2, 4)
    ankle_heights: FloatArray  # height of the ankles of planted feet (2,) [m]
    # Offset from each ankle to the toe joint, or else to the ground, for a
    # planted foot heading along z (2, 3) [m].
    ball_offsets: FloatArray
    leg_length: float  # total length of thigh and shin [m]

    @property
    def rig(self) -> Rig:
        """The rig of the biped, without the roles of its joints."""
        return self.skeleton.rig

    @staticmethod
    def from_rig(rig: Rig) -> Walker:
        """Return the legs of a biped at rest; raise SIM149 if it lacks two legs."""
        skeleton = RoledSkeleton.of(rig, find_anatomy(rig).roles)
        left, right, facing = skeleton.leg("l"), skeleton.leg("r"), skeleton.facing_axes
        if left is None or right is None or facing is None:
            message = f"{rig.name!r} does not have two legs with thigh, shin and foot"
            raise OptionError(Fault("SIM149", message, where="gaits"))
        heading = float(np.arctan2(facing[2, 0], facing[2, 2]))
        to_forward = rotations_about_y(np.array([-heading]))[0]
        ground = _rest_ground_height(skeleton)
        feet = [left[2], right[2]]
        toe_offsets = []
        for leg in (left, right):
            ankle = skeleton.positions[leg[2]]
            toe = skeleton.positions[leg[3]] if leg[3] >= 0 else ankle
            offset = so3.rotate(to_forward, toe - ankle)
            if leg[3] < 0:
                offset[1] = ground - ankle[1]
            toe_offsets.append(offset)
        return Walker(
            skeleton,
            (left, right),
            heading,
            so3.multiply(to_forward, skeleton.rotations[feet]),
            skeleton.positions[feet, 1] - ground,
            np.array(toe_offsets),
            skeleton.leg_length("l"),
        )


def _rest_ground_height(skeleton: RoledSkeleton) -> float:
    """Return the height of the ground below a rig at rest [m].

    This is the height of the lowest joint or bone end, such as a toe.
    """
    ends = [
        skeleton.positions[i] + so3.rotate(skeleton.rotations[i], np.array(tip))
        for i, joint in enumerate(skeleton.rig.joints)
        for tip in joint.tips
    ]
    return float(np.vstack([skeleton.positions, *ends])[:, 1].min())


@dataclass(frozen=True)
class Gait:
    """One cycle of a clip: the left foot lands first, the right in the middle.

    Values are in the frame of the body: on the ground below the hips, moving at
    constant speed along z and constant yaw rate.
    """

    name: str
    rotations: FloatArray  # local rotations of joints (P, J, 4)
    hips: FloatArray  # positions of the first joint (P, 3) [m]
    period: float  # length of the cycle [s]
    velocity: FloatArray  # along x and z of the body's frame (2,) [m/s]
    yaw_rate: float  # yaw rate of the body [rad/s]
    # Fraction of the cycle that each foot is planted (2,).
    stance_fractions: FloatArray = field(default_factory=lambda: np.ones(2))
    # Landing of each foot in the frame of the body: x, z and yaw (2, 3) [m], [rad].
    steps: FloatArray = field(default_factory=lambda: np.zeros((2, 3)))
    # Pitch of each foot about its local x over its stance, at equal intervals (2, P);
    # positive is heel up [rad].
    pitches: FloatArray = field(default_factory=lambda: np.zeros((2, 0)))
    # Rotation of each foot over its swing, relative to a point that moves from one
    # foothold to the next by `swing_progress` (2, P, 4).
    swings: FloatArray = field(default_factory=lambda: np.zeros((2, 0, 4)))
    # Ankle of each foot over its swing, relative to that point (2, P, 3) [m].
    lifts: FloatArray = field(default_factory=lambda: np.zeros((2, 0, 3)))

    @property
    def speed(self) -> float:
        """Forward speed [m/s]."""
        return float(self.velocity[1])


@dataclass(frozen=True)
class Gaits:
    """Clips of a rig: locomotion, standing and reactions."""

    walker: Walker
    cycles: tuple[Gait, ...]  # locomotion cycles, the slowest first; at least one
    idle: Gait  # clip of standing agents
    reactions: tuple[Gait, ...]  # clips played once when hit
    notices: tuple[Fault, ...]  # warnings about missing clips, and the fallback


def swing_progress(fraction: FloatArray) -> FloatArray:
    """Return the smoothed progress of a foot over a swing, from 0 to 1."""
    return fraction**3 * (10 - 15 * fraction + 6 * fraction * fraction)


def rotations_about_x(angles: FloatArray) -> FloatArray:
    """Return rotations about x ``(…, 4)`` by angles [rad]."""
    rotations = np.zeros((*angles.shape, 4))
    rotations[..., 0], rotations[..., 3] = np.sin(angles / 2), np.cos(angles / 2)
    return rotations


def standing_ankle(walker: Walker, foot_index: int, pitches: FloatArray) -> FloatArray:
    """Return the ankle positions of planted feet ``(K, 3)`` [m].

    Feet are rotated by ``pitches`` ``(K, 4)`` about the ball if the heel is up, else
    about the heel.
    """
    ankle = np.array([0.0, walker.ankle_heights[foot_index], 0.0])
    ball = walker.ball_offsets[foot_index]
    on_heel = so3.rotate(pitches, ankle)
    on_ball = ankle + ball - so3.rotate(pitches, ball)
    return np.where(pitches[..., :1] > 0, on_ball, on_heel)


def weighted_sum(gait_values: Sequence[FloatArray], weights: FloatArray) -> FloatArray:
    """Return the sum of values of gaits ``(N, …)``, with weights ``(N, G)``."""
    total = np.zeros_like(gait_values[0])
    for gait_value, weight in zip(gait_values, weights.T, strict=True):
        total += weight.reshape(-1, *[1] * (total.ndim - 1)) * gait_value
    return total


def sample_rows(
    table: FloatArray, frames: FloatArray, *, is_cyclic: bool = False
) -> FloatArray:
    """Return rows of a table ``(P, …)`` interpolated at fractional indices.

    With ``is_cyclic``, the first row follows the last.
    """
    count = len(table)
    lower = np.clip(frames.astype(np.int64), 0, count - 1)
    upper = (lower + 1) % count if is_cyclic else np.minimum(lower + 1, count - 1)
    fraction = (frames - lower).reshape(-1, *[1] * (table.ndim - 1))
    lower_values, upper_values = table[lower], table[upper]
    if table.shape[-1] == 4:
        is_opposite = (lower_values * upper_values).sum(axis=-1, keepdims=True) < 0
        upper_values = np.where(is_opposite, -upper_values, upper_values)
    return np.asarray(lower_values + fraction * (upper_values - lower_values))

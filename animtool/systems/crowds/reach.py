"""Reach of legs: when a planted foot must lift.

Coordinates are in the frames of bodies, at the scale of the rig.
"""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.rig.kinematics import forward_kinematics
from animtool.systems.crowds.gaits import (
    PHASE_COUNT,
    Gait,
    Gaits,
    rotations_about_x,
    sample_rows,
    standing_ankle,
    weighted_sum,
)
from animtool.systems.crowds.ground import rotations_about_y

# Largest leg extension, as a fraction of its length.
MAX_EXTENSION = 0.998
# Largest lowering of hips for a planted foot, and in poses, where thighs are exact;
# both relative to the leg length.
MAX_STANCE_LOWERING, MAX_LOWERING = 0.09, 0.11
# Largest yaw of a planted foot relative to the body [rad].
MAX_YAW_INWARDS, MAX_YAW_OUTWARDS = 0.4, 0.6
# Smallest margins of reach [m] and yaw [rad]; with less, slow agents would hurry.
MIN_REACH_MARGIN, MIN_YAW_MARGIN = 0.05, 0.3
# Additional lowering of hips for swinging feet, relative to the leg length.
SWING_MARGIN = 0.045
# Largest cadence [cycles/s].
MAX_CYCLE_RATE = 2.5


@dataclass(frozen=True)
class LegReach:
    """Reach of the legs of a rig, computed from the thigh positions in gaits."""

    gaits: Gaits  # gaits of the rig
    # Thigh joints of both legs by phase, for each gait (P, 2, 3) [m].
    gait_thighs: tuple[FloatArray, ...]
    standing_thighs: FloatArray  # mean thigh joints of the idle clip (2, 3) [m]

    @staticmethod
    def from_gaits(gaits: Gaits) -> LegReach:
        """Return the leg reach of the rig of the given gaits."""
        thigh_tables = tuple(_gait_thighs(gaits, gait) for gait in gaits.cycles)
        return LegReach(
            gaits, thigh_tables, _gait_thighs(gaits, gaits.idle).mean(axis=0)
        )

    def thighs(
        self, phases: FloatArray, weights: FloatArray, standing_weights: FloatArray
    ) -> FloatArray:
        """Return the thigh positions of bodies above level ground ``(N, 2, 3)``."""
        frames = phases * PHASE_COUNT
        thigh_tables = [
            sample_rows(table, frames, is_cyclic=True) for table in self.gait_thighs
        ]
        thighs = weighted_sum(thigh_tables, weights)
        offsets = standing_weights[:, None, None] * (self.standing_thighs - thighs)
        return np.asarray(thighs + offsets)

    def reach_margin(
        self, foot_index: int, thighs: FloatArray, feet: FloatArray, pitches: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the remaining horizontal reach of a planted foot ``(N,)`` [m].

        Also returns the horizontal direction from the thigh to the ankle ``(N, 2)``.
        The leg ``foot_index`` (0 left, 1 right) has thigh joints ``(N, 3)``, and feet
        with x, y, z and heading ``(N, 4)`` and a heel pitch ``(N,)`` [rad].
        """
        leg_length = self.gaits.walker.leg_length
        to_ankle = self._ankle_vectors(foot_index, thighs, feet, pitches)
        heights = np.maximum(-to_ankle[:, 1] - MAX_STANCE_LOWERING * leg_length, 0.0)
        distances = np.linalg.norm(to_ankle[:, [0, 2]], axis=1)
        outwards = to_ankle[:, [0, 2]] / np.maximum(distances, 1e-9)[:, None]
        return np.asarray(reach_across(leg_length, heights**2) - distances), outwards

    def hip_lowering(
        self, foot_index: int, thighs: FloatArray, feet: FloatArray, pitches: FloatArray
    ) -> FloatArray:
        """Return how far hips must be lowered for a planted foot ``(N,)`` [m]."""
        leg_length = self.gaits.walker.leg_length
        to_ankle = self._ankle_vectors(foot_index, thighs, feet, pitches)
        max_height = reach_across(leg_length, (to_ankle[:, [0, 2]] ** 2).sum(axis=1))
        lowerings = np.clip(
            -to_ankle[:, 1] - max_height, 0.0, MAX_LOWERING * leg_length
        )
        return np.asarray(lowerings)

    def _ankle_vectors(
        self, foot_index: int, thighs: FloatArray, feet: FloatArray, pitches: FloatArray
    ) -> FloatArray:
        """Return vectors from thighs to ankles of planted feet ``(N, 3)``."""
        lifts = standing_ankle(
            self.gaits.walker, foot_index, rotations_about_x(pitches)
        )
        ankles = feet[:, :3] + so3.rotate(rotations_about_y(feet[:, 3]), lifts)
        return np.asarray(ankles - thighs)


def reach_across(
    leg_length: FloatArray | float, squared_offset: FloatArray
) -> FloatArray:
    """Return how far an extended leg reaches at right angles to an offset ``(N,)`` [m].

    The offset is given by its square; beyond the reach of the leg the result is 0.
    """
    squared_reach = (MAX_EXTENSION * leg_length) ** 2 - squared_offset
    return np.asarray(np.sqrt(np.maximum(squared_reach, 0.0)))


@dataclass(frozen=True)
class Stances:
    """Feet of N bodies, with heel pitches now and at lift-off."""

    phases: FloatArray  # phase of each foot, from its landing (N, 2)
    # Fraction of the cycle that each foot is planted (N, 2).
    stance_fractions: FloatArray
    is_swinging: BoolArray  # mask of feet in the air (N, 2)
    feet: FloatArray  # position x, y, z and heading of each foot (N, 2, 4)
    thighs: FloatArray  # thigh joints (N, 2, 3)
    pitches: FloatArray  # heel pitches now, and at lift-off (2, N, 2) [rad]
    rate: FloatArray  # cycle rate of the blended gaits (N,) [1/s]


def step_rates(
    reach: LegReach, stances: Stances, hip_velocities: FloatArray, yaw_rates: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Return cycle rates ``(N,)`` [1/s], and which feet are out of reach ``(N, 2)``.

    Rates are high enough that a planted foot lifts before it is out of reach, given the
    velocities of the hips ``(N, 2)`` [1/s] and the yaw rates ``(N,)`` [rad/s].
    """
    rate = stances.rate.copy()
    is_stance_over = np.zeros((len(rate), 2), np.bool_)
    for k in range(2):
        is_swinging = stances.is_swinging[:, k]
        phase, stance_fraction = stances.phases[:, k], stances.stance_fractions[:, k]
        foot_stance = k, stances.thighs[:, k], stances.feet[:, k]
        pitch, lift_pitch = stances.pitches[:, :, k]
        current_margin, _ = reach.reach_margin(*foot_stance, pitch)
        lift_margin, outwards = reach.reach_margin(*foot_stance, lift_pitch)
        leaving_speed = -(outwards * hip_velocities).sum(axis=1)
        foot_yaw = stances.feet[:, k, 3]
        is_inwards = foot_yaw * (1 - 2 * k) < 0
        max_yaw = np.where(is_inwards, MAX_YAW_INWARDS, MAX_YAW_OUTWARDS)
        yaw_speeds = -yaw_rates * np.sign(foot_yaw)
        yaw_margin = max_yaw - np.abs(foot_yaw)
        yaw_rate = _rate_for_margin(yaw_margin, MIN_YAW_MARGIN, yaw_speeds)
        reach_rate = _rate_for_margin(lift_margin, MIN_REACH_MARGIN, leaving_speed)
        remaining_phase = np.maximum(stance_fraction - phase, 0.0)
        required_rates = np.maximum(reach_rate, yaw_rate) * remaining_phase
        is_out_of_reach = np.maximum(current_margin, lift_margin) < 0
        is_stance_over[:, k] = ~is_swinging & is_out_of_reach
        # A foot that lifted too early lands soon.
        must_land = (is_swinging & (phase < stance_fraction)) | is_stance_over[:, k]
        required_rates[is_swinging] = 0.0
        required_rates[must_land] = MAX_CYCLE_RATE
        rate = np.maximum(rate, np.minimum(required_rates, MAX_CYCLE_RATE))
    return rate, is_stance_over


def _rate_for_margin(
    margin: FloatArray, min_margin: float, speed: FloatArray
) -> FloatArray:
    """Return the inverse of the time in which a margin is used up ``(N,)`` [1/s]."""
    return np.asarray(np.maximum(speed, 0.0) / np.maximum(margin, min_margin))


def _gait_thighs(gaits: Gaits, gait: Gait) -> FloatArray:
    """Return the positions of the thigh joints over a gait ``(P, 2, 3)`` [m]."""
    rig = gaits.walker.rig
    translations = np.repeat(rig.rest_translations[None], len(gait.rotations), axis=0)
    translations[:, 0] = gait.hips
    legs = [leg[0] for leg in gaits.walker.legs]
    world = forward_kinematics(rig, translations, gait.rotations)
    return np.asarray(world.positions[:, legs])

"""Reach of legs: when a planted foot must lift, and when a pushed body must step.

All is in the frame of bodies, in lengths of the rig.
"""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.rig.kinematics import forward
from animtool.systems.crowds.gaits import (
    PHASES,
    Gait,
    Gaits,
    about_side,
    rows,
    standing_ankle,
)
from animtool.systems.crowds.ground import about_up

# Largest leg extension, as a fraction of its length.
STRAIGHT = 0.998
# Largest lowering of hips for a planted foot, over the leg length, and in poses, as
# thighs are approximate.
LOWERED, MOST_LOWERED = 0.09, 0.11
# Largest yaw of a planted foot against the body [rad].
TURNED_IN, TURNED_OUT = 0.4, 0.6
# Least margin of either [m], [rad]: slow agents do not hurry.
LEAST_ROOM, LEAST_YAW = 0.05, 0.3
# Additional margin of airborne feet.
AIRBORNE = 0.045
# Largest cadence [cycles/s].
MAX_RATE = 2.5


@dataclass(frozen=True)
class Reach:
    """Thigh positions of a rig as it walks and stands.

    Attributes:
        gaits: Of the rig.
        walking: Thighs of both legs by gait and phase ``(P, 2, 3)`` [m].
        standing: Mean thighs of the idle ``(2, 3)`` [m].
    """

    gaits: Gaits
    walking: tuple[FloatArray, ...]
    standing: FloatArray

    @staticmethod
    def of(gaits: Gaits) -> Reach:
        """Return the reach of a rig with some gaits."""
        walking = tuple(_thighs(gaits, one) for one in gaits.moving)
        return Reach(gaits, walking, _thighs(gaits, gaits.idle).mean(axis=0))

    def thighs(
        self, phases: FloatArray, weights: FloatArray, standing: FloatArray
    ) -> FloatArray:
        """Return thighs of bodies above level ground ``(N, 2, 3)``."""
        at = phases * PHASES
        thighs = np.zeros((len(phases), 2, 3))
        for weight, table in zip(weights.T, self.walking, strict=True):
            thighs += weight[:, None, None] * rows(table, at, again=True)
        return np.asarray(thighs + standing[:, None, None] * (self.standing - thighs))

    def room(
        self, k: int, thighs: FloatArray, feet: FloatArray, pitches: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the remaining reach of a planted foot ``(N,)``, and the direction.

        Level, from the thigh to the ankle ``(N, 2)``.

        Args:
            k: Which leg.
            thighs: Where its begins ``(N, 3)``.
            feet: x, y, z and heading of feet ``(N, 4)``.
            pitches: How far their heels are up ``(N,)`` [rad].
        """
        leg = self.gaits.walker.leg
        to_ankle = self._legs(k, thighs, feet, pitches)
        high = np.maximum(-to_ankle[:, 1] - LOWERED * leg, 0.0)
        away = np.linalg.norm(to_ankle[:, [0, 2]], axis=1)
        outwards = to_ankle[:, [0, 2]] / np.maximum(away, 1e-9)[:, None]
        far = np.maximum((STRAIGHT * leg) ** 2 - high**2, 0.0)
        return np.asarray(np.sqrt(far) - away), outwards

    def lowered(
        self, k: int, thighs: FloatArray, feet: FloatArray, pitches: FloatArray
    ) -> FloatArray:
        """Return how far hips are lowered for a planted foot ``(N,)``."""
        leg = self.gaits.walker.leg
        to_ankle = self._legs(k, thighs, feet, pitches)
        across = (to_ankle[:, [0, 2]] ** 2).sum(axis=1)
        high = np.sqrt(np.maximum((STRAIGHT * leg) ** 2 - across, 0.0))
        return np.asarray(np.clip(-to_ankle[:, 1] - high, 0.0, MOST_LOWERED * leg))

    def _legs(
        self, k: int, thighs: FloatArray, feet: FloatArray, pitches: FloatArray
    ) -> FloatArray:
        """Return vectors from thighs to ankles of planted feet ``(N, 3)``."""
        lifts = standing_ankle(self.gaits.walker, k, about_side(pitches))
        ankles = feet[:, :3] + so3.rotate(about_up(feet[:, 3]), lifts)
        return np.asarray(ankles - thighs)


@dataclass(frozen=True)
class Stances:
    """Planted feet of N bodies at two phases.

    Attributes:
        begins: Phase of each foot since its landing ``(N, 2)``.
        stands: Fraction of the cycle that each is planted ``(N, 2)``.
        swings: Which are in the air ``(N, 2)``.
        feet: x, y, z and heading of each ``(N, 2, 4)``.
        thighs: Thigh joints ``(N, 2, 3)``.
        pitches: Heel pitches now, and at lift-off ``(2, N, 2)`` [rad].
        rate: Undisturbed cycle rate ``(N,)`` [1/s].
    """

    begins: FloatArray
    stands: FloatArray
    swings: BoolArray
    feet: FloatArray
    thighs: FloatArray
    pitches: FloatArray
    rate: FloatArray


def hurried(
    reach: Reach, stances: Stances, went: FloatArray, turning: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Return cycle rates ``(N,)`` [1/s], and which feet are out of reach ``(N, 2)``.

    A foot lifts before its leg ends: at how fast the hips go from it ``went``
    ``(N, 2)`` [1/s], and at how fast they turn over it ``(N,)`` [rad/s], its stance has
    so long at most.
    """
    rate = stances.rate.copy()
    ends = np.zeros((len(rate), 2), np.bool_)
    for k in range(2):
        up = stances.swings[:, k]
        begin, stand = stances.begins[:, k], stances.stands[:, k]
        stance = k, stances.thighs[:, k], stances.feet[:, k]
        now, _ = reach.room(*stance, stances.pitches[0, :, k])
        last, outwards = reach.room(*stance, stances.pitches[1, :, k])
        leaves = -(outwards * went).sum(axis=1)
        foot_yaw = stances.feet[:, k, 3]
        most = np.where(foot_yaw * (1 - 2 * k) < 0, TURNED_IN, TURNED_OUT)
        twists = -turning * np.sign(foot_yaw)
        need = np.maximum(
            _hurry(last, LEAST_ROOM, leaves),
            _hurry(most - np.abs(foot_yaw), LEAST_YAW, twists),
        ) * np.maximum(stand - begin, 0.0)
        ends[:, k] = ~up & (np.maximum(now, last) < 0)
        # A foot that lifted too early lands soon.
        early = (up & (begin < stand)) | ends[:, k]
        need = np.where(early, MAX_RATE, np.where(up, 0.0, need))
        rate = np.maximum(rate, np.minimum(need, MAX_RATE))
    return rate, ends


def _hurry(room: FloatArray, least: float, speed: FloatArray) -> FloatArray:
    """Return 1 / (time until a margin is used up) at given speeds ``(N,)`` [1/s]."""
    return np.asarray(np.maximum(speed, 0.0) / np.maximum(room, least))


def _thighs(gaits: Gaits, gait: Gait) -> FloatArray:
    """Return the thighs over a gait ``(P, 2, 3)``."""
    rig = gaits.walker.rig
    translations = np.repeat(rig.rest_translations[None], len(gait.rotations), axis=0)
    translations[:, 0] = gait.hips
    legs = [leg[0] for leg in gaits.walker.legs]
    return np.asarray(forward(rig, translations, gait.rotations).positions[:, legs])

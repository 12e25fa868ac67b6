"""Legs at joint limits: knees swivel and hips rise so that planted feet stay in place.

Where that is not enough, feet move to where the limits allow.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.motion.contacts import gaussian_smoothed
from animtool.retarget.feet import Placed, upper
from animtool.retarget.legs import (
    LegTracks,
    ankle_rotations,
    leg_of,
    swivelled,
    up_index,
)
from animtool.retarget.roled_skeleton import RoledSkeleton
from animtool.rig.limits import BallLimit

# Knee swivels: a coarse grid, then a fine one about the best [rad].
SWIVELS = np.radians(np.arange(-60.0, 60.1, 15.0))
NEARBY = np.radians([-10.0, -5.0, 0.0, 5.0, 10.0])
# Cost of swivelling, over that of a limit violation.
SWIVEL_COST = 0.05
# Smoothing times of knee swivel and hip rise [s].
SWIVEL_TIME, RISE_TIME = 0.1, 0.2
# Most hip iterations, and the tolerated foot depth over the skeleton's size.
RISES, SUNK = 3, 5e-4


@dataclass(frozen=True, slots=True)
class _Leg:
    """A leg with a placed foot, in all frames."""

    target: RoledSkeleton
    side: str
    tracks: LegTracks
    goal: FloatArray  # of the ankle (F, 3) [m]
    foot: FloatArray  # world rotations of the foot (F, 4)
    stands: BoolArray  # (F,)

    def rotations(self, hips: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return rotations of thigh and shin that bring the ankle to its goal."""
        tracks = self.tracks
        about = np.stack([tracks.hip, tracks.knee, tracks.ankle], axis=1)
        both = tracks.rotations[:, 1], tracks.rotations[:, 2]
        return ankle_rotations(
            self.target, self.side, hips[:, None] + about, self.goal, both
        )

    def swivel(self, hips: FloatArray, fps: float) -> FloatArray:
        """Return the knee swivel that respects the leg's limits ``(F,)`` [rad].

        The smallest sufficient one, or the best if none is sufficient.
        """
        swivel = np.zeros(len(hips))
        rotations, axis = self.rotations(hips), self.goal - hips - self.tracks.hip
        every = np.arange(len(hips))
        off = np.flatnonzero(self._excess(rotations, axis, every, swivel) > 0)
        if not len(off):
            return swivel
        best = np.zeros(len(off))
        for steps in (SWIVELS, NEARBY):
            tried = best + steps[:, None]
            costs = [
                self._excess(rotations, axis, off, angles) + (SWIVEL_COST * angles) ** 2
                for angles in tried
            ]
            best = tried[np.argmin(costs, axis=0), np.arange(len(off))]
        swivel[off] = best
        return gaussian_smoothed(swivel, SWIVEL_TIME * fps)

    def _excess(
        self,
        rotations: tuple[FloatArray, FloatArray],
        axis: FloatArray,
        frames: IntArray,
        angles: FloatArray,
    ) -> FloatArray:
        """Return the squared limit violations of hip and ankle [rad²]."""
        rig, (thigh, _, foot, _) = self.target.rig, leg_of(self.target, self.side)
        both = rotations[0][frames], rotations[1][frames]
        first, second = swivelled(both, axis[frames], angles)
        above = so3.conjugate(self.tracks.rotations[frames, 0])
        total = np.zeros(len(frames))
        for joint, local in (
            (thigh, so3.multiply(above, first)),
            (foot, so3.multiply(so3.conjugate(second), self.foot[frames])),
        ):
            limit = rig.joints[joint].limits
            if isinstance(limit, BallLimit):
                back = so3.conjugate(rig.rest_rotations[joint])
                total += limit.excess(so3.multiply(back, local)) ** 2
        return total

    def sunk(self, hips: FloatArray, swivel: FloatArray) -> FloatArray:
        """Return how far hip limits put a planted ankle below its goal ``(F,)`` [m].

        It is 0 while the foot is in the air.
        """
        rig, (thigh, shin, foot, _) = self.target.rig, leg_of(self.target, self.side)
        limit = rig.joints[thigh].limits
        if not isinstance(limit, BallLimit):
            return np.zeros(len(hips))
        start = hips + self.tracks.hip
        first, second = swivelled(self.rotations(hips), self.goal - start, swivel)
        above, rest = self.tracks.rotations[:, 0], rig.rest_rotations[thigh]
        local = so3.multiply(so3.conjugate(so3.multiply(above, rest)), first)
        clamped = so3.multiply(above, so3.multiply(rest, limit.clamped(local)))
        # The knee is as bent as it was.
        second = so3.multiply(clamped, so3.multiply(so3.conjugate(first), second))
        bones = rig.rest_translations
        knee = start + so3.rotate(clamped, bones[shin])
        ankle = knee + so3.rotate(second, bones[foot])
        up = up_index(rig)
        low = np.maximum(self.goal[:, up] - ankle[:, up], 0.0)
        return np.where(self.stands, low, 0.0)


def within_limits(
    target: RoledSkeleton,
    sides: str,
    tracks: Sequence[LegTracks],
    placed: Placed,
    fps: float,
) -> tuple[FloatArray, list[FloatArray]]:
    """Return hip positions ``(F, 3)`` [m] and knee swivels [rad] within joint limits.

    Args:
        target: The skeleton.
        sides: Of the legs.
        tracks: Of each leg.
        placed: Goals of hips and feet.
        fps: Frames a second.
    """
    legs = [
        _Leg(target, *parts)
        for parts in zip(
            sides, tracks, placed.ankles, placed.rotations, placed.locked, strict=True
        )
    ]
    hips = placed.hips.copy()
    angles = [leg.swivel(hips, fps) for leg in legs]
    for tried in range(RISES):
        low = np.max(
            [leg.sunk(hips, a) for leg, a in zip(legs, angles, strict=True)], 0
        )
        if low.max() < SUNK * target.size:
            break
        hips[:, up_index(target.rig)] += upper(low, RISE_TIME * fps)
        if tried == RISES - 1:
            angles = [leg.swivel(hips, fps) for leg in legs]
    return hips, angles

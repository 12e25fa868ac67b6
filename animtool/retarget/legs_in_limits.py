"""Legs at joint limits: knees swivel and hips rise so that planted feet stay in place.

Where that is not enough, feet move to positions that the limits allow.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.motion.contacts import gaussian_smooth
from animtool.retarget.feet import PlacedFeet, upper_envelope
from animtool.retarget.legs import (
    LegTracks,
    ankle_rotations,
    leg_joints,
    swivel_leg,
    up_index,
)
from animtool.retarget.roled_skeleton import RoledSkeleton
from animtool.rig.limits import BallLimit

# Knee swivels: a coarse grid, then a fine one about the best [rad].
SWIVEL_ANGLES = np.radians(np.arange(-60.0, 60.1, 15.0))
FINE_SWIVEL_ANGLES = np.radians([-10.0, -5.0, 0.0, 5.0, 10.0])
# Cost of swivelling, relative to that of a limit violation.
SWIVEL_COST = 0.05
# Smoothing times of knee swivel and hip rise [s].
SWIVEL_SECONDS, RISE_SECONDS = 0.1, 0.2
# Maximum number of hip iterations, and the tolerated foot depth relative to the
# skeleton's size.
MAX_HIP_ITERATIONS, MAX_FOOT_DEPTH = 3, 5e-4


@dataclass(frozen=True, slots=True)
class _Leg:
    """A leg with a placed foot, in all frames."""

    target: RoledSkeleton
    side: str
    tracks: LegTracks
    ankle_goal: FloatArray  # goal of the ankle (F, 3) [m]
    foot_rotations: FloatArray  # world rotations of the foot (F, 4)
    is_planted: BoolArray  # whether the foot is planted (F,)

    def rotations(self, hips: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return rotations of thigh and shin that bring the ankle to its goal."""
        tracks = self.tracks
        relative_positions = np.stack([tracks.hip, tracks.knee, tracks.ankle], axis=1)
        joint_positions = hips[:, None] + relative_positions
        bones = tracks.rotations[:, 1], tracks.rotations[:, 2]
        return ankle_rotations(
            self.target, self.side, joint_positions, self.ankle_goal, bones
        )

    def solve_swivel(self, hips: FloatArray, fps: float) -> FloatArray:
        """Return the knee swivel that respects the leg's limits ``(F,)`` [rad].

        This is the smallest sufficient swivel, or the best one if none is sufficient.
        """
        swivel = np.zeros(len(hips))
        rotations, axis = self.rotations(hips), self.ankle_goal - hips - self.tracks.hip
        all_frames = np.arange(len(hips))
        excess = self._squared_excess(rotations, axis, all_frames, swivel)
        violating_frames = np.flatnonzero(excess > 0)
        if not len(violating_frames):
            return swivel
        best_swivel = np.zeros(len(violating_frames))
        for grid in (SWIVEL_ANGLES, FINE_SWIVEL_ANGLES):
            candidates = best_swivel + grid[:, None]
            costs = [
                self._squared_excess(rotations, axis, violating_frames, angles)
                + (SWIVEL_COST * angles) ** 2
                for angles in candidates
            ]
            frame_columns = np.arange(len(violating_frames))
            best_swivel = candidates[np.argmin(costs, axis=0), frame_columns]
        swivel[violating_frames] = best_swivel
        return gaussian_smooth(swivel, SWIVEL_SECONDS * fps)

    def _squared_excess(
        self,
        rotations: tuple[FloatArray, FloatArray],
        axis: FloatArray,
        frames: IntArray,
        swivels: FloatArray,
    ) -> FloatArray:
        """Return the sum of squared limit violations of hip and ankle [rad²]."""
        rig, (thigh, _, foot, _) = self.target.rig, leg_joints(self.target, self.side)
        bone_rotations = rotations[0][frames], rotations[1][frames]
        thigh_rotation, shin_rotation = swivel_leg(
            bone_rotations, axis[frames], swivels
        )
        inverse_parent = so3.conjugate(self.tracks.rotations[frames, 0])
        squared_violation = np.zeros(len(frames))
        inverse_shin = so3.conjugate(shin_rotation)
        for joint, local_rotation in (
            (thigh, so3.multiply(inverse_parent, thigh_rotation)),
            (foot, so3.multiply(inverse_shin, self.foot_rotations[frames])),
        ):
            limit = rig.joints[joint].limits
            if isinstance(limit, BallLimit):
                inverse_rest = so3.conjugate(rig.rest_rotations[joint])
                excess = limit.excess(so3.multiply(inverse_rest, local_rotation))
                squared_violation += excess**2
        return squared_violation

    def ankle_depth(self, hips: FloatArray, swivel: FloatArray) -> FloatArray:
        """Return the depth of a planted ankle below its goal ``(F,)`` [m].

        It is caused by hip limits, and 0 while the foot is in the air.
        """
        rig = self.target.rig
        thigh, shin, foot, _ = leg_joints(self.target, self.side)
        limit = rig.joints[thigh].limits
        if not isinstance(limit, BallLimit):
            return np.zeros(len(hips))
        hip_positions = hips + self.tracks.hip
        thigh_rotation, shin_rotation = swivel_leg(
            self.rotations(hips), self.ankle_goal - hip_positions, swivel
        )
        parent_rotation = self.tracks.rotations[:, 0]
        rest_rotation = rig.rest_rotations[thigh]
        rest_world_rotation = so3.multiply(parent_rotation, rest_rotation)
        relative_rotation = so3.multiply(
            so3.conjugate(rest_world_rotation), thigh_rotation
        )
        clamped_rotation = so3.multiply(rest_rotation, limit.clamped(relative_rotation))
        clamped_thigh = so3.multiply(parent_rotation, clamped_rotation)
        # The knee keeps its bend.
        bend = so3.multiply(so3.conjugate(thigh_rotation), shin_rotation)
        shin_rotation = so3.multiply(clamped_thigh, bend)
        bones = rig.rest_translations
        knee = hip_positions + so3.rotate(clamped_thigh, bones[shin])
        ankle = knee + so3.rotate(shin_rotation, bones[foot])
        up = up_index(rig)
        depth = np.maximum(self.ankle_goal[:, up] - ankle[:, up], 0.0)
        return np.where(self.is_planted, depth, 0.0)


def solve_within_limits(
    target: RoledSkeleton,
    sides: str,
    tracks: Sequence[LegTracks],
    feet_paths: PlacedFeet,
    fps: float,
) -> tuple[FloatArray, list[FloatArray]]:
    """Return hip positions ``(F, 3)`` [m] and knee swivels [rad] within joint limits.

    ``tracks`` are those of the legs at ``sides``, ``feet_paths`` the goals of hips and
    feet.
    """
    foot_arrays = (feet_paths.ankles, feet_paths.rotations, feet_paths.is_planted)
    legs = [_Leg(target, *leg) for leg in zip(sides, tracks, *foot_arrays, strict=True)]
    hips = feet_paths.hips.copy()
    swivels = [leg.solve_swivel(hips, fps) for leg in legs]
    for attempt in range(MAX_HIP_ITERATIONS):
        depths = [
            leg.ankle_depth(hips, a) for leg, a in zip(legs, swivels, strict=True)
        ]
        depth = np.max(depths, axis=0)
        if depth.max() < MAX_FOOT_DEPTH * target.size:
            break
        hips[:, up_index(target.rig)] += upper_envelope(depth, RISE_SECONDS * fps)
        if attempt == MAX_HIP_ITERATIONS - 1:
            swivels = [leg.solve_swivel(hips, fps) for leg in legs]
    return hips, swivels

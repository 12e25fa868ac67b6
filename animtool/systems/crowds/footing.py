"""Foot placement: planted feet, landings, and feet that avoid each other.

Coordinates are in the frame of the ground; a body has x to its left and z ahead.
"""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.record import dataclass
from animtool.maths.rows import Rows
from animtool.systems.crowds.agents import AgentMotion
from animtool.systems.crowds.gaits import Gaits, swing_progress
from animtool.systems.crowds.ground import (
    GroundSampler,
    rotate_about_y,
    sample_ground,
    wrap_angles,
)

# Largest distance of a planted foot from its target, relative to the leg length, and
# largest yaw [rad]; beyond them it is misplaced.
MAX_FOOT_OFFSET, MAX_FOOT_YAW = 0.15, 0.45
# Smallest step width relative to that of the gaits.
MIN_STEP_WIDTH = 0.6
# Gap of feet that pass each other, and range along z in which they do; both relative to
# the leg length.
PASSING_GAP, PASSING_RANGE = 0.09, 0.35
# Largest rates at which a landing may change [m/s], [rad/s]; faster changes would jerk
# the legs.
MAX_LANDING_SPEED, MAX_LANDING_YAW_RATE = 2.5, 6.0


@dataclass(frozen=True, slots=True)
class BodyState(Rows):
    """Gait phases and feet of N bodies."""

    phases: FloatArray  # phase of the cycle; the left foot lands at 0 (N,)
    places: FloatArray  # last foothold of each foot: x, z, heading (N, 2, 3)
    swings: FloatArray  # progress of each foot's swing, -1 if planted (N, 2)
    aims: FloatArray  # landings of swinging feet (N, 2, 3)
    rates: FloatArray  # cycles per second (N,) [1/s]
    lowered: FloatArray  # lowering of the hips, which rise again slowly (N,) [m]
    still: FloatArray  # blend weight: 1 is standing, 0 walking (N,)
    clocks: FloatArray  # time of the idle clip (N,) [s]
    # Smoothed forward speed [m/s], yaw rate [rad/s] and speed to the left (N, 3).
    paces: FloatArray
    reacts: FloatArray  # time since a reaction began (N,) [s]; -1 if there is none
    shoulders: FloatArray  # yaw of the shoulders (N,) [rad]
    heels: FloatArray  # heel pitch of each foot at its last lift-off (N, 2) [rad]
    spans: FloatArray  # remaining fraction of the cycle at each lift-off (N, 2)


@dataclass(frozen=True)
class Blend:
    """Gait weights of N agents, with blended cadence and steps."""

    weights: FloatArray  # (N, G)
    rate: FloatArray  # cycles per second (N,)
    free_rate: FloatArray  # cycles per second of straight forward motion (N,)
    stride: FloatArray  # step length relative to the step length of the gaits (N,)
    stance_fractions: FloatArray  # fraction of the cycle that feet are planted (N, 2)
    steps: FloatArray  # footholds in the frame of the body (N, 2, 3)


@dataclass(frozen=True)
class Footing:
    """Finds footholds for N bodies."""

    gaits: Gaits
    scales: FloatArray  # size of each body relative to its rig (N,)
    ground: GroundSampler

    def find_landings(
        self,
        foot_index: int,
        blend: Blend,
        points: FloatArray,
        headings: FloatArray,
        footholds: FloatArray,
    ) -> FloatArray:
        """Return landings ``(N, 3)`` of a foot, for bodies at positions and headings.

        The foot lands on its side of the other foot.
        """
        side = 1 - 2 * foot_index
        scale_factors = np.stack([self.scales, self.scales, 0 * self.scales + 1], 1)
        step = blend.steps[:, foot_index] * scale_factors
        other_foot = footholds[:, 1 - foot_index, :2] - points
        other_foot = rotate_about_y(other_foot, -headings)
        width = blend.steps[:, 0, 0] - blend.steps[:, 1, 0]
        min_width = MIN_STEP_WIDTH * width * self.scales
        is_too_close = side * (step[:, 0] - other_foot[:, 0]) < min_width
        # Another foot that is out of reach is no obstacle.
        is_too_close &= np.abs(other_foot[:, 0]) < 2 * min_width
        lateral_positions = np.where(
            is_too_close, other_foot[:, 0] + side * min_width, step[:, 0]
        )
        offsets = rotate_about_y(
            np.stack([lateral_positions, step[:, 1]], axis=1), headings
        )
        return np.column_stack([points + offsets, headings + step[:, 2]])

    def standing_targets(self, motion: AgentMotion, blend: Blend) -> FloatArray:
        """Return the foot targets of standing bodies ``(N, 2, 3)``."""
        scale_factors = np.stack([self.scales, 0 * self.scales, 0 * self.scales + 1], 1)
        steps = blend.steps * scale_factors[:, None]
        offsets = rotate_about_y(steps[..., :2], motion.headings[:, None])
        yaws = motion.headings[:, None, None] + steps[..., 2:]
        return np.concatenate([motion.points[:, None] + offsets, yaws], axis=2)

    def is_misplaced(
        self, state: BodyState, motion: AgentMotion, blend: Blend
    ) -> BoolArray:
        """Return a mask of the feet too far from their standing targets ``(N, 2)``."""
        offsets = state.places - self.standing_targets(motion, blend)
        distances = np.linalg.norm(offsets[..., :2], axis=2)
        leg_lengths = self.gaits.walker.leg_length * self.scales[:, None]
        yaws = np.abs(wrap_angles(offsets[..., 2]))
        return np.asarray(
            (distances > MAX_FOOT_OFFSET * leg_lengths) | (yaws > MAX_FOOT_YAW)
        )

    def foot_poses(
        self, state: BodyState, motion: AgentMotion
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return foot poses in body frames ``(N, 2, 4)``, and the ground normals.

        Feet are x, y, z and yaw, at the scale of the rig. Also returns the distance of
        each foot from the nearer of its last and next footholds ``(N, 2)``.
        """
        feet = np.zeros((len(state.phases), 2, 4))
        normals = np.zeros((len(state.phases), 2, 3))
        foothold_distances = np.zeros((len(state.phases), 2))
        ground_heights, _ = sample_ground(self.ground, motion.points)
        footholds = state.places.copy()
        for k in range(2):
            is_swinging = state.swings[:, k] >= 0
            fraction = swing_progress(np.maximum(state.swings[:, k], 0.0))[:, None]
            start, target = state.places[:, k], state.aims[:, k]
            stride = target - start
            footholds[is_swinging, k] = (start + fraction * stride)[is_swinging]
            stride_lengths = np.linalg.norm(stride[:, :2], axis=1)[:, None]
            distances = (stride_lengths * np.hstack([fraction, 1 - fraction])).min(
                axis=1
            )
            foothold_distances[:, k] = np.where(is_swinging, distances, 0.0)
            start_height, start_normal = sample_ground(self.ground, start[:, :2])
            target_height, target_normal = sample_ground(self.ground, target[:, :2])
            ground_height, _ = sample_ground(self.ground, footholds[:, k, :2])
            height = start_height + fraction[:, 0] * (target_height - start_height)
            height = np.maximum(height, ground_height)
            height = np.where(is_swinging, height, start_height)
            normal = start_normal + fraction * (target_normal - start_normal)
            normals[:, k] = np.where(is_swinging[:, None], normal, start_normal)
            feet[:, k, 1] = (height - ground_heights) / self.scales
        foothold_distances /= self.scales[:, None]
        detours = self._avoid_planted_feet(state, motion, footholds)
        foothold_distances += detours / self.scales[:, None]
        to_body_angles = -motion.headings[:, None]
        offsets = footholds[..., :2] - motion.points[:, None]
        offsets = rotate_about_y(offsets, to_body_angles)
        feet[..., [0, 2]] = offsets / self.scales[:, None, None]
        feet[..., 3] = wrap_angles(footholds[..., 2] - motion.headings[:, None])
        normals[..., [0, 2]] = rotate_about_y(normals[..., [0, 2]], to_body_angles)
        return feet, normals, foothold_distances

    def _avoid_planted_feet(
        self, state: BodyState, motion: AgentMotion, footholds: FloatArray
    ) -> FloatArray:
        """Move swinging feet around planted ones, in place.

        Returns the lengths of the detours ``(N, 2)`` [m].
        """
        detours = np.zeros((len(footholds), 2))
        local_footholds = rotate_about_y(footholds[..., :2], -motion.headings[:, None])
        leg_length = self.gaits.walker.leg_length
        gap = PASSING_GAP * leg_length * self.scales
        passing_range = PASSING_RANGE * leg_length * self.scales
        for k in range(2):
            side = 1 - 2 * k
            offset = local_footholds[:, k] - local_footholds[:, 1 - k]
            fraction = np.maximum(state.swings[:, k], 0.0)
            proximity = np.clip(1 - np.abs(offset[:, 1]) / passing_range, 0.0, 1.0)
            # The detour of crossed feet is limited: faster legs would jerk.
            shift = np.clip(gap - side * offset[:, 0], 0.0, gap) * proximity
            displacement = np.zeros_like(offset)
            displacement[:, 0] = side * shift * 16 * (fraction * (1 - fraction)) ** 2
            footholds[:, k, :2] += rotate_about_y(displacement, motion.headings)
            detours[:, k] = np.abs(displacement[:, 0])
        return detours


def limit_landings(
    aims: FloatArray,
    new_landings: FloatArray,
    swings: FloatArray,
    was_planted: BoolArray,
    scales: FloatArray,
    dt: float,
    foot_index: int,
) -> FloatArray:
    """Return landings ``(N, 3)`` of a foot with a limited rate of change.

    Feet that have just lifted (``was_planted``) use their new landing without a limit.
    """
    progress = swing_progress(np.clip(swings[:, foot_index], 0.0, 1.0))
    progress = np.where(was_planted, 0.0, progress)
    correction = new_landings - aims[:, foot_index]
    distances = progress * np.linalg.norm(correction[:, :2], axis=1)
    fraction = MAX_LANDING_SPEED * scales * dt / np.maximum(distances, 1e-9)
    fraction = np.where(distances > 0, np.minimum(fraction, 1.0), 1.0)
    landings = aims[:, foot_index] + fraction[:, None] * correction
    yaw = wrap_angles(correction[:, 2])
    max_yaw = MAX_LANDING_YAW_RATE * dt / np.maximum(progress, 1e-9)
    max_yaw = np.where(progress > 0, max_yaw, np.inf)
    landings[:, 2] = aims[:, foot_index, 2] + np.clip(yaw, -max_yaw, max_yaw)
    return np.where(was_planted[:, None], new_landings, landings)

"""Locomotion of agents' bodies: gait blending and planted feet.

Coordinates are in the frame of the ground. A body has x to its left and z ahead.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.systems.crowds.agents import AgentMotion
from animtool.systems.crowds.footing import Blend, BodyState, Footing, limit_landings
from animtool.systems.crowds.gaits import PHASE_COUNT, weighted_sum
from animtool.systems.crowds.ground import rotate_about_y, sample_ground, wrap_angles
from animtool.systems.crowds.reach import MAX_CYCLE_RATE, LegReach, Stances, step_rates
from animtool.systems.crowds.shoulders import Trunk

# Fraction of the slowest gait's speed below which agents stand, unless a foot is
# misplaced.
STANDING_SPEED = 0.1
# Cadence is proportional to this power of speed (Grieve and Gear, 1966).
CADENCE_POWER = 0.42
# Bounds of the cadence relative to that of the blended gaits.
MIN_CADENCE_RATIO, MAX_CADENCE_RATIO = 0.7, 1.6
# Time constant of gait blending [s].
PACE_TIME = 0.2
# Time to blend from walking to standing [s].
STANDING_TIME = 0.3
# Phase after which a foot that is about to land does not lift again.
NO_LIFT_PHASE = 0.95
# Largest difference of the yaw rate from its smoothed value, for step rates [rad/s].
YAW_RATE_TOLERANCE = 0.6
# Largest rate of change of the cadence [cycles/s²]; faster changes would jerk the legs.
MAX_CADENCE_CHANGE = 12.0
# Speed at which lowered hips rise, in leg lengths [1/s].
HIP_RISE_SPEED = 0.6
# Fraction of a swing after which its landing does not change.
LANDING_FIXED_PHASE = 0.6
# Largest yaw in the prediction of a landing [rad].
MAX_YAW = 1.0
# Speeds in any direction above this multiple of the standing speed count as walking.
PUSHED_SPEED = 3.0
# Largest steps sideways and backwards, relative to the leg length.
MAX_SIDE_STEP, MAX_BACK_STEP = 0.25, 0.3
# Largest yaw of a body over a planted foot [rad].
MAX_STANCE_YAW = 0.8


@dataclass(frozen=True)
class AgentBodies(Footing):
    """Steps the bodies of N agents: phases, footholds and hips."""

    @cached_property
    def animated_joints(self) -> IntArray:
        """Joints that gaits, leg IK or the trunk rotate, ascending ``(M,)``."""
        gaits = self.gaits
        rest = gaits.walker.rig.rest_rotations
        is_animated = [
            (np.abs(gait.rotations - rest) > 1e-9).any(axis=(0, 2))
            for gait in (*gaits.cycles, gaits.idle, *gaits.reactions)
        ]
        joints = [joint for leg in gaits.walker.legs for joint in leg[:3]]
        joints += self.trunk.joints.tolist()
        return np.union1d(np.flatnonzero(np.any(is_animated, axis=0)), joints)

    @cached_property
    def trunk(self) -> Trunk:
        """Trunk joints that rotate the shoulders."""
        return Trunk.from_skeleton(self.gaits.walker.skeleton)

    @cached_property
    def animated_rotations(self) -> tuple[list[FloatArray], FloatArray]:
        """Local rotations of the animated joints: of each gait and of the idle clip."""
        gaits, joints = self.gaits, self.animated_joints
        moving_rotations = [gait.rotations[:, joints] for gait in gaits.cycles]
        return moving_rotations, gaits.idle.rotations[:, joints]

    def initial_state(
        self, motion: AgentMotion, random_phases: FloatArray
    ) -> BodyState:
        """Return bodies standing at the start, with random phases ``(N,)``."""
        count = len(random_phases)
        paces = np.zeros((count, 3))
        blend = self.blend(paces)
        standing_targets = self.standing_targets(motion, blend)
        return BodyState(
            random_phases,
            standing_targets,
            -np.ones((count, 2)),
            standing_targets,
            blend.rate,
            np.zeros(count),
            np.ones(count),
            random_phases * self.gaits.idle.period,
            paces,
            -np.ones(count),
            np.zeros(count),
            np.zeros((count, 2)),
            np.ones((count, 2)),
        )

    def blend(self, paces: FloatArray) -> Blend:
        """Return gait weights and blended steps for speeds and yaw rates ``(N, 3)``."""
        moving_gaits, leg_length = self.gaits.cycles, self.gaits.walker.leg_length
        speeds = paces[:, 0] / self.scales
        yaw_rates = paces[:, 1]
        left_speeds = paces[:, 2] / self.scales
        pace_samples = np.stack(
            [np.maximum(speeds, 0.0), leg_length * yaw_rates], axis=1
        )
        gait_points = np.array(
            [[gait.speed, leg_length * gait.yaw_rate] for gait in moving_gaits]
        )
        weights = _gait_weights(pace_samples, gait_points)
        # BLAS sums in an order that depends on the number of agents; einsum does not.
        gait_paces = np.array([[gait.speed, gait.period] for gait in moving_gaits])
        speed, period = np.einsum("ng,gk->kn", weights, gait_paces)
        cadence_ratios = (np.hypot(speeds, left_speeds) / speed) ** CADENCE_POWER
        rates = np.clip(cadence_ratios, MIN_CADENCE_RATIO, MAX_CADENCE_RATIO) / period
        gait_steps = np.stack([gait.steps for gait in moving_gaits])
        steps = np.einsum("ng,gfk->nfk", weights, gait_steps)
        gait_fractions = np.stack([gait.stance_fractions for gait in moving_gaits])
        stance_fractions = np.einsum("ng,gf->nf", weights, gait_fractions)
        mean_fractions = stance_fractions.mean(axis=1)
        # Sideways, backward and spinning motion uses shorter, more frequent steps.
        side_step = left_speeds * mean_fractions / (2 * rates)
        back_step = -speeds * mean_fractions / (2 * rates)
        rate_factor = np.maximum(
            np.abs(side_step) / (MAX_SIDE_STEP * leg_length),
            back_step / (MAX_BACK_STEP * leg_length),
        )
        stance_yaw = np.abs(yaw_rates) * mean_fractions / rates
        rate_factor = np.maximum(rate_factor, stance_yaw / MAX_STANCE_YAW)
        rate_factor = np.clip(rate_factor, 1.0, np.maximum(MAX_CYCLE_RATE / rates, 1.0))
        free_rates, rates = rates, rates * rate_factor
        stride_ratios = speeds / speed / (rates * period)
        steps[..., 1] *= stride_ratios[:, None]
        steps[..., 0] += (side_step / rate_factor)[:, None]
        return Blend(weights, rates, free_rates, stride_ratios, stance_fractions, steps)

    def advance(
        self,
        state: BodyState,
        before: AgentMotion,
        after: AgentMotion,
        dt: float,
        is_hit: BoolArray | None = None,
    ) -> BodyState:
        """Return the bodies after a step [s], in which feet may lift off and land.

        ``is_hit`` is a mask of agents that were hit in the step ``(N,)``.
        """
        yaw_velocities = wrap_angles(after.headings - before.headings) / dt
        # Actual velocities: those of pushed agents differ from the preferred ones.
        velocities = (after.points - before.points) / dt
        local_velocities = rotate_about_y(velocities, -after.headings)
        left_speeds, forward_speeds = local_velocities.T
        paces = np.stack([forward_speeds, yaw_velocities, left_speeds], axis=1)
        smoothing_factor = -np.expm1(-dt / PACE_TIME)
        paces = state.paces + (paces - state.paces) * smoothing_factor
        blend = self.blend(paces)
        is_misplaced = self.is_misplaced(state, after, blend)
        is_standing = (state.swings < 0).all(axis=1)
        slow_speed = STANDING_SPEED * self.gaits.cycles[0].speed * self.scales
        total_speeds = np.linalg.norm(local_velocities, axis=1)
        is_walking = (forward_speeds > slow_speed) | is_misplaced.any(axis=1)
        is_walking |= total_speeds > PUSHED_SPEED * slow_speed
        is_starting = is_walking & (state.still >= 1)
        phases = self._lift_phases(state, blend, is_starting, is_misplaced, after)
        stances = self._foot_stances(state, after, phases, blend)
        speeds = local_velocities / self.scales[:, None]
        low, high = paces[:, 1] - YAW_RATE_TOLERANCE, paces[:, 1] + YAW_RATE_TOLERANCE
        yaw_rates = np.clip(yaw_velocities, low, high)
        rates, is_stance_over = step_rates(self.leg_reach, stances, speeds, yaw_rates)
        # Hurried steps slow down again with the pace.
        target_rates = state.rates + (blend.rate - state.rates) * smoothing_factor
        max_rates = np.maximum(target_rates, state.rates + MAX_CADENCE_CHANGE * dt)
        rates = np.minimum(np.maximum(rates, target_rates), max_rates)
        phase_change = np.where(is_walking | ~is_standing, rates * dt, 0.0)
        footholds, swings = state.places.copy(), state.swings.copy()
        aims, heels, spans = state.aims.copy(), state.heels.copy(), state.spans.copy()
        for k in range(2):
            swings[is_stance_over[:, k], k] = 0.0
            stance_phases = np.where(
                is_stance_over[:, k], stances.phases[:, k], blend.stance_fractions[:, k]
            )
            heel_pitches = self.heel_pitches(k, stance_phases, blend, state.still)
            self._advance_foot(
                k, phases, phase_change, blend, (before, after), footholds, swings
            )
            has_lifted = (state.swings[:, k] < 0) & (swings[:, k] >= 0)
            heels[has_lifted, k] = heel_pitches[has_lifted]
            remaining_phases = 1 - np.maximum((phases - 0.5 * k) % 1.0, stance_phases)
            spans[has_lifted, k] = remaining_phases[has_lifted]
            has_landed = (state.swings[:, k] >= LANDING_FIXED_PHASE) & (
                swings[:, k] < 0
            )
            footholds[has_landed, k] = state.aims[has_landed, k]
        phases = (phases + phase_change) % 1.0
        for k in range(2):
            is_landing_fixed = state.swings[:, k] >= LANDING_FIXED_PHASE
            is_swinging = (swings[:, k] >= 0) & ~is_landing_fixed
            remaining_times = (1 - (phases - 0.5 * k) % 1.0) / rates
            yaw = np.clip(paces[:, 1] * remaining_times, -MAX_YAW, MAX_YAW)
            points = after.points + after.velocities * remaining_times[:, None]
            landings = self.find_landings(
                k, blend, points, after.headings + yaw, footholds
            )
            was_planted = state.swings[:, k] < 0
            aims[is_swinging, k] = limit_landings(
                aims, landings, swings, was_planted, self.scales, dt, k
            )[is_swinging]
        is_stepping = is_walking | (swings >= 0).any(axis=1)
        standing_change = np.where(is_stepping, -dt, dt) / STANDING_TIME
        next_state = replace(
            state,
            phases=phases,
            places=footholds,
            swings=swings,
            aims=aims,
            rates=rates,
            still=np.clip(state.still + standing_change, 0.0, 1.0),
            clocks=state.clocks + dt,
            paces=paces,
            reacts=self._reaction_times(state.reacts, dt, is_hit),
            heels=heels,
            spans=spans,
        )
        return self._keep_in_reach(state, next_state, after, blend, dt)

    def _keep_in_reach(
        self,
        before: BodyState,
        state: BodyState,
        motion: AgentMotion,
        blend: Blend,
        dt: float,
    ) -> BodyState:
        """Return bodies with landed feet moved into reach, and hips lowered."""
        stances = self._foot_stances(state, motion, state.phases, blend)
        footholds = state.places.copy()
        leg_length = self.gaits.walker.leg_length
        hip_lowerings = np.maximum(
            before.lowered - HIP_RISE_SPEED * leg_length * dt, 0.0
        )
        for k in range(2):
            foot_stance = k, stances.thighs[:, k], stances.feet[:, k]
            pitches = stances.pitches[0, :, k]
            is_planted = state.swings[:, k] < 0
            reach_margin, outwards = self.leg_reach.reach_margin(*foot_stance, pitches)
            is_changed = (footholds[:, k] != before.places[:, k]).any(axis=1)
            has_landed = is_planted & is_changed
            overreach = np.minimum(reach_margin, 0.0)[:, None]
            shift = overreach * outwards * self.scales[:, None]
            shift = rotate_about_y(shift, motion.headings)
            footholds[has_landed, k, :2] += shift[has_landed]
            required_lowering = self.leg_reach.hip_lowering(*foot_stance, pitches)
            required_lowering = np.where(is_planted, required_lowering, 0.0)
            hip_lowerings = np.maximum(hip_lowerings, required_lowering)
        return replace(state, places=footholds, lowered=hip_lowerings)

    @cached_property
    def leg_reach(self) -> LegReach:
        """Reach of both legs, from the thigh positions in all gaits."""
        return LegReach.from_gaits(self.gaits)

    def heel_pitches(
        self,
        foot_index: int,
        stance_phases: FloatArray,
        blend: Blend,
        standing_weights: FloatArray,
    ) -> FloatArray:
        """Return the heel pitches of planted feet ``(N,)`` [rad]."""
        progress = np.clip(
            stance_phases / blend.stance_fractions[:, foot_index], 0.0, 1.0
        )
        stance_frames = progress * (PHASE_COUNT - 1)
        pitches = [
            np.interp(stance_frames, np.arange(PHASE_COUNT), gait.pitches[foot_index])
            for gait in self.gaits.cycles
        ]
        return weighted_sum(pitches, blend.weights) * (1 - standing_weights)

    def _foot_stances(
        self, state: BodyState, motion: AgentMotion, phases: FloatArray, blend: Blend
    ) -> Stances:
        """Return the stances of both feet at phases ``(N,)``."""
        feet = np.zeros((len(phases), 2, 4))
        offsets = state.places[..., :2] - motion.points[:, None]
        offsets = rotate_about_y(offsets, -motion.headings[:, None])
        feet[..., [0, 2]] = offsets / self.scales[:, None, None]
        feet[..., 3] = wrap_angles(state.places[..., 2] - motion.headings[:, None])
        heights, _ = sample_ground(self.ground, state.places[..., :2].reshape(-1, 2))
        body_height, _ = sample_ground(self.ground, motion.points)
        feet[..., 1] = heights.reshape(-1, 2) - body_height[:, None]
        feet[..., 1] /= self.scales[:, None]
        thighs = self.leg_reach.thighs(phases, blend.weights, state.still)
        thighs[..., 1] += feet[..., 1].mean(axis=1)[:, None]
        foot_phases = (phases[:, None] - [0.0, 0.5]) % 1.0
        stance_ends, is_swinging = blend.stance_fractions, state.swings >= 0
        pitches = [
            [self.heel_pitches(k, stance[:, k], blend, state.still) for k in range(2)]
            for stance in (foot_phases, stance_ends)
        ]
        pitch_array = np.array(pitches).swapaxes(1, 2)
        return Stances(
            foot_phases, stance_ends, is_swinging, feet, thighs, pitch_array, blend.rate
        )

    def _reaction_times(
        self, reacts: FloatArray, dt: float, is_hit: BoolArray | None
    ) -> FloatArray:
        """Return the time since each reaction began ``(N,)`` [s], or -1."""
        if not self.gaits.reactions:
            return reacts
        period = self.gaits.reactions[0].period
        times = np.where(reacts >= 0, reacts + dt, reacts)
        times = np.where(times > period, -1.0, times)
        return times if is_hit is None else np.where(is_hit & (times < 0), 0.0, times)

    def _lift_phases(
        self,
        state: BodyState,
        blend: Blend,
        is_starting: BoolArray,
        is_misplaced: BoolArray,
        motion: AgentMotion,
    ) -> FloatArray:
        """Return phases ``(N,)``; bodies that start to walk lift the rear foot."""
        offsets = self.standing_targets(motion, blend) - state.places
        local_offsets = rotate_about_y(offsets[..., :2], -motion.headings[:, None])
        lift_scores = local_offsets[..., 1] + np.where(is_misplaced, 10.0, 0.0)
        left_phases, right_phases = (blend.stance_fractions + np.array([0.0, 0.5])).T
        lift_phases = np.where(
            lift_scores[:, 1] > lift_scores[:, 0], right_phases, left_phases
        )
        return np.where(is_starting, lift_phases % 1.0, state.phases)

    def _advance_foot(
        self,
        foot_index: int,
        phases: FloatArray,
        phase_change: FloatArray,
        blend: Blend,
        motions: tuple[AgentMotion, AgentMotion],
        footholds: FloatArray,
        swings: FloatArray,
    ) -> None:
        """Lift, swing and land foot ``foot_index`` of each body, in place."""
        start_phase = (phases - 0.5 * foot_index) % 1.0
        end_phase = start_phase + phase_change
        stance_end = blend.stance_fractions[:, foot_index]
        # Feet that are planted longer than in the current gait lift at once.
        is_lifting = (
            (swings[:, foot_index] < 0) & (phase_change > 0) & (end_phase >= stance_end)
        )
        is_late = (start_phase > stance_end) & ~(start_phase < NO_LIFT_PHASE)
        is_lifting &= (start_phase < 1) & ~is_late
        swings[is_lifting, foot_index] = 0.0
        phase = np.where(is_lifting, np.maximum(start_phase, stance_end), start_phase)
        is_swinging = swings[:, foot_index] >= 0
        progress = np.clip((end_phase - phase) / np.maximum(1 - phase, 1e-9), 0.0, 1.0)
        has_landed = is_swinging & (end_phase >= 1)
        fraction = (1 - start_phase) / np.where(phase_change > 0, phase_change, 1.0)
        before, after = motions
        points = before.points + fraction[:, None] * (after.points - before.points)
        rotation = wrap_angles(after.headings - before.headings)
        headings = before.headings + fraction * rotation
        landings = self.find_landings(foot_index, blend, points, headings, footholds)
        footholds[has_landed, foot_index] = landings[has_landed]
        swings[is_swinging, foot_index] += (
            1 - swings[is_swinging, foot_index]
        ) * progress[is_swinging]
        swings[has_landed, foot_index] = -1.0


def _gait_weights(samples: FloatArray, gait_points: FloatArray) -> FloatArray:
    """Return gait weights ``(N, G)`` by gradient-band interpolation (Johansen, 2009).

    Samples ``(N, 2)`` and gait points ``(G, 2)`` are speeds and scaled yaw rates.
    """
    if len(gait_points) == 1:
        return np.ones((len(samples), 1))
    offsets = gait_points[None] - gait_points[:, None]  # (i, j, 2)
    squared_lengths = (offsets * offsets).sum(axis=2)
    squared_lengths[squared_lengths == 0] = np.inf
    sample_offsets = samples[:, None] - gait_points[None]
    projections = np.einsum("nik,ijk->nij", sample_offsets, offsets) / squared_lengths
    # The nearest band has at least half the weight: the sum is never 0.
    unnormalized_weights = np.clip(1 - projections, 0.0, 1.0).min(axis=2)
    return np.asarray(
        unnormalized_weights / unnormalized_weights.sum(axis=1, keepdims=True)
    )

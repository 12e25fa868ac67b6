"""Poses of bodies: blended gaits, with leg IK to planted feet."""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.retarget.legs import ankle_rotations
from animtool.rig.kinematics import forward_kinematics
from animtool.systems.crowds.agents import AgentMotion
from animtool.systems.crowds.bodies import AgentBodies
from animtool.systems.crowds.footing import Blend, BodyState
from animtool.systems.crowds.gaits import (
    PHASE_COUNT,
    SIDE_LETTERS,
    UP,
    Gait,
    Gaits,
    Walker,
    rotations_about_x,
    sample_rows,
    standing_ankle,
    swing_progress,
    weighted_sum,
)
from animtool.systems.crowds.ground import rotations_about_y
from animtool.systems.crowds.reach import MAX_LOWERING, SWING_MARGIN, reach_across

# Blend time at both ends of a reaction [s].
REACTION_BLEND_TIME = 0.2
# Largest slope that feet follow [rad].
MAX_TILT = 0.45
# Fraction of a swing, at both ends, in which hips are lowered for its foot.
LOWERING_PHASE = 0.4
# Fraction of a swing in which a foot blends from its stance to its gait.
STANCE_BLEND_PHASE = 0.7
# Fraction of a swing after which the foot rotates towards its landing.
LANDING_PHASE = 0.6
# Lift of the ankle of a flat foot, relative to that in the gait.
FLAT_FOOT_LIFT = 0.35
# Slope of the clearance of soles over the distance from a foothold, and its limit [m].
SOLE_SLOPE, SOLE_CLEARANCE = 2.0, 0.02


@dataclass(frozen=True, slots=True)
class BodyPoses:
    """Poses of N bodies, in the local frame of each body."""

    rotations: FloatArray  # local rotations of joints (N, J, 4)
    roots: FloatArray  # positions of the root joint (N, 3) [m]


def body_poses(bodies: AgentBodies, state: BodyState, motion: AgentMotion) -> BodyPoses:
    """Return the poses of bodies: blended gaits with leg IK."""
    rig = bodies.gaits.walker.rig
    blend = bodies.blend(state.paces)
    gait_rotations, roots = _gait_rotations(bodies, state, blend)
    rotations = np.repeat(rig.rest_rotations[None], len(gait_rotations), axis=0)
    rotations[:, bodies.animated_joints] = gait_rotations
    bodies.trunk.rotate_shoulders(rig.parents, rotations, state.shoulders)
    feet, normals, foothold_distances = bodies.foot_poses(state, motion)
    goals, soles = _ankle_targets(
        bodies, state, blend, feet, normals, foothold_distances
    )
    # Hips stay above the mean ground of both feet.
    roots[:, 1] += feet[:, :, 1].mean(axis=1)
    roots[:, 1] -= _solve_leg_ik(
        bodies.gaits.walker, rotations, roots, goals, soles, state
    )
    return BodyPoses(rotations, roots)


def _solve_leg_ik(
    walker: Walker,
    rotations: FloatArray,
    roots: FloatArray,
    goals: FloatArray,
    soles: FloatArray,
    state: BodyState,
) -> FloatArray:
    """Solve leg IK for ankle goals ``(N, 2, 3)`` and sole rotations, in place.

    Returns the lowering of hips ``(N,)`` [m].
    """
    rig = walker.rig
    translations = np.repeat(rig.rest_translations[None], len(rotations), axis=0)
    translations[:, 0] = roots
    world = forward_kinematics(rig, translations, rotations)
    joints = world.positions
    world_rotations = {
        joint: so3.from_matrix(world.linear[:, joint])
        for thigh, shin, _, _ in walker.legs
        for joint in (thigh, shin, int(rig.parents[thigh]))
        if joint >= 0
    }
    hip_lowerings = _hip_lowering(walker, joints, goals, state)
    joints = joints - hip_lowerings[:, None, None] * UP
    goals = _move_into_reach(walker, joints, goals, state.swings >= 0)
    for k, (thigh, shin, foot, _) in enumerate(walker.legs):
        hip_parent = int(rig.parents[thigh])
        thigh_rotation, shin_rotation = ankle_rotations(
            walker.skeleton,
            SIDE_LETTERS[k],
            joints[:, [thigh, shin, foot]],
            goals[:, k],
            (world_rotations[thigh], world_rotations[shin]),
        )
        level_rotation = np.broadcast_to(
            walker.level_rotations[k], thigh_rotation.shape
        )
        sole_rotation = so3.multiply(soles[:, k], level_rotation)
        if hip_parent >= 0:
            hip_rotation = world_rotations[hip_parent]
        else:
            hip_rotation = np.broadcast_to(so3.IDENTITY, thigh_rotation.shape)
        for joint, parent, joint_rotation in (
            (thigh, hip_rotation, thigh_rotation),
            (shin, thigh_rotation, shin_rotation),
            (foot, shin_rotation, sole_rotation),
        ):
            rotations[:, joint] = so3.multiply(so3.conjugate(parent), joint_rotation)
    return hip_lowerings


def _hip_lowering(
    walker: Walker, joints: FloatArray, goals: FloatArray, state: BodyState
) -> FloatArray:
    """Return how far hips must be lowered for the feet ``(N,)`` [m].

    In the middle of a swing hips need not be lowered.
    """
    hip_lowerings = state.lowered.copy()
    for k, (thigh, shin, foot, _) in enumerate(walker.legs):
        leg_joints = joints[:, [thigh, shin, foot]]
        length = np.linalg.norm(np.diff(leg_joints, axis=1), axis=2).sum(axis=1)
        leg_vectors = joints[:, thigh] - goals[:, k]
        max_height = reach_across(length, (leg_vectors[:, [0, 2]] ** 2).sum(axis=1))
        end_weight = np.abs(2 * state.swings[:, k] - 1) - 1 + 2 * LOWERING_PHASE
        end_weight = np.clip(end_weight / (2 * LOWERING_PHASE), 0.0, 1.0)
        required_lowering = leg_vectors[:, 1] - max_height
        swing_lowering = swing_progress(end_weight) * required_lowering
        max_lowering = state.lowered + SWING_MARGIN * walker.leg_length
        swing_lowering = np.minimum(swing_lowering, max_lowering)
        is_planted = state.swings[:, k] < 0
        foot_lowering = np.where(is_planted, required_lowering, swing_lowering)
        hip_lowerings = np.maximum(hip_lowerings, foot_lowering)
    return np.minimum(hip_lowerings, MAX_LOWERING * walker.leg_length)


def _move_into_reach(
    walker: Walker, joints: FloatArray, goals: FloatArray, is_swinging: BoolArray
) -> FloatArray:
    """Return ankle goals ``(N, 2, 3)``, moved into reach for swinging feet.

    Feet that are moved towards the hips are also raised.
    """
    reachable_goals = goals.copy()
    for k, (thigh, *_) in enumerate(walker.legs):
        leg_vectors = goals[:, k] - joints[:, thigh]
        distances = np.linalg.norm(leg_vectors[:, [0, 2]], axis=1)
        reach = reach_across(walker.leg_length, leg_vectors[:, 1] ** 2)
        overreach = np.maximum(distances - reach, 0.0) * is_swinging[:, k]
        excess = overreach / np.maximum(distances, 1e-9)
        reachable_goals[:, k, [0, 2]] -= excess[:, None] * leg_vectors[:, [0, 2]]
        reachable_goals[:, k, 1] += min_sole_height(overreach)
    return reachable_goals


def min_sole_height(distances: FloatArray) -> FloatArray:
    """Return the required sole height at a distance from a foothold [m]."""
    return np.minimum(SOLE_SLOPE * distances, SOLE_CLEARANCE)


def _ankle_targets(
    bodies: AgentBodies,
    state: BodyState,
    blend: Blend,
    feet: FloatArray,
    normals: FloatArray,
    foothold_distances: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return ankle targets ``(N, 2, 3)``, and rotations of soles."""
    gaits = bodies.gaits
    goals, soles = np.zeros((*feet.shape[:2], 3)), np.zeros(feet.shape)
    for k in range(2):
        stance_phases = (state.phases - 0.5 * k) % 1.0
        foot_rotations = rotations_about_x(
            bodies.heel_pitches(k, stance_phases, blend, state.still)
        )
        ankle_offsets = standing_ankle(gaits.walker, k, foot_rotations)
        is_swinging = state.swings[:, k] >= 0
        if is_swinging.any():
            foot_rotations[is_swinging], ankle_offsets[is_swinging] = _swing_poses(
                gaits, state, blend, k, is_swinging
            )
            ankle_offsets[is_swinging, 1] += _missing_clearance(
                gaits.walker,
                k,
                foot_rotations[is_swinging],
                ankle_offsets[is_swinging],
                foothold_distances[is_swinging, k],
            )
        tilt = _tilt_rotations(normals[:, k])
        yaw = rotations_about_y(feet[:, k, 3])
        goals[:, k] = feet[:, k, :3] + so3.rotate(tilt, so3.rotate(yaw, ankle_offsets))
        soles[:, k] = so3.multiply(tilt, so3.multiply(yaw, foot_rotations))
    return goals, soles


def _missing_clearance(
    walker: Walker,
    foot_index: int,
    foot_rotations: FloatArray,
    ankle_offsets: FloatArray,
    foothold_distances: FloatArray,
) -> FloatArray:
    """Return the depths of swinging soles below the required height ``(K,)`` [m].

    ``foothold_distances`` are those to the nearest foothold ``(K,)`` [m].
    """
    heel = ankle_offsets - so3.rotate(
        foot_rotations, walker.ankle_heights[foot_index] * UP
    )
    ball = ankle_offsets + so3.rotate(foot_rotations, walker.ball_offsets[foot_index])
    deficit = np.zeros(len(ankle_offsets))
    for sole, rest_offset in (
        (heel, 0 * UP),
        (ball, walker.ball_offsets[foot_index] + walker.ankle_heights[foot_index] * UP),
    ):
        offsets = np.linalg.norm((sole - rest_offset)[:, [0, 2]], axis=1)
        required_height = min_sole_height(foothold_distances + offsets)
        deficit = np.maximum(deficit, required_height - (sole - rest_offset)[:, 1])
    return deficit


def _swing_poses(
    gaits: Gaits,
    state: BodyState,
    blend: Blend,
    foot_index: int,
    is_swinging: BoolArray,
) -> tuple[FloatArray, FloatArray]:
    """Return rotations ``(K, 4)`` and ankle offsets ``(K, 3)`` of swinging feet.

    These are for one foot of the bodies in which it swings. Swings start at the pose
    of the last stance, as feet may lift earlier than in the gait.
    """
    swings = np.clip(state.swings[is_swinging, foot_index], 0.0, 1.0)
    foot_rotations, ankle_offsets = _gait_swing(
        gaits, state, blend, foot_index, is_swinging, swings
    )
    start_rotations, start_offsets = _gait_swing(
        gaits, state, blend, foot_index, is_swinging, np.zeros_like(swings)
    )
    stance_rotations = rotations_about_x(state.heels[is_swinging, foot_index])
    blend_progress = swing_progress(np.minimum(swings / STANCE_BLEND_PHASE, 1.0))
    stance_weight = (1 - blend_progress)[:, None]
    correction = so3.multiply(stance_rotations, so3.conjugate(start_rotations))
    identity = np.broadcast_to(so3.IDENTITY, correction.shape)
    partial_correction = _mix_rotations(identity, correction, stance_weight)
    offset = standing_ankle(gaits.walker, foot_index, stance_rotations) - start_offsets
    foot_rotations = so3.multiply(partial_correction, foot_rotations)
    return foot_rotations, ankle_offsets + stance_weight * offset


def _gait_swing(
    gaits: Gaits,
    state: BodyState,
    blend: Blend,
    foot_index: int,
    is_swinging: BoolArray,
    swings: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return rotations and ankle offsets of swinging feet, from their gaits."""
    moving_gaits = gaits.cycles
    frames = swings * (PHASE_COUNT - 1)
    weights = blend.weights[is_swinging]
    gait_rotations = [
        sample_rows(gait.swings[foot_index], frames) for gait in moving_gaits
    ]
    swing_rotations = _blend_rotations(gait_rotations, weights)
    lifts = [sample_rows(gait.lifts[foot_index], frames) for gait in moving_gaits]
    ankle_offsets = weighted_sum(lifts, weights)
    # Offsets along the motion are scaled with the step length.
    end_offsets = [
        sum(
            weight * gait.lifts[foot_index, end, 2]
            for weight, gait in zip(weights.T, moving_gaits, strict=True)
        )
        for end in (0, -1)
    ]
    fraction = frames / (PHASE_COUNT - 1)
    straight_offsets = end_offsets[0] + fraction * (end_offsets[1] - end_offsets[0])
    stride = np.minimum(blend.stride[is_swinging], 1.0)
    deviations = ankle_offsets[:, 2] - straight_offsets
    ankle_offsets[:, 2] = straight_offsets + stride * deviations
    # Feet stay flat after standing, and lift less in quick steps.
    standing_weight = state.still[is_swinging]
    swing_time = state.spans[is_swinging, foot_index] / state.rates[is_swinging]
    swing_fraction = 1 - blend.stance_fractions[is_swinging, foot_index]
    typical_time = swing_fraction / blend.free_rate[is_swinging]
    shortening_factor = 1 - np.minimum(swing_time / typical_time, 1.0)
    landing_progress = (swings - LANDING_PHASE) / (1 - LANDING_PHASE)
    landing_progress = swing_progress(np.clip(landing_progress, 0.0, 1.0))
    flat_weight = np.maximum(
        standing_weight, shortening_factor * (1 - landing_progress)
    )
    flat_weight = flat_weight[:, None]
    flat_rotations = np.broadcast_to(so3.IDENTITY, swing_rotations.shape)
    rotations = _mix_rotations(swing_rotations, flat_rotations, flat_weight)
    flat_ankle = standing_ankle(gaits.walker, foot_index, flat_rotations)
    lift = np.maximum(ankle_offsets[:, 1:2] - flat_ankle[:, 1:2], 0.0)
    flat_lift = FLAT_FOOT_LIFT * lift
    ankle_offsets += flat_weight * (flat_ankle + flat_lift * UP - ankle_offsets)
    return rotations, ankle_offsets


def _gait_rotations(
    bodies: AgentBodies, state: BodyState, blend: Blend
) -> tuple[FloatArray, FloatArray]:
    """Return rotations of animated joints ``(N, M, 4)``, and hip positions."""
    gaits, frames = bodies.gaits, state.phases * PHASE_COUNT
    gait_tables, idle_table = bodies.animated_rotations
    gait_rotations = [
        sample_rows(table, frames, is_cyclic=True) for table in gait_tables
    ]
    walk_rotations = _blend_rotations(gait_rotations, blend.weights)
    gait_hips = [
        sample_rows(gait.hips, frames, is_cyclic=True) for gait in gaits.cycles
    ]
    hips = weighted_sum(gait_hips, blend.weights)
    frames = idle_frames(gaits.idle, state.clocks)
    idle_weight = state.still[:, None]
    idle_rotations = sample_rows(idle_table, frames)
    rotations = _mix_rotations(walk_rotations, idle_rotations, idle_weight)
    hips = hips + idle_weight * (sample_rows(gaits.idle.hips, frames) - hips)
    if gaits.reactions and (state.reacts >= 0).any():
        reaction = gaits.reactions[0]
        elapsed_times = np.maximum(state.reacts, 0.0)
        fraction = (
            np.minimum(elapsed_times, reaction.period - elapsed_times)
            / REACTION_BLEND_TIME
        )
        weight = swing_progress(np.clip(fraction, 0.0, 1.0)) * (state.reacts >= 0)
        frames = elapsed_times / reaction.period * (len(reaction.rotations) - 1)
        reaction_rotations = sample_rows(
            reaction.rotations[:, bodies.animated_joints], frames
        )
        rotations = _mix_rotations(rotations, reaction_rotations, weight[:, None])
        # Height of the hips; their ground position is the agent's.
        height_change = sample_rows(reaction.hips, frames)[:, 1] - hips[:, 1]
        hips[:, 1] += weight * height_change
    return rotations, hips


def idle_frames(idle: Gait, clocks: FloatArray) -> FloatArray:
    """Return fractional frames of the idle clip, played back and forth ``(N,)``."""
    last_frame = len(idle.rotations) - 1
    if not last_frame:
        return np.zeros(len(clocks))
    cycle = (clocks / idle.period) % 2.0
    return np.asarray(np.minimum(cycle, 2 - cycle) * last_frame)


def _mix_rotations(
    first_rotations: FloatArray, second_rotations: FloatArray, weight: FloatArray
) -> FloatArray:
    """Return rotations blended by the weight of the second ones ``(N, 1)``."""
    return _blend_rotations(
        [first_rotations, second_rotations], np.hstack([1 - weight, weight])
    )


def _blend_rotations(rotations: list[FloatArray], weights: FloatArray) -> FloatArray:
    """Return rotations ``(N, …, 4)`` blended by weights ``(N, K)``, normalised."""
    reference = rotations[0]
    shape = (-1, *[1] * (reference.ndim - 1))
    total = reference * weights[:, 0].reshape(shape)
    for k, rotation in enumerate(rotations[1:], start=1):
        is_opposite = (reference * rotation).sum(axis=-1, keepdims=True) < 0
        nearest = np.where(is_opposite, -rotation, rotation)
        total = total + nearest * weights[:, k].reshape(shape)
    return np.asarray(total / np.linalg.norm(total, axis=-1, keepdims=True))


def _tilt_rotations(normals: FloatArray) -> FloatArray:
    """Return rotations from y to normals ``(N, 3)``, clamped to `MAX_TILT`."""
    axis = np.cross(UP, normals)
    lengths = np.linalg.norm(axis, axis=1)
    angle = np.minimum(np.arctan2(lengths, normals[:, 1]), MAX_TILT)
    return so3.exp(axis * (angle / np.where(lengths > 1e-12, lengths, 1.0))[:, None])

"""Poses of bodies: blended gaits, with leg IK to planted feet."""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.retarget.legs import ankle_rotations
from animtool.rig.kinematics import forward
from animtool.systems.crowds.agents import AgentMotion
from animtool.systems.crowds.bodies import AgentBodies
from animtool.systems.crowds.footing import Blend, BodyState
from animtool.systems.crowds.gaits import (
    PHASES,
    SIDES,
    UP,
    Gait,
    Gaits,
    Walker,
    about_side,
    eased,
    rows,
    standing_ankle,
)
from animtool.systems.crowds.ground import about_up
from animtool.systems.crowds.reach import AIRBORNE, MOST_LOWERED, STRAIGHT

# Blend time at both ends of a reaction [s].
RAMP = 0.2
# Largest slope that feet follow [rad].
TILT = 0.45
# Hips are lowered in these parts of a swing, for its foot.
NEARING = 0.4
# A foot blends from its last stance to its gait in this part of a swing.
LEAVING = 0.7
# From here on it rotates towards its landing.
LANDING = 0.6
# Fraction of the ankle lift that a flat foot uses.
LOW_STEP = 0.35
# Slope of descending soles, and the height it starts at [m].
STEEP, CLEAR = 2.0, 0.02


@dataclass(frozen=True, slots=True)
class BodyPoses:
    """Poses of N bodies, each in its own frame."""

    rotations: FloatArray  # local rotations of joints (N, J, 4)
    roots: FloatArray  # of the root joint (N, 3) [m]
    lowered: FloatArray  # lowering of the hips (N,) [m]
    missed: FloatArray  # distance of ankles from their targets (N, 2) [m]


def poses_of(bodies: AgentBodies, state: BodyState, going: AgentMotion) -> BodyPoses:
    """Return the poses of bodies."""
    rig = bodies.gaits.walker.rig
    blend = bodies.blend(state.paces)
    played, roots = _played(bodies, state, blend)
    rotations = np.repeat(rig.rest_rotations[None], len(played), axis=0)
    rotations[:, bodies.moves] = played
    bodies.trunk.rotate(rig.parents, rotations, state.shoulders)
    feet, normals, away = bodies.feet(state, going)
    goals, soles = _ankles(bodies, state, blend, feet, normals, away)
    # Hips stay above the mean ground of both feet.
    roots[:, 1] += feet[:, :, 1].mean(axis=1)
    lowered, missed = _reach(bodies.gaits.walker, rotations, roots, goals, soles, state)
    roots[:, 1] -= lowered
    return BodyPoses(rotations, roots, lowered, missed)


def _reach(
    walker: Walker,
    rotations: FloatArray,
    roots: FloatArray,
    goals: FloatArray,
    soles: FloatArray,
    state: BodyState,
) -> tuple[FloatArray, FloatArray]:
    """Solve leg IK for ankle goals ``(N, 2, 3)`` and sole rotations, in place.

    Returns how far hips are lowered for it ``(N,)``, and by how much ankles miss their
    goals all the same ``(N, 2)`` [m].
    """
    rig = walker.rig
    translations = np.repeat(rig.rest_translations[None], len(rotations), axis=0)
    translations[:, 0] = roots
    world = forward(rig, translations, rotations)
    joints = world.positions
    spins = {
        joint: so3.from_matrix(world.linear[:, joint])
        for thigh, shin, _, _ in walker.legs
        for joint in (thigh, shin, int(rig.parents[thigh]))
        if joint >= 0
    }
    lowered = _lowered(walker, joints, goals, state)
    joints = joints - lowered[:, None, None] * UP
    goals = _reached(walker, joints, goals, state.swings >= 0)
    missed = np.zeros((len(rotations), 2))
    for k, (thigh, shin, foot, _) in enumerate(walker.legs):
        above = int(rig.parents[thigh])
        upper, lower = ankle_rotations(
            walker.person,
            SIDES[k],
            joints[:, [thigh, shin, foot]],
            goals[:, k],
            (spins[thigh], spins[shin]),
        )
        sole = so3.multiply(soles[:, k], np.broadcast_to(walker.level[k], upper.shape))
        over = (
            spins[above] if above >= 0 else np.broadcast_to(so3.IDENTITY, upper.shape)
        )
        for joint, parent, posed in (
            (thigh, over, upper),
            (shin, upper, lower),
            (foot, lower, sole),
        ):
            rotations[:, joint] = so3.multiply(so3.conjugate(parent), posed)
        knee = joints[:, thigh] + so3.rotate(upper, rig.rest_translations[shin])
        ankle = knee + so3.rotate(lower, rig.rest_translations[foot])
        missed[:, k] = np.linalg.norm(ankle - goals[:, k], axis=1)
    return lowered, missed


def _lowered(
    walker: Walker, joints: FloatArray, goals: FloatArray, state: BodyState
) -> FloatArray:
    """Return how far hips are lowered for the legs to reach ``(N,)`` [m].

    Halfway of a swing they need not.
    """
    lowered = state.lowered.copy()
    for k, (thigh, shin, foot, _) in enumerate(walker.legs):
        bones = joints[:, [thigh, shin, foot]]
        length = np.linalg.norm(np.diff(bones, axis=1), axis=2).sum(axis=1)
        leg = joints[:, thigh] - goals[:, k]
        across = (leg[:, [0, 2]] ** 2).sum(axis=1)
        high = np.sqrt(np.maximum((STRAIGHT * length) ** 2 - across, 0.0))
        ends = (np.abs(2 * state.swings[:, k] - 1) - 1 + 2 * NEARING) / (2 * NEARING)
        need = leg[:, 1] - high
        air = eased(np.clip(ends, 0.0, 1.0)) * need
        air = np.minimum(air, state.lowered + AIRBORNE * walker.leg)
        lowered = np.maximum(lowered, np.where(state.swings[:, k] < 0, need, air))
    return np.minimum(lowered, MOST_LOWERED * walker.leg)


def _reached(
    walker: Walker, joints: FloatArray, goals: FloatArray, up: BoolArray
) -> FloatArray:
    """Return goals ``(N, 2, 3)``, with airborne feet moved into reach.

    As they go along below the hips, they are over the ground.
    """
    reached = goals.copy()
    for k, (thigh, *_) in enumerate(walker.legs):
        leg = goals[:, k] - joints[:, thigh]
        across = np.linalg.norm(leg[:, [0, 2]], axis=1)
        far = (STRAIGHT * walker.leg) ** 2 - leg[:, 1] ** 2
        over = np.maximum(across - np.sqrt(np.maximum(far, 0.0)), 0.0) * up[:, k]
        excess = over / np.maximum(across, 1e-9)
        reached[:, k, [0, 2]] -= excess[:, None] * leg[:, [0, 2]]
        reached[:, k, 1] += cleared(over)
    return reached


def cleared(away: FloatArray) -> FloatArray:
    """Return the minimum sole height at a distance from its foothold [m]."""
    return np.minimum(STEEP * away, CLEAR)


def _ankles(
    bodies: AgentBodies,
    state: BodyState,
    blend: Blend,
    feet: FloatArray,
    normals: FloatArray,
    away: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return ankle targets ``(N, 2, 3)``, and foot rotations."""
    gaits = bodies.gaits
    goals, soles = np.zeros((*feet.shape[:2], 3)), np.zeros(feet.shape)
    for k in range(2):
        begin = (state.phases - 0.5 * k) % 1.0
        pitched = about_side(bodies.pitches(k, begin, blend, state.still))
        lifts = standing_ankle(gaits.walker, k, pitched)
        up = state.swings[:, k] >= 0
        if up.any():
            pitched[up], lifts[up] = _swung(gaits, state, blend, k, up)
            lifts[up, 1] += _low(gaits.walker, k, pitched[up], lifts[up], away[up, k])
        tilt = _tilts(normals[:, k])
        yaw = about_up(feet[:, k, 3])
        goals[:, k] = feet[:, k, :3] + so3.rotate(tilt, so3.rotate(yaw, lifts))
        soles[:, k] = so3.multiply(tilt, so3.multiply(yaw, pitched))
    return goals, soles


def _low(
    walker: Walker, k: int, pitched: FloatArray, lifts: FloatArray, away: FloatArray
) -> FloatArray:
    """Return how far airborne soles are below their clearance ``(K,)`` [m].

    ``away``: distance to their nearest foothold ``(K,)`` [m].
    """
    heel = lifts - so3.rotate(pitched, walker.ankle[k] * UP)
    ball = lifts + so3.rotate(pitched, walker.ball[k])
    lack = np.zeros(len(lifts))
    for sole, at in ((heel, 0 * UP), (ball, walker.ball[k] + walker.ankle[k] * UP)):
        off = np.linalg.norm((sole - at)[:, [0, 2]], axis=1)
        lack = np.maximum(lack, cleared(away + off) - (sole - at)[:, 1])
    return lack


def _swung(
    gaits: Gaits, state: BodyState, blend: Blend, k: int, up: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Return rotations ``(K, 4)`` and ankles ``(K, 3)`` of swinging feet.

    They begin as their feet were, which may lift sooner than the gait has it.
    ``up``: of which bodies foot ``k`` does ``(N,)``.
    """
    swings = np.clip(state.swings[up, k], 0.0, 1.0)
    pitched, lifts = _in_swing(gaits, state, blend, k, up, swings)
    first, begins = _in_swing(gaits, state, blend, k, up, np.zeros_like(swings))
    stood = about_side(state.heels[up, k])
    left = (1 - eased(np.minimum(swings / LEAVING, 1.0)))[:, None]
    off = so3.multiply(stood, so3.conjugate(first))
    none = np.broadcast_to(so3.IDENTITY, off.shape)
    turned = so3.multiply(_mixed([none, off], np.hstack([1 - left, left])), pitched)
    return turned, lifts + left * (standing_ankle(gaits.walker, k, stood) - begins)


def _in_swing(
    gaits: Gaits,
    state: BodyState,
    blend: Blend,
    k: int,
    up: BoolArray,
    swings: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return rotations and ankles of swinging feet from their gaits."""
    moving = gaits.moving
    at = swings * (PHASES - 1)
    weights = blend.weights[up]
    swung = _mixed([rows(one.swings[k], at) for one in moving], weights)
    lifts = np.asarray(
        sum(
            weight[:, None] * rows(one.lifts[k], at)
            for weight, one in zip(weights.T, moving, strict=True)
        )
    )
    # Its distance before and after the body scales with the step length.
    ends = [
        sum(
            weight * one.lifts[k, end, 2]
            for weight, one in zip(weights.T, moving, strict=True)
        )
        for end in (0, -1)
    ]
    fraction = at / (PHASES - 1)
    even = ends[0] + fraction * (ends[1] - ends[0])
    long = np.minimum(blend.stride[up], 1.0)
    lifts[:, 2] = even + long * (lifts[:, 2] - even)
    # Bodies that just stood lift a flat foot; quick steps lift less.
    standing = state.still[up]
    long = state.spans[up, k] / state.rates[up]
    typical = (1 - blend.stands[up, k]) / blend.free[up]
    quick = 1 - np.minimum(long / typical, 1.0)
    lands = eased(np.clip((swings - LANDING) / (1 - LANDING), 0.0, 1.0))
    level = np.maximum(standing, quick * (1 - lands))[:, None]
    flat = np.broadcast_to(so3.IDENTITY, swung.shape)
    pitched = _mixed([swung, flat], np.hstack([1 - level, level]))
    low = standing_ankle(gaits.walker, k, flat)
    high = LOW_STEP * np.maximum(lifts[:, 1:2] - low[:, 1:2], 0.0)
    lifts += level * (low + high * UP - lifts)
    return pitched, lifts


def _played(
    bodies: AgentBodies, state: BodyState, blend: Blend
) -> tuple[FloatArray, FloatArray]:
    """Return local rotations of `moves` ``(N, M, 4)``, and root translations."""
    gaits, at = bodies.gaits, state.phases * PHASES
    tables, standing = bodies.tables
    walked = _mixed([rows(one, at, again=True) for one in tables], blend.weights)
    hips = np.asarray(
        sum(
            weight[:, None] * rows(one.hips, at, again=True)
            for weight, one in zip(blend.weights.T, gaits.moving, strict=True)
        )
    )
    at = idle_rows(gaits.idle, state.clocks)
    idling = state.still[:, None]
    stood = rows(standing, at)
    rotations = _mixed([walked, stood], np.concatenate([1 - idling, idling], axis=1))
    hips = hips + idling * (rows(gaits.idle.hips, at) - hips)
    if gaits.reactions and (state.reacts >= 0).any():
        reaction = gaits.reactions[0]
        since = np.maximum(state.reacts, 0.0)
        fraction = np.minimum(since, reaction.period - since) / RAMP
        weight = eased(np.clip(fraction, 0.0, 1.0)) * (state.reacts >= 0)
        at = since / reaction.period * (len(reaction.rotations) - 1)
        played = rows(reaction.rotations[:, bodies.moves], at)
        both = np.stack([1 - weight, weight], axis=1)
        rotations = _mixed([rotations, played], both)
        # Height of the hips; their ground position is the agent's.
        high = rows(reaction.hips, at)[:, 1] - hips[:, 1]
        hips[:, 1] += weight * high
    return rotations, hips


def idle_rows(idle: Gait, clocks: FloatArray) -> FloatArray:
    """Return fractional rows of the idle, played back and forth."""
    last = len(idle.rotations) - 1
    if not last:
        return np.zeros(len(clocks))
    cycle = (clocks / idle.period) % 2.0
    return np.asarray(np.minimum(cycle, 2 - cycle) * last)


def _mixed(rotations: list[FloatArray], weights: FloatArray) -> FloatArray:
    """Return rotations ``(N, …, 4)`` blended by weights ``(N, K)``, normalised."""
    first = rotations[0]
    wide = (-1, *[1] * (first.ndim - 1))
    mixed = first * weights[:, 0].reshape(wide)
    for k, one in enumerate(rotations[1:], start=1):
        flipped = (first * one).sum(axis=-1, keepdims=True) < 0
        mixed = mixed + np.where(flipped, -one, one) * weights[:, k].reshape(wide)
    return np.asarray(mixed / np.linalg.norm(mixed, axis=-1, keepdims=True))


def _tilts(normals: FloatArray) -> FloatArray:
    """Return rotations from upright to normals ``(N, 3)``, up to `TILT`."""
    axis = np.cross(UP, normals)
    size = np.linalg.norm(axis, axis=1)
    angle = np.minimum(np.arctan2(size, normals[:, 1]), TILT)
    return so3.exp(axis * (angle / np.where(size > 1e-12, size, 1.0))[:, None])

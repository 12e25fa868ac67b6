"""Poses of bodies: what their gaits play, with legs that reach where feet stand."""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.retarget.legs import ankle_rotations
from animtool.rig.kinematics import forward
from animtool.systems.crowds.agents import Going
from animtool.systems.crowds.bodies import Bodies
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

# How long bodies take to begin and to end a reaction [s].
RAMP = 0.2
# Feet follow ground that is steeper no farther [rad].
TILT = 0.45
# In this first and last part of a swing hips are lowered for its foot.
NEARING = 0.4
# Over this first part of a swing a foot comes from how it stood to how its gait has it.
LEAVING = 0.7
# From here on it turns to how it lands.
LANDING = 0.6
# Of how high ankles are lifted, who lifts a flat foot.
LOW_STEP = 0.35
# Soles come down as steep as this, from over so much [m].
STEEP, CLEAR = 2.0, 0.02


@dataclass(frozen=True, slots=True)
class Poses:
    """N bodies, each in the frame of its own."""

    turns: FloatArray  # local rotations of joints (N, J, 4)
    roots: FloatArray  # of the first joint (N, 3) [m]
    lowered: FloatArray  # hips, so that legs reach (N,) [m]
    missed: FloatArray  # how far ankles are from where they should be (N, 2) [m]


def poses_of(bodies: Bodies, state: BodyState, going: Going) -> Poses:
    """Return the poses of bodies."""
    rig = bodies.gaits.walker.rig
    blend = bodies.blend(state.paces)
    played, roots = _played(bodies, state, blend)
    turns = np.repeat(rig.rest_rotations[None], len(played), axis=0)
    turns[:, bodies.moves] = played
    bodies.trunk.turn(rig.parents, turns, state.shoulders)
    feet, normals, away = bodies.feet(state, going)
    goals, soles = _ankles(bodies, state, blend, feet, normals, away)
    # Hips are over the middle of both feet's ground.
    roots[:, 1] += feet[:, :, 1].mean(axis=1)
    lowered, missed = _reach(bodies.gaits.walker, turns, roots, goals, soles, state)
    roots[:, 1] -= lowered
    return Poses(turns, roots, lowered, missed)


def _reach(
    walker: Walker,
    turns: FloatArray,
    roots: FloatArray,
    goals: FloatArray,
    soles: FloatArray,
    state: BodyState,
) -> tuple[FloatArray, FloatArray]:
    """Turn legs so that ankles are at goals ``(N, 2, 3)``, and feet as soles, in place.

    Returns how far hips are lowered for it ``(N,)``, and by how much ankles miss their
    goals all the same ``(N, 2)`` [m].
    """
    rig = walker.rig
    translations = np.repeat(rig.rest_translations[None], len(turns), axis=0)
    translations[:, 0] = roots
    world = forward(rig, translations, turns)
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
    missed = np.zeros((len(turns), 2))
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
        for joint, parent, own in (
            (thigh, over, upper),
            (shin, upper, lower),
            (foot, lower, sole),
        ):
            turns[:, joint] = so3.multiply(so3.conjugate(parent), own)
        knee = joints[:, thigh] + so3.rotate(upper, rig.rest_translations[shin])
        ankle = knee + so3.rotate(lower, rig.rest_translations[foot])
        missed[:, k] = np.linalg.norm(ankle - goals[:, k], axis=1)
    return lowered, missed


def _lowered(
    walker: Walker, joints: FloatArray, goals: FloatArray, state: BodyState
) -> FloatArray:
    """Return how far hips are lowered so that legs reach their goals ``(N,)`` [m].

    Halfway of a swing they need not.
    """
    lowered = state.lowered.copy()
    for k, (thigh, shin, foot, _) in enumerate(walker.legs):
        bones = joints[:, [thigh, shin, foot]]
        length = np.linalg.norm(np.diff(bones, axis=1), axis=2).sum(axis=1)
        way = joints[:, thigh] - goals[:, k]
        across = (way[:, [0, 2]] ** 2).sum(axis=1)
        high = np.sqrt(np.maximum((STRAIGHT * length) ** 2 - across, 0.0))
        ends = (np.abs(2 * state.swings[:, k] - 1) - 1 + 2 * NEARING) / (2 * NEARING)
        need = way[:, 1] - high
        air = eased(np.clip(ends, 0.0, 1.0)) * need
        air = np.minimum(air, state.lowered + AIRBORNE * walker.leg)
        lowered = np.maximum(lowered, np.where(state.swings[:, k] < 0, need, air))
    return np.minimum(lowered, MOST_LOWERED * walker.leg)


def _reached(
    walker: Walker, joints: FloatArray, goals: FloatArray, up: BoolArray
) -> FloatArray:
    """Return goals ``(N, 2, 3)``; feet in the air stay as near as their legs have it.

    As they go along below the hips, they are over the ground.
    """
    made = goals.copy()
    for k, (thigh, *_) in enumerate(walker.legs):
        way = goals[:, k] - joints[:, thigh]
        across = np.linalg.norm(way[:, [0, 2]], axis=1)
        far = (STRAIGHT * walker.leg) ** 2 - way[:, 1] ** 2
        over = np.maximum(across - np.sqrt(np.maximum(far, 0.0)), 0.0) * up[:, k]
        share = over / np.maximum(across, 1e-9)
        made[:, k, [0, 2]] -= share[:, None] * way[:, [0, 2]]
        made[:, k, 1] += cleared(over)
    return made


def cleared(away: FloatArray) -> FloatArray:
    """Return how high soles are at least that are so far from where they stand [m]."""
    return np.minimum(STEEP * away, CLEAR)


def _ankles(
    bodies: Bodies,
    state: BodyState,
    blend: Blend,
    feet: FloatArray,
    normals: FloatArray,
    away: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return where ankles are to be ``(N, 2, 3)``, and how feet are turned."""
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
    """Return by how much soles in the air are too low ``(K,)`` [m].

    ``away``: how far their places are from where they stand ``(K,)`` [m].
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
    """Return turns and ankles of feet that swing ``(K, 4)``, ``(K, 3)``, as on the way.

    They begin as their feet were, which may lift sooner than the gait has it.
    ``up``: of which bodies foot ``k`` does ``(N,)``.
    """
    swings = np.clip(state.swings[up, k], 0.0, 1.0)
    pitched, lifts = _on_way(gaits, state, blend, k, up, swings)
    first, begins = _on_way(gaits, state, blend, k, up, np.zeros_like(swings))
    stood = about_side(state.heels[up, k])
    left = (1 - eased(np.minimum(swings / LEAVING, 1.0)))[:, None]
    off = so3.multiply(stood, so3.conjugate(first))
    none = np.broadcast_to(so3.IDENTITY, off.shape)
    turned = so3.multiply(_mixed([none, off], np.hstack([1 - left, left])), pitched)
    return turned, lifts + left * (standing_ankle(gaits.walker, k, stood) - begins)


def _on_way(
    gaits: Gaits,
    state: BodyState,
    blend: Blend,
    k: int,
    up: BoolArray,
    swings: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return turns and ankles of feet on their swings as their gaits have them."""
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
    # Before and behind its place it goes as far as its step is long.
    ends = [
        sum(
            weight * one.lifts[k, end, 2]
            for weight, one in zip(weights.T, moving, strict=True)
        )
        for end in (0, -1)
    ]
    share = at / (PHASES - 1)
    even = ends[0] + share * (ends[1] - ends[0])
    long = np.minimum(blend.stride[up], 1.0)
    lifts[:, 2] = even + long * (lifts[:, 2] - even)
    # Who just stood lifts a flat foot, and so does who steps fast, less high.
    still = state.still[up]
    long = state.spans[up, k] / state.rates[up]
    usual = (1 - blend.stands[up, k]) / blend.free[up]
    quick = 1 - np.minimum(long / usual, 1.0)
    lands = eased(np.clip((swings - LANDING) / (1 - LANDING), 0.0, 1.0))
    level = np.maximum(still, quick * (1 - lands))[:, None]
    flat = np.broadcast_to(so3.IDENTITY, swung.shape)
    pitched = _mixed([swung, flat], np.hstack([1 - level, level]))
    low = standing_ankle(gaits.walker, k, flat)
    high = LOW_STEP * np.maximum(lifts[:, 1:2] - low[:, 1:2], 0.0)
    lifts += level * (low + high * UP - lifts)
    return pitched, lifts


def _played(
    bodies: Bodies, state: BodyState, blend: Blend
) -> tuple[FloatArray, FloatArray]:
    """Return local rotations of `moves` ``(N, M, 4)``, and places of the root."""
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
    still = state.still[:, None]
    stood = rows(standing, at)
    turns = _mixed([walked, stood], np.concatenate([1 - still, still], axis=1))
    hips = hips + still * (rows(gaits.idle.hips, at) - hips)
    if gaits.reactions and (state.reacts >= 0).any():
        reaction = gaits.reactions[0]
        since = np.maximum(state.reacts, 0.0)
        share = np.minimum(since, reaction.period - since) / RAMP
        weight = eased(np.clip(share, 0.0, 1.0)) * (state.reacts >= 0)
        at = since / reaction.period * (len(reaction.turns) - 1)
        played = rows(reaction.turns[:, bodies.moves], at)
        both = np.stack([1 - weight, weight], axis=1)
        turns = _mixed([turns, played], both)
        # How high the hips are then; where, is where the agent is.
        high = rows(reaction.hips, at)[:, 1] - hips[:, 1]
        hips[:, 1] += weight * high
    return turns, hips


def idle_rows(idle: Gait, clocks: FloatArray) -> FloatArray:
    """Return where in what agents do as they stand they are: there and back again."""
    last = len(idle.turns) - 1
    if not last:
        return np.zeros(len(clocks))
    share = (clocks / idle.period) % 2.0
    return np.asarray(np.minimum(share, 2 - share) * last)


def _mixed(turns: list[FloatArray], weights: FloatArray) -> FloatArray:
    """Return turns ``(N, …, 4)`` mixed by weights ``(N, K)``, of length 1."""
    first = turns[0]
    wide = (-1, *[1] * (first.ndim - 1))
    made = first * weights[:, 0].reshape(wide)
    for k, one in enumerate(turns[1:], start=1):
        flipped = (first * one).sum(axis=-1, keepdims=True) < 0
        made = made + np.where(flipped, -one, one) * weights[:, k].reshape(wide)
    return np.asarray(made / np.linalg.norm(made, axis=-1, keepdims=True))


def _tilts(normals: FloatArray) -> FloatArray:
    """Return turns from upright to normals ``(N, 3)``, no farther than `TILT`."""
    axis = np.cross(UP, normals)
    size = np.linalg.norm(axis, axis=1)
    angle = np.minimum(np.arctan2(size, normals[:, 1]), TILT)
    return so3.exp(axis * (angle / np.where(size > 1e-12, size, 1.0))[:, None])

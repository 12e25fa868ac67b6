"""Locomotion of agents' bodies: gait blending and planted feet.

All is in the frame of the ground; a body has x to its left and z ahead.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.systems.crowds.agents import AgentMotion
from animtool.systems.crowds.footing import Blend, BodyState, Footing, followed
from animtool.systems.crowds.gaits import PHASES
from animtool.systems.crowds.ground import turned, wrapped
from animtool.systems.crowds.reach import MAX_RATE, Reach, Stances, hurried
from animtool.systems.crowds.shoulders import Trunk

# Below this fraction of the slowest gait agents stand, unless a foot is misplaced.
STANDS = 0.1
# Cadence grows with this power of speed, stride with the rest (Grieve and Gear, 1966).
CADENCE = 0.42
# Bounds of cadence over the blend's.
SLOWEST, FASTEST = 0.7, 1.6
# Time constant of gait blending [s].
PACING = 0.2
# Time to blend from walking to standing [s].
SETTLING = 0.3
# A foot that lands within this last part of its cycle does not lift again.
LAST = 0.95
# Yaw rates above the pace by less than this do not speed up steps [rad/s].
JERK = 0.6
# Largest change of cadence [cycles/s²]; faster changes would jerk the legs.
QUICKENS = 12.0
# Rising speed of lowered hips, over the leg length [1/s].
RISES = 0.6
# From this fraction of a swing on, its landing is fixed.
SETTLED = 0.6
# Largest yaw by which a landing is predicted [rad].
MAX_YAW = 1.0
# Sideways or backward speeds above this, over `STANDS`, count as walking.
PUSHED = 3.0
# Largest sideways and backward step from the hips, over the leg length.
SIDE, BACK = 0.25, 0.3
# Largest yaw of a body over a planted foot [rad].
SPUN = 0.8


@dataclass(frozen=True)
class AgentBodies(Footing):
    """Steps the bodies of N agents."""

    @cached_property
    def moves(self) -> IntArray:
        """Return the joints that gaits or leg IK rotate, ascending ``(M,)``."""
        gaits = self.gaits
        rest = gaits.walker.rig.rest_rotations
        tables = [
            one.rotations for one in (*gaits.moving, gaits.idle, *gaits.reactions)
        ]
        moved = [(np.abs(one - rest) > 1e-9).any(axis=(0, 2)) for one in tables]
        legs = [joint for leg in gaits.walker.legs for joint in leg[:3]]
        legs += self.trunk.joints.tolist()
        return np.union1d(np.flatnonzero(np.any(moved, axis=0)), legs)

    @cached_property
    def trunk(self) -> Trunk:
        """Return the joints that rotate the shoulders."""
        return Trunk.of(self.gaits.walker.person)

    @cached_property
    def tables(self) -> tuple[list[FloatArray], FloatArray]:
        """Return rotations of `moves` by gait, and of the idle."""
        gaits = self.gaits
        return [
            one.rotations[:, self.moves] for one in gaits.moving
        ], gaits.idle.rotations[:, self.moves]

    def first(self, going: AgentMotion, chances: FloatArray) -> BodyState:
        """Return bodies standing at the start, from random numbers ``(N,)``."""
        count = len(chances)
        paces = np.zeros((count, 3))
        blend = self.blend(paces)
        stands = self.stands(going, blend)
        return BodyState(
            chances,
            stands,
            -np.ones((count, 2)),
            stands,
            blend.rate,
            np.zeros(count),
            np.ones(count),
            chances * self.gaits.idle.period,
            paces,
            -np.ones(count),
            np.zeros(count),
            np.zeros((count, 2)),
            np.ones((count, 2)),
        )

    def blend(self, paces: FloatArray) -> Blend:
        """Return gait weights at the agents' speeds and yaw rates ``(N, 3)``."""
        moving, leg = self.gaits.moving, self.gaits.walker.leg
        speeds, around, leftward = (
            paces[:, 0] / self.scales,
            paces[:, 1],
            paces[:, 2] / self.scales,
        )
        weights = _weights(
            np.stack([np.maximum(speeds, 0.0), leg * around], axis=1),
            np.array([[one.speed, leg * one.turning] for one in moving]),
        )
        # BLAS sums in an order that depends on the number of agents; einsum does not.
        paced = np.array([[one.speed, one.period] for one in moving])
        speed, period = np.einsum("ng,gk->kn", weights, paced)
        cadence = (np.hypot(speeds, leftward) / speed) ** CADENCE
        rate = np.clip(cadence, SLOWEST, FASTEST) / period
        steps = np.einsum(
            "ng,gfk->nfk", weights, np.stack([one.steps for one in moving])
        )
        stands = np.einsum("ng,gf->nf", weights, np.stack([m.stands for m in moving]))
        # Sideways, backward and spinning motion uses shorter steps, and more of them.
        side = leftward * stands.mean(axis=1) / (2 * rate)
        back = -speeds * stands.mean(axis=1) / (2 * rate)
        over = np.maximum(np.abs(side) / (SIDE * leg), back / (BACK * leg))
        spun = np.abs(around) * stands.mean(axis=1) / rate
        over = np.maximum(over, spun / SPUN)
        over = np.clip(over, 1.0, np.maximum(MAX_RATE / rate, 1.0))
        free, rate = rate, rate * over
        stride = speeds / speed / (rate * period)
        steps[..., 1] *= stride[:, None]
        steps[..., 0] += (side / over)[:, None]
        return Blend(weights, rate, free, stride, stands, steps)

    def next(
        self,
        state: BodyState,
        before: AgentMotion,
        after: AgentMotion,
        dt: float,
        hit: BoolArray | None = None,
    ) -> BodyState:
        """Return bodies after a step [s]; feet land and lift within it.

        ``hit``: agents hit in the step ``(N,)``.
        """
        turning = wrapped(after.headings - before.headings) / dt
        # Actual motion: pushed agents do not move as they prefer.
        went = turned((after.points - before.points) / dt, -after.headings)
        paces = np.stack([went[:, 1], turning, went[:, 0]], axis=1)
        paces = state.paces + (paces - state.paces) * -np.expm1(-dt / PACING)
        blend = self.blend(paces)
        off = self.off(state, after, blend)
        standing = (state.swings < 0).all(axis=1)
        slow = STANDS * self.gaits.moving[0].speed * self.scales
        fast = (went[:, 1] > slow) | (np.linalg.norm(went, axis=1) > PUSHED * slow)
        moves = fast | off.any(axis=1)
        phases = self._begun(state, blend, moves & (state.still >= 1), off, after)
        goes = moves | ~standing
        stances = self._stances(state, after, phases, blend)
        speeds = went / self.scales[:, None]
        yaw_rates = np.clip(turning, paces[:, 1] - JERK, paces[:, 1] + JERK)
        rates, ends = hurried(self.reach, stances, speeds, yaw_rates)
        # Hurried steps slow down again with the pace.
        slower = state.rates + (blend.rate - state.rates) * -np.expm1(-dt / PACING)
        rates = np.maximum(rates, slower)
        rates = np.minimum(rates, np.maximum(slower, state.rates + QUICKENS * dt))
        change = np.where(goes, rates * dt, 0.0)
        footholds, swings = state.places.copy(), state.swings.copy()
        aims, heels, spans = state.aims.copy(), state.heels.copy(), state.spans.copy()
        for k in range(2):
            swings[ends[:, k], k] = 0.0
            begins = np.where(ends[:, k], stances.begins[:, k], blend.stands[:, k])
            heel = self.pitches(k, begins, blend, state.still)
            self._advance(k, phases, change, blend, (before, after), footholds, swings)
            lifted = (state.swings[:, k] < 0) & (swings[:, k] >= 0)
            heels[lifted, k] = heel[lifted]
            left = 1 - np.maximum((phases - 0.5 * k) % 1.0, begins)
            spans[lifted, k] = left[lifted]
            landed = (state.swings[:, k] >= SETTLED) & (swings[:, k] < 0)
            footholds[landed, k] = state.aims[landed, k]
        phases = (phases + change) % 1.0
        for k in range(2):
            aimed = (swings[:, k] >= 0) & ~(state.swings[:, k] >= SETTLED)
            left = (1 - (phases - 0.5 * k) % 1.0) / rates
            yaw = np.clip(paces[:, 1] * left, -MAX_YAW, MAX_YAW)
            then = after.points + after.velocities * left[:, None]
            lands = self.placed(k, blend, then, after.headings + yaw, footholds)
            new = state.swings[:, k] < 0
            aims[aimed, k] = followed(aims, lands, swings, new, self.scales, dt, k)[
                aimed
            ]
        target = np.where(moves | (swings >= 0).any(axis=1), -dt, dt) / SETTLING
        moved = replace(
            state,
            phases=phases,
            places=footholds,
            swings=swings,
            aims=aims,
            rates=rates,
            still=np.clip(state.still + target, 0.0, 1.0),
            clocks=state.clocks + dt,
            paces=paces,
            reacts=self._reacting(state.reacts, dt, hit),
            heels=heels,
            spans=spans,
        )
        return self._reached(state, moved, after, blend, dt)

    def _reached(
        self,
        before: BodyState,
        state: BodyState,
        going: AgentMotion,
        blend: Blend,
        dt: float,
    ) -> BodyState:
        """Return bodies with feet moved into reach, and hips lowered for them."""
        stances = self._stances(state, going, state.phases, blend)
        footholds = state.places.copy()
        leg = self.gaits.walker.leg
        lowered = np.maximum(before.lowered - RISES * leg * dt, 0.0)
        for k in range(2):
            stance = (
                k,
                stances.thighs[:, k],
                stances.feet[:, k],
                stances.pitches[0, :, k],
            )
            stands = state.swings[:, k] < 0
            room, outwards = self.reach.room(*stance)
            landed = stands & (footholds[:, k] != before.places[:, k]).any(axis=1)
            back = np.minimum(room, 0.0)[:, None] * outwards * self.scales[:, None]
            footholds[landed, k, :2] += turned(back, going.headings)[landed]
            need = np.where(stands, self.reach.lowered(*stance), 0.0)
            lowered = np.maximum(lowered, need)
        return replace(state, places=footholds, lowered=lowered)

    @cached_property
    def reach(self) -> Reach:
        """Return the reach of the legs."""
        return Reach.of(self.gaits)

    def pitches(
        self, k: int, begins: FloatArray, blend: Blend, standing: FloatArray
    ) -> FloatArray:
        """Return heel pitches of planted feet ``(N,)`` [rad]."""
        stood = np.clip(begins / blend.stands[:, k], 0.0, 1.0) * (PHASES - 1)
        pitch = np.zeros(len(begins))
        for weight, one in zip(blend.weights.T, self.gaits.moving, strict=True):
            pitch += weight * np.interp(stood, np.arange(PHASES), one.pitches[k])
        return np.asarray(pitch * (1 - standing))

    def _stances(
        self, state: BodyState, going: AgentMotion, phases: FloatArray, blend: Blend
    ) -> Stances:
        """Return the stance of feet at given phases."""
        feet = np.zeros((len(phases), 2, 4))
        off = turned(
            state.places[..., :2] - going.points[:, None], -going.headings[:, None]
        )
        feet[..., [0, 2]] = off / self.scales[:, None, None]
        feet[..., 3] = wrapped(state.places[..., 2] - going.headings[:, None])
        heights, _ = self.heights(state.places[..., :2].reshape(-1, 2))
        base, _ = self.heights(going.points)
        feet[..., 1] = (heights.reshape(-1, 2) - base[:, None]) / self.scales[:, None]
        thighs = self.reach.thighs(phases, blend.weights, state.still)
        thighs[..., 1] += feet[..., 1].mean(axis=1)[:, None]
        begins = (phases[:, None] - [0.0, 0.5]) % 1.0
        pitches = np.array(
            [
                [self.pitches(k, at[:, k], blend, state.still) for k in range(2)]
                for at in (begins, blend.stands)
            ]
        ).swapaxes(1, 2)
        up = state.swings >= 0
        return Stances(begins, blend.stands, up, feet, thighs, pitches, blend.rate)

    def _reacting(
        self, reacts: FloatArray, dt: float, hit: BoolArray | None
    ) -> FloatArray:
        """Return the time since each reaction began, after a step ``(N,)`` [s]."""
        if not self.gaits.reactions:
            return reacts
        period = self.gaits.reactions[0].period
        times = np.where(reacts >= 0, reacts + dt, reacts)
        times = np.where(times > period, -1.0, times)
        return times if hit is None else np.where(hit & (times < 0), 0.0, times)

    def _begun(
        self,
        state: BodyState,
        blend: Blend,
        begins: BoolArray,
        off: BoolArray,
        going: AgentMotion,
    ) -> FloatArray:
        """Return phases ``(N,)``; starters lift the foot that is farther back."""
        back = self.stands(going, blend) - state.places
        along = turned(back[..., :2], -going.headings[:, None])[..., 1]
        score = along + np.where(off, 10.0, 0.0)
        right = score[:, 1] > score[:, 0]
        lift_phases = np.where(right, 0.5 + blend.stands[:, 1], blend.stands[:, 0])
        return np.where(begins, lift_phases % 1.0, state.phases)

    def _advance(
        self,
        k: int,
        phases: FloatArray,
        change: FloatArray,
        blend: Blend,
        goings: tuple[AgentMotion, AgentMotion],
        footholds: FloatArray,
        swings: FloatArray,
    ) -> None:
        """Lift, swing and land a foot of each body in a step, in place."""
        begin = (phases - 0.5 * k) % 1.0
        end = begin + change
        stands = blend.stands[:, k]
        # Bodies that stand longer than their changed gait does lift at once.
        lifts = (swings[:, k] < 0) & (change > 0) & (end >= stands) & (begin < 1)
        late = (begin > stands) & ~(begin < LAST)
        lifts &= ~late
        swings[lifts, k] = 0.0
        at = np.where(lifts, np.maximum(begin, stands), begin)
        up = swings[:, k] >= 0
        done = np.clip((end - at) / np.maximum(1 - at, 1e-9), 0.0, 1.0)
        lands = up & (end >= 1)
        fraction = (1 - begin) / np.where(change > 0, change, 1.0)
        footholds[lands, k] = self.landing(k, blend, goings, fraction, footholds)[lands]
        swings[up, k] += (1 - swings[up, k]) * done[up]
        swings[lands, k] = -1.0


def _weights(points: FloatArray, known: FloatArray) -> FloatArray:
    """Return gait weights ``(N, G)`` by gradient-band interpolation (Johansen, 2009).

    ``points`` ``(N, 2)`` are among those of the gaits ``(G, 2)``.
    """
    if len(known) == 1:
        return np.ones((len(points), 1))
    off = known[None] - known[:, None]  # (i, j, 2)
    squares = (off * off).sum(axis=2)
    squares[squares == 0] = np.inf
    along = np.einsum("nik,ijk->nij", points[:, None] - known[None], off) / squares
    # The nearest band has at least half the weight: the sum is never 0.
    bands = np.clip(1 - along, 0.0, 1.0).min(axis=2)
    return np.asarray(bands / bands.sum(axis=1, keepdims=True))

"""Foot placement: planted feet, landings, and feet that avoid each other.

All is in the frame of the ground; a body has x to its left and z ahead.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.record import dataclass
from animtool.systems.crowds.agents import AgentMotion
from animtool.systems.crowds.gaits import Gaits, eased
from animtool.systems.crowds.ground import turned, wrapped

# A planted foot is misplaced if farther than this from its target, over the leg length,
# or rotated by more [rad].
MAX_FOOT_OFFSET, MAX_FOOT_YAW = 0.15, 0.45
# Least step width over the gaits' width.
STEP_WIDTH = 0.6
# Feet pass each other with this gap, over the leg length, if closer than this along z.
PASSING_GAP, PASSING_RANGE = 0.09, 0.35
# Largest speeds at which a landing may change [m/s], [rad/s]; faster changes would jerk
# the legs.
SWERVES, SWIVELS = 2.5, 6.0


class Heights(Protocol):
    """The ground as a height field."""

    def __call__(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return heights ``(K,)`` [m] and normals ``(K, 3)`` at x and z ``(K, 2)``."""


@dataclass(frozen=True, slots=True)
class BodyState:
    """Gait phases and feet of N bodies."""

    phases: FloatArray  # of the cycle, the left foot lands at 0 (N,)
    places: FloatArray  # last foothold of each foot: x, z, heading (N, 2, 3)
    swings: FloatArray  # progress of each swing, -1 if planted (N, 2)
    aims: FloatArray  # landings of swinging feet (N, 2, 3)
    rates: FloatArray  # cycles per second (N,) [1/s]
    lowered: FloatArray  # lowering of the hips, which recovers slowly (N,) [m]
    still: FloatArray  # 1 standing, 0 walking (N,)
    clocks: FloatArray  # of the idle (N,) [s]
    # Smoothed forward speed [m/s], yaw rate [rad/s] and speed to the left (N, 3).
    paces: FloatArray
    reacts: FloatArray  # time since a reaction began, -1 without one (N,) [s]
    shoulders: FloatArray  # yaw (N,) [rad]
    heels: FloatArray  # heel pitch of each foot when it lifted (N, 2) [rad]
    spans: FloatArray  # fraction of the cycle that remained at each lift (N, 2)


@dataclass(frozen=True)
class Blend:
    """Gait weights of N agents, and their blended steps."""

    weights: FloatArray  # (N, G)
    rate: FloatArray  # cycles per second (N,)
    free: FloatArray  # the same for straight forward motion (N,)
    stride: FloatArray  # step length over the gaits' (N,)
    stands: FloatArray  # (N, 2)
    steps: FloatArray  # footholds in the frame of the body (N, 2, 3)


@dataclass(frozen=True)
class Footing:
    """Foot placement of N bodies.

    Attributes:
        scales: Of each, over its rig ``(N,)``.
    """

    gaits: Gaits
    scales: FloatArray
    ground: Heights

    def landing(
        self,
        k: int,
        blend: Blend,
        goings: tuple[AgentMotion, AgentMotion],
        fractions: FloatArray,
        footholds: FloatArray,
    ) -> FloatArray:
        """Return landings ``(N, 3)``, at fractions of the step from now."""
        before, after = goings
        points = before.points + fractions[:, None] * (after.points - before.points)
        change = wrapped(after.headings - before.headings)
        headings = before.headings + fractions * change
        return self.placed(k, blend, points, headings, footholds)

    def placed(
        self,
        k: int,
        blend: Blend,
        points: FloatArray,
        headings: FloatArray,
        footholds: FloatArray,
    ) -> FloatArray:
        """Return a foot's landing for bodies at given positions ``(N, 3)``.

        On its own side of the other foot.
        """
        side = 1 - 2 * k
        step = blend.steps[:, k] * np.stack(
            [self.scales, self.scales, 0 * self.scales + 1], 1
        )
        other = turned(footholds[:, 1 - k, :2] - points, -headings)
        wide = STEP_WIDTH * (blend.steps[:, 0, 0] - blend.steps[:, 1, 0]) * self.scales
        near = side * (step[:, 0] - other[:, 0]) < wide
        # If the other foot is out of reach, nothing is in between.
        near &= np.abs(other[:, 0]) < 2 * wide
        x = np.where(near, other[:, 0] + side * wide, step[:, 0])
        flat = turned(np.stack([x, step[:, 1]], axis=1), headings)
        return np.column_stack([points + flat, headings + step[:, 2]])

    def stands(self, going: AgentMotion, blend: Blend) -> FloatArray:
        """Return foot targets of standing bodies ``(N, 2, 3)``."""
        steps = (
            blend.steps
            * np.stack([self.scales, 0 * self.scales, 0 * self.scales + 1], 1)[:, None]
        )
        flat = turned(steps[..., :2], going.headings[:, None])
        yaws = going.headings[:, None] + steps[..., 2:][..., 0]
        return np.concatenate([going.points[:, None] + flat, yaws[..., None]], axis=2)

    def off(self, state: BodyState, going: AgentMotion, blend: Blend) -> BoolArray:
        """Return which feet are away from their standing targets ``(N, 2)``."""
        away = state.places - self.stands(going, blend)
        far = np.linalg.norm(away[..., :2], axis=2)
        leg = self.gaits.walker.leg * self.scales[:, None]
        yaws = np.abs(wrapped(away[..., 2]))
        return np.asarray((far > MAX_FOOT_OFFSET * leg) | (yaws > MAX_FOOT_YAW))

    def feet(
        self, state: BodyState, going: AgentMotion
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return feet in the frame of bodies ``(N, 2, 4)``, and ground normals.

        x, y, z and yaw, in lengths of the rig. Also the distance of each from its last
        or next foothold, whichever is nearer ``(N, 2)``.
        """
        feet = np.zeros((len(state.phases), 2, 4))
        normals = np.zeros((len(state.phases), 2, 3))
        away = np.zeros((len(state.phases), 2))
        base, _ = self.heights(going.points)
        footholds = state.places.copy()
        for k in range(2):
            up = state.swings[:, k] >= 0
            fraction = eased(np.maximum(state.swings[:, k], 0.0))[:, None]
            from_, next_ = state.places[:, k], state.aims[:, k]
            stride = next_ - from_
            footholds[:, k] = np.where(up[:, None], from_ + fraction * stride, from_)
            ends = np.linalg.norm(stride[:, :2], axis=1)[:, None] * np.hstack(
                [fraction, 1 - fraction]
            )
            away[:, k] = np.where(up, ends.min(axis=1), 0.0) / self.scales
            low, first = self.heights(from_[:, :2])
            high, last = self.heights(next_[:, :2])
            here, _ = self.heights(footholds[:, k, :2])
            height = np.where(
                up, np.maximum(low + fraction[:, 0] * (high - low), here), low
            )
            normals[:, k] = np.where(
                up[:, None], first + fraction * (last - first), first
            )
            feet[:, k, 1] = (height - base) / self.scales
        away += self._pass(state, going, footholds) / self.scales[:, None]
        off = turned(
            footholds[..., :2] - going.points[:, None], -going.headings[:, None]
        )
        feet[..., [0, 2]] = off / self.scales[:, None, None]
        feet[..., 3] = wrapped(footholds[..., 2] - going.headings[:, None])
        normals[..., [0, 2]] = turned(normals[..., [0, 2]], -going.headings[:, None])
        return feet, normals, away

    def _pass(
        self, state: BodyState, going: AgentMotion, footholds: FloatArray
    ) -> FloatArray:
        """Move swinging feet around planted ones, in place.

        Returns how far they do ``(N, 2)`` [m].
        """
        around = np.zeros((len(footholds), 2))
        local = turned(footholds[..., :2], -going.headings[:, None])
        wide, long = (
            part * self.gaits.walker.leg * self.scales
            for part in (PASSING_GAP, PASSING_RANGE)
        )
        for k in range(2):
            side = 1 - 2 * k
            off = local[:, k] - local[:, 1 - k]
            fraction = np.maximum(state.swings[:, k], 0.0)
            near = np.clip(1 - np.abs(off[:, 1]) / long, 0.0, 1.0)
            # Crossed feet detour by no more: faster legs would jerk.
            lack = np.clip(wide - side * off[:, 0], 0.0, wide) * near
            out = np.zeros_like(off)
            out[:, 0] = side * lack * 16 * (fraction * (1 - fraction)) ** 2
            footholds[:, k, :2] += turned(out, going.headings)
            around[:, k] = np.abs(out[:, 0])
        return around

    def heights(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return heights and normals of the ground; 0 beyond its edge."""
        heights, normals = self.ground(points)
        return np.where(np.isfinite(heights), heights, 0.0), normals


def followed(
    aims: FloatArray,
    lands: FloatArray,
    swings: FloatArray,
    new: BoolArray,
    scales: FloatArray,
    dt: float,
    k: int,
) -> FloatArray:
    """Return landings of foot ``k`` ``(N, 3)``, limited to the speed of a foot.

    ``new``: feet that were planted before ``(N,)``.
    """
    gone = np.where(new, 0.0, eased(np.clip(swings[:, k], 0.0, 1.0)))
    correction = lands - aims[:, k]
    far = gone * np.linalg.norm(correction[:, :2], axis=1)
    room = np.minimum(SWERVES * scales * dt / np.maximum(far, 1e-9), 1.0)
    followed_aims = aims[:, k] + np.where(far > 0, room, 1.0)[:, None] * correction
    yaw = wrapped(correction[:, 2])
    most = np.where(gone > 0, SWIVELS * dt / np.maximum(gone, 1e-9), np.inf)
    followed_aims[:, 2] = aims[:, k, 2] + np.clip(yaw, -most, most)
    return np.where(new[:, None], lands, followed_aims)

"""A rig's active joints as the kernel takes them: one axis convention, one scale."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.maths import so3

PIN, SLIDE, BALL = 0, 1, 2
# Limits this close to a whole turn apart leave no gap [rad].
GAP = 1e-6
# Limits that are wider than a whole turn by no more than this are meant as one [rad].
HAIR = 0.02


@dataclass(frozen=True)
class Chain:
    """Nodes: joints turned so that z is what they turn, slide or twist about."""

    # Kind, parent, coordinate, whether it follows that of another node, or with 2 a
    # program ``(N, 4)``; behind these, rows of programs (`driver_programs`).
    nodes: IntArray
    # Rest rotation and offset, gain, shift, limits ``(N, 18)``, lengths in shares of
    # ``length``.
    numbers: FloatArray
    goals: IntArray  # node, root and middle of the limb, level ``(E, 4)``
    # Offset in the node's frame, of the joint and from the joint, aim axis, weights
    # ``(E, 9 + K)``.
    goal_numbers: FloatArray
    # Node_from_joint quaternions ``(E, 4)`` of the goals' joints.
    goal_frames: FloatArray
    columns: IntArray  # of the rig's coordinates, those of the chain, in its order
    scales: FloatArray  # what each of them is divided by
    # Least and largest of each that turns all the way round, else infinite ``(C, 2)``.
    periods: FloatArray
    # ``(first column of a ball, ball_from_joint quaternion)``.
    turns: tuple[tuple[int, FloatArray], ...]
    degrees: int  # degrees of freedom
    length: float  # [m]

    @property
    def arrays(self) -> tuple[IntArray, FloatArray, IntArray, FloatArray]:
        """What the kernels first take of a chain and its goals."""
        return self.nodes, self.numbers, self.goals, self.goal_numbers

    @cached_property
    def turning(self) -> IntArray:
        """Columns of the joints that turn all the way round."""
        return np.flatnonzero(np.isfinite(self.periods[:, 0]))

    @cached_property
    def _balls(self) -> tuple[IntArray, FloatArray]:
        """Columns ``(T, 4)`` of ball joints, and their turns ``(T, 4)``."""
        first = np.array([place for place, _ in self.turns], np.int64)
        turns = np.array([turn for _, turn in self.turns]).reshape(-1, 4)
        return first[:, None] + np.arange(4), turns

    def from_rig(self, coordinates: FloatArray) -> FloatArray:
        """Return the chain's coordinates ``(B, C)`` of the rig's ``(B, Q)``."""
        q = np.ascontiguousarray(coordinates[:, self.columns] / self.scales)
        columns, turns = self._balls
        q[:, columns] = _conjugated(so3.normalize(q[:, columns]), turns)
        return q

    def into_rig(self, q: FloatArray, coordinates: FloatArray) -> FloatArray:
        """Return the rig's coordinates ``(B, Q)`` with the chain's in place."""
        q = q.copy()
        columns, turns = self._balls
        q[:, columns] = _conjugated(q[:, columns], so3.conjugate(turns))
        if len(self.turning):
            low, high = self.periods[self.turning].T
            own = q[:, self.turning]
            whole = np.round((own - (low + high) / 2) / (2 * np.pi))
            inside = np.clip(own - 2 * np.pi * whole, low, high)
            q[:, self.turning] = np.where((own < low) | (own > high), inside, own)
        out = coordinates.copy()
        out[:, self.columns] = q * self.scales
        return out


def _conjugated(q: FloatArray, turn: FloatArray) -> FloatArray:
    """Return rotations ``(B, T, 4)`` as seen from turned frames ``(T, 4)``."""
    return np.concatenate([so3.rotate(turn, q[..., :3]), q[..., 3:]], axis=-1)


def difference(chain: Chain, start: FloatArray, end: FloatArray) -> FloatArray:
    """Return what takes poses to others ``(..., D)``, from coordinates ``(..., C)``.

    Pins in radians, slides in shares of the chain's length, balls as rotation vectors
    [rad] in the frame they rest in. Pins without limits go the short way round.
    """
    start, end = np.broadcast_arrays(start, end)
    out = np.zeros((*start.shape[:-1], chain.degrees))
    columns, places, balls = _layout(chain)
    single = end[..., columns[~balls]] - start[..., columns[~balls]]
    whole = 2 * np.pi * np.round(single / (2 * np.pi))
    single -= np.where(_endless(chain)[~balls], whole, 0.0)
    out[..., places[~balls]] = single
    for column, place in zip(columns[balls], places[balls], strict=True):
        own = slice(column, column + 4)
        turn = so3.multiply(end[..., own], so3.conjugate(start[..., own]))
        out[..., place : place + 3] = so3.log(turn)
    return out


def moved(chain: Chain, start: FloatArray, step: FloatArray) -> FloatArray:
    """Return the poses ``(..., C)`` that steps ``(..., D)`` lead to, limits aside."""
    shape = np.broadcast_shapes(start.shape[:-1], step.shape[:-1])
    out = np.array(np.broadcast_to(start, (*shape, start.shape[-1])))
    columns, places, balls = _layout(chain)
    out[..., columns[~balls]] += step[..., places[~balls]]
    for column, place in zip(columns[balls], places[balls], strict=True):
        own = slice(column, column + 4)
        turn = so3.exp(step[..., place : place + 3])
        out[..., own] = so3.multiply(turn, out[..., own])
    return out


def _layout(chain: Chain) -> tuple[IntArray, IntArray, BoolArray]:
    """Return each joint's first coordinate, first degree of freedom, whether a ball."""
    nodes = chain.nodes[chain.nodes[:, 3] == 0]
    balls = nodes[:, 0] == BALL
    widths = np.where(balls, 3, 1)
    return nodes[:, 2], np.cumsum(widths) - widths, balls


def unwound(chain: Chain, poses: FloatArray) -> FloatArray:
    """Return poses ``(F, C)`` in which pins without limits do not wrap."""
    columns = _layout(chain)[0][_endless(chain)]
    out = poses.copy()
    out[:, columns] = np.unwrap(poses[:, columns], axis=0)
    return out


def with_periods(chain: Chain) -> FloatArray:
    """Return the chain's ``numbers`` with limits more than a turn apart in place.

    Limits that are one turn apart, or a hair more as ±180.1° are, stay out: what
    crosses them ends at the other one, turned as if there were none.
    """
    numbers = chain.numbers.copy()
    for row, (kind, _, column, follows) in zip(numbers, chain.nodes, strict=True):
        # What follows a program has none of its own.
        if kind != PIN or follows > 1:
            continue
        low, high = chain.periods[column]
        if high - low > 2 * np.pi + HAIR and np.isfinite(low):
            row[14:16] = low, high
    return numbers


def _endless(chain: Chain) -> BoolArray:
    """Return which joints are pins without limits."""
    own = chain.nodes[:, 3] == 0
    free = ~np.isfinite(with_periods(chain)[own, 14:16]).any(axis=1)
    return np.asarray((chain.nodes[own, 0] == PIN) & free)

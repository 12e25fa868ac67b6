"""How far poses of a chain are apart, joint by joint, and poses that far away."""

from __future__ import annotations

import numpy as np

from animtool._types import BoolArray, FloatArray, IntArray
from animtool.ik.chain import BALL, PIN, Chain
from animtool.maths import so3

# Limits that are wider than a whole turn by no more than this are meant as one [rad].
HAIR = 0.02


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


def seamless(chain: Chain, steps: FloatArray) -> FloatArray:
    """Return steps ``(..., D)`` without whole turns of pins whose limits are one apart.

    Or a hair more, as ±180.1° are.
    What crosses such limits ends at the other one, and is turned as if there were none.
    """
    columns, places, balls = _layout(chain)
    low, high = chain.periods[columns[~balls]].T
    turns = (high > low) & (high - low <= 2 * np.pi + HAIR)
    own = places[~balls][turns]
    out = steps.copy()
    out[..., own] -= 2 * np.pi * np.round(out[..., own] / (2 * np.pi))
    return out


def with_periods(chain: Chain) -> FloatArray:
    """Return the chain's ``numbers`` with limits more than a turn apart in place."""
    numbers = chain.numbers.copy()
    for row, (kind, _, column, _) in zip(numbers, chain.nodes[:, :4], strict=True):
        if kind == PIN and np.isfinite(chain.periods[column, 0]):
            row[14:16] = chain.periods[column]
    return numbers


def _endless(chain: Chain) -> BoolArray:
    """Return which joints are pins without limits."""
    own = chain.nodes[:, 3] == 0
    free = ~np.isfinite(with_periods(chain)[own, 14:16]).any(axis=1)
    return np.asarray((chain.nodes[own, 0] == PIN) & free)

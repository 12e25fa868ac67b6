"""How far poses of a chain are apart, poses that far away, and those on a limit."""

from __future__ import annotations

import numpy as np

from animtool._types import BoolArray, FloatArray, IntArray
from animtool.ik.chain import BALL, PIN, Chain
from animtool.ik.problem import Problem
from animtool.maths import so3
from animtool.rig.joints import coordinate_slices
from animtool.rig.limits import BallLimit, RangeLimit

# A coordinate this near to its limit is on it [rad] or [m]: farther than what counts as
# inside a narrower one.
ON_LIMIT = 1e-8


def frames_on_limits(problem: Problem, coordinates: FloatArray) -> dict[str, BoolArray]:
    """Return by joint in which poses it stands on a limit ``(B,)``.

    Args:
        problem: Whose joints are looked at, those that have limits.
        coordinates: Of the whole rig ``(B, Q)``.
    """
    rig, names = problem.rig, set(problem.joints)
    return {
        joint.name: _on_limit(joint.limits, coordinates[:, place])
        for joint, place in zip(rig.joints, coordinate_slices(rig), strict=True)
        if joint.name in names and joint.limits is not None
    }


def _on_limit(limit: RangeLimit | BallLimit, own: FloatArray) -> BoolArray:
    if isinstance(limit, RangeLimit):
        room = np.minimum(own[:, 0] - limit.low, limit.high - own[:, 0])
        return np.asarray(room <= ON_LIMIT)
    # What a limit a little narrower takes back stands on the true one.
    swing, twist = limit.swing, limit.twist
    if swing is not None:
        swing = (max(swing[0] - ON_LIMIT, 0.0), max(swing[1] - ON_LIMIT, 0.0))
    if twist is not None and twist[1] - twist[0] > 2 * ON_LIMIT:
        twist = (twist[0] + ON_LIMIT, twist[1] - ON_LIMIT)
    inner = BallLimit(swing, twist, limit.twist_axis)
    return np.asarray(inner.excess(own[:, -4:]) > ON_LIMIT / 10)


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

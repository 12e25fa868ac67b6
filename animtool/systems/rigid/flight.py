"""Free flight of bodies under forces of position and velocity.

In a step each body goes for itself, so its equation of motion is solved alone, exactly
where the force is linear: drag, wind and springs of any stiffness are as they are with
a step as short as one likes. What of this contacts and joints prevent is found by the
kernel, which takes a force and a mass for the step.

References:
    M. Hochbruck, A. Ostermann, "Exponential integrators", Acta Numerica 2010, section
    2.3: the exponential method of Runge and Kutta of order 2, with the equation made
    linear where a step begins.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.record import dataclass
from animtool.maths.phi import phi_functions

# Error tolerance of a substep under a nonlinear force, over the motion in it.
TOLERANCE = 2e-5
# Shortest substep over the step, and largest growth of substeps: this resolves
# discontinuous forces.
FLOOR, MAX_PARTS = 1 / 2048, 128
# A substep with a larger error, over the motion, follows the Jacobian alone and is too
# long.
COARSE = 0.5
AT_REST = 1e-9  # least motion [m]
LARGEST = 1e300  # error of non-finite motion
# Bounds and safety factor of the next substep's change.
SHRINK, GROW, CAUTION = 0.1, 4.0, 0.8

# Accelerations at a time, positions and velocities ``(N, 3)``.
Rate: TypeAlias = Callable[[float, FloatArray, FloatArray], FloatArray]
# Their Jacobians by positions [1/s²] and by velocities [1/s], both ``(N, 3, 3)``.
Slopes: TypeAlias = Callable[
    [float, FloatArray, FloatArray], tuple[FloatArray, FloatArray]
]


@dataclass(frozen=True, slots=True)
class Flight:
    """Positions and velocities after a step without contact.

    Attributes:
        points: ``(N, 3)`` [m].
        velocities: ``(N, 3)`` [m/s].
        inertias: How much less their velocities change than by the force at the
            beginning, as a factor on their masses ``(N,)``.
        coarse: Whose forces change so fast that this is not so ``(N,)``.
    """

    points: FloatArray
    velocities: FloatArray
    inertias: FloatArray
    coarse: BoolArray


def fly(
    rate: Rate, slopes: Slopes, t: float, dt: float, x: FloatArray, v: FloatArray
) -> Flight:
    """Return positions and velocities ``(N, 3)`` after a free step [s]."""
    end, now, step = t + dt, t, dt
    begin, begin_slopes = rate(t, x, v), slopes(t, x, v)
    points, velocities, pull, grown = x, v, begin, begin_slopes
    parts_left, least, coarse = MAX_PARTS, FLOOR * dt, np.zeros(len(x), np.bool_)
    while now < end:
        after, shares = _part(rate, now, step, points, velocities, pull, grown)
        error = float(shares.max(initial=0.0)) / TOLERANCE
        if error > 1 and step > least:
            step = max(step * max(CAUTION / np.sqrt(error), SHRINK), least)
            continue
        points, velocities = after
        if step > 2 * FLOOR * dt:
            coarse |= shares > COARSE
        now = end if step >= end - now else now + step
        if now < end:
            parts_left -= 1
            least = max(FLOOR * dt, (end - now) / max(parts_left, 1) ** 2)
            pull, grown = rate(now, *after), slopes(now, *after)
            longer = step * min(CAUTION / np.sqrt(max(error, 1e-12)), GROW)
            step = min(max(longer, least), end - now)
    inertias = _inertias(begin, begin_slopes[1], velocities - v, dt, v)
    return Flight(points, velocities, inertias, coarse)


def _part(
    rate: Rate,
    t: float,
    h: float,
    x: FloatArray,
    v: FloatArray,
    pull: FloatArray,
    grown: tuple[FloatArray, FloatArray],
) -> tuple[tuple[FloatArray, FloatArray], FloatArray]:
    """Return positions and velocities after a substep, and their error ``(N,)``.

    Both are one vector for each, of positions and of velocities times the part.
    """
    by_position, by_speed = h * h * grown[0], h * grown[1]
    matrices = np.zeros((len(x), 6, 6))
    matrices[:, :3, 3:] = np.eye(3)
    matrices[:, 3:, :3], matrices[:, 3:, 3:] = by_position, by_speed
    one, two = phi_functions(matrices)
    first = _times(one, np.concatenate([h * v, h * h * pull], axis=1))
    change = h * h * (rate(t + h, x + first[:, :3], v + first[:, 3:] / h) - pull)
    change -= _times(by_position, first[:, :3]) + _times(by_speed, first[:, 3:])
    second = _times(two[:, :, 3:], change)
    moved = first + second
    size = np.linalg.norm(moved[:, :3], axis=1) + np.linalg.norm(h * v, axis=1)
    size += np.linalg.norm(h * v + moved[:, 3:], axis=1)
    off = np.linalg.norm(second, axis=1)
    shares = off / (size + AT_REST)
    shares[~np.isfinite(shares)] = LARGEST
    moved = np.where((shares > COARSE)[:, None], first, moved)
    return (x + moved[:, :3], v + moved[:, 3:] / h), shares


def _times(matrices: FloatArray, vectors: FloatArray) -> FloatArray:
    return np.asarray((matrices @ vectors[:, :, None])[:, :, 0])


def _inertias(
    begin: FloatArray, grown: FloatArray, change: FloatArray, dt: float, v: FloatArray
) -> FloatArray:
    """Return factors on mass so that an impulse changes velocity as the flow does."""
    # Equal for linear drag.
    z = np.maximum(-np.trace(grown, axis1=1, axis2=2) / 3 * dt, 0.0)
    ratios = np.divide(z, -np.expm1(-z), out=np.ones_like(z), where=z > 0)
    squared, along = (begin * begin).sum(axis=1), (begin * change).sum(axis=1)
    some = np.sqrt(squared) * dt > 1e-6 * np.linalg.norm(v, axis=1)
    some &= along > 0
    np.divide(squared * dt, along, out=ratios, where=some)
    return np.asarray(np.maximum(ratios, 1.0))

"""Free flight of bodies under forces of position and velocity.

In a step each body moves independently, so its equation of motion is solved alone. The
solution is exact for linear forces: drag, wind and springs of any stiffness. Contacts
and joints are solved by the kernel, which gets a mean force and a mass for the step.

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
MIN_STEP_FRACTION, MAX_SUBSTEPS = 1 / 2048, 128
# A substep with a larger error, over the motion, uses only the Jacobian and is too
# long.
COARSE_ERROR = 0.5
MIN_MOTION = 1e-9  # least motion [m]
INFINITE_ERROR = 1e300  # error of non-finite motion
# Bounds and safety factor of the next substep's change.
MIN_STEP_CHANGE, MAX_STEP_CHANGE, SAFETY = 0.1, 4.0, 0.8

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
        points: Positions ``(N, 3)`` [m].
        velocities: Velocities ``(N, 3)`` [m/s].
        inertias: Factors on masses with which the initial force causes the actual
            change of velocity ``(N,)``.
        coarse: Mask of bodies whose forces change too fast to be resolved ``(N,)``.
    """

    points: FloatArray
    velocities: FloatArray
    inertias: FloatArray
    coarse: BoolArray


def fly(
    rate: Rate, slopes: Slopes, t: float, dt: float, x: FloatArray, v: FloatArray
) -> Flight:
    """Return positions and velocities ``(N, 3)`` after a free step [s]."""
    end, time, step = t + dt, t, dt
    start_rate, start_jacobians = rate(t, x, v), slopes(t, x, v)
    points, velocities, acceleration, jacobians = x, v, start_rate, start_jacobians
    substeps_left, min_step, coarse = (
        MAX_SUBSTEPS,
        MIN_STEP_FRACTION * dt,
        np.zeros(len(x), np.bool_),
    )
    while time < end:
        next_state, errors = _substep(
            rate, time, step, points, velocities, acceleration, jacobians
        )
        error = float(errors.max(initial=0.0)) / TOLERANCE
        if error > 1 and step > min_step:
            step = max(step * max(SAFETY / np.sqrt(error), MIN_STEP_CHANGE), min_step)
            continue
        points, velocities = next_state
        if step > 2 * MIN_STEP_FRACTION * dt:
            coarse |= errors > COARSE_ERROR
        time = end if step >= end - time else time + step
        if time < end:
            substeps_left -= 1
            min_step = max(
                MIN_STEP_FRACTION * dt, (end - time) / max(substeps_left, 1) ** 2
            )
            acceleration, jacobians = rate(time, *next_state), slopes(time, *next_state)
            next_step = step * min(SAFETY / np.sqrt(max(error, 1e-12)), MAX_STEP_CHANGE)
            step = min(max(next_step, min_step), end - time)
    inertias = _inertia_factors(start_rate, start_jacobians[1], velocities - v, dt, v)
    return Flight(points, velocities, inertias, coarse)


def _substep(
    rate: Rate,
    t: float,
    h: float,
    x: FloatArray,
    v: FloatArray,
    acceleration: FloatArray,
    jacobians: tuple[FloatArray, FloatArray],
) -> tuple[tuple[FloatArray, FloatArray], FloatArray]:
    """Return positions and velocities after a substep, and their error ``(N,)``.

    Computed with vectors of positions and of velocities times the substep.
    """
    by_position, by_speed = h * h * jacobians[0], h * jacobians[1]
    matrices = np.zeros((len(x), 6, 6))
    matrices[:, :3, 3:] = np.eye(3)
    matrices[:, 3:, :3], matrices[:, 3:, 3:] = by_position, by_speed
    phi1, phi2 = phi_functions(matrices)
    first = _multiply(phi1, np.concatenate([h * v, h * h * acceleration], axis=1))
    change = (
        h * h * (rate(t + h, x + first[:, :3], v + first[:, 3:] / h) - acceleration)
    )
    change -= _multiply(by_position, first[:, :3]) + _multiply(by_speed, first[:, 3:])
    second = _multiply(phi2[:, :, 3:], change)
    total = first + second
    size = np.linalg.norm(total[:, :3], axis=1) + np.linalg.norm(h * v, axis=1)
    size += np.linalg.norm(h * v + total[:, 3:], axis=1)
    error_size = np.linalg.norm(second, axis=1)
    errors = error_size / (size + MIN_MOTION)
    errors[~np.isfinite(errors)] = INFINITE_ERROR
    total = np.where((errors > COARSE_ERROR)[:, None], first, total)
    return (x + total[:, :3], v + total[:, 3:] / h), errors


def _multiply(matrices: FloatArray, vectors: FloatArray) -> FloatArray:
    return np.asarray((matrices @ vectors[:, :, None])[:, :, 0])


def _inertia_factors(
    start_rate: FloatArray,
    jacobians: FloatArray,
    velocity_change: FloatArray,
    dt: float,
    v: FloatArray,
) -> FloatArray:
    """Return factors on masses so that impulses cause the change of the free flight."""
    # Equal for linear drag.
    z = np.maximum(-np.trace(jacobians, axis1=1, axis2=2) / 3 * dt, 0.0)
    ratios = np.divide(z, -np.expm1(-z), out=np.ones_like(z), where=z > 0)
    squared, projections = (
        (start_rate * start_rate).sum(axis=1),
        (start_rate * velocity_change).sum(axis=1),
    )
    is_clear = np.sqrt(squared) * dt > 1e-6 * np.linalg.norm(v, axis=1)
    is_clear &= projections > 0
    np.divide(squared * dt, projections, out=ratios, where=is_clear)
    return np.asarray(np.maximum(ratios, 1.0))

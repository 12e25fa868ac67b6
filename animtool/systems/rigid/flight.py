"""Free flight of bodies under forces of position and velocity.

In a step each body moves independently, so its equation of motion is solved alone. The
solution is exact for linear forces: drag, wind and springs of any stiffness. Contacts
and joints are solved by the kernel, which gets a mean force and a mass for the step.

References:
    M. Hochbruck, A. Ostermann, "Exponential integrators", Acta Numerica 2010, section
    2.3: the exponential Runge-Kutta method of order 2, linearized at the start of a
    step.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.record import dataclass
from animtool.maths.phi import phi_functions

# Error tolerance of a substep under a nonlinear force, relative to the motion in it.
ERROR_TOLERANCE = 2e-5
# Shortest substep relative to the step, and number of substeps after which longer ones
# are required. This resolves discontinuous forces.
MIN_STEP_FRACTION, MAX_SUBSTEPS = 1 / 2048, 128
# A substep with a larger error, relative to the motion, uses only the Jacobian; the
# force is then not resolved.
COARSE_ERROR = 0.5
MIN_MOTION = 1e-9  # added to the motion that errors are relative to [m]
INFINITE_ERROR = 1e300  # error of non-finite motion
# Limits and safety factor of the ratio between two substeps.
MIN_STEP_CHANGE, MAX_STEP_CHANGE, SAFETY_FACTOR = 0.1, 4.0, 0.8

# Accelerations at a time, positions and velocities ``(N, 3)``.
AccelerationFunction: TypeAlias = Callable[[float, FloatArray, FloatArray], FloatArray]
# Their Jacobians by positions [1/s²] and by velocities [1/s], both ``(N, 3, 3)``.
JacobianFunction: TypeAlias = Callable[
    [float, FloatArray, FloatArray], tuple[FloatArray, FloatArray]
]


@dataclass(frozen=True, slots=True)
class Flight:
    """Positions and velocities of bodies after a step without contacts."""

    points: FloatArray  # positions (N, 3) [m]
    velocities: FloatArray  # velocities (N, 3) [m/s]
    # Factors on masses with which the initial force causes the actual change of
    # velocity (N,).
    mass_factors: FloatArray
    # Mask of bodies whose forces change too fast to be resolved (N,).
    is_unresolved: BoolArray


def free_flight(
    acceleration_at: AccelerationFunction,
    jacobians_at: JacobianFunction,
    t: float,
    dt: float,
    x: FloatArray,
    v: FloatArray,
) -> Flight:
    """Return positions and velocities ``(N, 3)`` after a step [s] without contacts."""
    end_time, time, step = t + dt, t, dt
    start_acceleration = acceleration_at(t, x, v)
    start_jacobians = jacobians_at(t, x, v)
    points, velocities = x, v
    acceleration, jacobians = start_acceleration, start_jacobians
    substeps_left, min_step = MAX_SUBSTEPS, MIN_STEP_FRACTION * dt
    is_unresolved = np.zeros(len(x), np.bool_)
    while time < end_time:
        next_state, errors = _substep(
            acceleration_at, time, step, points, velocities, acceleration, jacobians
        )
        error_ratio = float(errors.max(initial=0.0)) / ERROR_TOLERANCE
        if error_ratio > 1 and step > min_step:
            step = max(
                step * max(SAFETY_FACTOR / np.sqrt(error_ratio), MIN_STEP_CHANGE),
                min_step,
            )
            continue
        points, velocities = next_state
        if step > 2 * MIN_STEP_FRACTION * dt:
            is_unresolved |= errors > COARSE_ERROR
        time = end_time if step >= end_time - time else time + step
        if time < end_time:
            substeps_left -= 1
            min_step = (end_time - time) / max(substeps_left, 1) ** 2
            min_step = max(MIN_STEP_FRACTION * dt, min_step)
            acceleration = acceleration_at(time, *next_state)
            jacobians = jacobians_at(time, *next_state)
            next_step = step * min(
                SAFETY_FACTOR / np.sqrt(max(error_ratio, 1e-12)), MAX_STEP_CHANGE
            )
            step = min(max(next_step, min_step), end_time - time)
    mass_factors = _mass_factors(
        start_acceleration, start_jacobians[1], velocities - v, dt, v
    )
    return Flight(points, velocities, mass_factors, is_unresolved)


def _substep(
    acceleration_at: AccelerationFunction,
    t: float,
    h: float,
    x: FloatArray,
    v: FloatArray,
    acceleration: FloatArray,
    jacobians: tuple[FloatArray, FloatArray],
) -> tuple[tuple[FloatArray, FloatArray], FloatArray]:
    """Take one exponential Runge-Kutta substep; return the motion and errors ``(N,)``.

    Vectors have six elements: a position, and a velocity times the substep.
    """
    by_position, by_velocity = h * h * jacobians[0], h * jacobians[1]
    matrices = np.zeros((len(x), 6, 6))
    matrices[:, :3, 3:] = np.eye(3)
    matrices[:, 3:, :3], matrices[:, 3:, 3:] = by_position, by_velocity
    phi1, phi2 = phi_functions(matrices)
    initial_changes = np.concatenate([h * v, h * h * acceleration], axis=1)
    linear_change = _multiply(phi1, initial_changes)
    dx, dv = linear_change[:, :3], linear_change[:, 3:]
    end_acceleration = acceleration_at(t + h, x + dx, v + dv / h)
    residual_acceleration = h * h * (end_acceleration - acceleration)
    residual_acceleration -= _multiply(by_position, dx) + _multiply(by_velocity, dv)
    correction = _multiply(phi2[:, :, 3:], residual_acceleration)
    total_change = linear_change + correction
    magnitudes = np.linalg.norm(total_change[:, :3], axis=1)
    magnitudes += np.linalg.norm(h * v, axis=1)
    magnitudes += np.linalg.norm(h * v + total_change[:, 3:], axis=1)
    correction_magnitudes = np.linalg.norm(correction, axis=1)
    errors = correction_magnitudes / (magnitudes + MIN_MOTION)
    errors[~np.isfinite(errors)] = INFINITE_ERROR
    is_coarse = (errors > COARSE_ERROR)[:, None]
    total_change = np.where(is_coarse, linear_change, total_change)
    return (x + total_change[:, :3], v + total_change[:, 3:] / h), errors


def _multiply(matrices: FloatArray, vectors: FloatArray) -> FloatArray:
    """Return the products of matrices ``(N, A, B)`` and vectors ``(N, B)``."""
    return np.asarray((matrices @ vectors[:, :, None])[:, :, 0])


def _mass_factors(
    start_acceleration: FloatArray,
    jacobians: FloatArray,
    velocity_change: FloatArray,
    dt: float,
    v: FloatArray,
) -> FloatArray:
    """Return mass factors that make impulses match the damped free flight."""
    # For linear drag these are the ratios below.
    z = np.maximum(-np.trace(jacobians, axis1=1, axis2=2) / 3 * dt, 0.0)
    ratios = np.divide(z, -np.expm1(-z), out=np.ones_like(z), where=z > 0)
    squared_accelerations = (start_acceleration * start_acceleration).sum(axis=1)
    projections = (start_acceleration * velocity_change).sum(axis=1)
    min_changes = 1e-6 * np.linalg.norm(v, axis=1)
    is_significant = np.sqrt(squared_accelerations) * dt > min_changes
    is_significant &= projections > 0
    np.divide(squared_accelerations * dt, projections, out=ratios, where=is_significant)
    return np.asarray(np.maximum(ratios, 1.0))

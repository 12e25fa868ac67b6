"""Jacobians of spring accelerations, and bounds of their frequencies."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TypeAlias

import numpy as np

from animtool import _kernels
from animtool.core.array_types import FloatArray, IntArray
from animtool.sim.system import Matrix
from animtool.systems.springs.body import PrescribedMotion, SpringForces, Springs

# Finite difference step of air forces, relative to lengths or speeds [1].
DIFFERENCE_STEP = 1e-5
# Derivative blocks of forces: row and column particles ``(B,)``, by positions and by
# velocities ``(B, 3, 3)``.
_JacobianBlocks: TypeAlias = tuple[IntArray, IntArray, FloatArray, FloatArray]


def mode_bounds(forces: SpringForces) -> FloatArray | None:
    """Return Gershgorin bounds of the fastest modes (ω, ζ) ``(2, 2)``, if any.

    By Gershgorin, eigenvalues of the stiffness over √(m m') are at most the largest row
    sum, with all springs of a particle taken as parallel; likewise for the damping. The
    first mode has all of the damping, the second only the drag.
    """
    springs, targets = forces.springs, forces.target_springs
    max_stiffness = _largest_row_sum(forces, springs.stiffness, targets.stiffness)
    if max_stiffness == 0:
        return None
    damping = _largest_row_sum(forces, springs.damping, targets.damping)
    damping += float(forces.drags.max(initial=0.0))
    omega = float(np.sqrt(max_stiffness))
    min_drag = float(forces.drags.min(initial=0.0))
    return np.array([[omega, damping / (2 * omega)], [omega, min_drag / (2 * omega)]])


def _largest_row_sum(
    forces: SpringForces,
    spring_coefficients: FloatArray,
    target_coefficients: FloatArray,
) -> float:
    """Return the largest absolute row sum of a mass-weighted spring matrix."""
    weights = forces.inverse_masses
    first, second = forces.springs.ends.T
    geometric_means = np.sqrt(weights[first] * weights[second])
    rows = np.zeros(len(weights))
    np.add.at(rows, first, spring_coefficients * (weights[first] + geometric_means))
    np.add.at(rows, second, spring_coefficients * (weights[second] + geometric_means))
    targets = forces.target_springs.particles
    np.add.at(rows, targets, target_coefficients * weights[targets])
    return float(rows.max(initial=0.0))


def acceleration_jacobians(
    forces: SpringForces,
    masses: FloatArray,
    wind: FloatArray,
    x: FloatArray,
    v: FloatArray,
) -> Iterator[Matrix]:
    """Yield the sparse Jacobians of accelerations: by positions, then by velocities.

    Jacobians of springs, targets and drag are analytic; air uses finite differences.
    Masses ``(N,)`` [kg] are 0 for pinned particles; the wind is ``(1, 3)`` [m/s].
    """
    from scipy.sparse import coo_array

    eye, particles = np.eye(3), np.arange(len(x))
    targets, *numbers = forces.target_springs
    stiffness, damping = (values[:, None, None] for values in numbers)
    drags = (forces.drags * masses)[:, None, None]
    blocks = [
        *_spring_blocks(forces.springs, x, v),
        (targets, targets, -stiffness * eye, -damping * eye),
        (particles, particles, np.zeros((len(x), 3, 3)), -drags * eye),
        *(
            _air_jacobian_blocks(forces, wind, x, v)
            if any(forces.air_coefficients)
            else ()
        ),
    ]
    rows, columns, by_x, by_v = map(np.concatenate, zip(*blocks, strict=True))
    i = np.broadcast_to(3 * rows[:, None, None] + np.arange(3)[:, None],
                        (len(rows), 3, 3))  # fmt: skip
    j = np.broadcast_to(3 * columns[:, None, None] + np.arange(3), i.shape)
    for derivatives in (by_x, by_v):
        values = forces.inverse_masses[rows][:, None, None] * derivatives
        indices = (i.ravel(), j.ravel())
        yield coo_array((values.ravel(), indices), shape=(x.size, x.size)).tocsc()


def _spring_blocks(
    springs: Springs, x: FloatArray, v: FloatArray
) -> Iterator[_JacobianBlocks]:
    """Yield Jacobian blocks of springs."""
    first, second = springs.ends.T
    d, e = x[second] - x[first], v[second] - v[first]
    square = (d * d).sum(axis=1)
    inverse = np.where(square > 0, 1 / np.where(square > 0, square, 1.0), 0.0)
    rest_ratio = springs.rest * np.sqrt(square) * inverse
    damping_term = springs.damping * (d * e).sum(axis=1) * inverse
    outer = d[:, :, None] * d[:, None, :] * inverse[:, None, None]
    # Derivative of the force on the first end by the position of the second.
    isotropic = springs.stiffness * (1 - rest_ratio) + damping_term
    axial = springs.stiffness * rest_ratio - 2 * damping_term
    by_x = isotropic[:, None, None] * np.eye(3) + axial[:, None, None] * outer
    by_x += (springs.damping * inverse)[:, None, None] * d[:, :, None] * e[:, None, :]
    by_x[(square == 0) & (springs.rest > 0)] = 0.0
    by_v = springs.damping[:, None, None] * outer
    for row in (first, second):
        for column in (first, second):
            sign = 1.0 if row is not column else -1.0
            yield row, column, sign * by_x, sign * by_v


def _air_jacobian_blocks(
    forces: SpringForces, wind: FloatArray, x: FloatArray, v: FloatArray
) -> Iterator[_JacobianBlocks]:
    """Yield Jacobian blocks of air forces, by central finite differences."""
    triangles, no_positions = forces.triangles, np.zeros((1, 0, 3))
    unit_masses, no_drags = np.ones(triangles.size), np.zeros(triangles.size)
    faces, air = np.arange(triangles.size).reshape(-1, 3), forces.air_coefficients
    separate_forces = SpringForces(
        unit_masses, no_drags, Springs.none(), faces, np.zeros(3), air
    )
    prescribed = PrescribedMotion(np.zeros(1), no_positions, no_positions, wind[None])
    network = separate_forces.network(prescribed)
    state = np.stack([x[triangles.ravel()], v[triangles.ravel()]])
    untorn_flags = np.zeros(0, np.uint8)

    def derivative(variable: int, corner: int) -> FloatArray:
        """Return the Jacobian of corner forces ``(T, 3, 3, 3)``.

        The axes are triangle, corner, force component and position component.
        """
        max_magnitude = float(np.abs(state[variable]).max(initial=0.0))
        increment = DIFFERENCE_STEP * max(max_magnitude, 1e-3)
        columns = []
        for k in range(3):
            values = []
            for sign in (1.0, -1.0):
                shifted_state = state.copy()
                shifted_state[variable, corner::3, k] += sign * increment
                values.append(
                    _kernels.spring_accelerations(
                        network, 0.0, 1.0, shifted_state, untorn_flags
                    )
                )
            columns.append((values[0] - values[1]) / (2 * increment))
        return np.stack(columns, axis=-1).reshape(-1, 3, 3, 3)

    for column in range(3):
        derivatives = [derivative(variable, column) for variable in range(2)]
        for row in range(3):
            by_x, by_v = (values[:, row] + 0.0 for values in derivatives)
            yield triangles[:, row], triangles[:, column], by_x, by_v

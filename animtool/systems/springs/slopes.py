"""Derivatives of spring accelerations, and bounds of their frequencies."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TypeAlias

import numpy as np

from animtool import _kernels
from animtool.core.array_types import FloatArray, IntArray
from animtool.sim.system import Matrix
from animtool.systems.springs.body import Paths, SpringForces, Springs

# Step of finite differences of air forces, relative to lengths or speeds.
NUDGE = 1e-5
# Derivative blocks of forces: row and column particles ``(B,)``, by positions and by
# velocities ``(B, 3, 3)``.
_Blocks: TypeAlias = tuple[IntArray, IntArray, FloatArray, FloatArray]


def fastest(loads: SpringForces) -> FloatArray | None:
    """Return bounds of the fastest modes (ω, ζ) ``(2, 2)``; None without springs.

    By Gershgorin, eigenvalues of the stiffness over √(m m') are at most the largest row
    sum, with all springs of a particle taken as parallel; likewise for the damping. The
    first mode has all of the damping, the second only the drag.
    """
    stiffest = _largest(loads, loads.springs.stiffness, loads.target_springs.stiffness)
    if stiffest == 0:
        return None
    slowed = _largest(loads, loads.springs.damping, loads.target_springs.damping)
    slowed += float(loads.drags.max(initial=0.0))
    omega = float(np.sqrt(stiffest))
    least = float(loads.drags.min(initial=0.0))
    return np.array([[omega, slowed / (2 * omega)], [omega, least / (2 * omega)]])


def _largest(loads: SpringForces, pull: FloatArray, draws: FloatArray) -> float:
    weights = loads.inverse_masses
    first, second = loads.springs.ends.T
    between = np.sqrt(weights[first] * weights[second])
    rows = np.zeros(len(weights))
    np.add.at(rows, first, pull * (weights[first] + between))
    np.add.at(rows, second, pull * (weights[second] + between))
    drawn = loads.target_springs.particles
    np.add.at(rows, drawn, draws * weights[drawn])
    return float(rows.max(initial=0.0))


def slopes(
    loads: SpringForces,
    masses: FloatArray,
    wind: FloatArray,
    x: FloatArray,
    v: FloatArray,
) -> Iterator[Matrix]:
    """Yield derivatives of accelerations by positions, then by velocities, sparse.

    Derivatives of springs, targets and drag are exact, those of air are differences.
    Masses ``(N,)`` [kg] are 0 for pinned particles; the wind is ``(1, 3)`` [m/s].
    """
    from scipy.sparse import coo_array

    per_block = zip(*_blocks(loads, masses, wind, x, v), strict=True)
    rows, columns, by_x, by_v = map(np.concatenate, per_block)
    i = np.broadcast_to(3 * rows[:, None, None] + np.arange(3)[:, None],
                        (len(rows), 3, 3))  # fmt: skip
    j = np.broadcast_to(3 * columns[:, None, None] + np.arange(3), i.shape)
    for joined in (by_x, by_v):
        values = loads.inverse_masses[rows][:, None, None] * joined
        indices = (i.ravel(), j.ravel())
        yield coo_array((values.ravel(), indices), shape=(x.size, x.size)).tocsc()


def _blocks(
    loads: SpringForces,
    masses: FloatArray,
    wind: FloatArray,
    x: FloatArray,
    v: FloatArray,
) -> Iterator[_Blocks]:
    eye, every = np.eye(3), np.arange(len(x))
    yield from _of_springs(loads.springs, x, v)
    drawn, *numbers = loads.target_springs
    stiffness, damping = (each[:, None, None] for each in numbers)
    yield drawn, drawn, -stiffness * eye, -damping * eye
    slowed = (loads.drags * masses)[:, None, None]
    yield every, every, np.zeros((len(x), 3, 3)), -slowed * eye
    if any(loads.pressures):
        yield from _of_air(loads, wind, x, v)


def _of_springs(springs: Springs, x: FloatArray, v: FloatArray) -> Iterator[_Blocks]:
    first, second = springs.ends.T
    d, e = x[second] - x[first], v[second] - v[first]
    square = (d * d).sum(axis=1)
    inverse = np.where(square > 0, 1 / np.where(square > 0, square, 1.0), 0.0)
    short = springs.rest * np.sqrt(square) * inverse
    closing = springs.damping * (d * e).sum(axis=1) * inverse
    outer = d[:, :, None] * d[:, None, :] * inverse[:, None, None]
    # Derivative of the force on the first end by the position of the second.
    isotropic = springs.stiffness * (1 - short) + closing
    along = springs.stiffness * short - 2 * closing
    by_x = isotropic[:, None, None] * np.eye(3) + along[:, None, None] * outer
    by_x += (springs.damping * inverse)[:, None, None] * d[:, :, None] * e[:, None, :]
    by_x[(square == 0) & (springs.rest > 0)] = 0.0
    by_v = springs.damping[:, None, None] * outer
    for row in (first, second):
        for column in (first, second):
            sign = 1.0 if row is not column else -1.0
            yield row, column, sign * by_x, sign * by_v


def _of_air(
    loads: SpringForces, wind: FloatArray, x: FloatArray, v: FloatArray
) -> Iterator[_Blocks]:
    triangles, nowhere = loads.triangles, np.zeros((1, 0, 3))
    ones, nothing = np.ones(triangles.size), np.zeros(triangles.size)
    faces = np.arange(triangles.size).reshape(-1, 3)
    alone = SpringForces(
        ones, nothing, Springs.none(), faces, np.zeros(3), loads.pressures
    )
    separate = alone.network(Paths(np.zeros(1), nowhere, nowhere, wind[None]))
    state = np.stack([x[triangles.ravel()], v[triangles.ravel()]])
    for column in range(3):
        derivatives = [_nudged(separate, state, part, column) for part in range(2)]
        for row in range(3):
            by_x, by_v = (each[:, row] + 0.0 for each in derivatives)
            yield triangles[:, row], triangles[:, column], by_x, by_v


def _nudged(
    separate: _kernels.SpringNetwork, state: FloatArray, part: int, corner: int
) -> FloatArray:
    """Return derivatives of corner forces by one corner's position or velocity.

    ``(T, 3, 3, 3)``: triangle, corner, force component, position component.
    """
    untorn = np.zeros(0, np.uint8)
    size = NUDGE * max(float(np.abs(state[part]).max(initial=0.0)), 1e-3)
    columns = []
    for k in range(3):
        sides = []
        for sign in (1.0, -1.0):
            moved = state.copy()
            moved[part, corner::3, k] += sign * size
            sides.append(
                _kernels.spring_accelerations(separate, 0.0, 1.0, moved, untorn)
            )
        columns.append((sides[0] - sides[1]) / (2 * size))
    return np.stack(columns, axis=-1).reshape(-1, 3, 3, 3)

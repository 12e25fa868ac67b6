"""Derivatives and bounds of the accelerations of springs."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from animtool import _kernels
from animtool._types import BoolArray, FloatArray, IntArray
from animtool.sim.system import Matrix
from animtool.systems.springs.body import (
    NO_DRAWS,
    Body,
    Draws,
    Paths,
    Springs,
    spring_network,
)

# Differences of the forces of air: a share of lengths, or of speeds.
NUDGE = 1e-5


class LoadedBody(Protocol):
    """A body of N particles with what holds, draws and slows them."""

    @property
    def body(self) -> Body:
        """Particles, springs and triangles."""

    @property
    def fixed(self) -> BoolArray:
        """Which particles are held ``(N,)``."""

    @property
    def inverse_masses(self) -> FloatArray:
        """Of particles ``(N,)`` [1/kg], 0 of those that are held."""

    @property
    def drags(self) -> FloatArray:
        """What slows each particle, over its mass and speed ``(N,)`` [1/s]."""

    @property
    def draws(self) -> Draws:
        """What draws particles to targets."""

    @property
    def gravity(self) -> FloatArray:
        """``(3,)`` [m/s²]."""

    @property
    def pressures(self) -> tuple[float, float]:
        """Drag and lift of triangles, over area and the square of speed."""

    def wind(self, t: float) -> FloatArray:
        """Return the velocity of the air at a time ``(1, 3)`` [m/s]."""


def fastest(system: LoadedBody) -> FloatArray | None:
    """Return bounds of the fastest motions (ω, ζ) ``(2, 2)``, None without springs.

    The stiffness over √(m m') has no eigenvalue above the largest sum of sizes in a row
    (Gershgorin), each spring as if along all others of its particle; the same of the
    damping. The first motion bears all of that, the second only the drag.
    """
    springs = system.body.springs
    stiffest = _largest(system, springs.stiffness, system.draws.stiffness)
    if stiffest == 0:
        return None
    slowed = _largest(system, springs.damping, system.draws.damping)
    slowed += float(system.drags.max(initial=0.0))
    omega = float(np.sqrt(stiffest))
    least = float(system.drags.min(initial=0.0))
    return np.array([[omega, slowed / (2 * omega)], [omega, least / (2 * omega)]])


def _largest(system: LoadedBody, pull: FloatArray, draws: FloatArray) -> float:
    weights = system.inverse_masses
    first, second = system.body.springs.ends.T
    between = np.sqrt(weights[first] * weights[second])
    rows = np.zeros(len(weights))
    np.add.at(rows, first, pull * (weights[first] + between))
    np.add.at(rows, second, pull * (weights[second] + between))
    drawn = system.draws.particles
    np.add.at(rows, drawn, draws * weights[drawn])
    return float(rows.max(initial=0.0))


class _Blocks:
    """Derivatives of forces, 3 by 3 of a particle by another, as they are found."""

    def __init__(self) -> None:
        self._rows: list[IntArray] = []
        self._columns: list[IntArray] = []
        self._by_x: list[FloatArray] = []
        self._by_v: list[FloatArray] = []

    def add(
        self, rows: IntArray, columns: IntArray, by_x: FloatArray, by_v: FloatArray
    ) -> None:
        """Add blocks ``(B, 3, 3)``."""
        self._rows.append(rows)
        self._columns.append(columns)
        self._by_x.append(by_x)
        self._by_v.append(by_v)

    def by_places(self, inverse_masses: FloatArray) -> Matrix:
        """Return the derivatives of accelerations by positions."""
        return self._matrix(self._by_x, inverse_masses)

    def by_speeds(self, inverse_masses: FloatArray) -> Matrix:
        """Return the derivatives of accelerations by velocities."""
        return self._matrix(self._by_v, inverse_masses)

    def _matrix(self, blocks: list[FloatArray], inverse_masses: FloatArray) -> Matrix:
        from scipy.sparse import coo_array

        size = 3 * len(inverse_masses)
        rows, columns = np.concatenate(self._rows), np.concatenate(self._columns)
        i = np.broadcast_to(3 * rows[:, None, None] + np.arange(3)[:, None],
                            (len(rows), 3, 3))  # fmt: skip
        j = np.broadcast_to(3 * columns[:, None, None] + np.arange(3), i.shape)
        values = inverse_masses[rows][:, None, None] * np.concatenate(blocks)
        places = (i.ravel(), j.ravel())
        return coo_array((values.ravel(), places), shape=(size, size)).tocsc()


def slopes(
    system: LoadedBody, t: float, x: FloatArray, v: FloatArray
) -> tuple[Matrix, Matrix]:
    """Return derivatives of accelerations by positions and by velocities, sparse.

    Those of springs, targets and drag are exact, those of the air differences.
    """
    blocks, weights = _blocks(system, t, x, v), system.inverse_masses
    return blocks.by_places(weights), blocks.by_speeds(weights)


def place_slopes(system: LoadedBody, t: float, x: FloatArray) -> Matrix:
    """Return derivatives of accelerations by positions, of particles at rest."""
    blocks = _blocks(system, t, x, np.zeros_like(x))
    return blocks.by_places(system.inverse_masses)


def _blocks(system: LoadedBody, t: float, x: FloatArray, v: FloatArray) -> _Blocks:
    blocks, eye, every = _Blocks(), np.eye(3), np.arange(len(x))
    _add_springs(blocks, system, x, v)
    drawn, *numbers = system.draws
    stiffness, damping = (each[:, None, None] for each in numbers)
    blocks.add(drawn, drawn, -stiffness * eye, -damping * eye)
    slowed = system.drags * np.where(system.fixed, 0.0, system.body.masses)
    blocks.add(every, every, np.zeros((len(x), 3, 3)), -slowed[:, None, None] * eye)
    if any(system.pressures):
        _add_air(blocks, system, t, x, v)
    return blocks


def _add_springs(
    blocks: _Blocks, system: LoadedBody, x: FloatArray, v: FloatArray
) -> None:
    springs = system.body.springs
    first, second = springs.ends.T
    d, e = x[second] - x[first], v[second] - v[first]
    square = (d * d).sum(axis=1)
    inverse = np.where(square > 0, 1 / np.where(square > 0, square, 1.0), 0.0)
    short = springs.rest * np.sqrt(square) * inverse
    closing = springs.damping * (d * e).sum(axis=1) * inverse
    outer = d[:, :, None] * d[:, None, :] * inverse[:, None, None]
    # Of the pull on the first end by the place of the second.
    isotropic = springs.stiffness * (1 - short) + closing
    along = springs.stiffness * short - 2 * closing
    by_x = isotropic[:, None, None] * np.eye(3) + along[:, None, None] * outer
    by_x += (springs.damping * inverse)[:, None, None] * d[:, :, None] * e[:, None, :]
    by_x[(square == 0) & (springs.rest > 0)] = 0.0
    by_v = springs.damping[:, None, None] * outer
    for row in (first, second):
        for column in (first, second):
            sign = 1.0 if row is not column else -1.0
            blocks.add(row, column, sign * by_x, sign * by_v)


def _add_air(
    blocks: _Blocks, system: LoadedBody, t: float, x: FloatArray, v: FloatArray
) -> None:
    triangles = system.body.triangles
    nowhere = np.zeros((1, 0, 3))
    apart = spring_network(
        np.ones(triangles.size),
        np.zeros(triangles.size),
        Springs.none(),
        np.arange(triangles.size).reshape(-1, 3),
        np.zeros(3),
        system.pressures,
        np.zeros(0, np.int64),
        NO_DRAWS,
        Paths(np.zeros(1), nowhere, nowhere, system.wind(t)[None]),
    )
    state = np.stack([x[triangles.ravel()], v[triangles.ravel()]])
    corners = [triangles[:, k] for k in range(3)]
    nothing = np.zeros((len(triangles), 3, 3))
    for column in range(3):
        found = [_nudged(apart, state, part, column) for part in range(2)]
        for row in range(3):
            by_x, by_v = (each[:, row] for each in found)
            blocks.add(corners[row], corners[column], by_x + nothing, by_v + nothing)


def _nudged(
    apart: _kernels.SpringNetwork, state: FloatArray, part: int, corner: int
) -> FloatArray:
    """Return derivatives of forces on corners by one corner's place or velocity.

    ``(T, 3, 3, 3)``: triangle, corner, component of the force, component of the place.
    """
    whole = np.zeros(0, np.uint8)
    size = NUDGE * max(float(np.abs(state[part]).max(initial=0.0)), 1e-3)
    columns = []
    for k in range(3):
        sides = []
        for sign in (1.0, -1.0):
            moved = state.copy()
            moved[part, corner::3, k] += sign * size
            sides.append(_kernels.spring_accelerations(apart, 0.0, 1.0, moved, whole))
        columns.append((sides[0] - sides[1]) / (2 * size))
    return np.stack(columns, axis=-1).reshape(-1, 3, 3, 3)

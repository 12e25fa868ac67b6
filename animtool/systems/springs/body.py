"""Bodies made of particles and springs, as arrays, and as kernels take them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import numpy as np

from animtool import _kernels
from animtool._types import ArrayLike, BoolArray, FloatArray, IntArray, as_floats
from animtool.systems.springs.records import Family, SelfContact

# Fields of `Springs` that are the columns of kernels, in their order.
COLUMNS = ("rest", "stiffness", "damping", "limit")


@dataclass(frozen=True, slots=True)
class Springs:
    """S springs.

    Attributes:
        ends: Particles that they join ``(S, 2)``.
        rest: Length at rest ``(S,)`` [m], 0 or more.
        stiffness: ``(S,)`` [N/m].
        damping: Along the spring ``(S,)`` [N s/m].
        limit: Length beyond which a spring tears ``(S,)`` [m], infinite where it
            does not.
    """

    ends: IntArray
    rest: FloatArray
    stiffness: FloatArray
    damping: FloatArray
    limit: FloatArray

    @staticmethod
    def none() -> Springs:
        """Return no springs."""
        empty = np.zeros(0)
        return Springs(np.zeros((0, 2), np.int64), empty, empty, empty, empty)

    def select(self, rows: IntArray | BoolArray) -> Springs:
        """Return some of them, by number in an order, or by a mask ``(S,)``."""
        return Springs(*(getattr(self, each.name)[rows] for each in fields(self)))


@dataclass(frozen=True, slots=True)
class Body:
    """N particles, the springs between them, and the surface that air acts on.

    Attributes:
        positions: ``(N, 3)`` [m].
        masses: ``(N,)`` [kg].
        springs: Between them.
        triangles: Corners ``(T, 3)``.
    """

    positions: FloatArray
    masses: FloatArray
    springs: Springs
    triangles: IntArray


def springs_between(
    ends: ArrayLike,
    family: Family,
    positions: FloatArray,
    masses: FloatArray,
    rest: ArrayLike | None = None,
) -> Springs:
    """Return springs of a family, at rest where the particles are.

    Args:
        ends: Particles to join ``(S, 2)``.
        family: What they have in common.
        positions: Of particles ``(N, 3)`` [m].
        masses: ``(N,)`` [kg].
        rest: Length at rest ``(S,)`` or one for all [m]; None is the distance, times
            what the family has.

    >>> line = np.array([[0.0, 0, 0], [2.0, 0, 0]])
    >>> springs_between([[0, 1]], Family(10.0), line, np.ones(2)).rest.tolist()
    [2.0]
    >>> rod = Family(0.0, axial_stiffness=30.0)
    >>> springs_between([[0, 1]], rod, line, np.ones(2)).stiffness.tolist()
    [15.0]
    """
    pairs = np.asarray(ends, np.int64).reshape(-1, 2)
    gaps = np.linalg.norm(positions[pairs[:, 1]] - positions[pairs[:, 0]], axis=1)
    lengths = gaps * family.rest if rest is None else np.asarray(rest, np.float64)
    lengths = np.broadcast_to(lengths, len(pairs)).astype(np.float64)
    stiffness = np.full(len(pairs), float(family.stiffness))
    if family.axial_stiffness is not None:
        stiffness = np.divide(
            family.axial_stiffness, lengths, out=stiffness, where=lengths > 0
        )
    critical = 2 * np.sqrt(stiffness * masses[pairs].mean(axis=1))
    limit = np.full(len(pairs), np.inf)
    if family.tear is not None:
        with np.errstate(invalid="ignore"):
            limit = lengths * (1 + family.tear)
        limit[np.isnan(limit)] = np.inf
    return Springs(
        pairs, lengths, stiffness, family.damping + family.ratio * critical, limit
    )


def gathered(springs: Sequence[Springs]) -> Springs:
    """Return springs of many families together."""
    every = [Springs.none(), *springs]
    columns = ([getattr(each, f.name) for each in every] for f in fields(Springs))
    return Springs(*map(np.concatenate, columns))


def built(
    positions: ArrayLike,
    masses: ArrayLike,
    families: Sequence[tuple[ArrayLike, Family | None]],
    triangles: ArrayLike = (),
) -> Body:
    """Return a body of families of springs, those that are None left out."""
    places = as_floats(positions, ("N", 3), "positions")
    weights = np.broadcast_to(np.asarray(masses, np.float64), len(places)).copy()
    springs = [
        springs_between(ends, family, places, weights)
        for ends, family in families
        if family is not None
    ]
    faces = np.asarray(triangles, np.int64).reshape(-1, 3)
    return Body(places, weights, gathered(springs), faces)


def join(bodies: Sequence[Body]) -> Body:
    """Return bodies as one; particles are those of the first, the second, and so on.

    >>> from animtool.systems.springs.shapes import rope
    >>> one = rope([0, 0, 0], [1, 0, 0], 4, Family(10.0), mass=1.0)
    >>> join([one, one]).springs.ends.tolist()[3]
    [4, 5]
    """
    offsets = np.cumsum([0, *(len(body.positions) for body in bodies)])
    springs = gathered([body.springs for body in bodies])
    shifts = np.repeat(offsets[:-1], [len(body.springs.rest) for body in bodies])
    faces = [body.triangles + at for body, at in zip(bodies, offsets, strict=False)]
    return Body(
        np.concatenate([np.zeros((0, 3)), *(body.positions for body in bodies)]),
        np.concatenate([np.zeros(0), *(body.masses for body in bodies)]),
        replace(springs, ends=springs.ends + shifts[:, None].astype(np.int64)),
        np.concatenate([np.zeros((0, 3), np.int64), *faces]),
    )


class Draws(NamedTuple):
    """What draws particles to points, by springs of no length."""

    particles: IntArray  # ``(A,)``
    stiffness: FloatArray  # ``(A,)`` [N/m]
    damping: FloatArray  # ``(A,)`` [N s/m]


NO_DRAWS = Draws(np.zeros(0, np.int64), np.zeros(0), np.zeros(0))


class Paths(NamedTuple):
    """Where holders are, and how the air moves, over times that all share."""

    knots: FloatArray  # ``(K,)`` [s]
    held: FloatArray  # of held particles ``(K or 1, P, 3)`` [m]
    drawn: FloatArray  # of the points that others are drawn to ``(K or 1, A, 3)`` [m]
    wind: FloatArray  # ``(K or 1, 1, 3)`` [m/s]


def spring_network(
    inverse_masses: FloatArray,
    drags: FloatArray,
    springs: Springs,
    triangles: IntArray,
    gravity: FloatArray,
    pressures: tuple[float, float],
    held: IntArray,
    draws: Draws,
    paths: Paths,
) -> _kernels.SpringNetwork:
    """Return what kernels step.

    Args:
        inverse_masses: Of particles ``(N,)`` [1/kg], 0 of those that are held.
        drags: What slows each, over its mass and speed ``(N,)`` [1/s].
        springs: In the order in which they are gone through.
        triangles: What the air acts on ``(T, 3)``.
        gravity: ``(3,)`` [m/s²].
        pressures: Drag and lift of triangles, over area and the square of speed.
        held: Particles that are ``(P,)``.
        draws: What draws others.
        paths: Of both, and of the air.
    """
    return _kernels.SpringNetwork(
        inverse_masses=inverse_masses,
        drags=drags,
        ends=np.ascontiguousarray(springs.ends),
        numbers=np.stack([getattr(springs, name) for name in COLUMNS], axis=1),
        triangles=triangles,
        field=np.array([*gravity, *pressures], np.float64),
        knots=paths.knots,
        held=held,
        held_path=paths.held,
        anchors=draws.particles,
        anchor_numbers=np.stack([draws.stiffness, draws.damping], axis=1),
        anchor_path=paths.drawn,
        winds=paths.wind,
    )


def spring_layers(
    network: _kernels.SpringNetwork, contact: SelfContact, rest: FloatArray
) -> _kernels.SpringLayers:
    """Return what of a surface kernels keep apart; at rest it is at ``(N, 3)`` [m]."""
    numbers = contact.thickness, contact.friction, contact.speed
    return _kernels.SpringLayers(network, rest, *numbers)

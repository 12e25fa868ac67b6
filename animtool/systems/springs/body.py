"""Bodies of particles and springs as arrays, and their kernel networks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import field, replace
from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from animtool import _kernels
from animtool.core.array_types import ArrayLike, FloatArray, IntArray, as_floats
from animtool.core.record import dataclass
from animtool.maths.rows import Rows
from animtool.systems.springs.records import Family

# Torn flags of springs in kernel order ``(S,)``.
TornFlags: TypeAlias = npt.NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Springs(Rows):
    """Properties of S springs, one row for each.

    Attributes:
        ends: Indices of both end particles ``(S, 2)``.
        rest: Length at rest ``(S,)`` [m], 0 or more.
        stiffness: ``(S,)`` [N/m].
        damping: Along the spring ``(S,)`` [N s/m].
        limit: Length beyond which a spring tears ``(S,)`` [m]; infinite if never.
    """

    ends: IntArray
    rest: FloatArray
    stiffness: FloatArray
    damping: FloatArray
    limit: FloatArray

    @staticmethod
    def none() -> Springs:
        """Return a set without springs."""
        return Springs(np.zeros((0, 2), np.int64), *np.zeros((4, 0)))

    def lengths(self, points: FloatArray) -> FloatArray:
        """Return spring lengths ``(S,)`` [m] for particles at points ``(N, 3)``."""
        gaps = points[self.ends[:, 1]] - points[self.ends[:, 0]]
        lengths: FloatArray = np.linalg.norm(gaps, axis=1)
        return lengths


@dataclass(frozen=True, slots=True)
class Body:
    """N particles, springs between them, and the surface triangles.

    Attributes:
        positions: ``(N, 3)`` [m].
        masses: ``(N,)`` [kg].
        springs: Springs between the particles.
        triangles: Corners ``(T, 3)``.
        strands: Number of strands, if xpbd solves each of them directly; else 0. They
            have equal numbers of particles of equal mass, from a pinned root on. Their
            structural springs come first, then one bend spring fewer for each.
    """

    positions: FloatArray
    masses: FloatArray
    springs: Springs
    triangles: IntArray
    strands: int = 0


def springs_between(
    ends: ArrayLike,
    family: Family,
    positions: FloatArray,
    masses: FloatArray,
    rest: ArrayLike | None = None,
) -> Springs:
    """Return springs of a family between particles, at rest in their positions.

    Args:
        ends: Particles that each spring connects ``(S, 2)``.
        family: Stiffness, damping and tear limit.
        positions: Positions of the particles ``(N, 3)`` [m].
        masses: Masses of the particles ``(N,)`` [kg].
        rest: Rest length ``(S,)`` or one for all [m]; None is the distance times the
            rest factor of the family.

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
    stiffness = np.full(len(pairs), float(family.stiffness or 0.0))
    if family.axial_stiffness is not None:
        np.divide(family.axial_stiffness, lengths, out=stiffness, where=lengths > 0)
    mean_masses = masses[pairs].mean(axis=1)
    # Overflow is reported when the simulation checks the body.
    with np.errstate(over="ignore", invalid="ignore"):
        if family.frequency is not None:
            stiffness = (2 * math.pi * family.frequency) ** 2 * mean_masses
        critical = 2 * np.sqrt(stiffness * mean_masses)
        damping = family.damping + family.ratio * critical
    limit = np.full(len(pairs), np.inf)
    if family.tear is not None:
        with np.errstate(invalid="ignore"):
            limit = lengths * (1 + family.tear)
        limit[np.isnan(limit)] = np.inf
    return Springs(pairs, lengths, stiffness, damping, limit)


def build_body(
    positions: ArrayLike,
    masses: ArrayLike,
    families: Sequence[tuple[ArrayLike, Family | None]],
    triangles: ArrayLike = (),
    strands: int = 0,
) -> Body:
    """Return a body with springs of all given families; None families are skipped."""
    points = as_floats(positions, ("N", 3), "positions")
    particle_masses = np.full(len(points), masses, np.float64)
    springs = [
        springs_between(ends, family, points, particle_masses)
        for ends, family in families
        if family is not None
    ]
    faces = np.asarray(triangles, np.int64).reshape(-1, 3)
    all_springs = Springs.concatenate([Springs.none(), *springs])
    return Body(points, particle_masses, all_springs, faces, strands)


def join(bodies: Sequence[Body]) -> Body:
    """Concatenate bodies; particles are numbered in the order of the bodies.

    >>> from animtool.systems.springs.shapes import rope
    >>> one = rope([0, 0, 0], [1, 0, 0], 4, Family(10.0), mass=1.0)
    >>> join([one, one]).springs.ends.tolist()[3]
    [4, 5]
    """
    offsets = np.cumsum([0, *(len(body.positions) for body in bodies)])
    springs = Springs.concatenate([Springs.none(), *(body.springs for body in bodies)])
    shifts = np.repeat(offsets[:-1], [len(body.springs.rest) for body in bodies])
    rows = zip(bodies, offsets, strict=False)
    faces = [body.triangles + offset for body, offset in rows]
    return Body(
        np.concatenate([np.zeros((0, 3)), *(body.positions for body in bodies)]),
        np.concatenate([np.zeros(0), *(body.masses for body in bodies)]),
        replace(springs, ends=springs.ends + shifts[:, None].astype(np.int64)),
        np.concatenate([np.zeros((0, 3), np.int64), *faces]),
    )


@dataclass(frozen=True, slots=True)
class Welded:
    """A body with merged particles.

    Attributes:
        body: The merged body; its springs and triangles keep their order.
        rows: New index of each original particle ``(N,)``.
        gap: Largest distance between two merged particles [m].
    """

    body: Body
    rows: IntArray
    gap: float


def weld(body: Body, pairs: ArrayLike) -> Welded:
    """Merge pairs of particles of a body; their masses add up.

    Args:
        body: Particles and springs.
        pairs: Particles to remove and the particles that replace them ``(J, 2)``.

    >>> from animtool.systems.springs import Family, join, rope
    >>> one = rope([0, 0, 0], [1, 0, 0], 2, Family(10.0), mass=1.0)
    >>> two = rope([1, 0, 0], [2, 0, 0], 2, Family(10.0), mass=1.0)
    >>> welded = weld(join([one, two]), [[2, 1]])
    >>> body = welded.body
    >>> welded.rows.tolist(), body.masses.tolist(), body.springs.ends.tolist()
    ([0, 1, 1, 2], [1.0, 2.0, 1.0], [[0, 1], [1, 2]])
    """
    merges = np.asarray(pairs, np.int64).reshape(-1, 2)
    replacements = np.arange(len(body.positions))
    for removed, replacement in merges.tolist():
        # Chains of merged particles all map to the one that is kept.
        replacements[replacements == replacements[removed]] = replacements[replacement]
    remaining, rows = np.unique(replacements, return_inverse=True)
    rows = rows.reshape(-1)
    offsets = body.positions - body.positions[replacements]
    gaps: FloatArray = np.linalg.norm(offsets, axis=1)
    masses = np.zeros(len(remaining))
    np.add.at(masses, rows, body.masses)
    springs = replace(body.springs, ends=rows[body.springs.ends])
    welded_body = Body(body.positions[remaining], masses, springs, rows[body.triangles])
    return Welded(welded_body, rows, float(gaps.max(initial=0.0)))


class TargetSprings(NamedTuple):
    """Zero-length springs between particles and target points."""

    particles: IntArray  # ``(A,)``
    stiffness: FloatArray  # ``(A,)`` [N/m]
    damping: FloatArray  # ``(A,)`` [N s/m]


NO_PARTICLES: IntArray = np.zeros(0, np.int64)
NO_TARGETS = TargetSprings(NO_PARTICLES, np.zeros(0), np.zeros(0))


class PrescribedMotion(NamedTuple):
    """Positions of pins and targets, and wind velocities, at shared times."""

    knots: FloatArray  # times ``(K,)`` [s]
    pin_positions: FloatArray  # ``(K or 1, P, 3)`` [m]
    target_positions: FloatArray  # ``(K or 1, A, 3)`` [m]
    wind: FloatArray  # ``(K or 1, 1, 3)`` [m/s]


@dataclass(frozen=True, slots=True)
class SpringForces:
    """Properties of N particles, springs, air and gravity that give forces."""

    inverse_masses: FloatArray  # ``(N,)`` [1/kg], 0 for pinned particles
    drags: FloatArray  # drag per mass and speed ``(N,)`` [1/s]
    springs: Springs
    triangles: IntArray  # triangles on which air acts ``(T, 3)``
    gravity: FloatArray  # ``(3,)`` [m/s²]
    air_coefficients: tuple[float, float]  # air drag and lift per area and speed²
    # Indices of the pinned particles ``(P,)``.
    pinned: IntArray = field(default_factory=NO_PARTICLES.copy)
    target_springs: TargetSprings = NO_TARGETS

    def network(self, prescribed: PrescribedMotion) -> _kernels.SpringNetwork:
        """Return the kernel network, with springs in the order of this record."""
        springs, targets = self.springs, self.target_springs
        return _kernels.SpringNetwork(
            inverse_masses=self.inverse_masses,
            drags=self.drags,
            ends=np.ascontiguousarray(springs.ends),
            rest=springs.rest,
            stiffness=springs.stiffness,
            damping=springs.damping,
            limit=springs.limit,
            triangles=self.triangles,
            gravity=self.gravity,
            air_drag=self.air_coefficients[0],
            air_lift=self.air_coefficients[1],
            knots=prescribed.knots,
            pinned=self.pinned,
            pinned_path=prescribed.pin_positions,
            anchors=targets.particles,
            anchor_stiffness=targets.stiffness,
            anchor_damping=targets.damping,
            anchor_path=prescribed.target_positions,
            winds=prescribed.wind,
        )

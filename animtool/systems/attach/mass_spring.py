"""Particles and springs of an attachment."""

from __future__ import annotations

import math
from dataclasses import field

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.errors import counted
from animtool.core.record import dataclass
from animtool.maths.faces import edge_counts
from animtool.systems.springs.body import Body, build_body
from animtool.systems.springs.records import Family

# Frequency of springs that are treated as rigid [rad/s].
RIGID_FREQUENCY = 1e6
# Area density of cloth [kg/m²], and smallest particle mass relative to the largest [1].
CLOTH_AREA_DENSITY = 0.3
MIN_MASS_FRACTION = 1e-3


def _no_rows(columns: int) -> IntArray:
    return np.zeros((0, columns), np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class MassSpringNetwork:
    """The particles of an attachment at bind time, and the springs between them."""

    points: FloatArray  # bind positions ``(N, 3)`` [m]
    pinned: IntArray  # points that follow the animation ``(P,)``, ascending
    structural: IntArray  # ends of structural springs, along edges ``(L, 2)``
    # Ends of springs along face diagonals, against shear ``(L, 2)``.
    shear: IntArray = field(default_factory=lambda: _no_rows(2))
    # Ends of springs across edges, against bending ``(L, 2)``.
    bend: IntArray = field(default_factory=lambda: _no_rows(2))
    # Corners of surface triangles ``(T, 3)``.
    triangles: IntArray = field(default_factory=lambda: _no_rows(3))
    # Number of strands with equally many particles, stored one after the other from
    # their pinned roots; 0 for a surface.
    strands: int = 0

    @property
    def count(self) -> int:
        """Number of particles N."""
        return len(self.points)

    @property
    def is_pinned(self) -> BoolArray:
        """Mask of the pinned particles ``(N,)``."""
        return np.isin(np.arange(self.count), self.pinned)

    @property
    def free(self) -> IntArray:
        """Indices of free particles, ascending."""
        return np.flatnonzero(~self.is_pinned)

    @property
    def rests(self) -> FloatArray:
        """Rest lengths of structural springs ``(L,)`` [m]."""
        return self.lengths(self.structural)

    def lengths(self, ends: IntArray) -> FloatArray:
        """Return rest lengths of springs by their ends ``(L, 2)`` [m]."""
        gaps = self.points[ends[:, 1]] - self.points[ends[:, 0]]
        return np.asarray(np.linalg.norm(gaps, axis=-1))

    @property
    def masses(self) -> FloatArray:
        """Particle masses ``(N,)`` [kg]: by area for cloth, else 1 each."""
        corners = self.triangles
        if not len(corners):
            return np.ones(self.count)
        a, b, c = (self.points[corners[:, k]] for k in range(3))
        areas = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
        corner_masses = np.repeat(areas * (CLOTH_AREA_DENSITY / 3), 3)
        masses = np.bincount(corners.ravel(), corner_masses, self.count)
        # Particles with degenerate faces alone get a small mass.
        min_mass = MIN_MASS_FRACTION * float(masses.max(initial=0.0))
        return np.maximum(masses, min_mass if min_mass > 0 else 1.0)

    def body(self, diagonals: float, bends: float) -> Body:
        """Return the spring body, with shear and bend frequencies [Hz]."""
        families = (
            (self.structural, RIGID_FREQUENCY / (2 * math.pi)),
            (self.shear, diagonals),
            (self.bend, bends),
        )
        springs = [
            (ends[~self.is_pinned[ends].all(axis=1)], Family(frequency=frequency))
            for ends, frequency in families
            if frequency
        ]
        points, strands = self.points, self.strands
        return build_body(points, self.masses, springs, self.triangles, strands)


def max_pin_hops(network: MassSpringNetwork) -> int:
    """Return the largest number of springs from a pinned particle to any other.

    Without pinned particles, springs are counted from the first particle.

    >>> line = np.array([[0, 1], [1, 2]])
    >>> max_pin_hops(MassSpringNetwork(np.eye(3), np.array([0]), line))
    2
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import dijkstra

    count, starts = network.count, network.pinned if len(network.pinned) else [0]
    graph = coo_array(
        (np.ones(len(network.structural)), network.structural.T), (count, count)
    )
    hops = dijkstra(
        graph, directed=False, indices=starts, unweighted=True, min_only=True
    )
    return int(hops[np.isfinite(hops)].max(initial=0.0))


def median_edge_length(network: MassSpringNetwork) -> float:
    """Return the median length of structural springs [m]; 0 without any."""
    rests = network.rests
    return float(np.median(rests[rests > 0])) if rests.any() else 0.0


def coincident_link_count(network: MassSpringNetwork, points: FloatArray) -> int:
    """Return the number of springs whose ends coincide at points ``(N, 3)``.

    Springs of rest length 0 do not count, unless all have it.

    >>> line = np.array([[0, 1], [1, 2]])
    >>> network = MassSpringNetwork(np.eye(3), np.array([0]), line)
    >>> coincident_link_count(network, np.array([[0.0, 0, 0], [0, 0, 0], [1, 0, 0]]))
    1
    """
    i, j = network.structural.T
    is_coincident = (points[i] == points[j]).all(axis=1)
    rests = network.rests
    return int((is_coincident & ((rests > 0) | ~rests.any())).sum())


def surface_defects(network: MassSpringNetwork) -> list[str]:
    """Return defects of a surface as text: degenerate triangles, shared edges.

    >>> fan = np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]])
    >>> points, pinned = np.eye(5, 3), np.array([0])
    >>> network = MassSpringNetwork(points, pinned, fan[:, :2], triangles=fan)
    >>> surface_defects(network)
    ['1 edge of more than two triangles']
    """
    corners = network.triangles
    if not len(corners):
        return []
    a, b, c = (network.points[corners[:, k]] for k in range(3))
    degenerate_count = int((~np.cross(b - a, c - a).any(axis=1)).sum())
    face_counts = edge_counts(np.full(len(corners), 3), corners.ravel())[1]
    nonmanifold_count = int((face_counts > 2).sum())
    defects = []
    if degenerate_count:
        defects.append(f"{counted(degenerate_count, 'triangle')} without area")
    if nonmanifold_count:
        edges = counted(nonmanifold_count, "edge")
        defects.append(f"{edges} of more than two triangles")
    return defects

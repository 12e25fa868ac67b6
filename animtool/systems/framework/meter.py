"""Measured depth, intersections and strain of simulated surfaces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, field
from typing import Any

import numpy as np

from animtool import _kernels
from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.errors import Fault, counted, percent_text, warning
from animtool.core.quantities import length_text
from animtool.core.record import dataclass
from animtool.sim.colliders import Colliders, Mesh

# Depth in a skin or a collider that is visible in a picture [m].
VISIBLE_DEPTH = 2e-3
# Depth that rounding explains [m].
MIN_DEPTH = 1e-9
# Surfaces that are deeper at the start begin inside; they are not pressed in [m].
MAX_START_DEPTH = 0.05
# Visible strain of cloth: 99th percentile and maximum [1].
VISIBLE_STRAIN_99, VISIBLE_STRAIN = 0.08, 0.15


@dataclass(frozen=True, slots=True)
class PeakValue:
    """The largest value over all frames, and the frame and position where it occurs."""

    value: float = 0.0  # a length in [m], a fraction or a count
    frame: float | None = None  # time code; None for a system, or if there is no value
    point: int | None = None  # particle index; of an edge, the first
    at: tuple[float, float, float] | None = None  # position of the point [m]
    time: float | None = None  # time of a system [s]

    @property
    def time_text(self) -> str:
        """Frame or time of the peak, as text."""
        return f"{self.time:.3g} s" if self.frame is None else f"frame {self.frame:g}"

    @property
    def text(self) -> str:
        """Frame, point and position of the peak, as text."""
        if self.point is None or self.at is None:
            return "nowhere"
        position = ", ".join(f"{value:.3g}" for value in self.at)
        return f"{self.time_text}, point {self.point} at [{position}]"


@dataclass(frozen=True, slots=True, eq=False)
class ClosedSurface:
    """A closed collision surface at one time."""

    points: FloatArray  # ``(P, 3)`` [m]
    triangles: IntArray  # counter-clockwise from outside ``(T, 3)``
    # Kernel surface of the triangles, if it exists and no two points coincide.
    kernel: Any = None


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredSurface:
    """The particles, triangles and edges of a surface at which contact is measured."""

    free_particles: IntArray  # free particles ``(M,)``
    triangles: IntArray  # ``(T, 3)``
    edges: IntArray  # particles of each edge ``(S, 2)``
    rest_lengths: FloatArray  # rest lengths of the edges, above 0 ``(S,)`` [m]

    @staticmethod
    def of_edges(
        ends: IntArray, rests: FloatArray, is_fixed: BoolArray, triangles: IntArray
    ) -> MeasuredSurface:
        """Return a surface without the edges that are fixed or have no rest length.

        Edges have ends ``(S, 2)`` and rest lengths ``(S,)`` [m]; the mask of fixed
        particles is ``(N,)``.
        """
        is_measured = (rests > 0) & ~is_fixed[ends].all(axis=1)
        return MeasuredSurface(
            np.flatnonzero(~is_fixed), triangles, ends[is_measured], rests[is_measured]
        )

    def lengths(self, points: FloatArray) -> FloatArray:
        """Return the lengths of the edges at points ``(N, 3)`` [m]."""
        i, j = self.edges.T
        return np.asarray(np.linalg.norm(points[j] - points[i], axis=1))


@dataclass(slots=True)
class ContactMeter:
    """Measures the peaks of depth, intersections and strain over frames."""

    uses_seconds: bool = False  # whether frames are times in [s], as for systems
    start: float | None = None  # first measured time of a system [s]
    start_depth: float = 0.0  # largest depth of a system at that time [m]
    # Height by which a system has to be raised to start outside [m]; 0 if unknown.
    start_lift: float = 0.0
    # Largest depth in a skin or a collider [m].
    depth: PeakValue = field(default_factory=PeakValue)
    # Largest number of intersecting edge-triangle pairs, with itself and with skins.
    pierced: PeakValue = field(default_factory=PeakValue)
    strain: PeakValue = field(default_factory=PeakValue)  # largest strain of a side [1]
    # 99th percentile of strain [1].
    strain_99: PeakValue = field(default_factory=PeakValue)

    def measure(
        self,
        frame: float,
        points: FloatArray,
        surface: MeasuredSurface,
        solids: Sequence[ClosedSurface] = (),
        depths: FloatArray | None = None,
        open_surfaces: Sequence[ClosedSurface] = (),
    ) -> None:
        """Measure a frame.

        Args:
            frame: Time code, or time [s].
            points: Particle positions ``(N, 3)`` [m].
            surface: Sides and triangles to measure.
            solids: Closed surfaces that particles must stay outside of.
            depths: Depths in other colliders ``(N,)`` [m], below 0 outside.
            open_surfaces: Other open surfaces, only tested for intersections.
        """
        if self.uses_seconds and self.start is None:
            self.start = frame
        max_depths = np.zeros(len(points)) if depths is None else depths.copy()
        free_particles = surface.free_particles
        for solid in solids:
            depths_in_solid = surface_depths(solid, points[free_particles])
            max_depths[free_particles] = np.maximum(
                max_depths[free_particles], depths_in_solid
            )
        if len(free_particles):
            deepest_particle = int(free_particles[max_depths[free_particles].argmax()])
            depth = float(max_depths[deepest_particle])
            if frame == self.start:
                self.start_depth = depth
            self.depth = self._larger_peak(
                self.depth, depth, frame, points, deepest_particle
            )
        if len(surface.triangles):
            pair_count = count_pierced_pairs(
                points, surface.triangles, [*solids, *open_surfaces]
            )
            first_corner = int(surface.triangles[0, 0])
            self.pierced = self._larger_peak(
                self.pierced, float(pair_count), frame, points, first_corner
            )
        if len(surface.rest_lengths):
            strains = np.abs(surface.lengths(points) / surface.rest_lengths - 1)
            largest_index = int(strains.argmax())
            particle = int(surface.edges[largest_index, 0])
            max_strain, strain_99 = (
                float(strains[largest_index]),
                float(np.quantile(strains, 0.99)),
            )
            self.strain = self._larger_peak(
                self.strain, max_strain, frame, points, particle
            )
            self.strain_99 = self._larger_peak(
                self.strain_99, strain_99, frame, points, particle
            )

    def _larger_peak(
        self,
        peak: PeakValue,
        value: float,
        frame: float,
        points: FloatArray,
        point: int,
    ) -> PeakValue:
        """Return the peak, or a new peak if the frame's value is larger."""
        if not value > peak.value:
            return peak
        x, y, z = points[point].tolist()
        time_code, time = (None, frame) if self.uses_seconds else (frame, None)
        return PeakValue(value, time_code, point, (x, y, z), time)

    @property
    def values(self) -> dict[str, dict[str, object]]:
        """Peak values for a report, by name."""
        names = ("depth", "pierced", "strain", "strain_99")
        return {name: asdict(getattr(self, name)) for name in names}

    @property
    def text(self) -> str:
        """Peaks of depth and strain as text; empty if there was neither."""
        phrases = []
        if self.depth.value > MIN_DEPTH:
            depth_text = length_text(self.depth.value, 2)
            phrases.append(f"{depth_text} inside {self._obstacle} ({self.depth.text})")
        if self.strain.value > 0:
            quantile_text = percent_text(self.strain_99.value)
            phrases.append(f"99th percentile of strain {quantile_text}")
            strain_text = percent_text(self.strain.value)
            phrases.append(f"largest strain {strain_text} ({self.strain.text})")
        return ", ".join(phrases)

    @property
    def _obstacle(self) -> str:
        return "a collider" if self.uses_seconds else "the skin or a collider"

    @property
    def starts_inside(self) -> bool:
        """Whether a system starts too deep in a collider to be pushed out gently."""
        return self.uses_seconds and self.start_depth > MAX_START_DEPTH

    def notices(self, label: str) -> list[Fault]:
        """Return warnings of visible depth, intersections and strain (SIM180-182)."""
        notices, remedy = [], "a shorter step" if self.uses_seconds else "a higher rate"
        if self.depth.value > VISIBLE_DEPTH:
            depth_text = length_text(self.depth.value, 2)
            message = f"{label} is {depth_text} inside {self._obstacle} "
            message += f"({self.depth.text})"
            hint = f"use a larger radius or {remedy}, or a slower motion"
            if self.starts_inside:
                hint = f"it starts {length_text(self.start_depth, 2)} inside: "
                hint += "move it out"
                if self.start_lift:
                    hint += f", up by {length_text(self.start_lift, 2)} or more"
            notices.append(warning("SIM180", message, hint))
        if self.starts_inside:
            return notices  # the others result from it
        if self.pierced.value:
            pairs_text = counted(int(self.pierced.value), "pair")
            message = f"{label} intersects itself or {self._obstacle}: {pairs_text} of "
            message += f"an edge and a triangle ({self.pierced.time_text})"
            hint = "use a larger radius or thickness, or a finer mesh"
            notices.append(warning("SIM181", message, hint))
        is_strained = self.strain.value > VISIBLE_STRAIN
        if is_strained or self.strain_99.value > VISIBLE_STRAIN_99:
            message = f"{label} is strained by up to "
            message += f"{percent_text(self.strain.value)} ({self.strain.text}), 99th "
            message += f"percentile {percent_text(self.strain_99.value)}"
            hint = f"pins or contacts pull it apart; use {remedy}"
            hint += " or a higher stiffness" if self.uses_seconds else ""
            notices.append(warning("SIM182", message, hint))
        return notices


def closed_surfaces(colliders: Colliders, t: float) -> list[ClosedSurface]:
    """Return the closed moving surfaces of colliders at a time [s]."""
    return [
        ClosedSurface(sheet.motion.points(t), sheet.motion.triangles(t))
        for sheet in colliders.sheets
        if sheet.closed
    ]


def collider_depths(colliders: Colliders, points: FloatArray, t: float) -> FloatArray:
    """Return depths of points in rigid colliders ``(N,)`` [m]; below 0 is outside."""
    if not colliders.rigid_colliders:
        return np.full(len(points), -np.inf)
    return np.asarray(-colliders.sample(points, t).distances.min(axis=0))


def surface_depths(surface: ClosedSurface, points: FloatArray) -> FloatArray:
    """Return depths of points ``(N, 3)`` in a closed surface ``(N,)`` [m].

    >>> corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    >>> faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    >>> points = np.array([[0.1, 0.2, 0.2], [2.0, 0.0, 0.0]])
    >>> surface_depths(ClosedSurface(corners, faces), points).round(3).tolist()
    [0.1, 0.0]
    """
    low, high = surface.points.min(axis=0), surface.points.max(axis=0)
    candidate_indices = np.flatnonzero(((points > low) & (points < high)).all(axis=1))
    depths = np.zeros(len(points))
    if len(candidate_indices):
        positions, kernel = surface.points, surface.kernel
        if kernel is None:
            positions, triangles = Mesh(positions, surface.triangles).weld()
            kernel = _kernels.MeshSurface(positions, triangles)
        distances = kernel.distances(positions, points[candidate_indices])
        depths[candidate_indices] = np.maximum(-distances, 0.0)
    return depths


def count_pierced_pairs(
    points: FloatArray, triangles: IntArray, solids: Sequence[ClosedSurface] = ()
) -> int:
    """Return the number of intersecting pairs of an edge and a triangle.

    Pairs within solids are not counted.
    """
    cloth_triangles = np.ascontiguousarray(triangles, np.int64)
    count = _kernels.pierced_edges(np.ascontiguousarray(points), cloth_triangles)
    low, high = points.min(axis=0), points.max(axis=0)
    for solid in solids:
        corners = solid.points[solid.triangles]
        is_near = (corners.max(axis=1) >= low) & (corners.min(axis=1) <= high)
        faces = solid.triangles[is_near.all(axis=1)]
        if not len(faces):
            continue
        all_points = np.concatenate([points, solid.points])
        other_triangles = np.asarray(faces + len(points), np.int64)
        count += _kernels.pierced_edges(all_points, cloth_triangles, other_triangles)
    return count

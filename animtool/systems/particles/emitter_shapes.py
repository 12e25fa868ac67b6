"""Shapes of emitters, in the emitter's frame."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, TypeAlias

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.options import ENTRY_RANGE_MESSAGE, Range, range_faults
from animtool.core.record import dataclass
from animtool.sim.colliders.shapes import Mesh

# Points ``(N, 3)``, and outward normals or None.
PointsAndNormals: TypeAlias = tuple[FloatArray, FloatArray | None]

Radius: TypeAlias = Annotated[
    float, Range("above 0", "SIM021", 0.0, includes_minimum=False, finite=True)
]


class _RangeChecked:
    """Base of shapes that are checked against the declared ranges of their fields."""

    __slots__ = ()

    def faults(self) -> list[str]:
        """Return a message for each invalid value."""
        return [fault.message for fault in range_faults(self, ENTRY_RANGE_MESSAGE)]


@dataclass(frozen=True, slots=True)
class Point(_RangeChecked):
    """Emits from the origin of the emitter's frame."""

    def points(self, uniform_values: FloatArray) -> PointsAndNormals:
        """Return points from random numbers in [0, 1) ``(N, 3)``."""
        return np.zeros((len(uniform_values), 3)), None


@dataclass(frozen=True, slots=True)
class Disc(_RangeChecked):
    """Emits from a disc perpendicular to y.

    Attributes:
        radius: [m].
    """

    radius: Radius

    def points(self, uniform_values: FloatArray) -> PointsAndNormals:
        """Return random points, uniform by area."""
        radius = self.radius * np.sqrt(uniform_values[:, 0])
        angle = 2 * np.pi * uniform_values[:, 1]
        heights = np.zeros(len(uniform_values))
        x, z = radius * np.cos(angle), radius * np.sin(angle)
        return np.stack([x, heights, z], axis=1), None


@dataclass(frozen=True, slots=True)
class SphereShape(_RangeChecked):
    """Emits from a sphere.

    Attributes:
        radius: [m].
        hollow: Whether to emit from the surface only, along its normals.
    """

    radius: Radius
    hollow: bool = False

    def points(self, uniform_values: FloatArray) -> PointsAndNormals:
        """Return random points, uniform by volume or by area."""
        height = 2 * uniform_values[:, 0] - 1
        radius = np.sqrt(np.maximum(1 - height * height, 0))
        angle = 2 * np.pi * uniform_values[:, 1]
        x, z = radius * np.cos(angle), radius * np.sin(angle)
        normals = np.stack([x, height, z], axis=1)
        if self.hollow:
            return normals * self.radius, normals
        return normals * (self.radius * np.cbrt(uniform_values[:, 2:])), None


@dataclass(frozen=True, slots=True)
class BoxShape(_RangeChecked):
    """Emits from a box centred at the origin.

    Attributes:
        size: Full edge lengths [m]; 0 is flat.
    """

    size: Annotated[
        Sequence[float],
        Range("three numbers of 0 or more", "SIM021", 0.0, finite=True, count=3),
    ]

    def points(self, uniform_values: FloatArray) -> PointsAndNormals:
        """Return random points, uniform by volume."""
        return (uniform_values - 0.5) * np.asarray(self.size, np.float64), None


@dataclass(frozen=True, slots=True)
class MeshSurface:
    """Emits from the surface of a mesh, along its normals.

    Attributes:
        mesh: Triangles that particles are emitted from.
    """

    mesh: Mesh

    def points(self, uniform_values: FloatArray) -> PointsAndNormals:
        """Return random points, uniform by area, and outward normals."""
        points, corners = self.mesh.weld()
        a, b, c = points[corners].swapaxes(0, 1)
        normals = np.cross(b - a, c - a)
        areas = np.linalg.norm(normals, axis=1)
        cumulative_areas = np.cumsum(areas)
        samples = uniform_values[:, 0] * cumulative_areas[-1]
        face_indices = np.searchsorted(cumulative_areas, samples, side="right")
        face_indices = np.minimum(face_indices, len(areas) - 1)
        # Folded along the diagonal, the unit square is a triangle.
        u, v = uniform_values[:, 1], uniform_values[:, 2]
        is_outside = u + v > 1
        u = np.where(is_outside, 1 - u, u)[:, None]
        v = np.where(is_outside, 1 - v, v)[:, None]
        points = a[face_indices] + u * (b - a)[face_indices] + v * (c - a)[face_indices]
        return points, normals[face_indices] / areas[face_indices, None]

    def faults(self) -> list[str]:
        """Return a message for each invalid value."""
        return self.mesh.faults()


EmitterShape: TypeAlias = Point | Disc | SphereShape | BoxShape | MeshSurface


# Shapes by name in files; a mesh becomes its surface.
EMITTER_SHAPES: dict[str, type[Any]] = {
    "box": BoxShape,
    "disc": Disc,
    "mesh": Mesh,
    "point": Point,
    "sphere": SphereShape,
}

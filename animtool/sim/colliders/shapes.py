"""Collider shapes, in their local frames."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Annotated, Any, TypeAlias

import numpy as np
import numpy.typing as npt

from animtool.core.array_types import ArrayLike, FloatArray
from animtool.core.options import OF_ENTRY, Range, range_faults
from animtool.core.record import dataclass

Vector: TypeAlias = Sequence[float]
Radius = Annotated[float, Range("above 0", "SIM020", 0.0, reached=False, finite=True)]
ORIGIN = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Plane:
    """A half-space below a plane.

    Attributes:
        normal: Out of it, of any length above 0.
        offset: Of the plane from the origin, along the normal [m].
    """

    normal: Vector = (0.0, 1.0, 0.0)
    offset: float = 0.0

    def sizes(self) -> FloatArray:
        """Return the unit normal and offset ``(4,)``."""
        return np.array([*_unit(self.normal), self.offset], np.float64)

    def anchors(self) -> FloatArray:
        """Return points to measure its speed at ``(1, 3)`` [m]."""
        return _unit(self.normal)[None] * self.offset

    def faults(self) -> list[str]:
        """Return messages about invalid values."""
        faults = [] if np.isfinite(self.offset) else ["its offset is not finite"]
        return faults + _direction_faults("normal", self.normal)


@dataclass(frozen=True, slots=True)
class Sphere:
    """A ball.

    Attributes:
        radius: [m].
        centre: In its frame [m].
    """

    radius: Radius
    centre: Vector = ORIGIN

    def sizes(self) -> FloatArray:
        """Return centre and radius ``(4,)``."""
        return np.array([*self.centre, self.radius], np.float64)

    def anchors(self) -> FloatArray:
        """Return points to measure its speed at ``(1, 3)`` [m]."""
        return np.array([self.centre], np.float64)

    def faults(self) -> list[str]:
        """Return messages about invalid values."""
        return _range_faults(self) + _point_faults(self.centre)


@dataclass(frozen=True, slots=True)
class Capsule:
    """All points within a radius of a segment.

    Attributes:
        radius: [m].
        length: Of the segment [m]; 0 is a ball.
        axis: Direction of the segment, of any length above 0.
        centre: Of the segment, in its frame [m].
    """

    radius: Radius
    length: Annotated[float, Range("0 or more", "SIM020", 0.0, finite=True)]
    axis: Vector = (0.0, 1.0, 0.0)
    centre: Vector = ORIGIN

    def sizes(self) -> FloatArray:
        """Return both ends of the segment and the radius ``(7,)``."""
        return np.append(self.anchors().ravel(), self.radius)

    def anchors(self) -> FloatArray:
        """Return points to measure its speed at ``(2, 3)`` [m]."""
        half = _unit(self.axis) * (self.length / 2)
        centre = np.asarray(self.centre, np.float64)
        return np.stack([centre - half, centre + half])

    def faults(self) -> list[str]:
        """Return messages about invalid values."""
        faults = _range_faults(self) + _point_faults(self.centre)
        return faults + _direction_faults("axis", self.axis)


@dataclass(frozen=True, slots=True)
class Box:
    """A box centred at the origin of its frame.

    Attributes:
        size: Its three sides, whole [m].
    """

    size: Vector

    def sizes(self) -> FloatArray:
        """Return the half extents ``(3,)``."""
        return np.asarray(self.size, np.float64) / 2

    def anchors(self) -> FloatArray:
        """Return points to measure its speed at ``(8, 3)`` [m]."""
        corners = np.array(list(product((-1.0, 1.0), repeat=3)), np.float64)
        return np.asarray(corners * self.sizes(), np.float64)

    def faults(self) -> list[str]:
        """Return messages about invalid values."""
        if len(self.size) != 3:
            return [f"its size must be three numbers, not {len(self.size)}"]
        return _size_faults(self.size)


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """Triangles with two sides, or the surface of a solid.

    Coincident points are merged, and triangles without area dropped.

    Attributes:
        points: ``(P, 3)`` [m].
        triangles: Corners of each ``(T, 3)``; of a skin counter-clockwise as seen from
            outside.
        closed: Whether it is the skin of a volume, which is met from outside only:
            behind a face is inside; an open mesh has no inside beyond its rim.
    """

    points: ArrayLike
    triangles: ArrayLike
    closed: bool = False

    def sizes(self) -> FloatArray:
        """Return an empty array; meshes have arrays of their triangles instead."""
        return np.zeros(0)

    def anchors(self) -> FloatArray:
        """Return points to measure its speed at ``(8, 3)`` [m]."""
        points = np.asarray(self.points, np.float64)
        low, high = points.min(axis=0), points.max(axis=0)
        corners = np.array(list(product((0.0, 1.0), repeat=3)))
        return np.asarray(low + corners * (high - low), np.float64)

    def welded(self) -> tuple[FloatArray, npt.NDArray[np.int32]]:
        """Return merged points and triangles, without degenerate ones."""
        points, same = np.unique(
            np.asarray(self.points, np.float64), axis=0, return_inverse=True
        )
        triangles = same.reshape(-1)[np.asarray(self.triangles, np.int64)]
        kept = triangles[_have_area(points, triangles)]
        return points, np.ascontiguousarray(kept, np.int32)

    @property
    def watertight(self) -> bool:
        """Whether each edge has two triangles of consistent winding."""
        corners = self.welded()[1].astype(np.int64)
        sides = np.concatenate([corners[:, [k, (k + 1) % 3]] for k in range(3)])
        size = np.array([corners.max(initial=0) + 1, 1])
        there, back = np.sort(sides @ size), np.sort(sides[:, ::-1] @ size)
        return bool((there == back).all() and (np.diff(there) > 0).all())

    def faults(self) -> list[str]:
        """Return messages about invalid values."""
        points = np.asarray(self.points, np.float64)
        triangles = np.asarray(self.triangles)
        if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
            return ["its points must be finite, of shape (P, 3)"]
        if triangles.ndim != 2 or triangles.shape[1] != 3:
            return [f"its triangles must have shape (T, 3), not {triangles.shape}"]
        if triangles.size and not 0 <= triangles.min() <= triangles.max() < len(points):
            return [f"corners of its triangles must refer to its {len(points)} points"]
        if not triangles.size or not _have_area(points, triangles).any():
            return ["it has no triangle with an area"]
        return []


def _have_area(points: FloatArray, triangles: ArrayLike) -> npt.NDArray[np.bool_]:
    """Return which triangles ``(T, 3)`` are not degenerate ``(T,)``."""
    a, b, c = points[np.asarray(triangles, np.int64)].swapaxes(0, 1)
    return np.asarray(np.cross(b - a, c - a).any(axis=1), np.bool_)


@dataclass(frozen=True, slots=True)
class HeightField:
    """Heights over a rectangle at the origin, a mesh with one side: the top.

    Attributes:
        size: Both sides of the rectangle, along x and z [m].
    """

    size: Vector

    def mesh(self, heights: ArrayLike) -> Mesh:
        """Return the mesh of heights ``(R, C)`` [m]: rows along z, columns along x."""
        y = np.asarray(heights, np.float64)
        x, z = (
            np.linspace(-side / 2, side / 2, count)
            for side, count in zip(self.size, y.shape[::-1], strict=True)
        )
        points = np.stack(np.broadcast_arrays(x, y, z[:, None]), axis=-1)
        number = np.arange(y.size).reshape(y.shape)
        a, b = number[:-1, :-1].ravel(), number[:-1, 1:].ravel()
        c, d = number[1:, :-1].ravel(), number[1:, 1:].ravel()
        triangles = np.stack([a, c, b, b, c, d], axis=1).reshape(-1, 3)
        return Mesh(points.reshape(-1, 3), triangles, closed=True)

    def faults(self) -> list[str]:
        """Return messages about invalid values."""
        if len(self.size) != 2:
            return [f"its size must be two numbers, not {len(self.size)}"]
        return _size_faults(self.size)

    @staticmethod
    def height_faults(heights: ArrayLike) -> list[str]:
        """Return messages about invalid heights."""
        shape = np.shape(heights)
        if len(shape) == 2 and min(shape) >= 2:
            return []
        return [
            f"its heights must have at least two rows and columns, not shape {shape}"
        ]


Shape: TypeAlias = Plane | Sphere | Capsule | Box | Mesh
# By their names in files; a height field becomes a mesh.
SHAPES: dict[str, type[Any]] = {
    "box": Box,
    "capsule": Capsule,
    "height_field": HeightField,
    "mesh": Mesh,
    "plane": Plane,
    "sphere": Sphere,
}


def bounds(shape: Any) -> FloatArray:
    """Return a shape's lower and upper bounds in its frame ``(2, 3)`` [m].

    Of a shape that ends: no plane.
    """
    sizes = np.asarray(shape.sizes(), np.float64)
    if isinstance(shape, Box):
        return np.stack([-sizes, sizes])
    if isinstance(shape, Sphere):
        return np.stack([sizes[:3] - sizes[3], sizes[:3] + sizes[3]])
    if isinstance(shape, Capsule):
        ends = sizes[:6].reshape(2, 3)
        return np.stack([ends.min(axis=0) - sizes[6], ends.max(axis=0) + sizes[6]])
    points = np.asarray(shape.points, np.float64)
    return np.stack([points.min(axis=0), points.max(axis=0)])


def _unit(direction: Vector) -> FloatArray:
    vector = np.asarray(direction, np.float64)
    return np.asarray(vector / np.linalg.norm(vector), np.float64)


def _range_faults(shape: Any) -> list[str]:
    return [fault.message for fault in range_faults(shape, OF_ENTRY)]


def _size_faults(values: Sequence[float]) -> list[str]:
    invalid = [value for value in values if not 0 < value < np.inf]
    return [f"its size must be above 0, not {value:g}" for value in invalid[:1]]


def _point_faults(point: Vector) -> list[str]:
    fits = len(point) == 3 and np.isfinite(point).all()
    return [] if fits else ["its centre must be three finite numbers"]


def _direction_faults(name: str, direction: Vector) -> list[str]:
    vector = np.asarray(direction, np.float64)
    fits = vector.shape == (3,) and np.isfinite(vector).all() and vector.any()
    return [] if fits else [f"its {name} must be three finite numbers, not all 0"]

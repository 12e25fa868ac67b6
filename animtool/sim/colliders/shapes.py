"""Collider shapes, in their local frames."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Annotated, Any, TypeAlias

import numpy as np
import numpy.typing as npt

from animtool.core.array_types import ArrayLike, FloatArray
from animtool.core.options import ENTRY_RANGE_MESSAGE, Range, range_faults
from animtool.core.record import dataclass

Vector: TypeAlias = Sequence[float]
Radius = Annotated[
    float, Range("above 0", "SIM020", 0.0, includes_minimum=False, finite=True)
]
ORIGIN = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Plane:
    """A half-space below a plane.

    Attributes:
        normal: Normal out of the half-space, of any length above 0.
        offset: Distance of the plane from the origin, along the normal [m].
    """

    normal: Vector = (0.0, 1.0, 0.0)
    offset: float = 0.0

    def sizes(self) -> FloatArray:
        """Return the unit normal and offset ``(4,)``."""
        return np.array([*_normalized(self.normal), self.offset], np.float64)

    def anchors(self) -> FloatArray:
        """Return the local points at which the speed is measured ``(1, 3)`` [m]."""
        return _normalized(self.normal)[None] * self.offset

    def faults(self) -> list[str]:
        """Return a message for each invalid value."""
        faults = [] if np.isfinite(self.offset) else ["its offset is not finite"]
        return faults + _direction_faults("normal", self.normal)


@dataclass(frozen=True, slots=True)
class Sphere:
    """All points within a radius of a centre.

    Attributes:
        radius: Radius [m].
        centre: Centre, local space [m].
    """

    radius: Radius
    centre: Vector = ORIGIN

    def sizes(self) -> FloatArray:
        """Return centre and radius ``(4,)``."""
        return np.array([*self.centre, self.radius], np.float64)

    def anchors(self) -> FloatArray:
        """Return the local points at which the speed is measured ``(1, 3)`` [m]."""
        return np.array([self.centre], np.float64)

    def faults(self) -> list[str]:
        """Return a message for each invalid value."""
        return _range_faults(self) + _point_faults(self.centre)


@dataclass(frozen=True, slots=True)
class Capsule:
    """All points within a radius of a segment.

    Attributes:
        radius: Radius [m].
        length: Length of the segment [m]; 0 is a sphere.
        axis: Direction of the segment, of any length above 0.
        centre: Centre of the segment, local space [m].
    """

    radius: Radius
    length: Annotated[float, Range("0 or more", "SIM020", 0.0, finite=True)]
    axis: Vector = (0.0, 1.0, 0.0)
    centre: Vector = ORIGIN

    def sizes(self) -> FloatArray:
        """Return both ends of the segment and the radius ``(7,)``."""
        return np.append(self.anchors().ravel(), self.radius)

    def anchors(self) -> FloatArray:
        """Return the local points at which the speed is measured ``(2, 3)`` [m]."""
        half_axis = _normalized(self.axis) * (self.length / 2)
        centre = np.asarray(self.centre, np.float64)
        return np.stack([centre - half_axis, centre + half_axis])

    def faults(self) -> list[str]:
        """Return a message for each invalid value."""
        faults = _range_faults(self) + _point_faults(self.centre)
        return faults + _direction_faults("axis", self.axis)


@dataclass(frozen=True, slots=True)
class Box:
    """A box centred at the origin of its frame.

    Attributes:
        size: Full edge lengths along x, y and z [m].
    """

    size: Vector

    def sizes(self) -> FloatArray:
        """Return the half extents ``(3,)``."""
        return np.asarray(self.size, np.float64) / 2

    def anchors(self) -> FloatArray:
        """Return the local points at which the speed is measured ``(8, 3)`` [m]."""
        corners = np.array(list(product((-1.0, 1.0), repeat=3)), np.float64)
        return np.asarray(corners * self.sizes(), np.float64)

    def faults(self) -> list[str]:
        """Return a message for each invalid value."""
        if len(self.size) != 3:
            return [f"its size must be three numbers, not {len(self.size)}"]
        return _size_faults(self.size)


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """Two-sided triangles, or the surface of a solid.

    Coincident points are merged, and triangles without area removed.

    Attributes:
        points: ``(P, 3)`` [m].
        triangles: Corners of each ``(T, 3)``; of a solid, counter-clockwise as seen
            from outside.
        closed: Whether it is the surface of a solid: collisions are from outside only,
            and behind a face is inside. An open mesh has no inside beyond its rim.
    """

    points: ArrayLike
    triangles: ArrayLike
    closed: bool = False

    def sizes(self) -> FloatArray:
        """Return an empty array: kernels use the triangles instead."""
        return np.zeros(0)

    def anchors(self) -> FloatArray:
        """Return the local points at which the speed is measured ``(8, 3)`` [m]."""
        points = np.asarray(self.points, np.float64)
        low, high = points.min(axis=0), points.max(axis=0)
        corners = np.array(list(product((0.0, 1.0), repeat=3)))
        return np.asarray(low + corners * (high - low), np.float64)

    def weld(self) -> tuple[FloatArray, npt.NDArray[np.int32]]:
        """Return merged points, and triangles without degenerate ones."""
        points = np.asarray(self.points, np.float64)
        points, inverse = np.unique(points, axis=0, return_inverse=True)
        triangles = inverse.reshape(-1)[np.asarray(self.triangles, np.int64)]
        faces = triangles[_has_area(points, triangles)]
        return points, np.ascontiguousarray(faces, np.int32)

    @property
    def is_watertight(self) -> bool:
        """Whether every edge has two triangles of consistent winding."""
        triangles = self.weld()[1].astype(np.int64)
        edges = np.concatenate([triangles[:, [k, (k + 1) % 3]] for k in range(3)])
        strides = np.array([triangles.max(initial=0) + 1, 1])
        forward, backward = np.sort(edges @ strides), np.sort(edges[:, ::-1] @ strides)
        return bool((forward == backward).all() and (np.diff(forward) > 0).all())

    def faults(self) -> list[str]:
        """Return a message for each invalid value."""
        points = np.asarray(self.points, np.float64)
        triangles = np.asarray(self.triangles)
        if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
            return ["its points must be finite, of shape (P, 3)"]
        if triangles.ndim != 2 or triangles.shape[1] != 3:
            return [f"its triangles must have shape (T, 3), not {triangles.shape}"]
        if triangles.size and not 0 <= triangles.min() <= triangles.max() < len(points):
            return [f"corners of its triangles must refer to its {len(points)} points"]
        if not triangles.size or not _has_area(points, triangles).any():
            return ["it has no triangle with an area"]
        return []


def _has_area(points: FloatArray, triangles: ArrayLike) -> npt.NDArray[np.bool_]:
    """Return a mask of the triangles ``(T, 3)`` with nonzero area ``(T,)``."""
    a, b, c = points[np.asarray(triangles, np.int64)].swapaxes(0, 1)
    return np.asarray(np.cross(b - a, c - a).any(axis=1), np.bool_)


@dataclass(frozen=True, slots=True)
class HeightField:
    """Heights over a rectangle at the origin; a one-sided mesh that faces up.

    Attributes:
        size: Edge lengths of the rectangle along x and z [m].
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
        indices = np.arange(y.size).reshape(y.shape)
        a, b = indices[:-1, :-1].ravel(), indices[:-1, 1:].ravel()
        c, d = indices[1:, :-1].ravel(), indices[1:, 1:].ravel()
        triangles = np.stack([a, c, b, b, c, d], axis=1).reshape(-1, 3)
        return Mesh(points.reshape(-1, 3), triangles, closed=True)

    def faults(self) -> list[str]:
        """Return a message for each invalid value."""
        if len(self.size) != 2:
            return [f"its size must be two numbers, not {len(self.size)}"]
        return _size_faults(self.size)

    @staticmethod
    def height_faults(heights: ArrayLike) -> list[str]:
        """Return a message if heights have fewer than two rows or columns."""
        shape = np.shape(heights)
        if len(shape) == 2 and min(shape) >= 2:
            return []
        message = "its heights must have at least two rows and columns, not shape"
        return [f"{message} {shape}"]


Shape: TypeAlias = Plane | Sphere | Capsule | Box | Mesh
# Shapes by name in files; a height field becomes a mesh.
SHAPES: dict[str, type[Any]] = {
    "box": Box,
    "capsule": Capsule,
    "height_field": HeightField,
    "mesh": Mesh,
    "plane": Plane,
    "sphere": Sphere,
}


def shape_bounds(shape: Any) -> FloatArray:
    """Return a shape's lower and upper bounds, local space ``(2, 3)`` [m].

    The shape must be finite: not a plane.
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


def _normalized(direction: Vector) -> FloatArray:
    """Return a direction as a unit vector ``(3,)``."""
    vector = np.asarray(direction, np.float64)
    return np.asarray(vector / np.linalg.norm(vector), np.float64)


def _range_faults(shape: Any) -> list[str]:
    """Return a message for each number of a shape outside its declared range."""
    return [fault.message for fault in range_faults(shape, ENTRY_RANGE_MESSAGE)]


def _size_faults(sizes: Sequence[float]) -> list[str]:
    """Return a message about the first size that is not above 0."""
    invalid_values = [value for value in sizes if not 0 < value < np.inf]
    return [f"its size must be above 0, not {value:g}" for value in invalid_values[:1]]


def _point_faults(point: Vector) -> list[str]:
    """Return a message if a centre is not three finite numbers."""
    is_valid = len(point) == 3 and np.isfinite(point).all()
    return [] if is_valid else ["its centre must be three finite numbers"]


def _direction_faults(name: str, direction: Vector) -> list[str]:
    """Return a message if a direction is not a finite, nonzero vector."""
    vector = np.asarray(direction, np.float64)
    is_valid = vector.shape == (3,) and np.isfinite(vector).all() and vector.any()
    return [] if is_valid else [f"its {name} must be three finite numbers, not all 0"]

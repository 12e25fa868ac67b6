"""Terrain of a crowd: a plane, or the topmost faces of a mesh."""

from __future__ import annotations

from dataclasses import field
from functools import cached_property

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.maths import so3

# Largest number of grid cells along an axis.
MAX_CELLS = 2048
# Points outside a triangle by less lie on its edge [1].
EDGE = 1e-9


def about_up(angles: FloatArray) -> FloatArray:
    """Return rotations about y ``(…, 4)`` by angles [rad]."""
    rotations = np.zeros((*angles.shape, 4))
    rotations[..., 1], rotations[..., 3] = np.sin(angles / 2), np.cos(angles / 2)
    return rotations


def turned(vectors: FloatArray, angle: FloatArray | float) -> FloatArray:
    """Return x and z ``(…, 2)`` rotated about y by an angle [rad]."""
    cosine, sine = np.cos(angle), np.sin(angle)
    x, z = vectors[..., 0], vectors[..., 1]
    return np.stack([cosine * x + sine * z, cosine * z - sine * x], axis=-1)


def wrapped(angles: FloatArray) -> FloatArray:
    """Return angles wrapped to [-π, π] [rad]."""
    return np.asarray((angles + np.pi) % (2 * np.pi) - np.pi)


@dataclass(frozen=True)
class Frame:
    """The frame of the ground: agents use its x and z; y is up.

    Attributes:
        origin: In the world ``(3,)`` [m].
        rotation: To the world: a unit quaternion x, y, z, w ``(4,)``.
    """

    origin: FloatArray
    rotation: FloatArray

    def to_local(self, points: FloatArray) -> FloatArray:
        """Transform world points ``(…, 3)`` to the ground's frame."""
        return self.turned_back(points - self.origin)

    def to_world(self, points: FloatArray) -> FloatArray:
        """Transform ground points ``(…, 3)`` to the world."""
        return self.turned(points) + self.origin

    def turned(self, vectors: FloatArray) -> FloatArray:
        """Rotate ground vectors ``(…, 3)`` to the world."""
        return so3.rotate(self.rotation, vectors)

    def turned_back(self, vectors: FloatArray) -> FloatArray:
        """Rotate world vectors ``(…, 3)`` to the ground's frame."""
        return so3.rotate(so3.conjugate(self.rotation), vectors)


@dataclass(frozen=True)
class Terrain:
    """Triangles seen from above, or none for a plane at height 0.

    Attributes:
        triangles: Corners of each, in the frame of the ground ``(T, 3, 3)`` [m].
    """

    triangles: FloatArray = field(default_factory=lambda: np.zeros((0, 3, 3)))

    @property
    def flat(self) -> bool:
        """Whether it is a plane."""
        return not len(self.triangles)

    def __call__(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return heights ``(K,)`` [m] and normals ``(K, 3)`` at x and z ``(K, 2)``.

        Where there is no ground heights are NaN, and normals point up.
        """
        count = len(points)
        normals = np.tile([0.0, 1.0, 0.0], (count, 1))
        if self.flat:
            return np.zeros(count), normals
        heights = np.full(count, -np.inf)
        rows, which = self._candidates(points)
        (a, to_b, to_c), over, normal_table = self._planes
        off = points[rows] - a[which][:, [0, 2]]
        b, c = to_b[which], to_c[which]
        weight_b = (off[:, 0] * c[:, 2] - off[:, 1] * c[:, 0]) * over[which]
        weight_c = (b[:, 0] * off[:, 1] - b[:, 2] * off[:, 0]) * over[which]
        least = np.minimum(np.minimum(weight_b, weight_c), 1 - weight_b - weight_c)
        inside = least >= -EDGE
        rows, which = rows[inside], which[inside]
        at = (
            a[which, 1]
            + weight_b[inside] * b[inside, 1]
            + weight_c[inside] * c[inside, 1]
        )
        np.maximum.at(heights, rows, at)
        highest = at == heights[rows]
        # Of two faces with a common edge, the last one.
        normals[rows[highest]] = normal_table[which[highest]]
        return np.where(np.isfinite(heights), heights, np.nan), normals

    @cached_property
    def bounds(self) -> FloatArray:
        """Return lower and upper x and z ``(2, 2)`` [m]."""
        flat = self.triangles[..., [0, 2]].reshape(-1, 2)
        return np.stack([flat.min(axis=0), flat.max(axis=0)])

    @cached_property
    def _planes(self) -> tuple[tuple[FloatArray, ...], FloatArray, FloatArray]:
        """Return first corners, both edges from them, 1 / area, and normals."""
        a, b, c = self._upward.swapaxes(0, 1)
        to_b, to_c = b - a, c - a
        area = to_b[:, 0] * to_c[:, 2] - to_b[:, 2] * to_c[:, 0]
        face_normals = np.cross(to_c, to_b)
        face_normals = face_normals / np.linalg.norm(face_normals, axis=1)[:, None]
        return (a, to_b, to_c), 1 / area, face_normals * np.sign(face_normals[:, 1:2])

    @cached_property
    def _upward(self) -> FloatArray:
        """Return triangles that are not vertical ``(S, 3, 3)``."""
        a, b, c = self.triangles[..., [0, 2]].swapaxes(0, 1)
        to_b, to_c = b - a, c - a
        area = np.abs(to_b[:, 0] * to_c[:, 1] - to_b[:, 1] * to_c[:, 0])
        size = np.abs(to_b).sum(axis=1) * np.abs(to_c).sum(axis=1)
        return np.asarray(self.triangles[area > EDGE * size])

    @cached_property
    def _grid(self) -> tuple[FloatArray, FloatArray, IntArray, IntArray, IntArray]:
        """Return the low corner, cell sizes and counts, and triangles by cell."""
        flat = self._upward[..., [0, 2]]
        low, high = flat.min(axis=(0, 1)), flat.max(axis=(0, 1))
        side = max(1, min(MAX_CELLS, int(np.sqrt(len(flat)))))
        counts = np.array([side, side])
        size = np.maximum((high - low) / counts, np.finfo(float).tiny)
        first = np.clip(
            ((flat.min(axis=1) - low) / size - EDGE).astype(np.int64), 0, side - 1
        )
        last = np.clip(
            ((flat.max(axis=1) - low) / size + EDGE).astype(np.int64), 0, side - 1
        )
        spans = last - first + 1
        number = spans.prod(axis=1)
        which = np.repeat(np.arange(len(flat)), number)
        k = np.arange(len(which)) - np.repeat(np.cumsum(number) - number, number)
        wide = spans[which, 1]
        cells = (first[which, 0] + k // wide) * side + first[which, 1] + k % wide
        order = np.argsort(cells, kind="stable")
        starts = np.searchsorted(cells[order], np.arange(side * side + 1))
        return low, size, counts, which[order], starts

    def _candidates(self, points: FloatArray) -> tuple[IntArray, IntArray]:
        """Return pairs of points and triangles that may lie above each other."""
        low, size, counts, which, starts = self._grid
        at = (points - low) / size
        within = np.all((at >= -EDGE) & (at <= counts + EDGE), axis=1)
        cells = np.clip(
            np.where(within.reshape(-1, 1), at, 0).astype(np.int64), 0, counts - 1
        )
        number = cells[:, 0] * counts[1] + cells[:, 1]
        many = np.where(within, starts[number + 1] - starts[number], 0)
        rows = np.repeat(np.arange(len(points)), many)
        k = np.arange(len(rows)) - np.repeat(np.cumsum(many) - many, many)
        return rows, which[starts[number[rows]] + k]


def walkable(
    ground: Terrain,
    nodes: FloatArray,
    shape: tuple[int, int],
    cell: float,
    slope: float,
) -> tuple[FloatArray, BoolArray]:
    """Return heights at grid nodes, and which are walkable ``(R, C)``.

    Not where there is no ground, or it rises more than a slope [rad] to a neighbour.
    """
    heights, _ = ground(nodes)
    heights = heights.reshape(shape)
    free = np.array(np.isfinite(heights))
    most = np.tan(slope) * cell
    for walkable_rows, rows in ((free, heights), (free.T, heights.T)):
        steep = np.abs(np.diff(rows, axis=0)) > most
        walkable_rows[:-1] &= ~steep
        walkable_rows[1:] &= ~steep
    return heights, free

"""Terrain of a crowd: a plane, or the topmost faces of a mesh."""

from __future__ import annotations

from dataclasses import field
from functools import cached_property
from typing import Protocol

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.maths import so3

# Largest number of grid cells along an axis.
MAX_CELLS = 2048
# Points count as inside a triangle up to this barycentric distance outside [1].
EDGE_TOLERANCE = 1e-9


def rotations_about_y(angles: FloatArray) -> FloatArray:
    """Return rotations about y ``(…, 4)`` by angles [rad]."""
    rotations = np.zeros((*angles.shape, 4))
    rotations[..., 1], rotations[..., 3] = np.sin(angles / 2), np.cos(angles / 2)
    return rotations


def rotate_about_y(vectors: FloatArray, angle: FloatArray | float) -> FloatArray:
    """Return (x, z) vectors ``(…, 2)`` rotated about y by an angle [rad]."""
    cosine, sine = np.cos(angle), np.sin(angle)
    x, z = vectors[..., 0], vectors[..., 1]
    return np.stack([cosine * x + sine * z, cosine * z - sine * x], axis=-1)


def sample_ground(
    ground: GroundSampler, points: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return heights and normals of the ground; beyond its edge, heights are 0."""
    heights, normals = ground(points)
    return np.where(np.isfinite(heights), heights, 0.0), normals


def wrap_angles(angles: FloatArray) -> FloatArray:
    """Return angles wrapped to [-π, π] [rad]."""
    return np.asarray((angles + np.pi) % (2 * np.pi) - np.pi)


class GroundSampler(Protocol):
    """Interface of the ground as a height field."""

    def __call__(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return heights ``(K,)`` [m] and normals ``(K, 3)`` at (x, z) points."""


@dataclass(frozen=True)
class GroundFrame:
    """The frame of the ground; y is up, and agents move along x and z."""

    origin: FloatArray  # origin in world space (3,) [m]
    rotation: FloatArray  # rotation to world space, unit quaternion x, y, z, w (4,)

    def to_local(self, points: FloatArray) -> FloatArray:
        """Transform world points ``(…, 3)`` to the ground's frame."""
        return self.vector_to_local(points - self.origin)

    def to_world(self, points: FloatArray) -> FloatArray:
        """Transform ground points ``(…, 3)`` to the world."""
        return self.vector_to_world(points) + self.origin

    def vector_to_world(self, vectors: FloatArray) -> FloatArray:
        """Rotate ground vectors ``(…, 3)`` to the world."""
        return so3.rotate(self.rotation, vectors)

    def vector_to_local(self, vectors: FloatArray) -> FloatArray:
        """Rotate world vectors ``(…, 3)`` to the ground's frame."""
        return so3.rotate(so3.conjugate(self.rotation), vectors)


@dataclass(frozen=True)
class Terrain:
    """Height field of triangles seen from above; the plane y = 0 if there are none."""

    # Corners of triangles, in the frame of the ground (T, 3, 3) [m].
    triangles: FloatArray = field(default_factory=lambda: np.zeros((0, 3, 3)))

    @property
    def is_plane(self) -> bool:
        """Whether the terrain is a plane at height 0."""
        return not len(self.triangles)

    def __call__(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return heights ``(K,)`` [m] and normals ``(K, 3)`` at (x, z) points.

        Without ground, heights are NaN and normals point up.
        """
        count = len(points)
        normals = np.tile([0.0, 1.0, 0.0], (count, 1))
        if self.is_plane:
            return np.zeros(count), normals
        heights = np.full(count, -np.inf)
        point_indices, faces = self._candidate_pairs(points)
        (a, edges_b, edges_c), inverse_doubled_areas, normal_table = self._planes
        offsets = points[point_indices] - a[faces][:, [0, 2]]
        b, c = edges_b[faces], edges_c[faces]
        x, z = offsets.T
        weight_b = (x * c[:, 2] - z * c[:, 0]) * inverse_doubled_areas[faces]
        weight_c = (b[:, 0] * z - b[:, 2] * x) * inverse_doubled_areas[faces]
        weights = np.stack([weight_b, weight_c, 1 - weight_b - weight_c])
        is_inside = weights.min(axis=0) >= -EDGE_TOLERANCE
        point_indices, faces = point_indices[is_inside], faces[is_inside]
        face_heights = (
            a[faces, 1]
            + weight_b[is_inside] * b[is_inside, 1]
            + weight_c[is_inside] * c[is_inside, 1]
        )
        np.maximum.at(heights, point_indices, face_heights)
        is_highest = face_heights == heights[point_indices]
        # On a common edge of two faces, the last face is used.
        normals[point_indices[is_highest]] = normal_table[faces[is_highest]]
        return np.where(np.isfinite(heights), heights, np.nan), normals

    @cached_property
    def bounds(self) -> FloatArray:
        """Lower and upper (x, z) bounds ``(2, 2)`` [m]."""
        positions = self.triangles[..., [0, 2]].reshape(-1, 2)
        return np.stack([positions.min(axis=0), positions.max(axis=0)])

    @cached_property
    def _planes(self) -> tuple[tuple[FloatArray, ...], FloatArray, FloatArray]:
        """First corner, edges from it, 1 / (2 area), and normal of each triangle."""
        a, b, c = self._nonvertical_triangles.swapaxes(0, 1)
        to_b, to_c = b - a, c - a
        doubled_area = to_b[:, 0] * to_c[:, 2] - to_b[:, 2] * to_c[:, 0]
        face_normals = np.cross(to_c, to_b)
        face_normals = face_normals / np.linalg.norm(face_normals, axis=1)[:, None]
        return (
            (a, to_b, to_c),
            1 / doubled_area,
            face_normals * np.sign(face_normals[:, 1:2]),
        )

    @cached_property
    def _nonvertical_triangles(self) -> FloatArray:
        """Triangles that are not vertical ``(S, 3, 3)``."""
        a, b, c = self.triangles[..., [0, 2]].swapaxes(0, 1)
        to_b, to_c = b - a, c - a
        doubled_area = np.abs(to_b[:, 0] * to_c[:, 1] - to_b[:, 1] * to_c[:, 0])
        area_scale = np.abs(to_b).sum(axis=1) * np.abs(to_c).sum(axis=1)
        return np.asarray(self.triangles[doubled_area > EDGE_TOLERANCE * area_scale])

    @cached_property
    def _grid(self) -> tuple[FloatArray, FloatArray, IntArray, IntArray, IntArray]:
        """Low corner of the grid, cell size, cell counts, and triangles by cell."""
        triangles_xz = self._nonvertical_triangles[..., [0, 2]]
        low, high = triangles_xz.min(axis=(0, 1)), triangles_xz.max(axis=(0, 1))
        cells_per_axis = max(1, min(MAX_CELLS, int(np.sqrt(len(triangles_xz)))))
        counts = np.array([cells_per_axis, cells_per_axis])
        cell_size = np.maximum((high - low) / counts, np.finfo(float).tiny)
        first_cells, last_cells = (
            np.clip(coordinates.astype(np.int64), 0, cells_per_axis - 1)
            for coordinates in (
                (triangles_xz.min(axis=1) - low) / cell_size - EDGE_TOLERANCE,
                (triangles_xz.max(axis=1) - low) / cell_size + EDGE_TOLERANCE,
            )
        )
        cell_spans = last_cells - first_cells + 1
        cell_counts = cell_spans.prod(axis=1)
        faces = np.repeat(np.arange(len(triangles_xz)), cell_counts)
        k = np.arange(len(faces)) - _group_starts(cell_counts)
        width = cell_spans[faces, 1]
        cells = (
            (first_cells[faces, 0] + k // width) * cells_per_axis
            + first_cells[faces, 1]
            + k % width
        )
        order = np.argsort(cells, kind="stable")
        cell_indices = np.arange(cells_per_axis * cells_per_axis + 1)
        start_indices = np.searchsorted(cells[order], cell_indices)
        return low, cell_size, counts, faces[order], start_indices

    def _candidate_pairs(self, points: FloatArray) -> tuple[IntArray, IntArray]:
        """Return pairs of points and triangles that may overlap seen from above."""
        low, cell_size, counts, faces, start_indices = self._grid
        grid_points = (points - low) / cell_size
        is_inside = np.all(grid_points >= -EDGE_TOLERANCE, axis=1)
        is_inside &= np.all(grid_points <= counts + EDGE_TOLERANCE, axis=1)
        cells = np.where(is_inside[:, None], grid_points, 0).astype(np.int64)
        cells = np.clip(cells, 0, counts - 1)
        cell_indices = cells[:, 0] * counts[1] + cells[:, 1]
        face_counts = start_indices[cell_indices + 1] - start_indices[cell_indices]
        pair_counts = np.where(is_inside, face_counts, 0)
        point_indices = np.repeat(np.arange(len(points)), pair_counts)
        k = np.arange(len(point_indices)) - _group_starts(pair_counts)
        return point_indices, faces[start_indices[cell_indices[point_indices]] + k]


def _group_starts(counts: IntArray) -> IntArray:
    """Return the first index of each entry's group, given the sizes of the groups."""
    return np.repeat(np.cumsum(counts) - counts, counts)


def find_walkable_nodes(
    ground: Terrain,
    nodes: FloatArray,
    shape: tuple[int, int],
    cell_size: float,
    max_slope: float,
) -> tuple[FloatArray, BoolArray]:
    """Return the heights of grid nodes, and a mask of walkable nodes ``(R, C)``.

    Nodes without ground are not walkable, nor those with a slope to a neighbour above
    ``max_slope`` [rad].
    """
    heights, _ = ground(nodes)
    heights = heights.reshape(shape)
    is_walkable = np.array(np.isfinite(heights))
    max_rise = np.tan(max_slope) * cell_size
    for walkable_rows, rows in ((is_walkable, heights), (is_walkable.T, heights.T)):
        is_steep = np.abs(np.diff(rows, axis=0)) > max_rise
        walkable_rows[:-1] &= ~is_steep
        walkable_rows[1:] &= ~is_steep
    return heights, is_walkable

"""Deforming surfaces, contact of particles with them, and their arrays for kernels."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Any, ClassVar, Protocol

import numpy as np

from animtool import _kernels
from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.errors import Fault, warning
from animtool.core.options import CheckedRecord, above, inherits_docs
from animtool.core.record import dataclass
from animtool.sim.colliders.collider import Collider
from animtool.sim.colliders.shapes import Mesh, Radius
from animtool.sim.contact import SPEED_LIMIT, Material

# Shortest interval between samples of points [s]; they are interpolated in between.
KNOT_INTERVAL = 1 / 240
# Rounding tolerance of the number of steps between samples [1].
RELATIVE_ROUNDING = 1e-9


class SheetMotion(Protocol):
    """Interface of a surface over time, which particles do not push."""

    def points(self, t: float) -> FloatArray:
        """Return the points of the surface ``(N, 3)`` [m] at a time [s].

        Times before the last call of `forget` are not available.
        """

    def triangles(self, t: float) -> IntArray:
        """Return the point indices of the triangles ``(T, 3)`` at a time [s]."""

    def forget(self, t: float) -> None:
        """Release buffered states before a time [s]."""


@inherits_docs
@dataclass(frozen=True, slots=True, eq=False)
class Sheet(Material, CheckedRecord):
    """A deforming surface and its contact material.

    Unless closed, particles collide with both sides of it.

    Attributes:
        motion: Points over time.
        radius: Half the thickness of the sheet, above 0 [m].
        closed: Whether it is the surface of a solid: collisions are from outside only.
        name: Name for messages.
        depenetration: Speed at which particles that start inside are moved out [m/s].
    """

    code: ClassVar[str] = "SIM020"

    motion: SheetMotion
    radius: Radius
    closed: bool = False
    name: str = ""
    depenetration: Annotated[float, above(0, "SIM020")] = 1.0

    def problems(self) -> list[tuple[str, str]]:
        """Return the names of invalid options, each with a message."""
        faults = CheckedRecord.problems(self)
        return [fault for fault in faults if fault[0] == "radius"] or faults

    def collider(self, points: FloatArray, triangles: IntArray) -> Collider:
        """Return a static collider of points ``(N, 3)`` and triangles ``(T, 3)``."""
        shape = Mesh(points, triangles, closed=True)
        if not self.closed:
            shape = hull(points, triangles, self.radius)
        return Collider(
            shape,
            name=self.name,
            restitution=self.restitution,
            friction=self.friction,
            margin=self.radius if self.closed else 0.0,
            depenetration=self.depenetration,
        )


def hull(points: FloatArray, triangles: IntArray, radius: float) -> Mesh:
    """Return a closed mesh around a surface: both sides and the rim.

    Points are ``(N, 3)`` [m], triangles ``(T, 3)``; the radius is half the thickness
    [m].

    >>> flat = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    >>> mesh = hull(flat, np.array([[0, 1, 2]]), 0.1)
    >>> len(mesh.points), len(mesh.triangles)
    (6, 8)
    """
    faces = hull_faces(triangles, len(points))
    return Mesh(hull_points(points, triangles, radius), faces, closed=True)


def hull_points(points: FloatArray, triangles: IntArray, radius: float) -> FloatArray:
    """Return the points of a hull: the front, then the back ``(2 N, 3)`` [m]."""
    a, b, c = points[triangles].swapaxes(0, 1)
    area_vectors = np.cross(b - a, c - a)
    corners, corner_vectors = triangles.T.ravel(), np.tile(area_vectors, (3, 1)).T
    vector_sums = [
        np.bincount(corners, component, len(points)) for component in corner_vectors
    ]
    offsets: FloatArray = np.stack(vector_sums, axis=1)
    lengths = np.linalg.norm(offsets, axis=1, keepdims=True)
    offsets = offsets / np.where(lengths > 0, lengths, 1.0) * radius
    return np.concatenate([points + offsets, points - offsets])


def hull_faces(triangles: IntArray, point_count: int) -> IntArray:
    """Return the triangles of a hull around a surface of N points ``(M, 3)``."""
    edges = np.concatenate([triangles[:, [k, (k + 1) % 3]] for k in range(3)])
    strides = [point_count, 1]
    is_rim = ~np.isin(edges @ strides, edges[:, ::-1] @ strides)
    edge_starts, edge_ends = edges[is_rim].T
    rim_faces = [
        np.stack([edge_ends, edge_starts, edge_starts + point_count], axis=1),
        np.stack(
            [edge_ends, edge_starts + point_count, edge_ends + point_count], axis=1
        ),
    ]
    back_faces = triangles[:, ::-1] + point_count
    return np.concatenate([triangles, back_faces, *rim_faces])


@dataclass(frozen=True, slots=True, eq=False)
class NearbyStates:
    """Particles near a sheet, in the frame in which the sheet is at rest."""

    collider: Collider  # the sheet in its final shape
    indices: IntArray  # indices of the particles (K,)
    start: FloatArray  # positions and velocities at the start of a step (2, K, 3)
    end: FloatArray  # the same at the end of the step, without contacts (2, K, 3)
    velocity: FloatArray  # velocity of the frame of each particle (K, 3) [m/s]


def nearby_states(
    sheet: Sheet,
    start_states: FloatArray,
    end_states: FloatArray,
    interval: tuple[float, float],
    radii: FloatArray,
    spawn_times: FloatArray,
) -> NearbyStates | None:
    """Return the states of nearby particles relative to a sheet; None if none is near.

    Each particle is in the moving frame of the nearest point of the sheet, whose path
    in the step is straight: in this frame the sheet is at rest in its final shape.

    Limits of the method: if a sheet rotates by a large angle in one step, positions of
    particles have an error of this angle times their distance from the nearest point.

    ``start_states`` and ``end_states`` are positions and velocities of particles at
    both ends of the step, without contacts ``(2, N, 3)``. Radii are ``(N,)`` [m], spawn
    times are from the start of the step ``(N,)`` [s].
    """
    t0, t1 = interval
    sheet.motion.forget(t0)
    start_points, end_points = sheet.motion.points(t0), sheet.motion.points(t1)
    triangles = sheet.motion.triangles(t1)
    is_near = _is_near_sheet(
        start_points, end_points, start_states[0], end_states[0], radii + sheet.radius
    )
    indices = np.flatnonzero(is_near)
    if not len(indices) or not len(triangles):
        return None
    sheet_displacements = end_points - start_points
    displacement = _displacement(
        start_states[0, indices], start_points, sheet_displacements, triangles
    )
    velocity = displacement / (t1 - t0)
    start_state, end_state = (
        start_states[:, indices].copy(),
        end_states[:, indices].copy(),
    )
    start_state[0] += velocity * (t1 - t0 - spawn_times[indices])[:, None]
    start_state[1] -= velocity
    end_state[1] -= velocity
    collider = sheet.collider(end_points, triangles)
    return NearbyStates(collider, indices, start_state, end_state, velocity)


def _is_near_sheet(
    start_points: FloatArray,
    end_points: FloatArray,
    path_starts: FloatArray,
    path_ends: FloatArray,
    radii: FloatArray,
) -> BoolArray:
    """Return a mask of paths that enter the bounding box of a sheet ``(N,)``."""
    low = np.minimum(start_points.min(axis=0), end_points.min(axis=0))
    high = np.maximum(start_points.max(axis=0), end_points.max(axis=0))
    # A path is a parabola: it leaves the box of its end points by at most its length.
    path_lengths = np.linalg.norm(path_ends - path_starts, axis=1, keepdims=True)
    margin = radii[:, None] + path_lengths
    above_low = np.maximum(path_starts, path_ends) + margin >= low
    below_high = np.minimum(path_starts, path_ends) - margin <= high
    return np.asarray((above_low & below_high).all(axis=1))


def _displacement(
    points: FloatArray,
    sheet_points: FloatArray,
    sheet_displacements: FloatArray,
    triangles: IntArray,
) -> FloatArray:
    """Return how far the surface moves where it is nearest to points ``(N, 3)``."""
    from scipy.spatial import cKDTree

    used_points = np.unique(triangles)
    nearest_indices = used_points[cKDTree(sheet_points[used_points]).query(points)[1]]
    triangle_indices = _triangles_by_point(triangles, len(sheet_points))[
        nearest_indices
    ]
    corners = triangles[triangle_indices]
    a, b, c = (sheet_points[corners[..., k]] for k in range(3))
    weights = _barycentric_weights(points[:, None], a, b, c)
    nearest_points = np.einsum("ndk,ndkx->ndx", weights, sheet_points[corners])
    distances = np.linalg.norm(nearest_points - points[:, None], axis=2)
    distances[triangle_indices < 0] = np.inf
    nearest_triangle = distances.argmin(axis=1)[:, None, None]
    candidate_displacements = np.einsum(
        "ndk,ndkx->ndx", weights, sheet_displacements[corners]
    )
    return np.asarray(
        np.take_along_axis(candidate_displacements, nearest_triangle, axis=1)[:, 0]
    )


def _triangles_by_point(triangles: IntArray, point_count: int) -> IntArray:
    """Return the triangles of each point, padded with -1 ``(N, max_triangles)``."""
    order = np.argsort(triangles.ravel(), kind="stable")
    sorted_corners, sorted_faces = triangles.ravel()[order], order // 3
    start_indices = np.searchsorted(sorted_corners, np.arange(point_count + 1))
    neighbours = np.full((point_count, max(int(np.diff(start_indices).max()), 1)), -1)
    columns = np.arange(len(sorted_corners)) - start_indices[sorted_corners]
    neighbours[sorted_corners, columns] = sorted_faces
    return neighbours


def _barycentric_weights(
    points: FloatArray, a: FloatArray, b: FloatArray, c: FloatArray
) -> FloatArray:
    """Return barycentric weights of the points of triangles nearest to ``points``."""
    ab, ac, ap = b - a, c - a, points - a
    d00, d01, d11 = ((u * v).sum(axis=-1) for u, v in ((ab, ab), (ab, ac), (ac, ac)))
    d20, d21 = (ap * ab).sum(axis=-1), (ap * ac).sum(axis=-1)
    determinant = d00 * d11 - d01 * d01
    divisor = np.where(determinant > 0, determinant, 1.0)
    v, w = (d11 * d20 - d01 * d21) / divisor, (d00 * d21 - d01 * d20) / divisor
    weights = np.clip(np.stack([1 - v - w, v, w], axis=-1), 0.0, None)
    return np.asarray(weights / weights.sum(axis=-1, keepdims=True))


class Surfaces:
    """Sheets in the array layout of kernels that compute many substeps in one call.

    Points that coincide at the beginning are merged; triangles do not change.

    Attributes:
        max_speed: Highest speed so far [m/s]; teleports do not count.
    """

    def __init__(self, sheets: Sequence[Sheet]) -> None:
        self._sheets = tuple(sheets)
        self._start: float | None = None
        self._prepared_sheets: list[_PreparedSheet] = []
        self._teleports: dict[tuple[int, float], Fault] = {}
        self.max_speed = 0.0

    def kernel_arrays(
        self, start: float, dt: float, first_step: int, step_count: int
    ) -> list[tuple[Any, ...]]:
        """Return the kernel's arrays for consecutive steps of length ``dt`` [s].

        Step 0 begins at ``start`` [s]; the first has the index ``first_step``.
        """
        if self._start != start:
            self._start = start
            prepared_sheets = [_PreparedSheet(sheet, start) for sheet in self._sheets]
            self._prepared_sheets = [
                sheet for sheet in prepared_sheets if len(sheet.faces)
            ]
        knot_steps = max(1, math.floor(KNOT_INTERVAL / dt * (1 + RELATIVE_ROUNDING)))
        first_knot, offset = divmod(first_step, knot_steps)
        last_knot = -(-(first_step + step_count) // knot_steps)
        knot_indices = np.arange(first_knot, last_knot + 1)
        knot_times = np.asarray(start + knot_indices * (knot_steps * dt), np.float64)
        arrays = []
        for sheet_index, sheet in enumerate(self._prepared_sheets):
            points = np.stack([sheet.points(t) for t in knot_times.tolist()])
            self._record_speed(sheet_index, sheet.sheet, points, knot_times)
            kernel, material = sheet.kernel, sheet.material
            arrays.append((kernel, points, material, knot_steps, offset))
        return arrays

    def _record_speed(
        self, sheet_index: int, sheet: Sheet, points: FloatArray, knot_times: FloatArray
    ) -> None:
        """Record the maximum speed of a sheet, and its teleports."""
        distances = np.linalg.norm(np.diff(points, axis=0), axis=2).max(axis=1)
        speeds = distances / np.diff(knot_times)
        is_teleport = speeds > SPEED_LIMIT
        self.max_speed = max(
            self.max_speed, float(speeds[~is_teleport].max(initial=0.0))
        )
        for time in knot_times[1:][is_teleport].tolist():
            label = sheet.name or f"sheets[{sheet_index}]"
            fault = teleport_warning(SPEED_LIMIT, time, label)
            self._teleports[sheet_index, time] = fault

    def notices(self) -> list[Fault]:
        """Return a warning for each teleport so far (SIM120)."""
        return list(self._teleports.values())


def teleport_warning(
    limit: float, end_time: float, location: str, hint: str | None = None
) -> Fault:
    """Return a warning about motion above a speed limit [m/s] (SIM120)."""
    message = f"it moves faster than {limit:g} m/s until {end_time:g} s: it collides "
    return warning("SIM120", f"{message}with nothing", hint, location)


class _PreparedSheet:
    """A sheet with a bounding volume tree, built once at the start.

    Attributes:
        sheet: The sheet.
        faces: Triangles of the sheet; for a two-sided sheet, of its hull ``(T, 3)``.
        kernel: Kernel object with the tree of the triangles.
        material: Restitution, friction, margin, depenetration and the speed limit.
    """

    def __init__(self, sheet: Sheet, start: float) -> None:
        self.sheet = sheet
        points = sheet.motion.points(start)
        self._indices, self._triangles = _used_topology(
            points, sheet.motion.triangles(start)
        )
        self._cached_points: tuple[FloatArray, FloatArray] | None = None
        margin = sheet.radius if sheet.closed else 0.0
        self.material = (
            sheet.restitution, sheet.friction, margin, sheet.depenetration, SPEED_LIMIT,
        )  # fmt: skip
        self.faces = self._triangles
        if not sheet.closed:
            self.faces = hull_faces(self._triangles, len(self._indices))
        if len(self.faces):
            corners = np.ascontiguousarray(self.faces, np.int32)
            self.kernel = _kernels.MeshSurface(self.points(start), corners)

    def points(self, t: float) -> FloatArray:
        """Return the points of the faces ``(P, 3)`` [m] at a time [s]."""
        points = self.sheet.motion.points(t)
        if self._cached_points is None or self._cached_points[0] is not points:
            welded_points = np.ascontiguousarray(points[self._indices], np.float64)
            if not self.sheet.closed:
                welded_points = hull_points(
                    welded_points, self._triangles, self.sheet.radius
                )
            self._cached_points = points, welded_points
        return self._cached_points[1]


def _used_topology(
    points: FloatArray, triangles: IntArray
) -> tuple[IntArray, IntArray]:
    """Return indices of the used points, and triangles without degenerate ones.

    Coincident points are merged, except in triangles that would become degenerate:
    they may gain an area later.
    """
    _, first_indices, inverse = np.unique(
        points, axis=0, return_index=True, return_inverse=True
    )
    representatives = first_indices[inverse.reshape(-1)]
    degenerate_triangles = triangles[_is_degenerate(representatives[triangles])]
    representatives[degenerate_triangles] = degenerate_triangles
    corners = representatives[triangles]
    corners = corners[~_is_degenerate(corners)]
    used_points, corner_indices = np.unique(corners, return_inverse=True)
    return used_points, corner_indices.reshape(-1, 3)


def _is_degenerate(triangles: IntArray) -> Any:
    """Return a mask of the triangles with two equal corners ``(T,)``."""
    return (triangles == np.roll(triangles, 1, axis=1)).any(axis=1)

"""Deforms meshes over frames by shapes and skin; computes extents and velocities."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from animtool import _kernels
from animtool.core.array_types import ArrayLike, FloatArray, as_floats
from animtool.core.errors import Fault, FormatError, listed
from animtool.core.record import dataclass
from animtool.maths.faces import triangulate
from animtool.motion.motion import Channel
from animtool.rig.kinematics import WorldTransforms
from animtool.rig.surfaces import Surface
from animtool.skin.shapes import PreparedShapes, blend_normals, blend_points
from animtool.skin.skinning import PreparedSkin, skin_normals, skin_points

# Size of a block of frames [bytes]: small enough to stay in cache between steps and for
# a writing thread; for large meshes, enough frames for fast matrix products.
BLOCK_BYTES = 2**22
MIN_BLOCK_FRAMES = 4


@dataclass(frozen=True, slots=True)
class DeformedMesh:
    """A mesh with blend shapes and a skin, prepared for deformation.

    Raises:
        FormatError: Shapes, skin or normals do not match the number of vertices
            (SKIN001), or points are not finite (SKIN003).
    """

    points: FloatArray  # ``(V, 3)`` at rest, mesh space
    # Prepared on the same points (and normals); None if there are no shapes.
    shapes: PreparedShapes | None = None
    skin: PreparedSkin | None = None  # prepared for V vertices; None if not skinned
    normals: FloatArray | None = None  # ``(V, 3)`` at rest; None if it has none

    def __post_init__(self) -> None:
        """Raise if shapes, skin or normals do not match the points."""
        points = as_floats(self.points, ("V", 3), "points")
        object.__setattr__(self, "points", points)
        faults = [
            Fault(
                "SKIN001",
                f"{name} for {prepared.vertex_count} vertices, not {len(points)}",
            )
            for name, prepared in (("shapes", self.shapes), ("skin", self.skin))
            if prepared is not None and prepared.vertex_count != len(points)
        ]
        bad_vertices = np.flatnonzero(~np.isfinite(points).all(axis=1)).tolist()
        if bad_vertices:
            faults.append(
                Fault("SKIN003", f"points not finite: {listed(bad_vertices)}")
            )
        if self.normals is not None and np.shape(self.normals) != (len(points), 3):
            message = (
                f"normals are {np.shape(self.normals)}, but must be ({len(points)}, 3)"
            )
            faults.append(Fault("SKIN001", message))
        if faults:
            raise FormatError(faults)


@dataclass(frozen=True, slots=True)
class DeformedFrames:
    """A deformed mesh in F frames."""

    # ``(F, V, 3)``; skeleton space if skinned, else mesh space.
    points: FloatArray
    extents: FloatArray  # minimum and maximum coordinates ``(F, 2, 3)``
    # Unit normals ``(F, V, 3)``; None unless requested.
    normals: FloatArray | None = None
    # ``(F, V, 3)`` [unit of the points / s]; None unless requested.
    velocities: FloatArray | None = None

    def select(self, frames: slice) -> DeformedFrames:
        """Return the selected range of frames."""
        return DeformedFrames(
            self.points[frames],
            self.extents[frames],
            None if self.normals is None else self.normals[frames],
            None if self.velocities is None else self.velocities[frames],
        )


def deform(
    mesh: DeformedMesh,
    weights: ArrayLike | None = None,
    world: WorldTransforms | None = None,
    *,
    normals: bool = False,
    times: ArrayLike | None = None,
) -> DeformedFrames:
    """Return a mesh deformed in every frame, first by its shapes, then by its skin.

    Args:
        mesh: V vertices.
        weights: Shape weights ``(F, S)`` [1], products of combined shapes included;
            None is all zero.
        world: World transforms of the skeleton's joints in F frames; None is the bind
            pose.
        normals: Deform the normals too.
        times: Times of the frames ``(F,)`` [s], ascending, to compute velocities by
            second-order central differences, one-sided at the ends; None for no
            velocities.

    >>> mesh = DeformedMesh(np.eye(3))
    >>> deform(mesh, np.zeros((2, 0))).extents[1].tolist()
    [[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]]
    """
    weights_array = (
        None if weights is None else as_floats(weights, ("F", "S"), "weights")
    )
    return _deform_into(mesh, weights_array, world, normals, _times_array(times), None)


def _deform_into(
    mesh: DeformedMesh,
    weights: FloatArray | None,
    world: WorldTransforms | None,
    normals: bool,
    times: FloatArray | None,
    buffers: _DeformBuffers | None,
) -> DeformedFrames:
    """Return the deformed mesh like `deform`, reusing buffers if given."""
    frame_count = _frame_count(weights, world)
    points = _deform_points(mesh, weights, world, frame_count, buffers)
    return DeformedFrames(
        points,
        extents(points),
        _deform_normals(mesh, weights, world, frame_count, buffers)
        if normals
        else None,
        None if times is None else _point_velocities(points, times),
    )


@dataclass(frozen=True, slots=True)
class _DeformBuffers:
    """Arrays that are reused for every block of frames."""

    unskinned_values: FloatArray  # points or normals before skinning ``(F, V, 3)``
    points: FloatArray  # ``(F, V, 3)``
    normals: FloatArray  # ``(F, V, 3)``, or empty

    @classmethod
    def allocate(
        cls, mesh: DeformedMesh, frame_count: int, *, normals: bool
    ) -> _DeformBuffers:
        """Return buffers for a number of frames, with normals only if requested."""
        normal_count = 0 if mesh.normals is None or not normals else len(mesh.normals)
        shape = (frame_count, *mesh.points.shape)
        return cls(
            np.zeros(shape), np.zeros(shape), np.zeros((frame_count, normal_count, 3))
        )


def deform_blocks(
    mesh: DeformedMesh,
    weights: ArrayLike | None = None,
    world: WorldTransforms | None = None,
    *,
    normals: bool = False,
    times: ArrayLike | None = None,
) -> Iterator[DeformedFrames]:
    """Yield a deformed mesh in blocks of consecutive frames; arguments as for `deform`.

    Blocks share memory: each must be used before the next is requested.
    """
    weights_array = (
        None if weights is None else as_floats(weights, ("F", "S"), "weights")
    )
    frame_count = _frame_count(weights_array, world)
    block_size = block_frames(len(mesh.points))
    # Central differences need the frame on either side.
    frame_times = _times_array(times)
    margin = 0 if frame_times is None else 1
    buffers = _DeformBuffers.allocate(
        mesh, min(frame_count, block_size + 2 * margin), normals=normals
    )
    for begin in range(0, frame_count, block_size):
        end = min(begin + block_size, frame_count)
        first, stop = max(begin - margin, 0), min(end + margin, frame_count)
        deformed_frames = _deform_into(
            mesh,
            None if weights_array is None else weights_array[first:stop],
            None
            if world is None
            else WorldTransforms(world.positions[first:stop], world.linear[first:stop]),
            normals,
            None if frame_times is None else frame_times[first:stop],
            buffers,
        )
        yield deformed_frames.select(slice(begin - first, end - first))


def block_frames(vertex_count: int) -> int:
    """Return how many frames of a mesh fit in 4 MB: a multiple of 4, at least 4.

    >>> block_frames(10_000)
    16
    """
    frame_count = BLOCK_BYTES // max(24 * vertex_count, 1)
    return max(MIN_BLOCK_FRAMES, frame_count // MIN_BLOCK_FRAMES * MIN_BLOCK_FRAMES)


def extents(points: ArrayLike) -> FloatArray:
    """Return the minimum and maximum coordinates ``(F, 2, 3)`` of points ``(F, V, 3)``.

    >>> extents([[[0, 5, 1], [2, 3, 4]]]).tolist()
    [[[0.0, 3.0, 1.0], [2.0, 5.0, 4.0]]]
    """
    return _kernels.point_extents(as_floats(points, ("F", "V", 3), "points"))


def _frame_count(weights: FloatArray | None, world: WorldTransforms | None) -> int:
    """Return the common frame count of weights and joints; raise if they differ."""
    frame_counts = set()
    if weights is not None:
        frame_counts.add(len(weights))
    if world is not None:
        frame_counts.add(len(world.positions))
    if len(frame_counts) != 1:
        raise ValueError("weights and joints need the same number of frames")
    return frame_counts.pop()


def _deform_points(
    mesh: DeformedMesh,
    weights: FloatArray | None,
    world: WorldTransforms | None,
    frame_count: int,
    buffers: _DeformBuffers | None,
) -> FloatArray:
    """Return the deformed points ``(F, V, 3)``."""
    points = mesh.points[None]
    is_skinned = mesh.skin is not None and world is not None
    out = None if buffers is None else buffers.points[:frame_count]
    if mesh.shapes is not None and weights is not None and weights.any():
        unskinned_points = (
            buffers.unskinned_values[:frame_count]
            if is_skinned and buffers is not None
            else out
        )
        points = blend_points(mesh.shapes, weights, out=unskinned_points)
    if mesh.skin is not None and world is not None:
        return skin_points(mesh.skin, points, world, out=out)
    return np.ascontiguousarray(
        np.broadcast_to(points, (frame_count, *points.shape[1:]))
    )


def _deform_normals(
    mesh: DeformedMesh,
    weights: FloatArray | None,
    world: WorldTransforms | None,
    frame_count: int,
    buffers: _DeformBuffers | None,
) -> FloatArray:
    """Return the deformed unit normals ``(F, V, 3)``."""
    if mesh.normals is None:
        raise ValueError("the mesh has no normals")
    normals = np.asarray(mesh.normals, np.float64)[None]
    shapes = mesh.shapes
    has_normal_offsets = shapes is not None and shapes.normals is not None
    if has_normal_offsets and weights is not None and weights.any():
        assert shapes is not None
        unskinned_normals = (
            None if buffers is None else buffers.unskinned_values[:frame_count]
        )
        normals = blend_normals(shapes, weights, out=unskinned_normals)
    if mesh.skin is not None and world is not None:
        out = None if buffers is None else buffers.normals[:frame_count]
        return skin_normals(mesh.skin, normals, world, out=out)
    normals = unit_normals(normals)
    return np.ascontiguousarray(
        np.broadcast_to(normals, (frame_count, *normals.shape[1:]))
    )


def _times_array(times: ArrayLike | None) -> FloatArray | None:
    """Return the times of the frames as an array ``(F,)``; None if there are none."""
    return None if times is None else as_floats(times, ("F",), "times")


def _point_velocities(points: FloatArray, times: FloatArray) -> FloatArray:
    """Return the velocities of points ``(F, V, 3)``; zero for a single frame."""
    if len(points) < 2:
        return np.zeros_like(points)
    return np.asarray(np.gradient(points, times, axis=0))


def replace_points(
    deformed_frames: DeformedFrames,
    points: Channel,
    frames: slice,
    surface: Surface | None,
    times: FloatArray | None,
) -> DeformedFrames:
    """Return frames of a mesh with other points, such as simulated ones.

    Normals are kept in frames with unchanged points, and computed from faces elsewhere.

    Args:
        deformed_frames: The frames, deformed by joints.
        points: Replacement points of all frames ``(F, V, 3)`` [m].
        frames: Range of the deformed frames within all frames.
        surface: Mesh with the faces; None for strands.
        times: Times of all frames ``(F,)`` [s]; None for no velocities.

    >>> static = DeformedFrames(np.zeros((1, 2, 3)), np.zeros((1, 2, 3)))
    >>> up = Channel(np.zeros((2, 3)), np.arange(2), np.ones((3, 2, 3)))
    >>> replace_points(static, up, slice(1, 2), None, None).extents.tolist()
    [[[1.0, 1.0, 1.0], [1.0, 1.0, 1.0]]]
    """
    margin = 0 if times is None else 1
    first = max(frames.start - margin, 0)
    stop = min(frames.stop + margin, len(points.values))
    points_with_margin = points.select(slice(first, stop)).dense()
    requested_frames = slice(frames.start - first, frames.stop - first)
    new_points = np.ascontiguousarray(points_with_margin[requested_frames])
    velocities = deformed_frames.velocities
    if times is not None:
        velocities = _point_velocities(points_with_margin, times[first:stop])
        velocities = velocities[requested_frames]
    normals = deformed_frames.normals
    if normals is not None and surface is not None:
        has_changed = (new_points != deformed_frames.points).any(axis=(1, 2))
        normals = normals.copy()
        normals[has_changed] = vertex_normals(surface, new_points[has_changed])
    return replace(
        deformed_frames,
        points=new_points,
        extents=extents(new_points),
        normals=normals,
        velocities=velocities,
    )


def vertex_normals(surface: Surface, points: FloatArray) -> FloatArray:
    """Return area-weighted unit normals of vertices ``(F, V, 3)``.

    Args:
        surface: Mesh with the faces.
        points: Points of the vertices ``(F, V, 3)``.
    """
    triangles = triangulate(surface.counts, surface.indices)
    a, b, c = (points[:, triangles[:, k]] for k in range(3))
    area_vectors = np.cross(b - a, c - a)
    normal_sums = np.zeros_like(points)
    sums_by_vertex = np.moveaxis(normal_sums, 1, 0)
    for k in range(3):
        np.add.at(sums_by_vertex, triangles[:, k], np.moveaxis(area_vectors, 1, 0))
    return unit_normals(normal_sums)


def unit_normals(normals: FloatArray) -> FloatArray:
    """Return normals ``(..., 3)`` scaled to length 1; zero vectors stay zero.

    >>> unit_normals(np.array([[0.0, 2.0, 0.0], [0.0, 0.0, 0.0]])).tolist()
    [[0.0, 1.0, 0.0], [0.0, 0.0, 0.0]]
    """
    lengths = np.linalg.norm(normals, axis=-1, keepdims=True)
    return np.asarray(normals / np.where(lengths > 0, lengths, 1.0))

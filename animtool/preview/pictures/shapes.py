"""Draws meshes, instances, points and strands, as the viewer's `meshes.js` does."""

from __future__ import annotations

from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.preview.pictures.camera import Bounds, EyeMatrices
from animtool.preview.pictures.data import StreamReader
from animtool.preview.pictures.device import Array, Device, TextureTable
from animtool.preview.pictures.lines import (
    OFFSCREEN_COORDINATE,
    LineRenderer,
    SpriteRenderer,
    VertexBuffer,
    move_missing_offscreen,
    repeat_color,
    srgb_colors,
)
from animtool.preview.pictures.pose import PosedTake, compose_matrices

# Meshes with fewer points are shaded by face, so boxes keep their edges.
MIN_SMOOTH_POINTS = 200
# Number of vertices that measure the bounds of a skinned mesh.
BOUNDS_VERTICES = 200
DEFAULT_COLOR = (0.4, 0.43, 0.48)
# Meshes lower than this are a ground, and wider ones are a room, relative to the radius
# of the scene.
GROUND_HEIGHT, ROOM_WIDTH = 0.02, 2.2
POINT_COLOR = (0.7, 0.32, 0.05)
STRAND_COLOR = (0.26, 0.15, 0.07)


def vertex_normals(points: Array, faces: Array) -> FloatArray:
    """Return area-weighted vertex normals ``(V, 3)``."""
    a, b, c = (points[faces[:, k]].astype(np.float64) for k in range(3))
    face_normals = np.cross(b - a, c - a)
    corner_indices, count = faces.ravel(), len(points)
    corner_normals = [
        np.bincount(corner_indices, np.repeat(face_normals[:, k], 3), minlength=count)
        for k in range(3)
    ]
    return np.stack(corner_normals, axis=1)


class GeometryBuffers:
    """Vertex buffers of a rest mesh, shared by meshes with the same streams."""

    def __init__(
        self, device: Device, streams: StreamReader, manifest_entry: dict[str, Any]
    ):
        self.rest_points = streams.static_values(manifest_entry["points"]).reshape(
            -1, 3
        )
        self.faces = (
            streams.static_values(manifest_entry["faces"])
            .astype(np.uint32)
            .reshape(-1, 3)
        )
        self.is_smooth = len(self.rest_points) >= MIN_SMOOTH_POINTS
        self.radius = float(np.abs(self.rest_points).max(initial=0.0))
        self.points, self.normals = VertexBuffer(device), VertexBuffer(device)
        self.set_points(self.rest_points)
        self.index_buffer = device.gl.buffer(self.faces.tobytes())
        self.buffers: list[tuple[Any, str, str]] = [
            (self.points.buffer, "3f", "point"),
            (self.normals.buffer, "3f", "normal"),
        ]
        self.has_colors = manifest_entry.get("colors") is not None
        if self.has_colors:
            point_colors = streams.static_values(manifest_entry["colors"]).astype(
                np.uint8
            )
            self.buffers.append(
                (device.gl.buffer(point_colors.tobytes()), "3f1", "paint")
            )
        self.joints: Array = np.zeros((0, 4), np.uint16)
        self.bind: FloatArray = np.zeros((0, 4, 4))
        if skin := manifest_entry.get("skin"):
            self.joints = streams.static_values(skin["joints"]).astype(np.uint16)
            bind = streams.static_values(skin["bind"]).reshape(-1, 4, 4)
            self.bind = bind.swapaxes(1, 2).astype(np.float64)
            weights = streams.static_values(skin["weights"]).astype("<f4")
            self.buffers += [
                (device.gl.buffer(self.joints.tobytes()), "4u2", "joints"),
                (device.gl.buffer(weights.tobytes()), "4f", "weights"),
            ]
            self.joints = self.joints.reshape(-1, 4)

    def set_points(self, points: Array) -> None:
        """Replace the points, and compute their normals."""
        normals = vertex_normals(points, self.faces) if self.is_smooth else points
        self.points.write(np.asarray(points, "<f4"))
        self.normals.write(np.asarray(normals, "<f4"))


class MeshRenderer:
    """Draws a mesh that is static, skinned, deformed by shapes, or a point cache."""

    def __init__(
        self,
        device: Device,
        streams: StreamReader,
        manifest_entry: dict[str, Any],
        pose: PosedTake | None,
        geometry_by_streams: dict[tuple[Any, ...], GeometryBuffers],
    ) -> None:
        self._device, self._streams = device, streams
        self.manifest_entry, self.pose = manifest_entry, pose
        self.is_prototype = bool(manifest_entry.get("prototype"))
        self.geometry = self._shared_geometry(geometry_by_streams)
        self._drawn_points = self.geometry.rest_points
        self._shapes = [
            (
                shape["column"],
                streams.static_values(shape["vertices"]).astype(np.int64),
                streams.static_values(shape["offsets"])
                .reshape(-1, 3)
                .astype(np.float64),
            )
            for shape in manifest_entry.get("shapes") or []
        ]
        self._applied_weights = np.zeros(len(self._shapes))
        skin = manifest_entry.get("skin") if pose else None
        self._joints = np.array(skin["palette"], np.int64) if skin else None
        self._palette = TextureTable(device)
        self.is_hidden = False
        has_colors = self.geometry.has_colors
        is_defined = {"SKIN": skin, "PAINT": has_colors, "INSTANCES": self.is_prototype}
        define_names = tuple(name for name, is_on in is_defined.items() if is_on)
        self.program = device.program("meshes.js", defines=define_names)
        color = manifest_entry.get("color")
        self._color = srgb_colors(DEFAULT_COLOR if color is None else color) / 255
        self._array: Any = None
        if not self.is_prototype:
            self._array = self.vertex_array([])

    def _shared_geometry(
        self, geometry_by_streams: dict[tuple[Any, ...], GeometryBuffers]
    ) -> GeometryBuffers:
        """Return the buffers of the rest mesh, shared with equal undeformed meshes."""
        manifest_entry, skin = (
            self.manifest_entry,
            self.manifest_entry.get("skin") or {},
        )
        if manifest_entry.get("cache") is not None or manifest_entry.get("shapes"):
            return GeometryBuffers(self._device, self._streams, manifest_entry)
        stream_names = ("points", "faces", "colors")
        geometry_key = tuple(
            [manifest_entry.get(name) for name in stream_names]
            + [skin.get(name) for name in ("joints", "weights", "bind")]
        )
        if geometry_key not in geometry_by_streams:
            geometry_by_streams[geometry_key] = GeometryBuffers(
                self._device, self._streams, manifest_entry
            )
        return geometry_by_streams[geometry_key]

    def vertex_array(self, extra_buffers: list[tuple[Any, str, str]]) -> Any:
        """Return the vertex array of the mesh, with extra buffers appended."""
        unused_attributes = {"joints", "weights"} if self._joints is None else set()
        buffers = [
            buffer
            for buffer in self.geometry.buffers
            if buffer[2] not in unused_attributes
        ]
        return self._device.gl.vertex_array(
            self.program,
            [*buffers, *extra_buffers],
            self.geometry.index_buffer,
            index_element_size=4,
        )

    @property
    def is_skinned(self) -> bool:
        """Whether joints deform the mesh."""
        return self._joints is not None

    def update(self, sample: int) -> None:
        """Set the points or joint matrices of the mesh at a sample."""
        pose, manifest_entry = self.pose, self.manifest_entry
        first = pose.first_sample if pose else 0
        visibility_stream = manifest_entry.get("visible")
        self.is_hidden = (
            visibility_stream is not None
            and self._streams.sample_values(visibility_stream, sample - first)[0] == 0
        ) or (pose is not None and not pose.is_visible)
        if self.is_hidden:
            return
        if pose is not None and self._joints is not None:
            matrices = pose.world_matrices[self._joints] @ self.geometry.bind
            texels = np.zeros((len(matrices), 4, 4), np.float32)
            texels[:, :3], texels[:, 3, 0] = matrices[:, :3], -1
            self._palette.upload(texels.reshape(-1, 4))
        shape_track = pose.manifest_entry.get("shapes") if pose else None
        if pose is not None and shape_track and self._shapes:
            weights = pose.sample_values(shape_track["weights"], sample)
            if weights is not None:
                self._apply_shapes(weights)
        if manifest_entry.get("cache") is not None:
            cached_points = self._streams.sample_values(
                manifest_entry["cache"], sample - first
            )
            self._drawn_points = cached_points.reshape(-1, 3)
            self.geometry.set_points(self._drawn_points)

    def _apply_shapes(self, weights: FloatArray) -> None:
        """Deform the points by blend shapes if their weights changed."""
        shape_weights = np.array([weights[column] for column, _, _ in self._shapes])
        if np.array_equal(shape_weights, self._applied_weights):
            return
        self._applied_weights = shape_weights
        points = self.geometry.rest_points.astype(np.float64)
        for shape_weight, (_, vertices, offsets) in zip(
            shape_weights, self._shapes, strict=True
        ):
            if shape_weight:
                points[vertices] += shape_weight * offsets
        self.geometry.set_points(points)

    def grow_bounds(self, bounds: Bounds) -> None:
        """Grow bounds by the mesh; if skinned, by a sample of its vertices."""
        pose, geometry = self.pose, self.geometry
        if self.is_prototype or (pose is not None and not pose.is_visible):
            return
        if pose is None or self._joints is None:
            bounds.add(self._drawn_points.astype(np.float64))
            return
        sampled_vertices = slice(
            None, None, max(-(-len(geometry.rest_points) // BOUNDS_VERTICES), 1)
        )
        first_joints = geometry.joints[sampled_vertices, 0]
        matrices = (
            pose.world_matrices[self._joints[first_joints]]
            @ geometry.bind[first_joints]
        )
        points = geometry.rest_points[sampled_vertices].astype(np.float64)
        bounds.add(
            np.einsum("vij,vj->vi", matrices[:, :3, :3], points) + matrices[:, :3, 3]
        )

    def is_ground_or_room(self, radius: float) -> bool:
        """Return whether the shape is a ground or a room, which cast no shadow.

        ``radius`` [m] is that of the scene.
        """
        if (
            self.pose
            or self.is_prototype
            or self.manifest_entry.get("cache") is not None
        ):
            return False
        low = self.geometry.rest_points.min(axis=0)
        high = self.geometry.rest_points.max(axis=0)
        width = min(high[0] - low[0], high[2] - low[2])
        return bool(high[1] < GROUND_HEIGHT * radius or width > ROOM_WIDTH * radius)

    def draw(
        self, eye: EyeMatrices, array: Any = None, instance_count: int = 1
    ) -> None:
        """Draw the mesh once, or an instance of it for each row of an array."""
        if self.is_hidden or not instance_count:
            return
        shift = self.pose.shift if self.pose else (0.0, 0.0, 0.0)
        palette = {} if self._joints is None else {"palette": self._palette}
        self._device.set_uniforms(
            self.program,
            eye,
            color=self._color,
            shift=shift,
            faceted=0.0 if self.geometry.is_smooth else 1.0,
            **palette,
        )
        vertex_array = self._array if array is None else array
        vertex_array.render(self._device.moderngl.TRIANGLES, instances=instance_count)


class InstanceRenderer:
    """Draws the instances of a mesh: rigid bodies, flocks, crowds and props."""

    def __init__(
        self,
        device: Device,
        streams: StreamReader,
        manifest_entry: dict[str, Any],
        mesh: MeshRenderer,
    ) -> None:
        self._streams, self._manifest_entry, self._mesh = streams, manifest_entry, mesh
        self._matrix_buffer, self._colors = VertexBuffer(device), VertexBuffer(device)
        self._instance_count = streams.width(manifest_entry["t"]) // 3
        color = mesh.manifest_entry.get("color") or DEFAULT_COLOR
        self._colors.write(repeat_color(self._instance_count, srgb_colors(color)))
        self._array: Any = None
        self.pose = None
        self.matrices = np.zeros((0, 4, 4))

    def update(self, sample: int) -> None:
        """Set the transforms of the instances at a sample."""
        streams, manifest_entry = self._streams, self._manifest_entry
        positions, rotations = (
            streams.sample_values(manifest_entry[component], sample).astype(np.float64)
            for component in "tr"
        )
        positions, rotations = positions.reshape(-1, 3), rotations.reshape(-1, 4)
        is_visible = np.isfinite(positions[:, 0])
        if manifest_entry["visible"] is not None:
            is_visible &= streams.sample_values(manifest_entry["visible"], sample) != 0
        visible_scales = None
        if manifest_entry["s"] is not None:
            scales = streams.sample_values(manifest_entry["s"], sample).reshape(-1, 3)
            visible_scales = scales[is_visible].astype(np.float64)
        self.matrices = compose_matrices(
            positions[is_visible], rotations[is_visible], visible_scales
        )
        if self._matrix_buffer.write(self.matrices.swapaxes(1, 2).astype("<f4")):
            self._array = self._mesh.vertex_array(
                [
                    (self._matrix_buffer.buffer, "16f/i", "placed"),
                    (self._colors.buffer, "3f1/i", "ownColor"),
                ]
            )

    def grow_bounds(self, bounds: Bounds) -> None:
        """Grow bounds by the bounding boxes of the instances."""
        radii = self._mesh.geometry.radius * np.linalg.norm(
            self.matrices[:, :3, 0], axis=1
        )
        for side in (-1, 1):
            bounds.add(self.matrices[:, :3, 3] + side * radii[:, None])

    def draw(self, eye: EyeMatrices) -> None:
        """Draw the instances."""
        self._mesh.draw(eye, self._array, len(self.matrices))


class PointRenderer:
    """Draws the points of a simulation or a capture."""

    def __init__(
        self, device: Device, streams: StreamReader, manifest_entry: dict[str, Any]
    ):
        self._streams, self._manifest_entry = streams, manifest_entry
        self._sprites = SpriteRenderer(device)
        count = streams.width(manifest_entry["positions"]) // 3
        self._point_colors = repeat_color(
            count, srgb_colors(manifest_entry.get("color") or POINT_COLOR)
        )
        if manifest_entry.get("colors") is not None:
            colors = streams.static_values(manifest_entry["colors"]) / 255
            self._point_colors = srgb_colors(colors).astype(np.uint8).reshape(-1, 3)
        radii = manifest_entry.get("radii")
        self._radii = None if radii is None else streams.static_values(radii)
        self.pose = None
        self._points = np.zeros((0, 3))

    def update(self, sample: int) -> None:
        """Set the positions of the points at a sample."""
        self._points = move_missing_offscreen(
            self._streams.sample_values(self._manifest_entry["positions"], sample)
        )
        self._sprites.set_points(self._points, self._point_colors, self._radii)

    def grow_bounds(self, bounds: Bounds) -> None:
        """Grow bounds by the points that exist at the sample."""
        bounds.add(self._points[self._points[:, 0] < OFFSCREEN_COORDINATE / 10])

    def draw(self, eye: EyeMatrices) -> None:
        """Draw the points as balls of their radii."""
        self._sprites.draw(eye, self._manifest_entry.get("radius") or 0.0, 2)


class StrandRenderer:
    """Draws strands and ropes as polylines that are at least one pixel wide."""

    def __init__(
        self,
        device: Device,
        streams: StreamReader,
        manifest_entry: dict[str, Any],
        pose: PosedTake | None,
    ) -> None:
        self._streams, self._manifest_entry, self.pose = streams, manifest_entry, pose
        self._lines = LineRenderer(device)
        point_counts = streams.static_values(manifest_entry["counts"]).astype(np.int64)
        starts_segment = np.ones(int(point_counts.sum()), bool)
        starts_segment[np.cumsum(point_counts) - 1] = False
        self._segment_starts = np.flatnonzero(starts_segment)
        color = srgb_colors(manifest_entry.get("color") or STRAND_COLOR)
        self._color = np.append(color, 255.0)
        self._points = np.zeros((0, 3))

    def update(self, sample: int) -> None:
        """Set the points of the strands at a sample."""
        pose, manifest_entry = self.pose, self._manifest_entry
        first = pose.first_sample if pose else 0
        stream_values = self._streams.sample_values(
            manifest_entry["points"], sample - first
        )
        points = stream_values.reshape(-1, 3).astype(np.float64)
        if pose is not None:
            joint, bind = manifest_entry.get("joint"), manifest_entry.get("bind")
            if joint is not None and bind:
                matrix = pose.world_matrices[joint] @ np.reshape(bind, (4, 4)).T
                points = points @ matrix[:3, :3].T + matrix[:3, 3]
            else:
                points = points + pose.shift
        self._points = points
        segment_ends = (points[self._segment_starts], points[self._segment_starts + 1])
        self._lines.set_segments(*segment_ends, self._color)

    def grow_bounds(self, bounds: Bounds) -> None:
        """Grow bounds by the points of the strands."""
        bounds.add(self._points)

    def draw(self, eye: EyeMatrices) -> None:
        """Draw the strands, unless their take is hidden."""
        if self.pose is None or self.pose.is_visible:
            self._lines.draw(
                eye, width=1, world_width=self._manifest_entry.get("width") or 0.0
            )

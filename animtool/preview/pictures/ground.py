"""Draws the ground: the grid, contact shadows, and trails of the root and the feet."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.preview.pictures.bones import Color, ColorOfTake
from animtool.preview.pictures.camera import CameraView, EyeMatrices
from animtool.preview.pictures.device import Device
from animtool.preview.pictures.lines import LineRenderer
from animtool.preview.pictures.pose import PosedTake, is_in_spans

GRID_CELLS, SEGMENT_CELLS = 28, 4
# Samples of a trail before and after the current one.
TRAIL_SAMPLES = 48
# As in the page's `shadow.js`.
SHADOW_PIXELS = 512
SHADOW_WIDTH, SHADOW_HEIGHT, SHADOW_DEPTH, SHADOW_OFFSET = 1.1, 0.35, 2e-3, 0.2


def round_to_1_2_5(x: float) -> float:
    """Round up to the next number of 1, 2, 5, 10, …; down if only slightly larger.

    >>> round_to_1_2_5(0.31), round_to_1_2_5(2.001)
    (0.5, 2.0)
    """
    power = 10.0 ** math.floor(math.log10(max(x, 1e-9)))
    return next((k for k in (1, 2, 5) if k * power >= x * 0.99), 10) * power


class GroundRenderer:
    """Draws the grid on the ground, with cells that suit the size of the scene."""

    def __init__(self, device: Device, radius: float) -> None:
        self._lines = LineRenderer(device)
        self._cell_size = round_to_1_2_5(max(radius, 1e-6) * 0.3)
        self._center_cell: tuple[int, int] | None = None

    def draw(
        self, eye: EyeMatrices, center: FloatArray, line_color: Color, axis_color: Color
    ) -> None:
        """Draw the grid around a point, fading with distance."""
        cell_size = self._cell_size
        # Rounds half up, like JavaScript.
        cell_x, cell_z = (math.floor(center[k] / cell_size + 0.5) for k in (0, 2))
        if (cell_x, cell_z) != self._center_cell:
            self._center_cell = cell_x, cell_z
            self._set_lines(cell_x, cell_z, line_color, axis_color)
        fade = (center[0], 0.0, center[2], cell_size * GRID_CELLS / 2)
        self._lines.draw(eye, width=1, fade=fade)

    def _set_lines(
        self, cell_x: int, cell_z: int, line_color: Color, axis_color: Color
    ) -> None:
        """Set the segments of the grid lines around the cell ``cell_x``, ``cell_z``."""
        half_cells, cell_size = GRID_CELLS // 2, self._cell_size
        segments = []
        for i in range(-half_cells, half_cells + 1):
            x, z = (cell_x + i) * cell_size, (cell_z + i) * cell_size
            # Lines are split into segments: those that pass the camera are less exact.
            for k in range(-half_cells, half_cells, SEGMENT_CELLS):
                # Segments further out have faded to nothing.
                if math.hypot(i, min(abs(k), abs(k + SEGMENT_CELLS))) > half_cells:
                    continue
                left, right = (
                    (cell_x + k) * cell_size,
                    (cell_x + k + SEGMENT_CELLS) * cell_size,
                )
                back, front = (
                    (cell_z + k) * cell_size,
                    (cell_z + k + SEGMENT_CELLS) * cell_size,
                )
                x_color = line_color if cell_x + i else axis_color
                z_color = line_color if cell_z + i else axis_color
                segments.append((x, back, x, front, *x_color))
                segments.append((left, z, right, z, *z_color))
        segment_table = np.array(segments, np.float64)
        ends = np.zeros((2, len(segment_table), 3))
        ends[0][:, [0, 2]], ends[1][:, [0, 2]] = (
            segment_table[:, :2],
            segment_table[:, 2:4],
        )
        alpha = np.full((len(segment_table), 1), 255.0)
        colors = np.concatenate([segment_table[:, 4:], alpha], axis=1)
        self._lines.set_segments(ends[0], ends[1], colors)


class TrailRenderer:
    """Draws the trails of roots and feet around a frame, with ground contacts."""

    def __init__(self, device: Device, codes: FloatArray) -> None:
        self._codes = codes
        self._trails, self._rings = LineRenderer(device), LineRenderer(device)

    def update(
        self,
        poses: Sequence[PosedTake],
        sample: int,
        color_of_take: ColorOfTake,
        contact_color: Color,
        shown_layers: frozenset[str],
    ) -> None:
        """Set the trails and contact rings of posed takes at a sample."""
        trail_segments = [np.zeros((0, 10))]
        ring_segments = [np.zeros((0, 10))]
        for pose in poses:
            if "trails" in shown_layers and pose.trail_joints:
                trail_segments.append(
                    self._trail_segments(
                        pose, sample, color_of_take(pose.index), contact_color
                    )
                )
            for contact_entry in pose.manifest_entry.get("contacts") or []:
                code = self._codes[sample : sample + 1]
                if (
                    "contacts" in shown_layers
                    and is_in_spans(code, contact_entry["spans"])[0]
                ):
                    contact_position = pose.positions[contact_entry["joint"]]
                    ring_segments.append(
                        _ring_segments(
                            contact_position, pose.bounds_radius * 0.045, contact_color
                        )
                    )
        for lines, segments in (
            (self._trails, trail_segments),
            (self._rings, ring_segments),
        ):
            segment_table = np.concatenate(segments)
            lines.set_segments(
                segment_table[:, :3], segment_table[:, 3:6], segment_table[:, 6:]
            )

    def _trail_segments(
        self, pose: PosedTake, sample: int, trail_color: Color, contact_color: Color
    ) -> FloatArray:
        """Return the line segments of a take's trails, which fade with time."""
        first_sample = max(0, sample - TRAIL_SAMPLES)
        last_sample = min(len(self._codes) - 1, sample + TRAIL_SAMPLES)
        paths = pose.trail_positions(first_sample, last_sample)
        samples = np.arange(first_sample, last_sample + 1)
        time_weights = 1 - np.abs(samples - sample) / (TRAIL_SAMPLES + 1)
        alpha = 255 * time_weights * np.where(samples <= sample, 0.95, 0.4)
        is_in_contact = pose.contacts_at(self._codes[samples])
        segments = []
        # Joint by joint, the order in which the page draws them.
        for column in range(len(pose.trail_joints)):
            segment_colors = np.where(
                is_in_contact[1:, column, None], contact_color, trail_color
            )
            trail_positions = paths[:, column]
            segments.append(
                np.concatenate(
                    [
                        trail_positions[:-1],
                        trail_positions[1:],
                        segment_colors,
                        alpha[1:, None],
                    ],
                    axis=1,
                )
            )
        return np.concatenate(segments)

    def draw(self, eye: EyeMatrices) -> None:
        """Draw the trails, and the rings around contacts."""
        self._trails.draw(eye, width=2)
        self._rings.draw(eye, width=3)


def _ring_segments(center: FloatArray, radius: float, color: Color) -> FloatArray:
    """Return the segments of a ring around a contact."""
    angles = np.arange(25) * np.pi / 12
    circle = np.stack([np.cos(angles), np.zeros(25), np.sin(angles)], axis=1)
    points = center + radius * circle
    segment_colors = np.tile([*color, 255.0], (24, 1))
    return np.concatenate([points[:-1], points[1:], segment_colors], axis=1)


class ContactShadow:
    """Draws contact shadows of geometry near the ground."""

    def __init__(self, device: Device) -> None:
        gl, moderngl = device.gl, device.moderngl
        self._device = device
        program, size = device.program, (SHADOW_PIXELS, SHADOW_PIXELS)
        self._blur_program = program("shadow.js", "SCREEN_VERTEX", "BLUR_FRAGMENT")
        self._ground_program = program("shadow.js", "GROUND_VERTEX", "GROUND_FRAGMENT")
        self._height_map = gl.depth_texture(size)
        self._height_map.compare_func = ""
        self._height_map.filter = moderngl.NEAREST, moderngl.NEAREST
        self._height_buffer = gl.framebuffer([], self._height_map)
        self._blurred_maps = [gl.texture(size, 1) for _ in range(2)]
        for texture in (self._height_map, *self._blurred_maps):
            texture.repeat_x = texture.repeat_y = False
        self._blur_buffers = [
            gl.framebuffer([height_map]) for height_map in self._blurred_maps
        ]
        self._shadow_area = (0.0, 0.0, 1.0)

    def cast(self, view: CameraView, draw: Callable[[EyeMatrices], None]) -> bool:
        """Render the shadow map around the camera target.

        Returns whether there is a shadow.
        """
        half_width = view.radius * SHADOW_WIDTH
        if view.floor < -SHADOW_OFFSET * view.radius:
            return False
        texel_size = 2 * half_width / SHADOW_PIXELS
        x, z = (
            math.floor(view.target[k] / texel_size + 0.5) * texel_size for k in (0, 2)
        )
        self._shadow_area = x, z, half_width
        gl, moderngl = self._device.gl, self._device.moderngl
        self._height_buffer.use()
        self._height_buffer.clear(depth=1.0)
        gl.enable(moderngl.DEPTH_TEST)
        eye = _upward_view(view, x, z, half_width)
        draw(eye)
        gl.disable(moderngl.DEPTH_TEST)
        blur_radius = 1.5 / SHADOW_PIXELS
        blur_passes = (
            (self._blur_buffers[0], self._height_map, (blur_radius, 0.0), 1.0),
            (self._blur_buffers[1], self._blurred_maps[0], (0.0, blur_radius), 0.0),
        )
        for framebuffer, source, blur_step, heights in blur_passes:
            framebuffer.use()
            source.use(0)
            self._device.set_uniforms(
                self._blur_program, eye, reach=blur_step, heights=heights
            )
            self._blur_program["source"].value = 0
            self._device.draw_generated(self._blur_program, 3)
        return True

    def draw(self, eye: EyeMatrices) -> None:
        """Draw the contact shadows on the ground."""
        self._blurred_maps[1].use(0)
        self._device.set_uniforms(self._ground_program, eye, area=self._shadow_area)
        self._ground_program["map"].value = 0
        strip = self._device.moderngl.TRIANGLE_STRIP
        self._device.draw_generated(self._ground_program, 4, strip)


def _upward_view(
    view: CameraView, x: float, z: float, half_width: float
) -> EyeMatrices:
    """Return the matrices of an orthographic camera that looks up from below ground."""
    height = SHADOW_HEIGHT * view.radius
    depth = -SHADOW_DEPTH * height
    depth_scale = 2 / (height - depth)
    from_world = np.array(
        [[1, 0, 0, -x], [0, 0, 1, -z], [0, -1, 0, 0], [0, 0, 0, 1]], np.float64
    )
    matrix = np.array(
        [
            [1 / half_width, 0, 0, -x / half_width],
            [0, 0, 1 / half_width, -z / half_width],
            [0, depth_scale, 0, -1 - depth * depth_scale],
            [0, 0, 0, 1],
        ]
    )
    return EyeMatrices(
        from_world,
        matrix,
        SHADOW_PIXELS,
        SHADOW_PIXELS,
        SHADOW_PIXELS / (2 * half_width),
        view.light,
    )

"""Draws wide lines and camera-facing balls."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from animtool.core.array_types import FloatArray
from animtool.preview.pictures.camera import EyeMatrices
from animtool.preview.pictures.device import Array, Device, TextureTable
from animtool.preview.streams import Array as Values

ByteArray = npt.NDArray[np.uint8]
# Coordinate of points without a position: outside of every view.
OFFSCREEN_COORDINATE = 1e30


def srgb_colors(color: npt.ArrayLike) -> FloatArray:
    """Return linear colors from 0 to 1 as sRGB, 0 to 255.

    >>> srgb_colors([0.0, 1.0]).tolist()
    [0.0, 255.0]
    """
    srgb: FloatArray = np.maximum(np.asarray(color, np.float64), 0) ** (1 / 2.2) * 255
    return srgb


def repeat_color(count: int, color: FloatArray) -> ByteArray:
    """Return one color repeated for each of N points ``(N, 3)``."""
    return np.repeat(np.clip(color, 0, 255).astype(np.uint8)[None], count, axis=0)


class LineRenderer:
    """Draws line segments in one draw call."""

    def __init__(self, device: Device) -> None:
        self._device, self._table = device, TextureTable(device)
        self._program = device.program("lines.js")
        self.segment_count = 0

    def set_segments(
        self, begins: FloatArray, ends: FloatArray, colors: FloatArray
    ) -> None:
        """Replace the segments to draw, from starts to ends ``(N, 3)``.

        Args:
            begins: Start points ``(N, 3)``.
            ends: End points ``(N, 3)``.
            colors: With alpha, per segment or one for all ``(N or 1, 4)``, 0 to 255.
        """
        self.segment_count = len(begins)
        texels = np.zeros((self.segment_count, 3, 4), np.float32)
        texels[:, 0, :3], texels[:, 1, :3] = begins, ends
        texels[:, 2] = np.asarray(colors) / 255
        if self.segment_count:
            self._table.upload(texels.reshape(-1, 4))

    def draw(
        self,
        eye: EyeMatrices,
        width: float = 1.5,
        world_width: float = 0.0,
        fade: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0),
    ) -> None:
        """Draw the segments with widths in pixels or metres, faded around a point."""
        if not self.segment_count:
            return
        self._device.set_uniforms(
            self._program,
            eye,
            size=(eye.width, eye.height),
            width=width,
            world=world_width,
            perMetre=eye.pixels_per_metre,
            fade=fade,
            segments=self._table,
        )
        self._device.draw_generated(self._program, self.segment_count * 6)


class VertexBuffer:
    """A vertex buffer that grows on demand."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self.buffer: Any = None

    def write(self, values: Array) -> bool:
        """Replace the buffer's contents; return whether it was reallocated."""
        value_bytes = np.ascontiguousarray(values).tobytes()
        if self.buffer is not None and self.buffer.size >= len(value_bytes):
            self.buffer.write(value_bytes)
            return False
        if self.buffer is not None:
            self.buffer.release()
        self.buffer = self._device.gl.buffer(value_bytes or b"\0" * 4, dynamic=True)
        return True


class SpriteRenderer:
    """Draws camera-facing balls for particles, markers and joints."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._program = device.program("points.js")
        self._buffers = [VertexBuffer(device) for _ in range(3)]
        self._array: Any = None
        self._point_count = 0

    def set_points(
        self, positions: Array, colors: ByteArray, radii: Array | None = None
    ) -> None:
        """Replace the points to draw ``(N, 3)``, with colors and radii."""
        self._point_count = len(positions)
        sizes = np.zeros(self._point_count) if radii is None else radii
        arrays = np.asarray(positions, "<f4"), colors, np.asarray(sizes, "<f4")
        if not self._point_count:
            return
        buffer_arrays = zip(self._buffers, arrays, strict=True)
        if any([buffer.write(array) for buffer, array in buffer_arrays]):
            buffer_formats = ("3f", "point"), ("3f1", "color"), ("1f", "own")
            self._array = self._device.gl.vertex_array(
                self._program,
                [
                    (buffer.buffer, *buffer_format)
                    for buffer, buffer_format in zip(
                        self._buffers, buffer_formats, strict=True
                    )
                ],
            )

    def draw(self, eye: EyeMatrices, radius: float, min_radius: float) -> None:
        """Draw the balls with a radius [m], at least ``min_radius`` [px]."""
        if not self._point_count:
            return
        self._device.set_uniforms(
            self._program,
            eye,
            radius=radius,
            least=min_radius * 2,
            perMetre=eye.pixels_per_metre,
        )
        self._array.render(self._device.moderngl.POINTS, vertices=self._point_count)


def move_missing_offscreen(values: Values) -> FloatArray:
    """Return positions ``(N, 3)`` with missing points moved far out of view."""
    points = np.reshape(values, (-1, 3)).astype(np.float64)
    return np.where(np.isfinite(points), points, OFFSCREEN_COORDINATE)

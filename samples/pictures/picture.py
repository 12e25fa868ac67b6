"""Pictures of surfaces in plain numpy: a depth buffer, soft light and a PNG file."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Directions to the lights in the camera's frame, and their strengths.
LIGHTS = (
    ((-0.5, 0.65, 0.8), 0.72),
    ((0.85, 0.1, 0.55), 0.24),
    ((0.1, 0.6, -0.8), 0.20),
)
AMBIENT = 0.20
GLOSS, SHARPNESS = 0.10, 24.0
COARSE = 3  # of 256 levels of a channel, to keep files small
GROUND = np.array([0.86, 0.88, 0.90])


@dataclass(frozen=True, slots=True)
class Surface:
    """Triangles with a colour at every point.

    Attributes:
        points: ``(V, 3)``.
        triangles: ``(T, 3)`` indices.
        colours: ``(V, 3)`` from 0 to 1.
    """

    points: Array
    triangles: NDArray[np.int64]
    colours: Array


@dataclass(frozen=True, slots=True)
class Camera:
    """A camera without perspective.

    Attributes:
        centre: What stands in the middle of the picture ``(3,)``.
        height: What the picture shows from top to bottom, in the surface's unit.
        turn: Degrees that it goes round to the left of what faces +Z.
        lift: Degrees that it looks down.
    """

    centre: tuple[float, float, float]
    height: float
    turn: float = 0.0
    lift: float = 0.0

    def axes(self) -> Array:
        """Return the rows right, up and towards the camera ``(3, 3)``."""
        turn, lift = np.radians([self.turn, self.lift])
        towards = np.array(
            [np.sin(turn) * np.cos(lift), np.sin(lift), np.cos(turn) * np.cos(lift)]
        )
        right = np.array([np.cos(turn), 0.0, -np.sin(turn)])
        return np.stack([right, np.cross(towards, right), towards])


def ribbons(
    strands: Array, colour: Sequence[float], width: float, camera: Camera
) -> Surface:
    """Return strands ``(S, K, 3)`` as ribbons that face a camera, tips thin."""
    count, length = strands.shape[:2]
    along = np.gradient(strands, axis=1)
    passthrough = np.cross(along, camera.axes()[2])
    passthrough /= np.maximum(np.linalg.norm(passthrough, axis=-1), 1e-12)[..., None]
    half = 0.5 * width * np.linspace(1.0, 0.3, length)[:, None]
    points = np.stack(
        [strands - half * passthrough, strands + half * passthrough], axis=2
    )
    first = 2 * (np.arange(count)[:, None] * length + np.arange(length - 1)).ravel()
    ring = [first, first + 1, first + 3, first + 2]
    faces = triangulated(np.stack(ring, axis=1))
    # Every strand a little lighter or darker, so that they can be told apart.
    shade = 0.85 + 0.3 * (np.arange(count) * 0.618 % 1)
    colours = np.repeat(shade[:, None] * np.array(colour), 2 * length, axis=0)
    return Surface(points.reshape(-1, 3), faces, np.clip(colours, 0, 1))


def triangulated(faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the triangles of faces ``(N, 3 or 4)``, -1 filling triangles."""
    if faces.shape[1] == 3:
        return faces
    second = faces[faces[:, 3] >= 0][:, [0, 2, 3]]
    return np.concatenate([faces[:, :3], second])


def point_normals(points: Array, triangles: NDArray[np.int64]) -> Array:
    """Return unit normals of points, weighted by area ``(V, 3)``."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    across = np.cross(b - a, c - a)
    made = np.zeros_like(points)
    for k in range(3):
        np.add.at(made, triangles[:, k], across)
    return np.asarray(made / np.maximum(np.linalg.norm(made, axis=1), 1e-15)[:, None])


def render(surfaces: list[Surface], camera: Camera, size: tuple[int, int]) -> Array:
    """Return a picture ``(height, width, 3)``, every pixel of four samples."""
    height, width = 2 * size[0], 2 * size[1]
    depth = np.full((height, width), -np.inf)
    # Of what is seen at a sample: its normal and its colour.
    data = np.zeros((height, width, 6))
    axes, scale = camera.axes(), height / camera.height
    for surface in surfaces:
        seen = (surface.points - np.array(camera.centre)) @ axes.T
        normals = point_normals(surface.points, surface.triangles) @ axes.T
        place = seen[:, :2] * [scale, -scale] + [width / 2, height / 2]
        own = np.concatenate([normals, surface.colours], axis=1)
        corners = place[surface.triangles]
        low = np.maximum(np.floor(corners.min(1)), 0).astype(int)
        high = np.minimum(np.ceil(corners.max(1)), [width, height]).astype(int)
        for i in np.flatnonzero((low < high).all(1)):
            triangle = surface.triangles[i]
            box = (slice(low[i, 1], high[i, 1]), slice(low[i, 0], high[i, 0]))
            _fill(corners[i], seen[triangle, 2], own[triangle], box, depth, data)
    image = np.broadcast_to(GROUND, (height, width, 3)).copy()
    hit = depth > -np.inf
    image[hit] = _lit(data[hit, :3], data[hit, 3:])
    return image.reshape(size[0], 2, size[1], 2, 3).mean((1, 3))


def _fill(
    place: Array,
    near: Array,
    own: Array,
    box: tuple[slice, slice],
    depth: Array,
    data: Array,
) -> None:
    """Put a triangle into the samples of a box where it is the nearest so far."""
    (ax, ay), (bx, by), (cx, cy) = place.tolist()
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    if abs(area) < 1e-12:
        return
    x = np.arange(box[1].start, box[1].stop) + 0.5
    y = (np.arange(box[0].start, box[0].stop) + 0.5)[:, None]
    v = ((x - ax) * (cy - ay) - (y - ay) * (cx - ax)) / area
    w = ((y - ay) * (bx - ax) - (x - ax) * (by - ay)) / area
    u = 1.0 - v - w
    z = u * near[0] + v * near[1] + w * near[2]
    shown = (u >= -1e-9) & (v >= -1e-9) & (w >= -1e-9) & (z > depth[box])
    if not shown.any():
        return
    depth[box][shown] = z[shown]
    shares = np.stack([u[shown], v[shown], w[shown]], axis=-1)
    data[box][shown] = shares @ own


def _lit(normals: Array, colours: Array) -> Array:
    normals = normals / np.maximum(np.linalg.norm(normals, axis=1), 1e-12)[:, None]
    light = np.full(len(normals), AMBIENT)
    gloss = np.zeros(len(normals))
    for towards, strength in LIGHTS:
        to = np.array(towards) / np.linalg.norm(towards)
        light += strength * np.maximum(normals @ to, 0.0)
        half = to + np.array([0.0, 0.0, 1.0])
        half /= np.linalg.norm(half)
        gloss += strength * np.maximum(normals @ half, 0.0) ** SHARPNESS
    return np.clip(colours * light[:, None] + GLOSS * gloss[:, None], 0, 1)


def write_png(path: Path, image: Array) -> None:
    """Write a picture with values from 0 to 1, 8 bits a channel."""
    steps = np.round(np.clip(image, 0, 1) * 255 / COARSE) * COARSE
    pixels = np.minimum(steps, 255).astype(np.uint8)
    height, width = pixels.shape[:2]
    rows = pixels.reshape(height, -1)
    # Filter 2 of the format: every row less the one above it.
    above = np.concatenate([np.zeros_like(rows[:1]), rows[:-1]])
    lines = np.concatenate([np.full((height, 1), 2, np.uint8), rows - above], axis=1)

    def chunk(kind: bytes, data: bytes) -> bytes:
        body = kind + data
        return struct.pack(">I", len(data)) + body + struct.pack(">I", zlib.crc32(body))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + chunk(b"IDAT", zlib.compress(lines.tobytes(), 9))
        + chunk(b"IEND", b"")
    )

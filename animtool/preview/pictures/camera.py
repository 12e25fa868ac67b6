"""Camera of pages and pictures: orbits a target, or looks through a shot camera.

It is the rule of the page's `camera.js`, so that both show the same.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import field
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.record import dataclass
from animtool.preview.pictures.data import Streams
from animtool.preview.pictures.pose import composed

# Tangent of half the angle of view.
HALF = 0.3
# Distance to show all, of that where it touches the edges.
ROOM = 1.15
STEEP = math.pi / 2 - 1e-3
# Yaw and pitch [rad].
PRESETS = {
    "home": (0.6, 0.18),
    "front": (0.0, 0.0),
    "side": (math.pi / 2, 0.0),
    "back": (math.pi, 0.0),
    "top": (0.0, STEEP),
}
# From where the key light comes, in the frame of the view.
LIGHT = np.array([-0.35, 0.65, 0.68])


class Bounds:
    """Axis-aligned bounds."""

    def __init__(self) -> None:
        self.low, self.high = np.full(3, np.inf), np.full(3, -np.inf)

    def add(self, points: FloatArray) -> None:
        """Grow to contain points ``(N, 3)``, ignoring non-finite ones."""
        points = np.reshape(points, (-1, 3))
        points = points[np.isfinite(points).all(axis=1)]
        if len(points):
            self.low = np.minimum(self.low, points.min(axis=0))
            self.high = np.maximum(self.high, points.max(axis=0))

    def join(self, other: Bounds, shift: FloatArray | float = 0.0) -> None:
        """Grow to contain other bounds, shifted."""
        if not other.empty:
            self.add(np.stack([other.low, other.high]) + shift)

    @property
    def empty(self) -> bool:
        """Whether it contains nothing."""
        return not self.low[0] <= self.high[0]

    @property
    def center(self) -> FloatArray:
        """Center of the bounds."""
        if self.empty:
            return np.array([0.0, 0.5, 0.0])
        center: FloatArray = (self.low + self.high) / 2
        return center

    @property
    def radius(self) -> float:
        """Half of the diagonal."""
        if self.empty:
            return 1.0
        return max(float(np.linalg.norm(self.high - self.low)) / 2, 1e-3)


@dataclass(slots=True)
class Eye:
    """Camera matrices for drawing.

    Attributes:
        view: camera_from_world ``(4, 4)``.
        view_projection: To clip space ``(4, 4)``.
        width: Of its picture [px].
        height: Likewise.
        per_metre: Pixels of a metre at distance 1.
        light: From where the key light comes, in the frame of the view.
        opacity: Of what is laid over other things.
    """

    view: FloatArray
    view_projection: FloatArray
    width: int
    height: int
    per_metre: float
    light: FloatArray
    opacity: float = 1.0

    def between(self, near: float, far: float, opacity: float = 1.0) -> Eye:
        """Return the camera with its depth mapped to part of the range 0 to 1."""
        matrix = self.view_projection.copy()
        matrix[2] = (far - near) * matrix[2] + (far + near - 1) * matrix[3]
        return Eye(
            self.view,
            matrix,
            self.width,
            self.height,
            self.per_metre,
            self.light,
            opacity,
        )


@dataclass(slots=True)
class CameraView:
    """An orbit camera with the size of its picture.

    Attributes:
        width: Of the picture [px].
        height: Likewise.
        inset: What text covers at the top [px]: the picture is centred beneath.
        yaw: Around the target [rad].
        pitch: Likewise.
        distance: From it [m].
        target: What it looks at [m].
        radius: Of what is shown [m].
        floor: Height of the lowest of that [m].
        follow: Whether it goes along with a joint.
        followed: Where that was last.
        light: From where the key light comes, in its frame.
    """

    width: int
    height: int
    inset: int = 0
    yaw: float = PRESETS["home"][0]
    pitch: float = PRESETS["home"][1]
    distance: float = 4.0
    target: FloatArray = field(default_factory=lambda: np.array([0.0, 0.9, 0.0]))
    radius: float = 1.0
    floor: float = 0.0
    follow: bool = False
    followed: FloatArray | None = None
    light: FloatArray = field(default_factory=lambda: LIGHT / np.linalg.norm(LIGHT))

    def _back(self, distance: float) -> FloatArray:
        level = math.cos(self.pitch) * distance
        x, z = math.sin(self.yaw) * level, math.cos(self.yaw) * level
        return np.array([x, math.sin(self.pitch) * distance, z])

    @property
    def _covered(self) -> float:
        return min(self.inset / self.height, 0.5)

    def _halves(self) -> tuple[float, float]:
        """Return half of the unobstructed width and height at distance 1."""
        aspect, free = self.width / self.height, 1 - self._covered
        high = HALF * max(1.0, free / aspect)
        return high / free * aspect, high

    def frame(self, box: Bounds) -> None:
        """Frame the given bounds."""
        self.target, self.radius = box.center, box.radius
        self.floor = float(box.low[1])
        self.distance = self.radius * 0.2
        if box.empty:
            return
        world = _look_at(self._back(1.0), np.zeros(3))
        wide, high = self._halves()
        for corner in np.ndindex(2, 2, 2):
            point = np.where(corner, box.low, box.high) - self.target
            x, y, z = world[:3, :3].T @ point
            for half, size in ((wide, x), (high, y)):
                self.distance = max(self.distance, (abs(size) / half + z) * ROOM)

    def track(self, position: FloatArray | None) -> None:
        """Follow a joint horizontally."""
        if self.follow and position is not None and self.followed is not None:
            self.target = self.target + (position - self.followed) * [1.0, 0.0, 1.0]
        self.followed = position

    def eye(self) -> Eye:
        """Return the camera matrices."""
        half_wide, half_high = self._halves()
        half_high /= 1 - self._covered
        world = _look_at(self.target + self._back(self.distance), self.target)
        away = self.distance
        projection = _perspective(
            half_wide, half_high, away * 0.01, away + self.radius * 100
        )
        projection[1, 2] = self._covered
        return self._eye(world, projection, half_high)

    def through(
        self, camera: Mapping[str, Any], streams: Streams, sample: int
    ) -> Eye | None:
        """Return the view through a shot camera; None if its transform is invalid."""
        t, r = (streams.at(camera[part], sample) for part in "tr")
        if not (len(t) and len(r)):
            return None
        world = composed(t.astype(np.float64), r.astype(np.float64), None)
        wide, high = camera["aperture_mm"]
        focal = camera.get("focal")
        length = camera["focal_mm"] if focal is None else streams.at(focal, sample)[0]
        aspect = self.width / self.height
        # Its gate fills the picture, which shows more where its shape is another.
        half_high = max(high, wide / aspect) / (2 * length)
        away = self.radius * 4
        projection = _perspective(
            half_high * aspect, half_high, away * 0.01, away + self.radius * 100
        )
        return self._eye(world, projection, half_high)

    def _eye(self, world: FloatArray, projection: FloatArray, half_high: float) -> Eye:
        rotation = world[:3, :3].T
        view = np.eye(4)
        view[:3, :3], view[:3, 3] = rotation, -rotation @ world[:3, 3]
        size = self.width, self.height
        per_metre = self.height / (2 * half_high)
        return Eye(view, projection @ view, *size, per_metre, self.light)


def _look_at(eye: FloatArray, target: FloatArray) -> FloatArray:
    """Return world_from_camera; the camera looks along -Z."""
    z = (eye - target) / np.linalg.norm(eye - target)
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    world = np.eye(4)
    world[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    world[:3, 3] = eye
    return world


def _perspective(wide: float, high: float, near: float, far: float) -> FloatArray:
    """Return a projection matrix; half sizes are at distance 1."""
    out = np.zeros((4, 4))
    out[0, 0], out[1, 1] = 1 / wide, 1 / high
    out[2, 2], out[2, 3] = (far + near) / (near - far), 2 * far * near / (near - far)
    out[3, 2] = -1.0
    return out

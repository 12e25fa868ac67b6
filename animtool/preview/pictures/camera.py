"""Camera of pages and pictures: orbits a target, or looks through a shot camera.

It follows the rules of the page's `camera.js`, so that both show the same.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import field, replace
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.record import dataclass
from animtool.preview.pictures.data import StreamReader
from animtool.preview.pictures.pose import compose_matrices

# Tangent of half the field of view.
HALF_FOV_TANGENT = 0.3
# Distance of the camera relative to the one where the subject touches the frame.
FRAMING_MARGIN = 1.15
MAX_PITCH = math.pi / 2 - 1e-3
# Yaw and pitch [rad].
VIEW_ANGLES = {
    "home": (0.6, 0.18),
    "front": (0.0, 0.0),
    "side": (math.pi / 2, 0.0),
    "back": (math.pi, 0.0),
    "top": (0.0, MAX_PITCH),
}
# Direction to the key light, in view space.
KEY_LIGHT = np.array([-0.35, 0.65, 0.68])
KEY_LIGHT /= np.linalg.norm(KEY_LIGHT)


class Bounds:
    """An axis-aligned bounding box that grows by points."""

    def __init__(self) -> None:
        self.low, self.high = np.full(3, np.inf), np.full(3, -np.inf)

    def add(self, points: FloatArray) -> None:
        """Grow to contain points ``(N, 3)``, ignoring non-finite ones."""
        points = np.reshape(points, (-1, 3))
        points = points[np.isfinite(points).all(axis=1)]
        if len(points):
            self.low = np.minimum(self.low, points.min(axis=0))
            self.high = np.maximum(self.high, points.max(axis=0))

    def union_with(self, other_bounds: Bounds, shift: FloatArray | float = 0.0) -> None:
        """Grow to contain other bounds, shifted by an offset [m]."""
        if not other_bounds.is_empty:
            self.add(np.stack([other_bounds.low, other_bounds.high]) + shift)

    @property
    def is_empty(self) -> bool:
        """Whether the bounds contain no point."""
        return not self.low[0] <= self.high[0]

    @property
    def center(self) -> FloatArray:
        """Center of the box ``(3,)`` [m]; 0.5 m above the origin if it is empty."""
        if self.is_empty:
            return np.array([0.0, 0.5, 0.0])
        center: FloatArray = (self.low + self.high) / 2
        return center

    @property
    def radius(self) -> float:
        """Half the diagonal of the box [m], at least 1 mm; 1 m if it is empty."""
        if self.is_empty:
            return 1.0
        return max(float(np.linalg.norm(self.high - self.low)) / 2, 1e-3)


@dataclass(slots=True)
class EyeMatrices:
    """View and projection matrices of a camera, with the size of its picture.

    Attributes:
        view: camera_from_world ``(4, 4)``.
        view_projection: clip_from_world ``(4, 4)``.
        width: Width of the picture [px].
        height: Height of the picture [px].
        pixels_per_metre: Pixels per metre at distance 1.
        light: Direction to the key light, in view space.
        opacity: Opacity of overlays [1].
    """

    view: FloatArray
    view_projection: FloatArray
    width: int
    height: int
    pixels_per_metre: float
    light: FloatArray
    opacity: float = 1.0

    def with_depth_range(
        self, near: float, far: float, opacity: float = 1.0
    ) -> EyeMatrices:
        """Return the camera with its depth mapped to a range within 0 to 1."""
        matrix = self.view_projection.copy()
        matrix[2] = (far - near) * matrix[2] + (far + near - 1) * matrix[3]
        return replace(self, view_projection=matrix, opacity=opacity)


@dataclass(slots=True)
class CameraView:
    """An orbit camera and the size of its picture.

    Attributes:
        width: Width of the picture [px].
        height: Height of the picture [px].
        top_inset: Height covered by text at the top [px]; the view is centred below.
        yaw: Angle around the vertical axis [rad].
        pitch: Angle above the horizon [rad].
        distance: Distance from the target [m].
        target: Point that it looks at [m].
        radius: Radius of the framed bounds [m].
        floor: Height of the lowest point of the bounds [m].
        is_following: Whether it follows a joint.
        followed_position: Last position of the followed joint [m].
        light: Direction to the key light, in view space.
    """

    width: int
    height: int
    top_inset: int = 0
    yaw: float = VIEW_ANGLES["home"][0]
    pitch: float = VIEW_ANGLES["home"][1]
    distance: float = 4.0
    target: FloatArray = field(default_factory=lambda: np.array([0.0, 0.9, 0.0]))
    radius: float = 1.0
    floor: float = 0.0
    is_following: bool = False
    followed_position: FloatArray | None = None
    light: FloatArray = field(default_factory=KEY_LIGHT.copy)

    @property
    def _covered_fraction(self) -> float:
        """Fraction of the picture height that text covers."""
        return min(self.top_inset / self.height, 0.5)

    def _half_size(self) -> tuple[float, float]:
        """Return half the unobstructed width and height of the view at distance 1."""
        aspect, free_fraction = self.width / self.height, 1 - self._covered_fraction
        half_height = HALF_FOV_TANGENT * max(1.0, free_fraction / aspect)
        return half_height / free_fraction * aspect, half_height

    def frame_bounds(self, bounds: Bounds) -> None:
        """Aim the camera at bounds, at a distance at which all of them are visible."""
        self.target, self.radius = bounds.center, bounds.radius
        self.floor = float(bounds.low[1])
        self.distance = self.radius * 0.2
        if bounds.is_empty:
            return
        world_from_camera = _look_at_matrix(
            spherical_offset(self.yaw, self.pitch), np.zeros(3)
        )
        half_width, half_height = self._half_size()
        for corner in np.ndindex(2, 2, 2):
            point = np.where(corner, bounds.low, bounds.high) - self.target
            x, y, z = world_from_camera[:3, :3].T @ point
            for half_size, coordinate in ((half_width, x), (half_height, y)):
                self.distance = max(
                    self.distance, (abs(coordinate) / half_size + z) * FRAMING_MARGIN
                )

    def follow_position(self, position: FloatArray) -> None:
        """Move the camera horizontally with a joint, if it is following one."""
        if self.is_following and self.followed_position is not None:
            shift = position - self.followed_position
            self.target = self.target + shift * [1.0, 0.0, 1.0]
        self.followed_position = position

    def eye_matrices(self) -> EyeMatrices:
        """Return the matrices of the orbit camera, centred below the caption."""
        half_width, half_height = self._half_size()
        half_height /= 1 - self._covered_fraction
        distance = self.distance
        offset = spherical_offset(self.yaw, self.pitch, distance)
        world_from_camera = _look_at_matrix(self.target + offset, self.target)
        projection = _perspective_matrix(
            half_width, half_height, distance * 0.01, distance + self.radius * 100
        )
        projection[1, 2] = self._covered_fraction
        return self._projected_matrices(world_from_camera, projection, half_height)

    def view_through(
        self, camera: Mapping[str, Any], streams: StreamReader, sample: int
    ) -> EyeMatrices | None:
        """Return the view through a shot camera; None if its transform is missing."""
        world_from_camera = shot_camera_matrix(camera, streams, sample)
        if world_from_camera is None:
            return None
        aperture_width, aperture_height = camera["aperture_mm"]
        focal = camera.get("focal")
        focal_length = (
            camera["focal_mm"]
            if focal is None
            else streams.sample_values(focal, sample)[0]
        )
        aspect = self.width / self.height
        # The picture contains the whole film gate, and more if the aspect ratios
        # differ.
        half_height = max(aperture_height, aperture_width / aspect) / (2 * focal_length)
        distance = self.radius * 4
        far = distance + self.radius * 100
        projection = _perspective_matrix(
            half_height * aspect, half_height, distance * 0.01, far
        )
        return self._projected_matrices(world_from_camera, projection, half_height)

    def _projected_matrices(
        self, world_from_camera: FloatArray, projection: FloatArray, half_height: float
    ) -> EyeMatrices:
        """Return the matrices of a camera with a world transform and projection."""
        rotation = world_from_camera[:3, :3].T
        view = np.eye(4)
        view[:3, :3], view[:3, 3] = (rotation, -rotation @ world_from_camera[:3, 3])
        size = self.width, self.height
        pixels_per_metre = self.height / (2 * half_height)
        return EyeMatrices(view, projection @ view, *size, pixels_per_metre, self.light)


def spherical_offset(yaw: float, pitch: float, distance: float = 1.0) -> FloatArray:
    """Return the vector ``(3,)`` of a length that points along a yaw and pitch [rad].

    >>> spherical_offset(0.0, 0.0, 2.0).tolist()
    [0.0, 0.0, 2.0]
    """
    horizontal_distance = math.cos(pitch) * distance
    x = math.sin(yaw) * horizontal_distance
    z = math.cos(yaw) * horizontal_distance
    return np.array([x, math.sin(pitch) * distance, z])


def shot_camera_matrix(
    camera: Mapping[str, Any], streams: StreamReader, sample: int
) -> FloatArray | None:
    """Return the world_from_camera matrix of a shot camera; None if it is missing."""
    translation, rotation = (
        streams.sample_values(camera[component], sample) for component in "tr"
    )
    if not (len(translation) and len(rotation)):
        return None
    return compose_matrices(
        translation.astype(np.float64), rotation.astype(np.float64), None
    )


def _look_at_matrix(eye: FloatArray, target: FloatArray) -> FloatArray:
    """Return the world_from_camera matrix of a camera aimed at a point along -Z."""
    z = (eye - target) / np.linalg.norm(eye - target)
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    world_from_camera = np.eye(4)
    world_from_camera[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    world_from_camera[:3, 3] = eye
    return world_from_camera


def _perspective_matrix(
    half_width: float, half_height: float, near: float, far: float
) -> FloatArray:
    """Return a perspective projection matrix from half sizes at distance 1."""
    matrix = np.zeros((4, 4))
    matrix[0, 0], matrix[1, 1] = 1 / half_width, 1 / half_height
    matrix[2, 2] = (far + near) / (near - far)
    matrix[2, 3] = 2 * far * near / (near - far)
    matrix[3, 2] = -1.0
    return matrix

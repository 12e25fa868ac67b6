"""Calibrated cameras: lens, pose, and the projection of points to pixels.

References:
    Brown, Decentering distortion of lenses, 1966; the rational model is that of
    OpenCV's ``calib3d``.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault
from animtool.core.old_names import rename_attributes
from animtool.core.record import dataclass
from animtool.core.units import UpAxis

# Name of a single unnamed camera.
DEFAULT_CAMERA_NAME = "cam00"
# How far a matrix may be from a rotation: files round to three digits and more.
ROTATION_TOLERANCE = 5e-3
_NEWTON_STEPS = 20
MAX_CAMERAS = 256
# Largest side of an image [px].
MAX_IMAGE_SIDE = 100_000


@dataclass(frozen=True, slots=True)
class Camera:
    """A calibrated camera.

    The camera looks along +z, with x right and y down: ``x_camera = R x_world + t``.

    Attributes:
        name: Unique among the cameras.
        focal: Focal lengths along x and y [px].
        centre: Principal point [px].
        rotation: ``R`` ``(3, 3)``.
        translation: ``t`` [m] ``(3,)``.
        size: Width and height of the image [px]; None where unknown.
        skew: Skew of the image axes [px].
        distortion: k1 k2 p1 p2 k3 k4 k5 k6 [1], as OpenCV has them.
    """

    name: str
    focal: tuple[float, float]
    centre: tuple[float, float]
    rotation: FloatArray
    translation: FloatArray
    size: tuple[int, int] | None = None
    skew: float = 0.0
    distortion: tuple[float, ...] = (0.0,) * 8

    @property
    def position(self) -> FloatArray:
        """Camera position in the world [m] ``(3,)``."""
        return -self.rotation.T @ self.translation

    @property
    def kernel_parameters(self) -> FloatArray:
        """Focal lengths, centre, skew, lens, pose, image size for kernels ``(27,)``."""
        lens_parameters = (*self.focal, *self.centre, self.skew, *self.distortion)
        size = self.size or (0, 0)
        pose_parameters = (self.rotation.ravel(), self.translation)
        return np.concatenate([lens_parameters, *pose_parameters, size])


rename_attributes(Camera, numbers="kernel_parameters")


@dataclass(frozen=True, slots=True)
class Cameras:
    """All calibrated cameras of a capture, with the up axis of their world.

    Attributes:
        cameras: Cameras in the order of the file.
        up: The up axis of the world.
        path: File of the cameras; empty if there is none.
        notices: Warnings and notes about the file.
    """

    cameras: tuple[Camera, ...]
    up: UpAxis = UpAxis.Y
    path: str = ""
    notices: tuple[Fault, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the cameras, in the order of `cameras`."""
        return tuple(camera.name for camera in self.cameras)

    def __len__(self) -> int:
        """Return the number of cameras."""
        return len(self.cameras)


def nearest_rotation(matrix: FloatArray) -> FloatArray | None:
    """Return the rotation nearest to a matrix ``(3, 3)``; None if it is far from one.

    >>> nearest_rotation(np.diag([1.0, 1.0, -1.0])) is None
    True
    """
    if not np.isfinite(matrix).all() or abs(matrix).max() > 2:
        return None
    u, _, v = np.linalg.svd(matrix)
    rotation: FloatArray = u @ v
    if np.linalg.det(rotation) < 0:
        return None
    return rotation if abs(rotation - matrix).max() <= ROTATION_TOLERANCE else None


def camera_parameters(cameras: Sequence[Camera]) -> FloatArray:
    """Return each camera's `Camera.kernel_parameters` as a row ``(C, 27)``."""
    return np.array([camera.kernel_parameters for camera in cameras]).reshape(-1, 27)


def distort(camera: Camera, points: FloatArray) -> FloatArray:
    """Return image plane points at depth 1 with lens distortion applied ``(…, 2)``."""
    k1, k2, p1, p2, k3, k4, k5, k6 = camera.distortion
    x, y = points[..., 0], points[..., 1]
    squared_radius = x * x + y * y
    radial = 1 + squared_radius * (k1 + squared_radius * (k2 + squared_radius * k3))
    radial /= 1 + squared_radius * (k4 + squared_radius * (k5 + squared_radius * k6))
    x_distorted = x * radial + 2 * p1 * x * y + p2 * (squared_radius + 2 * x * x)
    y_distorted = y * radial + p1 * (squared_radius + 2 * y * y) + 2 * p2 * x * y
    return np.stack([x_distorted, y_distorted], axis=-1)


def project(camera: Camera, points: FloatArray) -> FloatArray:
    """Return the pixels ``(…, 2)`` of points in the world [m] ``(…, 3)``.

    Pixels are NaN where a point is missing or behind the camera.

    >>> camera = Camera("a", (100.0, 100.0), (50.0, 40.0), np.eye(3), np.zeros(3))
    >>> project(camera, np.array([0.1, 0.0, 1.0])).tolist()
    [60.0, 40.0]
    """
    # Overflows are outside any image.
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        camera_points = points @ camera.rotation.T + camera.translation
        depth = np.where(camera_points[..., 2] > 0, camera_points[..., 2], np.nan)
        distorted_points = distort(camera, camera_points[..., :2] / depth[..., None])
        x, y = np.moveaxis(distorted_points, -1, 0)
        pixel_x = camera.focal[0] * x + camera.skew * y + camera.centre[0]
        pixel_y = camera.focal[1] * y + camera.centre[1]
    pixels = np.stack([pixel_x, pixel_y], axis=-1)
    pixels[~np.isfinite(pixels).all(axis=-1)] = np.nan
    return pixels


def pixel_rays(camera: Camera, pixels: FloatArray) -> FloatArray:
    """Return ray directions in the camera's frame, at depth 1, of pixels ``(…, 2)``.

    Rays are NaN where no direction near a pixel projects to it.
    """
    # Overflows are invalid, and become NaN below.
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        undistorted_points = _undistort(camera, pixels)
    undistorted_points[~np.isfinite(undistorted_points).all(axis=-1)] = np.nan
    return undistorted_points


def _undistort(camera: Camera, pixels: FloatArray) -> FloatArray:
    """Undistort pixels to points at depth 1 with Newton's method."""
    y = (pixels[..., 1] - camera.centre[1]) / camera.focal[1]
    x = (pixels[..., 0] - camera.centre[0] - camera.skew * y) / camera.focal[0]
    target = np.stack([x, y], axis=-1)
    points = target.copy()
    for _ in range(_NEWTON_STEPS if any(camera.distortion) else 0):
        # Finite differences are exact enough for the slopes of the lens: every step is
        # checked with the lens model itself.
        increment, distorted_points = 1e-6, distort(camera, points)
        derivative_x, derivative_y = (
            (distort(camera, points + np.array(offset)) - distorted_points) / increment
            for offset in ([increment, 0], [0, increment])
        )
        residual = distorted_points - target
        determinant = (
            derivative_x[..., 0] * derivative_y[..., 1]
            - derivative_x[..., 1] * derivative_y[..., 0]
        )
        determinant = np.where(determinant > 0, determinant, np.nan)
        newton_step = np.stack(
            [
                residual[..., 0] * derivative_y[..., 1]
                - residual[..., 1] * derivative_y[..., 0],
                residual[..., 1] * derivative_x[..., 0]
                - residual[..., 0] * derivative_x[..., 1],
            ],
            axis=-1,
        )
        points -= newton_step / determinant[..., None]
    return points

"""Camera poses in the conventions of other programs.

Cameras that disagree may be right in another convention: quaternions with w last, poses
of cameras in the world, camera positions, transposed matrices, or the axes of OpenGL.
Observations tell which: in the right convention all rays meet.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from animtool.capture.cameras.camera import Camera
from animtool.core.record import dataclass
from animtool.maths.so3 import from_matrix, to_matrix

# Axes of OpenGL and Blender, which look along -z with y up, in those of a camera.
_CAMERA_FROM_OPENGL = np.diag([1.0, -1.0, -1.0])
# Another convention must make the rays meet this many times better.
MIN_IMPROVEMENT = 10.0


@dataclass(frozen=True, slots=True)
class Convention:
    """Deviation of a file's camera poses from ``x_camera = R x_world + t``."""

    is_w_last: bool = False  # quaternions are [x, y, z, w]
    is_transposed: bool = False  # the rotation is from the camera to the world
    is_camera_position: bool = False  # the translation is the camera's position
    has_opengl_axes: bool = False  # the camera looks along -z with y up

    def convert(self, camera: Camera) -> Camera:
        """Return the camera with its pose converted from this convention."""
        rotation = camera.rotation
        if self.is_w_last:
            x, y, z, w = from_matrix(rotation)
            rotation = to_matrix(np.array([w, x, y, z]))
        if self.is_transposed:
            rotation = rotation.T
        if self.has_opengl_axes:
            rotation = _CAMERA_FROM_OPENGL @ rotation
        translation = camera.translation
        if self.is_camera_position:
            translation = -rotation @ translation
        elif self.has_opengl_axes:
            translation = _CAMERA_FROM_OPENGL @ translation
        return replace(camera, rotation=rotation, translation=translation)

    @property
    def description_and_remedy(self) -> tuple[str, str]:
        """The difference, and how to correct the file, as text for messages."""
        problems, remedies = [], []
        if self.is_w_last:
            problems.append("quaternions are [x, y, z, w]")
            remedies.append("write [w, x, y, z]")
        if self.is_transposed and self.is_camera_position:
            problems.append("poses place the camera in the world")
            remedies.append("invert the poses")
        elif self.is_transposed:
            problems.append("rotations are from the camera to the world")
            remedies.append("transpose the rotations")
        elif self.is_camera_position:
            problems.append("translations are positions of the cameras")
            remedies.append("write -R * position as translation")
        if self.has_opengl_axes:
            problems.append("cameras look along -z with y up, as in Blender and OpenGL")
            remedies.append("negate the y and z axes of the cameras")
        return " and ".join(problems), ", ".join(remedies)


# The simplest first.
CONVENTIONS = [
    Convention(*flags)
    for flags in sorted(itertools.product((False, True), repeat=4), key=sum)
][1:]


def better_convention(
    cameras: Sequence[Camera],
    measure_noise: Callable[[Sequence[Camera]], float],
    max_noise: float,
) -> tuple[Convention, float, float] | None:
    """Return the convention in which cameras agree, its noise, and the noise as read.

    ``measure_noise`` returns by how much the rays of cameras miss each other [px];
    ``max_noise`` is its largest value for cameras that agree. Return None if no
    convention is `MIN_IMPROVEMENT` times better than the poses as read.
    """
    noise_as_read = measure_noise(cameras)
    convention_noises = [
        measure_noise([c.convert(camera) for camera in cameras]) for c in CONVENTIONS
    ]
    best_index = int(np.argmin(convention_noises))
    if convention_noises[best_index] > min(max_noise, noise_as_read / MIN_IMPROVEMENT):
        return None
    return CONVENTIONS[best_index], convention_noises[best_index], noise_as_read

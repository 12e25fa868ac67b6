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
_OPENGL_AXES = np.diag([1.0, -1.0, -1.0])
# Another convention must make the rays meet this many times better.
MIN_IMPROVEMENT = 10.0


@dataclass(frozen=True, slots=True)
class Convention:
    """A convention of camera poses that differs from ``x_camera = R x_world + t``."""

    w_last: bool = False  # quaternions are [x, y, z, w]
    transposed: bool = False  # the rotation is from the camera to the world
    position: bool = False  # the translation is the camera's position in the world
    opengl: bool = False  # the camera looks along -z with y up

    def camera(self, camera: Camera) -> Camera:
        """Convert a camera whose pose was read without regard to this convention."""
        rotation = camera.rotation
        if self.w_last:
            x, y, z, w = from_matrix(rotation)
            rotation = to_matrix(np.array([w, x, y, z]))
        if self.transposed:
            rotation = rotation.T
        if self.opengl:
            rotation = _OPENGL_AXES @ rotation
        translation = camera.translation
        if self.position:
            translation = -rotation @ translation
        elif self.opengl:
            translation = _OPENGL_AXES @ translation
        return replace(camera, rotation=rotation, translation=translation)

    @property
    def texts(self) -> tuple[str, str]:
        """Descriptions of this convention and of its correction, for messages."""
        written, remedies = [], []
        if self.w_last:
            written.append("quaternions are [x, y, z, w]")
            remedies.append("write [w, x, y, z]")
        if self.transposed and self.position:
            written.append("poses place the camera in the world")
            remedies.append("invert the poses")
        elif self.transposed:
            written.append("rotations are from the camera to the world")
            remedies.append("transpose the rotations")
        elif self.position:
            written.append("translations are positions of the cameras")
            remedies.append("write -R * position as translation")
        if self.opengl:
            written.append("cameras look along -z with y up, as in Blender and OpenGL")
            remedies.append("negate the y and z axes of the cameras")
        return " and ".join(written), ", ".join(remedies)


# The simplest first.
CONVENTIONS = sorted(
    (Convention(*flags) for flags in itertools.product((False, True), repeat=4)),
    key=lambda c: c.w_last + c.transposed + c.position + c.opengl,
)[1:]


def better_convention(
    cameras: Sequence[Camera], noise: Callable[[Sequence[Camera]], float], limit: float
) -> tuple[Convention, float, float] | None:
    """Return the convention in which cameras agree, its noise, and the noise as read.

    ``noise`` measures how far the rays of cameras miss each other [px]; ``limit`` is
    its largest value for cameras that agree. Return None if no convention is
    `MIN_IMPROVEMENT` times better than the poses as read.
    """
    as_read = noise(cameras)
    noises = [noise([c.camera(camera) for camera in cameras]) for c in CONVENTIONS]
    best_index = int(np.argmin(noises))
    if noises[best_index] > min(limit, as_read / MIN_IMPROVEMENT):
        return None
    return CONVENTIONS[best_index], noises[best_index], as_read

"""Placement of a skeleton on a stage: position, rotation, scale."""

from __future__ import annotations

import math
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.record import dataclass
from animtool.maths import so3

if TYPE_CHECKING:
    from animtool.core.units import UpAxis

# Parts of a placement nearer to the identity than this are rounding of files [m], [1].
IDENTITY_TOLERANCE = 1e-7


@dataclass(frozen=True, eq=False)
class Placement:
    """A rigid motion and a uniform scale: ``p -> translation + rotation · size · p``.

    Attributes:
        translations: Positions ``(F, 3)`` [m]; F is 1 if nothing moves.
        rotations: Unit quaternions ``(F, 4)``.
        sizes: Scale factors ``(F,)``, positive.
    """

    translations: FloatArray
    rotations: FloatArray
    sizes: FloatArray

    @staticmethod
    def from_rotation(rotation: FloatArray) -> Placement:
        """Return a placement that only rotates, by a quaternion ``(4,)``."""
        return Placement(np.zeros((1, 3)), np.asarray(rotation)[None], np.ones(1))

    @property
    def is_animated(self) -> bool:
        """Whether there is a transform for each frame instead of one for all."""
        return len(self.sizes) > 1

    @property
    def size(self) -> float:
        """Scale of bone lengths, from the first frame.

        If the scale is animated, the roots contain the ratio to the first frame's.
        """
        return float(self.sizes[0])

    @cached_property
    def is_identity(self) -> bool:
        """Whether the placement moves nothing in any frame, up to rounding."""
        max_distance = np.abs(self.translations).max(initial=0.0)
        rotation_error = 1.0 - np.abs(self.rotations[:, 3]).min(initial=1.0)
        scale_error = np.abs(self.sizes - 1.0).max(initial=0.0)
        # For a small angle, w differs from 1 by an eighth of its square.
        return bool(
            max_distance <= IDENTITY_TOLERANCE
            and rotation_error <= IDENTITY_TOLERANCE**2
            and scale_error <= IDENTITY_TOLERANCE
        )

    def transform_points(self, points: FloatArray) -> FloatArray:
        """Transform points by the placement; ``(F, N, 3)`` if it is animated."""
        sizes, rotations, translations = self._broadcastable_parts()
        # Skipping identities keeps values bit-exact, including the signs of zeros.
        scaled_points = points if (self.sizes == 1.0).all() else sizes * points
        rotated_points = so3.rotate(rotations, scaled_points)
        if not self.translations.any():
            return rotated_points
        return np.asarray(rotated_points + translations)

    def transform_rotations(self, rotations: FloatArray) -> FloatArray:
        """Rotate quaternions by the placement; ``(F, N, 4)`` if it is animated."""
        return so3.multiply(self._broadcastable_parts()[1], rotations)

    def _broadcastable_parts(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return sizes, rotations and translations that broadcast over points."""
        if not self.is_animated:
            return self.sizes[0], self.rotations[0], self.translations[0]
        sizes = self.sizes[:, None, None]
        return sizes, self.rotations[:, None], self.translations[:, None]

    def inverse(self) -> Placement:
        """Return the placement that undoes this one, frame by frame."""
        inverse_rotations = so3.conjugate(self.rotations)
        inverse_translations = (
            so3.rotate(inverse_rotations, self.translations) / self.sizes[:, None]
        )
        return Placement(-inverse_translations, inverse_rotations, 1.0 / self.sizes)

    def after(self, other: Placement) -> Placement:
        """Return the composition: another placement, then this one."""
        scaled_translations = self.sizes[:, None] * other.translations
        return Placement(
            so3.rotate(self.rotations, scaled_translations) + self.translations,
            so3.multiply(self.rotations, other.rotations),
            self.sizes * other.sizes,
        )

    def first(self) -> Placement:
        """Return the placement of the first frame."""
        return Placement(self.translations[:1], self.rotations[:1], self.sizes[:1])

    def simplified(self) -> Placement:
        """Return a placement of a single frame if all frames are equal, else itself."""
        if not self.is_animated:
            return self
        deviations = [
            np.abs(self.translations - self.translations[:1]).max(),
            np.abs(self.sizes / self.sizes[0] - 1.0).max(),
            1.0 - np.abs((self.rotations * self.rotations[:1]).sum(axis=-1)).min(),
        ]
        limits = [IDENTITY_TOLERANCE, IDENTITY_TOLERANCE, IDENTITY_TOLERANCE**2]
        is_constant = all(
            deviation <= limit
            for deviation, limit in zip(deviations, limits, strict=True)
        )
        return self.first() if is_constant else self

    def description(self) -> str:
        """Return the first frame's placement in words and numbers."""
        x, y, z = (round(v, 4) + 0.0 for v in self.translations[0].tolist())
        cosine = min(1.0, abs(float(self.rotations[0, 3])))
        angle = round(math.degrees(2 * math.acos(cosine)), 2)
        return f"at ({x:g}, {y:g}, {z:g}) m, rotated by {angle:g}°"

    def split(self, up: UpAxis) -> tuple[Placement, Placement]:
        """Split into heading and position, and a preceding scale and up-axis rotation.

        The second holds the scale, and the rotation from the skeleton axis nearest to
        up, such as Y under a Z-up stage, to up itself. The first holds the rest:
        position, heading, and slope.
        """
        axis = np.array(up.vector)
        local_up = so3.rotate(so3.conjugate(self.rotations[0]), axis)
        axis_index = int(np.abs(local_up).argmax())
        nearest_axis = np.zeros(3)
        nearest_axis[axis_index] = np.copysign(1.0, local_up[axis_index])
        righting_rotation = so3.shortest_rotation(nearest_axis, axis)
        righting_rotations = np.repeat(righting_rotation[None], len(self.sizes), axis=0)
        scale_and_righting = Placement(
            np.zeros((len(righting_rotations), 3)), righting_rotations, self.sizes
        )
        remaining_rotations = so3.multiply(
            self.rotations, so3.conjugate(righting_rotation)
        )
        heading_placement = Placement(
            self.translations, remaining_rotations, np.ones(len(righting_rotations))
        )
        return heading_placement, scale_and_righting


def placement_matrices(placement: Placement, unit: float = 1.0) -> FloatArray:
    """Return the matrices of a placement for column vectors ``(F, 4, 4)``.

    unit: unit of the vectors [m].
    """
    matrices = np.tile(np.eye(4), (len(placement.sizes), 1, 1))
    linear = so3.to_matrix(placement.rotations)
    matrices[:, :3, :3] = linear * placement.sizes[:, None, None]
    matrices[:, :3, 3] = placement.translations / unit
    return matrices

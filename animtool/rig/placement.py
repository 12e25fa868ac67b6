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

# A part of a placement nearer to none than this is the rounding of files [m], [1].
SAME = 1e-7


@dataclass(frozen=True, eq=False)
class Placement:
    """A rigid motion and an even scale: ``p -> translation + rotation · size · p``.

    Attributes:
        translations: ``(F, 3)`` [m]; F is 1 where nothing moves.
        rotations: Unit quaternions ``(F, 4)``.
        sizes: ``(F,)``, positive.
    """

    translations: FloatArray
    rotations: FloatArray
    sizes: FloatArray

    @staticmethod
    def from_rotation(rotation: FloatArray) -> Placement:
        """Return a placement that only rotates, by a quaternion ``(4,)``."""
        return Placement(np.zeros((1, 3)), np.asarray(rotation)[None], np.ones(1))

    @property
    def moves(self) -> bool:
        """Whether it is animated."""
        return len(self.sizes) > 1

    @property
    def size(self) -> float:
        """The scale that lengths of bones are multiplied by, that of the first frame.

        Where the scale changes, the roots hold what is left of it.
        """
        return float(self.sizes[0])

    @cached_property
    def is_none(self) -> bool:
        """Whether it is the identity."""
        away = np.abs(self.translations).max(initial=0.0)
        turned = 1.0 - np.abs(self.rotations[:, 3]).min(initial=1.0)
        sized = np.abs(self.sizes - 1.0).max(initial=0.0)
        # For a small angle, w differs from 1 by an eighth of its square.
        return bool(away <= SAME and turned <= SAME**2 and sized <= SAME)

    def points(self, points: FloatArray) -> FloatArray:
        """Return transformed points; ``(F, N, 3)`` if animated."""
        sizes, rotations, translations = self._parts()
        # Skipping identities keeps values bit-exact, signs of zeros included.
        sized = points if (self.sizes == 1.0).all() else sizes * points
        turned = so3.rotate(rotations, sized)
        if not self.translations.any():
            return turned
        return np.asarray(turned + translations)

    def rotated(self, rotations: FloatArray) -> FloatArray:
        """Return transformed rotations; ``(F, N, 4)`` if animated."""
        return so3.multiply(self._parts()[1], rotations)

    def _parts(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        if not self.moves:
            return self.sizes[0], self.rotations[0], self.translations[0]
        return (
            self.sizes[:, None, None],
            self.rotations[:, None],
            self.translations[:, None],
        )

    def inverse(self) -> Placement:
        """Return the inverse placement."""
        back = so3.conjugate(self.rotations)
        shifts = so3.rotate(back, self.translations) / self.sizes[:, None]
        return Placement(-shifts, back, 1.0 / self.sizes)

    def after(self, other: Placement) -> Placement:
        """Return the composition: another placement, then this one."""
        moved = self.sizes[:, None] * other.translations
        return Placement(
            so3.rotate(self.rotations, moved) + self.translations,
            so3.multiply(self.rotations, other.rotations),
            self.sizes * other.sizes,
        )

    def first(self) -> Placement:
        """Return the placement of the first frame."""
        return Placement(self.translations[:1], self.rotations[:1], self.sizes[:1])

    def steady(self) -> Placement:
        """Return a single frame if all frames are equal."""
        if not self.moves:
            return self
        spans = [
            np.abs(self.translations - self.translations[:1]).max(),
            np.abs(self.sizes / self.sizes[0] - 1.0).max(),
            1.0 - np.abs((self.rotations * self.rotations[:1]).sum(axis=-1)).min(),
        ]
        limits = [SAME, SAME, SAME**2]
        same = all(a <= limit for a, limit in zip(spans, limits, strict=True))
        return self.first() if same else self

    def described(self) -> str:
        """Describe the first frame in words and numbers."""
        x, y, z = (round(v, 4) + 0.0 for v in self.translations[0].tolist())
        cosine = min(1.0, abs(float(self.rotations[0, 3])))
        angle = round(math.degrees(2 * math.acos(cosine)), 2)
        return f"at ({x:g}, {y:g}, {z:g}) m, rotated by {angle:g}°"

    def split(self, up: UpAxis) -> tuple[Placement, Placement]:
        """Split into heading and position, and a preceding scale and up-axis fix.

        The second holds the scale, and the turn that brings the axis of a skeleton that
        is nearest to up, such as Y under a stage of Z up, to up itself. The first holds
        all else: the way and the heading, and a slope.
        """
        axis = np.array(up.vector)
        local_up = so3.rotate(so3.conjugate(self.rotations[0]), axis)
        k = int(np.abs(local_up).argmax())
        nearest = np.zeros(3)
        nearest[k] = np.copysign(1.0, local_up[k])
        righting = _shortest(nearest, axis)
        frames = np.repeat(righting[None], len(self.sizes), axis=0)
        sized = Placement(np.zeros((len(frames), 3)), frames, self.sizes)
        back = so3.multiply(self.rotations, so3.conjugate(righting))
        stands = Placement(self.translations, back, np.ones(len(frames)))
        return stands, sized


def _shortest(one: FloatArray, other: FloatArray) -> FloatArray:
    """Return the shortest rotation between two axes; about X if opposite."""
    if (one == -other).all():
        return np.array([1.0, 0.0, 0.0, 0.0])
    return so3.between(one, other)


def placement_matrix(placement: Placement, unit: float = 1.0) -> FloatArray:
    """Return the placement of the first frame for column vectors ``(4, 4)``.

    unit: of the lengths of those vectors [m].
    """
    matrix = np.eye(4)
    matrix[:3, :3] = so3.to_matrix(placement.rotations[0])
    if placement.size != 1.0:
        matrix[:3, :3] *= placement.size
    matrix[:3, 3] = placement.translations[0] / unit
    return matrix

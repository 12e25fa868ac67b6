"""The neutral face, and the ways in which the blend shapes of the head move it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from head_mesh import (
    CANTHUS,
    LID_HALF_WIDTH,
    MOUTH_HALF_WIDTH,
    lid_elevation,
    lip_line,
)
from head_surface import EYE, LID_RADIUS, head_field
from numpy.typing import NDArray
from solids import Array, Ints, falloff, gradient, length, smoothstep

HINGE = np.array([0.0, 0.172, 0.008])  # of the jaw
CORNER = (0.0245, 0.1426, 0.083)  # of the mouth
LID_SPREAD = 8  # steps of smoothing
LEAST_ANGLE = 2e-4
BROW_HOLDERS = 6  # points of the skin that hold one of a brow


@dataclass(frozen=True)
class Sculptor:
    """The neutral face and what shapes ask about it.

    Attributes:
        points: ``(V, 3)``.
        part: Name of the part of each point.
        side: 1 on an upper lid or lip, -1 on a lower one.
        share: Way from the middle of the mouth to the corner, or along an eye.
        mirror: Index of each point's mirror image.
        pairs: Neighbours ``(E, 2)``.
    """

    points: Array
    part: NDArray[np.str_]
    side: Array
    share: Array
    mirror: Ints
    pairs: Ints

    def near(self, centre: Sequence[float], radii: Sequence[float]) -> Array:
        """Return how near soft points are, 1 at the centre and 0 off the radii."""
        hard = np.isin(self.part, ["upper_teeth", "lower_teeth", "tongue"])
        return np.where(hard, 0.0, falloff(self.points, centre, radii))

    def pull(
        self, centre: Sequence[float], radii: Sequence[float], move: Sequence[float]
    ) -> Array:
        """Return a pull that fades out at the radii ``(V, 3)``."""
        return self.near(centre, radii)[:, None] * np.array(move)

    def pulls(
        self, centre: Sequence[float], radii: Sequence[float], move: Sequence[float]
    ) -> Array:
        """Return a pull on the left and its mirror image, added up ``(V, 3)``."""
        left = self.pull(centre, radii, move)
        return left + self.mirrored(left)

    def slid(self, move: Array) -> Array:
        """Return a move with the skin kept as far from the skull as they were."""
        loose = (self.part == "skin") & (move != 0).any(1)
        there = self.points[loose] + move[loose]
        off = head_field(self.points[loose]) - head_field(there)
        share = 0.85 * smoothstep(0.004, 0.014, np.abs(self.lip_distance()[loose]))
        away = gradient(head_field, there)
        made = move.copy()
        made[loose] += np.clip(off * share, -0.006, 0.006)[:, None] * away
        return made

    def lip_distance(self) -> Array:
        """Return how far a point is above the line of the lips, large off the mouth."""
        x, y, z = self.points.T
        off = np.maximum(np.abs(x) - MOUTH_HALF_WIDTH, 0.0)
        above = y - lip_line(np.minimum(np.abs(x), MOUTH_HALF_WIDTH))
        sign = np.where(above < 0, -1.0, 1.0)
        far = np.sqrt(above**2 + off**2 + np.maximum(0.07 - z, 0) ** 2)
        mouth = np.isin(self.part, ["lip", "pocket"])
        return np.where(mouth, above, sign * far)

    def jaw(self) -> Array:
        """Return how far a point follows the jaw, from 0 to 1."""
        x, y, z = self.points.T
        x = np.abs(x)
        across = x / MOUTH_HALF_WIDTH
        back = (z - HINGE[2]) / (CORNER[2] - HINGE[2])
        seam = HINGE[1] + (CORNER[1] - HINGE[1]) * np.clip(back, 0, 1.2)
        lips = lip_line(np.minimum(x, MOUTH_HALF_WIDTH))
        line = lips + (seam - lips) * smoothstep(0.6, 1.3, across)
        band = 0.0012 + 0.0068 * np.clip(across, 0, 1) ** 2.2
        band = band + 0.024 * smoothstep(0.9, 2.3, across)
        low = smoothstep(-band, band, line - y)
        throat = smoothstep(0.062, 0.112, y + 0.45 * (z - 0.03))
        made = low * throat * smoothstep(-0.035, 0.012, z)
        corner = 0.5 * np.abs(self.share) ** 2.2
        lip = np.where(self.side > 0, corner, 1 - corner)
        lip = np.where(self.side == 0, 0.5, lip)
        made = np.where(np.isin(self.part, ["lip", "pocket"]), lip, made)
        for part, follows in (("lower_teeth", 1.0), ("tongue", 0.92)):
            made = np.where(self.part == part, follows, made)
        return np.where(
            np.isin(self.part, ["upper_teeth", "ear", "brow", "rim", "lining"]),
            0.0,
            made,
        )

    def jaw_turn(self, angle: float) -> Array:
        """Return the way of the jaw as it opens by an angle ``(V, 3)``."""
        turn = angle * self.jaw()
        return turned(self.points, HINGE, turn)

    def lids(
        self, upper: Callable[[Array], Array], lower: Callable[[Array], Array]
    ) -> Array:
        """Return lids turned about the left eyeball ``(V, 3)``.

        Args:
            upper: Angle up of the upper lid's rim, from the share of the way along it.
            lower: That of the lower lid.
        """
        share, up, weight = self.lid_weights()
        angle = self.spread(np.where(up, upper(share), lower(share)) * weight)
        return turned(self.points, EYE, -angle)

    def spread(self, angle: Array) -> Array:
        """Return a lid's angle smoothed over the skin, the rims kept."""
        skin = self.part == "skin"
        count = np.bincount(self.pairs.ravel(), minlength=len(angle))
        first, second = self.pairs.T
        for _ in range(LID_SPREAD):
            total = np.bincount(first, angle[second], len(angle))
            total += np.bincount(second, angle[first], len(angle))
            mean = total / np.maximum(count, 1)
            angle = np.where(skin, 0.5 * (angle + mean), angle)
        return np.where(np.abs(angle) < LEAST_ANGLE, 0.0, angle)

    def lid_weights(self) -> tuple[Array, NDArray[np.bool_], Array]:
        """Return share of the way along the left eye, whether upper lid, and weight."""
        off = self.points - EYE
        far = length(off)
        side = np.arcsin(np.clip(off[:, 0] / far, -1, 1))
        lift = np.arctan2(off[:, 1], off[:, 2])
        share = np.clip(side / LID_HALF_WIDTH, -1, 1)
        inner = np.isin(self.part, ["rim", "lining"])
        share = np.where(inner, self.share, share)
        up = np.where(inner, self.side > 0, lift > CANTHUS * share)
        rim = lid_elevation(share, up)
        beyond = np.where(up, lift - rim, rim - lift)
        weight = smoothstep(np.radians(58), np.radians(4), beyond)
        weight = weight * smoothstep(LID_RADIUS + 0.013, LID_RADIUS + 0.001, far)
        weight = weight * (off[:, 2] > 0) * (self.part == "skin")
        weight = np.where(
            inner & (self.points[:, 0] > 0),
            np.abs(self.side),
            weight,
        )
        return share, np.asarray(up), weight

    @cached_property
    def brow_holders(self) -> tuple[Ints, Ints, Array]:
        """Points of the left brow ``(B,)``, skin that holds each, and its share."""
        skin = np.flatnonzero(self.part == "skin")
        left = np.flatnonzero((self.part == "brow") & (self.points[:, 0] > 0))
        away = length(self.points[left][:, None] - self.points[skin][None])
        near = np.argsort(away, axis=1, kind="stable")[:, :BROW_HOLDERS]
        share = 1 / (np.take_along_axis(away, near, axis=1) + 1e-4) ** 2
        return left, skin[near], share / share.sum(1, keepdims=True)

    def with_brows(self, move: Array) -> Array:
        """Return a move in which the brows go with the skin beneath them."""
        left, holders, share = self.brow_holders
        made = move.copy()
        for brow, held in (
            (left, holders),
            (self.mirror[left], self.mirror[holders]),
        ):
            made[brow] = np.einsum("bk,bkc->bc", share, move[held])
        return made

    def mirrored(self, move: Array) -> Array:
        """Return the mirror image of a move."""
        return np.asarray(move[self.mirror] * [-1.0, 1.0, 1.0])


def turned(points: Array, centre: Array, angle: Array) -> Array:
    """Return the way of points turned about the X axis through a centre ``(V, 3)``."""
    _, y, z = (points - centre).T
    c, s = np.cos(angle) - 1, np.sin(angle)
    return np.column_stack([np.zeros(len(points)), c * y - s * z, s * y + c * z])

"""Surfaces that change their shape, as what particles run into."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Protocol

import numpy as np

from animtool._types import FloatArray, IntArray
from animtool.errors import Fault
from animtool.ranges import Range
from animtool.sim.colliders.collider import (
    Collider,
    Depenetration,
    Friction,
    Restitution,
    range_problems,
)
from animtool.sim.colliders.shapes import Mesh


class SheetMotion(Protocol):
    """Where a surface is over time; it does not feel what runs into it."""

    def points(self, t: float) -> FloatArray:
        """Return its points ``(N, 3)`` at a time [s] [m].

        Times may go back as far as the last one that `forget` was given.
        """

    def triangles(self, t: float) -> IntArray:
        """Return corners of its triangles ``(T, 3)`` at such a time."""

    def forget(self, t: float) -> None:
        """Take note that no time before one will be asked for [s]."""


@dataclass(frozen=True, slots=True, eq=False)
class Sheet:
    """A surface in motion, and what touching it does.

    Particles meet it from both sides of its thickness.

    Attributes:
        motion: Where it is.
        radius: Half its thickness, above 0 [m].
        closed: Whether it is the skin of a volume, which is met from outside only.
        name: For messages.
        restitution: Share of the speed into the surface that comes back [0, 1].
        friction: Coulomb's coefficient [1].
        depenetration: How fast particles that start inside are moved out [m/s].
    """

    motion: SheetMotion
    radius: Annotated[float, Range("above 0", "SIM020", 0, reached=False, finite=True)]
    closed: bool = False
    name: str = ""
    restitution: Restitution = 0.0
    friction: Friction = 0.0
    depenetration: Depenetration = 1.0

    def problems(self) -> list[tuple[str, str]]:
        """Return what of it makes no sense: an option, and why."""
        found = range_problems(self)
        return [one for one in found if one[0] == "radius"] or found

    def faults(self, where: str) -> list[Fault]:
        """Return what of it makes no sense (SIM020)."""
        return [Fault("SIM020", why, where=where) for _, why in self.problems()]

    def collider(self, points: FloatArray, triangles: IntArray) -> Collider:
        """Return it as it stands at a time, as a collider that rests.

        Args:
            points: ``(N, 3)`` [m].
            triangles: ``(T, 3)``.
        """
        shape = Mesh(points, triangles)
        if not self.closed:
            shape = hull(points, triangles, self.radius)
        return Collider(
            shape,
            name=self.name,
            restitution=self.restitution,
            friction=self.friction,
            margin=self.radius if self.closed else 0.0,
            depenetration=self.depenetration,
        )


def hull(points: FloatArray, triangles: IntArray, radius: float) -> Mesh:
    """Return a closed mesh about a surface: both its sides, and its rim.

    Args:
        points: ``(N, 3)`` [m].
        triangles: ``(T, 3)``.
        radius: Half the thickness [m].

    >>> flat = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    >>> made = hull(flat, np.array([[0, 1, 2]]), 0.1)
    >>> len(made.points), len(made.triangles)
    (6, 8)
    """
    return Mesh(
        hull_points(points, triangles, radius), hull_faces(triangles, len(points))
    )


def hull_points(points: FloatArray, triangles: IntArray, radius: float) -> FloatArray:
    """Return the points of a hull: of the front, then of the back ``(2 N, 3)`` [m]."""
    a, b, c = points[triangles].swapaxes(0, 1)
    across = np.cross(b - a, c - a)
    corners, weights = triangles.T.ravel(), np.tile(across, (3, 1)).T
    sums = [np.bincount(corners, each, len(points)) for each in weights]
    normals: FloatArray = np.stack(sums, axis=1)
    sizes = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = normals / np.where(sizes > 0, sizes, 1.0) * radius
    return np.concatenate([points + normals, points - normals])


def hull_faces(triangles: IntArray, count: int) -> IntArray:
    """Return the triangles of a hull about a surface of so many points ``(M, 3)``."""
    sides = np.concatenate([triangles[:, [k, (k + 1) % 3]] for k in range(3)])
    size = [count, 1]
    alone = ~np.isin(sides @ size, sides[:, ::-1] @ size)
    first, second = sides[alone].T
    rim = [
        np.stack([second, first, first + count], axis=1),
        np.stack([second, first + count, second + count], axis=1),
    ]
    back = triangles[:, ::-1] + count
    return np.concatenate([triangles, back, *rim])

"""Deforming surfaces, and contact of particles with them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, ClassVar, Protocol, TypeAlias

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.options import Checked, Range, above, inherits_docs
from animtool.core.record import dataclass
from animtool.sim.colliders.collider import Collider
from animtool.sim.colliders.shapes import Mesh
from animtool.sim.contact import Material


class SheetMotion(Protocol):
    """A surface over time; particles do not push it."""

    def points(self, t: float) -> FloatArray:
        """Return its points ``(N, 3)`` at a time [s] [m].

        Times may go back as far as the last one that `forget` was given.
        """

    def triangles(self, t: float) -> IntArray:
        """Return the corners of its triangles ``(T, 3)`` at a time [s]."""

    def forget(self, t: float) -> None:
        """Release buffered states before a time [s]."""


@inherits_docs
@dataclass(frozen=True, slots=True, eq=False)
class Sheet(Material, Checked):
    """A deforming surface and its contact material.

    Particles meet it from both sides of its thickness.

    Attributes:
        motion: Where it is.
        radius: Half its thickness, above 0 [m].
        closed: Whether it is the skin of a volume, which is met from outside only.
        name: For messages.
        depenetration: How fast particles that start inside are moved out [m/s].
    """

    code: ClassVar[str] = "SIM020"

    motion: SheetMotion
    radius: Annotated[float, Range("above 0", "SIM020", 0, reached=False, finite=True)]
    closed: bool = False
    name: str = ""
    depenetration: Annotated[float, above(0, "SIM020")] = 1.0

    def problems(self) -> list[tuple[str, str]]:
        """Return invalid options, each with a message."""
        faults = Checked.problems(self)
        return [one for one in faults if one[0] == "radius"] or faults

    def collider(self, points: FloatArray, triangles: IntArray) -> Collider:
        """Return its shape at a time as a static collider.

        Args:
            points: ``(N, 3)`` [m].
            triangles: ``(T, 3)``.
        """
        shape = Mesh(points, triangles, closed=True)
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
    """Return a closed mesh around a surface: both sides and the rim.

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
        hull_points(points, triangles, radius),
        hull_faces(triangles, len(points)),
        closed=True,
    )


def hull_points(points: FloatArray, triangles: IntArray, radius: float) -> FloatArray:
    """Return a hull's points: the front's, then the back's ``(2 N, 3)`` [m]."""
    a, b, c = points[triangles].swapaxes(0, 1)
    across = np.cross(b - a, c - a)
    corners, weights = triangles.T.ravel(), np.tile(across, (3, 1)).T
    sums = [np.bincount(corners, each, len(points)) for each in weights]
    normals: FloatArray = np.stack(sums, axis=1)
    sizes = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = normals / np.where(sizes > 0, sizes, 1.0) * radius
    return np.concatenate([points + normals, points - normals])


def hull_faces(triangles: IntArray, count: int) -> IntArray:
    """Return the triangles of a hull around a surface of N points ``(M, 3)``."""
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


# Maps static colliders, start and end states ``(2, N, 3)``, radii and spawn times
# within the step to end states, contact kinds ``(N,)`` and normals ``(N, 3)``.
Settle: TypeAlias = Callable[
    [Collider, FloatArray, FloatArray, FloatArray, FloatArray], Any
]


def collide_with_sheet(
    sheet: Sheet,
    before: FloatArray,
    after: FloatArray,
    span: tuple[float, float],
    radii: FloatArray,
    late: FloatArray,
    settle: Settle,
) -> tuple[IntArray, Any] | None:
    """Return the particles near a sheet and their end states, or None without any.

    Each particle is seen from what of the sheet is nearest to it, which goes straight
    through the step: the sheet is then as it is at the end, and at rest.

    Limits of the method: where a sheet turns by much in one step, what is on it may be
    off by that turn times its distance from the nearest point.

    Args:
        sheet: The surface.
        before: Positions, then velocities at the start of the step ``(2, N, 3)``.
        after: Likewise at the end, without contacts.
        span: Start and end of the step [s].
        radii: Of the particles ``(N,)`` [m].
        late: From when on in the step particles are there ``(N,)`` [s].
        settle: Ends a step among colliders at rest.
    """
    t0, t1 = span
    sheet.motion.forget(t0)
    begin, end = sheet.motion.points(t0), sheet.motion.points(t1)
    triangles = sheet.motion.triangles(t1)
    near = np.flatnonzero(
        _within(begin, end, before[0], after[0], radii + sheet.radius)
    )
    if not len(near) or not len(triangles):
        return None
    velocity = _displacement(before[0, near], begin, end - begin, triangles) / (t1 - t0)
    start, goal = before[:, near].copy(), after[:, near].copy()
    start[0] += velocity * (t1 - t0 - late[near])[:, None]
    start[1] -= velocity
    goal[1] -= velocity
    collider = sheet.collider(end, triangles)
    state, touches, normals = settle(collider, start, goal, radii[near], late[near])
    state[1] += velocity
    return near, (state, touches, normals)


def _within(
    begin: FloatArray,
    end: FloatArray,
    start: FloatArray,
    goal: FloatArray,
    reach: FloatArray,
) -> BoolArray:
    """Return which paths enter the bounding box of a sheet ``(N,)``."""
    low = np.minimum(begin.min(axis=0), end.min(axis=0))
    high = np.maximum(begin.max(axis=0), end.max(axis=0))
    # A path is a parabola: it leaves its end points' box by at most its length.
    slack = reach[:, None] + np.linalg.norm(goal - start, axis=1, keepdims=True)
    above = np.maximum(start, goal) + slack >= low
    below = np.minimum(start, goal) - slack <= high
    return np.asarray((above & below).all(axis=1))


def _displacement(
    points: FloatArray,
    positions: FloatArray,
    displacements: FloatArray,
    triangles: IntArray,
) -> FloatArray:
    """Return a surface's displacement at its nearest points ``(N, 3)``."""
    from scipy.spatial import cKDTree

    used = np.unique(triangles)
    nearest = used[cKDTree(positions[used]).query(points)[1]]
    around = _around(triangles, len(positions))[nearest]
    corners = triangles[around]
    a, b, c = (positions[corners[..., k]] for k in range(3))
    shares = _shares(points[:, None], a, b, c)
    displaced = np.einsum("ndk,ndkx->ndx", shares, positions[corners])
    off = np.linalg.norm(displaced - points[:, None], axis=2)
    off[around < 0] = np.inf
    best = off.argmin(axis=1)[:, None, None]
    candidates = np.einsum("ndk,ndkx->ndx", shares, displacements[corners])
    return np.asarray(np.take_along_axis(candidates, best, axis=1)[:, 0])


def _around(triangles: IntArray, count: int) -> IntArray:
    """Return the triangles around each point ``(N, most)``, padded with -1."""
    order = np.argsort(triangles.ravel(), kind="stable")
    corner, face = triangles.ravel()[order], order // 3
    firsts = np.searchsorted(corner, np.arange(count + 1))
    neighbours = np.full((count, max(int(np.diff(firsts).max()), 1)), -1)
    neighbours[corner, np.arange(len(corner)) - firsts[corner]] = face
    return neighbours


def _shares(
    points: FloatArray, a: FloatArray, b: FloatArray, c: FloatArray
) -> FloatArray:
    """Return barycentric weights of the nearest points of triangles."""
    ab, ac, ap = b - a, c - a, points - a
    d00, d01, d11 = ((u * v).sum(axis=-1) for u, v in ((ab, ab), (ab, ac), (ac, ac)))
    d20, d21 = (ap * ab).sum(axis=-1), (ap * ac).sum(axis=-1)
    area = d00 * d11 - d01 * d01
    safe = np.where(area > 0, area, 1.0)
    v, w = (d11 * d20 - d01 * d21) / safe, (d00 * d21 - d01 * d20) / safe
    shares = np.clip(np.stack([1 - v - w, v, w], axis=-1), 0.0, None)
    return np.asarray(shares / shares.sum(axis=-1, keepdims=True))

"""The end of a step of particles among surfaces that change their shape."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np

from animtool._types import BoolArray, FloatArray, IntArray
from animtool.sim.colliders.collider import Collider
from animtool.sim.colliders.sheets import Sheet

# From colliders at rest, a start and an end ``(2, N, 3)``, radii and times within a
# step from when on particles are there, to where these end, whether they touch, and
# how ``(N,)`` and ``(N, 3)``.
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
    """Return who may touch a sheet in a step, and how they end; None for nobody.

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
    start, ahead = before[:, near].copy(), after[:, near].copy()
    start[0] += velocity * (t1 - t0 - late[near])[:, None]
    start[1] -= velocity
    ahead[1] -= velocity
    collider = sheet.collider(end, triangles)
    state, touches, normals = settle(collider, start, ahead, radii[near], late[near])
    state[1] += velocity
    return near, (state, touches, normals)


def _within(
    begin: FloatArray,
    end: FloatArray,
    start: FloatArray,
    goal: FloatArray,
    reach: FloatArray,
) -> BoolArray:
    """Return whose way comes into the box of a sheet's ``(N,)``."""
    low = np.minimum(begin.min(axis=0), end.min(axis=0))
    high = np.maximum(begin.max(axis=0), end.max(axis=0))
    # A path is a parabola, which leaves the box of its ends by no more than its length.
    slack = reach[:, None] + np.linalg.norm(goal - start, axis=1, keepdims=True)
    above = np.maximum(start, goal) + slack >= low
    below = np.minimum(start, goal) - slack <= high
    return np.asarray((above & below).all(axis=1))


def _displacement(
    points: FloatArray, places: FloatArray, ways: FloatArray, triangles: IntArray
) -> FloatArray:
    """Return the ways that a surface goes where it is nearest to points ``(N, 3)``."""
    from scipy.spatial import cKDTree

    used = np.unique(triangles)
    nearest = used[cKDTree(places[used]).query(points)[1]]
    around = _around(triangles, len(places))[nearest]
    corners = triangles[around]
    a, b, c = (places[corners[..., k]] for k in range(3))
    shares = _shares(points[:, None], a, b, c)
    found = np.einsum("ndk,ndkx->ndx", shares, places[corners])
    off = np.linalg.norm(found - points[:, None], axis=2)
    off[around < 0] = np.inf
    best = off.argmin(axis=1)[:, None, None]
    whole = np.einsum("ndk,ndkx->ndx", shares, ways[corners])
    return np.asarray(np.take_along_axis(whole, best, axis=1)[:, 0])


def _around(triangles: IntArray, count: int) -> IntArray:
    """Return the triangles at each point ``(N, most)``, -1 where there are fewer."""
    order = np.argsort(triangles.ravel(), kind="stable")
    corner, face = triangles.ravel()[order], order // 3
    firsts = np.searchsorted(corner, np.arange(count + 1))
    found = np.full((count, max(int(np.diff(firsts).max()), 1)), -1)
    found[corner, np.arange(len(corner)) - firsts[corner]] = face
    return found


def _shares(
    points: FloatArray, a: FloatArray, b: FloatArray, c: FloatArray
) -> FloatArray:
    """Return what of each corner is in the point of a triangle below others."""
    ab, ac, ap = b - a, c - a, points - a
    d00, d01, d11 = ((u * v).sum(axis=-1) for u, v in ((ab, ab), (ab, ac), (ac, ac)))
    d20, d21 = (ap * ab).sum(axis=-1), (ap * ac).sum(axis=-1)
    area = d00 * d11 - d01 * d01
    safe = np.where(area > 0, area, 1.0)
    v, w = (d11 * d20 - d01 * d21) / safe, (d00 * d21 - d01 * d20) / safe
    shares = np.clip(np.stack([1 - v - w, v, w], axis=-1), 0.0, None)
    return np.asarray(shares / shares.sum(axis=-1, keepdims=True))

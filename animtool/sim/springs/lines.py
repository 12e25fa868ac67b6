"""Ropes and strands: particles in a row."""

from __future__ import annotations

import numpy as np

from animtool._types import ArrayLike, as_floats
from animtool.sim.springs.body import Body, Family, built


def rope(
    start: ArrayLike,
    end: ArrayLike,
    count: int,
    along: Family | None,
    *,
    mass: float,
    tip_mass: float | None = None,
    bend: Family | None = None,
) -> Body:
    """Return a straight rope.

    Args:
        start: Where it begins ``(3,)`` [m].
        end: Where it ends ``(3,)`` [m].
        count: Of particles, two or more.
        along: Springs from each particle to the next; None leaves them out.
        mass: Of each particle [kg].
        tip_mass: Of the last [kg]; None is `mass`.
        bend: Springs that skip one, against bending.

    >>> rope([0, 0, 0], [0, 0, -1], 3, Family(1e4), mass=0.1).positions[1].tolist()
    [0.0, 0.0, -0.5]
    """
    share = np.linspace(0.0, 1.0, count)[:, None]
    first, last = (np.asarray(point, np.float64) for point in (start, end))
    body = strand(first + share * (last - first), along, mass=mass, bend=bend)
    if tip_mass is None:
        return body
    masses = body.masses.copy()
    masses[-1] = tip_mass
    families = [(_skipping(count, 1), along), (_skipping(count, 2), bend)]
    return built(body.positions, masses, families)


def strand(
    points: ArrayLike,
    along: Family | None,
    *,
    mass: ArrayLike,
    bend: Family | None = None,
) -> Body:
    """Return a strand through points, at rest where they are.

    Args:
        points: ``(N, 3)`` [m].
        along: Springs from each particle to the next; None leaves them out.
        mass: Of each particle, or of all ``(N,)`` [kg].
        bend: Springs that skip one, against bending.
    """
    places = as_floats(points, ("N", 3), "points")
    count = len(places)
    families = [(_skipping(count, 1), along), (_skipping(count, 2), bend)]
    return built(places, mass, families)


def _skipping(count: int, step: int) -> ArrayLike:
    first = np.arange(max(count - step, 0))
    return np.stack([first, first + step], axis=1)

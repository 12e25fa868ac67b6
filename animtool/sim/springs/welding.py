"""Bodies whose particles are one."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from animtool._types import ArrayLike, FloatArray, IntArray
from animtool.sim.springs.body import Body


@dataclass(frozen=True, slots=True)
class Welded:
    """A body some of whose particles became one.

    Attributes:
        body: The rest of them; its springs and triangles are those of before.
        rows: The particle that each of before is now ``(N,)``.
        gap: Largest distance between two that became one [m].
    """

    body: Body
    rows: IntArray
    gap: float


def weld(body: Body, pairs: ArrayLike) -> Welded:
    """Return a body in which particles are one: masses add up.

    Args:
        body: Particles and springs.
        pairs: Particles that go, and those whose place they take ``(J, 2)``.

    >>> from animtool.sim.springs import Family, join, rope
    >>> one = rope([0, 0, 0], [1, 0, 0], 2, Family(10.0), mass=1.0)
    >>> two = rope([1, 0, 0], [2, 0, 0], 2, Family(10.0), mass=1.0)
    >>> made = weld(join([one, two]), [[2, 1]])
    >>> made.rows.tolist(), made.body.masses.tolist(), made.body.springs.ends.tolist()
    ([0, 1, 1, 2], [1.0, 2.0, 1.0], [[0, 1], [1, 2]])
    """
    joined = np.asarray(pairs, np.int64).reshape(-1, 2)
    place = np.arange(len(body.positions))
    for gone, kept in joined.tolist():
        # All that are one with either stand where the one that stays does.
        place[place == place[gone]] = place[kept]
    stay, rows = np.unique(place, return_inverse=True)
    rows = rows.reshape(-1)
    gaps: FloatArray = np.linalg.norm(body.positions - body.positions[place], axis=1)
    masses = np.zeros(len(stay))
    np.add.at(masses, rows, body.masses)
    springs = replace(body.springs, ends=rows[body.springs.ends])
    welded = Body(body.positions[stay], masses, springs, rows[body.triangles])
    return Welded(welded, rows, float(gaps.max(initial=0.0)))

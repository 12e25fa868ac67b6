"""What rigid bodies run into through a step, surfaces as they then are."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from animtool._types import FloatArray
from animtool.maths import so3
from animtool.sim.colliders import Collider, Colliders, Poses, Sheet


class Surroundings:
    """Colliders as the kernel takes them."""

    def __init__(self, colliders: Colliders) -> None:
        self.colliders = colliders
        # Points of surfaces in the last step, and these as colliders.
        self._known: tuple[list[FloatArray], Colliders] | None = None

    def arrays(self, t: float, end: float) -> tuple[Any, ...]:
        """Return what bodies run into through a step."""
        sheets = self.colliders.sheets
        if not sheets:
            return self.colliders.arrays(t, end)
        places = [point for one in sheets for point in _ends(one, t, end)]
        known = self._known
        if known is None or any(
            old is not new for old, new in zip(known[0], places, strict=True)
        ):
            moving = [_going(one, t, end) for one in sheets]
            around = Colliders([*self.colliders, *moving], (), self.colliders.bodies)
            known = self._known = places, around
        return known[1].arrays(t, end)


def _ends(sheet: Sheet, t: float, end: float) -> tuple[FloatArray, FloatArray]:
    """Return the points of a surface at both ends of a step; none before again."""
    sheet.motion.forget(t)
    return sheet.motion.points(t), sheet.motion.points(end)


def _going(sheet: Sheet, t: float, end: float) -> Collider:
    """Return a surface through a step: as it begins, and as nearly as it goes as one.

    The rotation is that of Kabsch (1976): points that change shape differ from it.
    """
    begin, after = _ends(sheet, t, end)
    collider = sheet.collider(begin, sheet.motion.triangles(t))
    if begin is after or (begin == after).all():
        return collider
    middle, goal = begin.mean(axis=0), after.mean(axis=0)
    u, _, v = np.linalg.svd((after - goal).T @ (begin - middle))
    turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v
    poses = Poses(
        (t, end),
        np.stack([np.zeros(3), goal - turn @ middle]),
        np.stack([so3.IDENTITY, so3.from_matrix(turn)]),
    )
    return replace(collider, poses=poses)

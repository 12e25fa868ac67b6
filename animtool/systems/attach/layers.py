"""Simulated cloth as a collider of attachments that are named after it."""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.sim.colliders import Sheet


@dataclass(eq=False)
class ClothMotion:
    """Points of simulated cloth over the last simulated frame.

    Points move linearly within the frame, and are constant before and after it.
    """

    faces: IntArray  # triangles ``(T, 3)``
    begin: FloatArray  # points at the start of the frame ``(N, 3)`` [m]
    end: FloatArray  # points at the end of the frame ``(N, 3)`` [m]
    times: tuple[float, float] = (0.0, 0.0)  # start and end of the frame [s]

    def points(self, t: float) -> FloatArray:
        """Return the points at a time [s] ``(N, 3)`` [m]."""
        first, last = self.times
        if t >= last:
            return self.end
        if t <= first:
            return self.begin
        fraction = (t - first) / (last - first)
        return self.begin + fraction * (self.end - self.begin)

    def triangles(self, t: float) -> IntArray:  # noqa: ARG002
        """Return the constant triangles ``(T, 3)``."""
        return self.faces

    def forget(self, t: float) -> None:
        """Do nothing, as only the last frame is stored."""


def cloth_sheet(
    name: str,
    points: FloatArray,
    triangles: IntArray,
    thickness: float,
    friction: float,
    depenetration: float,
) -> Sheet:
    """Return cloth at points ``(N, 3)`` [m] as a collider with a thickness [m]."""
    motion = ClothMotion(np.asarray(triangles, np.int64), points, points)
    return Sheet(
        motion,
        thickness / 2,
        friction=friction,
        name=name,
        depenetration=depenetration,
    )

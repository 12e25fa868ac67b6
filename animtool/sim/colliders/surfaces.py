"""Deforming surfaces, prepared for kernels that take many substeps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from animtool import _kernels
from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, warning
from animtool.sim.colliders.sheets import Sheet, hull_faces, hull_points
from animtool.sim.contact import SPEED_LIMIT

# Points are sampled at most this often [s], and interpolated in between.
KNOT = 1 / 240
# Rounding tolerance of the cell count, as a fraction of a cell.
ON_GRID = 1e-9


class Surfaces:
    """Sheets in the layout of kernels that take many substeps at once.

    Points at one place at the beginning are one; triangles stay as they are then.

    Attributes:
        fastest: Highest speed so far [m/s]; teleports do not count.

    Args:
        sheets: Surfaces whose motion may be asked for at any time.
    """

    def __init__(self, sheets: Sequence[Sheet]) -> None:
        self._sheets = tuple(sheets)
        self._origin: float | None = None
        self._ready: list[_Ready] = []
        self._jumps: dict[tuple[int, float], Fault] = {}
        self.fastest = 0.0

    def over(
        self, origin: float, cell: float, index: int, cells: int
    ) -> list[tuple[Any, ...]]:
        """Return the kernel's arrays for an interval split into equal cells.

        Args:
            origin: Where the first of all cells begins [s].
            cell: Length of each [s].
            index: Of the first of these.
            cells: How many.
        """
        if self._origin != origin:
            self._origin = origin
            ready = [_Ready(sheet, origin) for sheet in self._sheets]
            self._ready = [one for one in ready if len(one.faces)]
        lasts = max(1, math.floor(KNOT / cell * (1 + ON_GRID)))
        first, over = divmod(index, lasts)
        last = -(-(index + cells) // lasts)
        steps = np.arange(first, last + 1)
        knots = np.asarray(origin + steps * (lasts * cell), np.float64)
        rows = []
        for i, one in enumerate(self._ready):
            points = np.stack([one.points(t) for t in knots.tolist()])
            self._look(i, one.sheet, points, knots)
            rows.append((one.kernel, points, one.numbers, lasts, over))
        return rows

    def _look(
        self, i: int, sheet: Sheet, points: FloatArray, knots: FloatArray
    ) -> None:
        """Record a sheet's speed, and its teleports."""
        travelled = np.linalg.norm(np.diff(points, axis=0), axis=2).max(axis=1)
        speeds = travelled / np.diff(knots)
        jumps = speeds > SPEED_LIMIT
        self.fastest = max(self.fastest, float(speeds[~jumps].max(initial=0.0)))
        for when in knots[1:][jumps].tolist():
            message = f"it moves faster than {SPEED_LIMIT:g} m/s until {when:g} s: it "
            message += "collides with nothing"
            where = sheet.name or f"sheets[{i}]"
            fault = warning("SIM120", message, where=where)
            self._jumps[i, when] = fault

    def notices(self) -> list[Fault]:
        """Return a warning for each teleport so far (SIM120)."""
        return list(self._jumps.values())


class _Ready:
    """A sheet with its tree, built once at the start.

    Attributes:
        sheet: What it is made of.
        faces: Its triangles, of a hull where it is met from both sides ``(T, 3)``.
        kernel: Their tree.
        numbers: Restitution, friction, margin, depenetration and the speed limit.
    """

    def __init__(self, sheet: Sheet, origin: float) -> None:
        self.sheet = sheet
        points = sheet.motion.points(origin)
        self._rows, self._triangles = _welded(points, sheet.motion.triangles(origin))
        self._displaced: tuple[FloatArray, FloatArray] | None = None
        margin = sheet.radius if sheet.closed else 0.0
        self.numbers = (
            sheet.restitution, sheet.friction, margin, sheet.depenetration, SPEED_LIMIT,
        )  # fmt: skip
        self.faces = self._triangles
        if not sheet.closed:
            self.faces = hull_faces(self._triangles, len(self._rows))
        if len(self.faces):
            corners = np.ascontiguousarray(self.faces, np.int32)
            self.kernel = _kernels.MeshSurface(self.points(origin), corners)

    def points(self, t: float) -> FloatArray:
        """Return its points at a time [s] [m]."""
        points = self.sheet.motion.points(t)
        if self._displaced is None or self._displaced[0] is not points:
            displaced = np.ascontiguousarray(points[self._rows], np.float64)
            if not self.sheet.closed:
                displaced = hull_points(displaced, self._triangles, self.sheet.radius)
            self._displaced = points, displaced
        return self._displaced[1]


def _welded(points: FloatArray, triangles: IntArray) -> tuple[IntArray, IntArray]:
    """Return the used points, and triangles without degenerate ones.

    Points of a triangle that would lose its area by that stay: it may yet gain it.
    """
    _, first, same = np.unique(points, axis=0, return_index=True, return_inverse=True)
    one = first[same.reshape(-1)]
    loose = triangles[_pinched(one[triangles])]
    one[loose] = loose
    corners = one[triangles]
    used, kept = np.unique(corners[~_pinched(corners)], return_inverse=True)
    return used, kept.reshape(-1, 3)


def _pinched(triangles: IntArray) -> Any:
    """Return which triangles have two equal corners ``(T,)``."""
    return (triangles == np.roll(triangles, 1, axis=1)).any(axis=1)

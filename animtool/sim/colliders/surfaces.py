"""Deforming surfaces, prepared for kernels that compute many substeps in one call."""

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

# Shortest interval between samples of points [s]; they are interpolated in between.
KNOT_INTERVAL = 1 / 240
# Rounding tolerance of the number of steps between samples [1].
RELATIVE_ROUNDING = 1e-9


class Surfaces:
    """Sheets in the array layout of kernels that compute many substeps in one call.

    Points that coincide at the beginning are merged; triangles do not change.

    Attributes:
        fastest: Highest speed so far [m/s]; teleports do not count.
    """

    def __init__(self, sheets: Sequence[Sheet]) -> None:
        self._sheets = tuple(sheets)
        self._start: float | None = None
        self._prepared_sheets: list[_PreparedSheet] = []
        self._teleports: dict[tuple[int, float], Fault] = {}
        self.max_speed = 0.0

    def kernel_arrays(
        self, start: float, dt: float, first_step: int, step_count: int
    ) -> list[tuple[Any, ...]]:
        """Return the kernel's arrays for consecutive steps of length ``dt`` [s].

        Step 0 begins at ``start`` [s]; the first has the index ``first_step``.
        """
        if self._start != start:
            self._start = start
            prepared_sheets = [_PreparedSheet(sheet, start) for sheet in self._sheets]
            self._prepared_sheets = [
                sheet for sheet in prepared_sheets if len(sheet.faces)
            ]
        knot_steps = max(1, math.floor(KNOT_INTERVAL / dt * (1 + RELATIVE_ROUNDING)))
        first_knot, offset = divmod(first_step, knot_steps)
        last_knot = -(-(first_step + step_count) // knot_steps)
        knot_indices = np.arange(first_knot, last_knot + 1)
        knots = np.asarray(start + knot_indices * (knot_steps * dt), np.float64)
        arrays = []
        for sheet_index, sheet in enumerate(self._prepared_sheets):
            points = np.stack([sheet.points(t) for t in knots.tolist()])
            self._record_speed(sheet_index, sheet.sheet, points, knots)
            kernel, material = sheet.kernel, sheet.material
            arrays.append((kernel, points, material, knot_steps, offset))
        return arrays

    def _record_speed(
        self, sheet_index: int, sheet: Sheet, points: FloatArray, knots: FloatArray
    ) -> None:
        """Record the maximum speed of a sheet, and its teleports."""
        distances = np.linalg.norm(np.diff(points, axis=0), axis=2).max(axis=1)
        speeds = distances / np.diff(knots)
        is_teleport = speeds > SPEED_LIMIT
        self.max_speed = max(
            self.max_speed, float(speeds[~is_teleport].max(initial=0.0))
        )
        for time in knots[1:][is_teleport].tolist():
            label = sheet.name or f"sheets[{sheet_index}]"
            fault = teleport_warning(SPEED_LIMIT, time, label)
            self._teleports[sheet_index, time] = fault

    def notices(self) -> list[Fault]:
        """Return a warning for each teleport so far (SIM120)."""
        return list(self._teleports.values())


def teleport_warning(
    limit: float, end_time: float, location: str, hint: str | None = None
) -> Fault:
    """Return a warning about motion above a speed limit [m/s] (SIM120)."""
    message = f"it moves faster than {limit:g} m/s until {end_time:g} s: it collides "
    return warning("SIM120", f"{message}with nothing", hint, location)


class _PreparedSheet:
    """A sheet with a bounding volume tree, built once at the start.

    Attributes:
        sheet: The sheet.
        faces: Triangles of the sheet; for a two-sided sheet, of its hull ``(T, 3)``.
        kernel: Kernel object with the tree of the triangles.
        material: Restitution, friction, margin, depenetration and the speed limit.
    """

    def __init__(self, sheet: Sheet, start: float) -> None:
        self.sheet = sheet
        points = sheet.motion.points(start)
        self._indices, self._triangles = _used_topology(
            points, sheet.motion.triangles(start)
        )
        self._cached_points: tuple[FloatArray, FloatArray] | None = None
        margin = sheet.radius if sheet.closed else 0.0
        self.material = (
            sheet.restitution, sheet.friction, margin, sheet.depenetration, SPEED_LIMIT,
        )  # fmt: skip
        self.faces = self._triangles
        if not sheet.closed:
            self.faces = hull_faces(self._triangles, len(self._indices))
        if len(self.faces):
            corners = np.ascontiguousarray(self.faces, np.int32)
            self.kernel = _kernels.MeshSurface(self.points(start), corners)

    def points(self, t: float) -> FloatArray:
        """Return the points of the faces ``(P, 3)`` [m] at a time [s]."""
        points = self.sheet.motion.points(t)
        if self._cached_points is None or self._cached_points[0] is not points:
            welded_points = np.ascontiguousarray(points[self._indices], np.float64)
            if not self.sheet.closed:
                welded_points = hull_points(
                    welded_points, self._triangles, self.sheet.radius
                )
            self._cached_points = points, welded_points
        return self._cached_points[1]


def _used_topology(
    points: FloatArray, triangles: IntArray
) -> tuple[IntArray, IntArray]:
    """Return indices of the used points, and triangles without degenerate ones.

    Coincident points are merged, except in triangles that would become degenerate:
    they may gain an area later.
    """
    _, first_indices, inverse = np.unique(
        points, axis=0, return_index=True, return_inverse=True
    )
    representatives = first_indices[inverse.reshape(-1)]
    degenerate_triangles = triangles[_is_degenerate(representatives[triangles])]
    representatives[degenerate_triangles] = degenerate_triangles
    corners = representatives[triangles]
    corners = corners[~_is_degenerate(corners)]
    used_points, corner_indices = np.unique(corners, return_inverse=True)
    return used_points, corner_indices.reshape(-1, 3)


def _is_degenerate(triangles: IntArray) -> Any:
    """Return a mask of the triangles with two equal corners ``(T,)``."""
    return (triangles == np.roll(triangles, 1, axis=1)).any(axis=1)

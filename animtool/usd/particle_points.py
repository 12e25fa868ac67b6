"""Particles as UsdGeomPoints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from pxr import Sdf, Vt

from animtool._types import FloatArray, IntArray
from animtool.usd.finite import Labels, narrowed
from animtool.usd.layers import attribute, prim
from animtool.usd.prim_writer import PrimWriter

_TYPES = Sdf.ValueTypeNames


@dataclass(frozen=True, slots=True)
class PointsRow:
    """One prim at one frame.

    Attributes:
        ids: ``(N,)``.
        points: ``(N, 3)`` [m].
        velocities: ``(N, 3)`` [m/s].
        radii: ``(N,)`` [m].
        ages: ``(N,)`` [s].
    """

    ids: IntArray
    points: FloatArray
    velocities: FloatArray
    radii: FloatArray
    ages: FloatArray


class PointsWriter(PrimWriter):
    """Writes points that come and go."""

    def begin(self, layer: Any, row: PointsRow) -> None:  # noqa: ARG002
        """Write the prim; every frame changes all that it has."""
        spec = prim(layer, self.report.path, "Points")
        kinds = {
            "points": _TYPES.Point3fArray,
            "velocities": _TYPES.Vector3fArray,
            "ids": _TYPES.Int64Array,
            "widths": _TYPES.FloatArray,
            "primvars:age": _TYPES.FloatArray,
            "extent": _TYPES.Float3Array,
        }
        each = {"widths", "primvars:age"}
        for name, kind in kinds.items():
            attribute(spec, name, kind, interpolation="vertex" if name in each else "")
        self.report.sampled = list(kinds)

    def add(self, layer: Any, code: float, row: PointsRow) -> None:
        """Write a frame."""
        at = np.array([code])
        points, error, _, worst = self.rounded("points", row.points, code)
        path = self.report.path
        widths, ages = (
            narrowed(values[None], "f", Labels(f"{path}.{name}", "point"), at)[0]
            for name, values in (
                ("widths", 2 * row.radii / self.unit),
                ("primvars:age", row.ages),
            )
        )
        speeds = self.rounded("velocities", row.velocities, code)[0][0]
        extent = _extent(points[0], widths)
        for name, value in {
            "points": Vt.Vec3fArray.FromNumpy(points[0]),
            "velocities": Vt.Vec3fArray.FromNumpy(speeds),
            "ids": Vt.Int64Array.FromNumpy(row.ids),
            "widths": Vt.FloatArray.FromNumpy(widths),
            "primvars:age": Vt.FloatArray.FromNumpy(ages),
            "extent": Vt.Vec3fArray.FromNumpy(extent),
        }.items():
            self.put(layer, code, name, value)
        self.report.vertices = max(self.report.vertices, len(row.ids))
        self.count(code, error, worst, len(row.ids) * 40 + 24)


def _extent(points: Any, widths: Any) -> Any:
    """Return bounds of balls, as `UsdGeom.Points` has them; empty ones of none."""
    if not len(points):
        return np.zeros((2, 3), np.float32)
    half = widths[:, None] / 2
    return np.stack([(points - half).min(axis=0), (points + half).max(axis=0)])

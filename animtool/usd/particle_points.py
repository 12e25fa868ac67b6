"""Particles as UsdGeomPoints, written while they are made.

A crate that is saved now and then has its samples on disk: memory stays the same
however long a simulation is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Sdf, Vt

from animtool import _kernels
from animtool._types import FloatArray, IntArray
from animtool.output import replacing
from animtool.units import UpAxis
from animtool.usd.layers import (
    StageMetadata,
    attribute,
    author_metadata,
    new_layer,
    prim,
    save_layer,
    usd_errors,
)
from animtool.usd.point_cache import CachedMesh

__all__ = ["PointsJob", "PointsRow", "write_points"]

_TYPES = Sdf.ValueTypeNames
# Samples in memory before they go to the disk [byte].
HELD = 32_000_000


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


@dataclass(frozen=True, slots=True)
class PointsJob:
    """What to write.

    Attributes:
        output: The file; None is usda for stdout.
        model: Path of the prim above the points.
        names: Of the prims of points, legal and distinct.
        fps: Time codes a second.
        frames: First and last time code.
        meters_per_unit: Unit of the layer [m].
        up: Its up axis.
    """

    output: Path | None
    model: str
    names: Sequence[str]
    fps: Fraction
    frames: tuple[Fraction, Fraction]
    meters_per_unit: float
    up: UpAxis


def write_points(
    job: PointsJob,
    rows: Iterable[tuple[float, Sequence[PointsRow]]],
    check: Callable[[], None],
) -> tuple[list[CachedMesh], int]:
    """Write points frame by frame, as a whole file or not at all.

    Args:
        job: What to write.
        rows: Of each frame its time code, and what each prim is.
        check: Called when all is authored; what it raises leaves nothing behind.

    Returns:
        What was written of each prim, and the size of the file [byte].

    Raises:
        OutputError: It cannot be written.
    """
    if job.output is None or job.output.suffix.lower() == ".usda":
        layer = new_layer(job.output or Path("stdout.usda"))
        found = _author(layer, job, rows, None)
        check()
        return found, save_layer(layer, job.output)
    with replacing(job.output) as temporary:
        with _crate(temporary, job.output) as layer:
            found = _author(layer, job, rows, layer.Save)
            check()
            layer.Save()
        return found, temporary.stat().st_size


@contextmanager
def _crate(temporary: Path, path: Path) -> Iterator[Any]:
    """Give a layer whose file is a temporary one."""
    with usd_errors(path):
        yield Sdf.Layer.CreateNew(str(temporary), args={"format": "usdc"})


def _author(
    layer: Any,
    job: PointsJob,
    rows: Iterable[tuple[float, Sequence[PointsRow]]],
    save: Callable[[], object] | None,
) -> list[CachedMesh]:
    model = Sdf.Path(job.model)
    for ancestor in model.GetPrefixes():
        kind = "component" if ancestor == model else "group"
        prim(layer, str(ancestor), "Xform").SetInfo("kind", kind)
    default = model.GetPrefixes()[0].name
    author_metadata(
        layer,
        StageMetadata(default, job.fps, *job.frames, job.meters_per_unit, job.up),
    )
    writers = [_Writer(layer, f"{job.model}/{name}", job) for name in job.names]
    held = 0
    for code, frame in rows:
        before = sum(writer.report.bytes for writer in writers)
        for writer, row in zip(writers, frame, strict=True):
            writer.add(code, row)
        held += sum(writer.report.bytes for writer in writers) - before
        if save is not None and held > HELD:
            save()
            held = 0
    return [writer.report for writer in writers]


class _Writer:
    """Writes the samples of one prim."""

    def __init__(self, layer: Any, path: str, job: PointsJob) -> None:
        self.report = CachedMesh(path)
        self._layer, self._unit = layer, job.meters_per_unit
        spec = prim(layer, path, "Points")
        kinds = {
            "points": _TYPES.Point3fArray,
            "velocities": _TYPES.Vector3fArray,
            "ids": _TYPES.Int64Array,
            "widths": _TYPES.FloatArray,
            "primvars:age": _TYPES.FloatArray,
            "extent": _TYPES.Float3Array,
        }
        each = {"widths", "primvars:age"}
        self._paths = {
            name: attribute(
                spec, name, kind, interpolation="vertex" if name in each else ""
            ).path
            for name, kind in kinds.items()
        }
        self.report.sampled = list(kinds)

    def add(self, code: float, row: PointsRow) -> None:
        """Write a frame."""
        report = self.report
        points, error, _, worst = _kernels.round_points(row.points[None], self._unit)
        widths = (2 * row.radii / self._unit).astype(np.float32)
        speeds = _kernels.round_points(row.velocities[None], self._unit)[0][0]
        self._set(code, "points", Vt.Vec3fArray.FromNumpy(points[0]))
        self._set(code, "velocities", Vt.Vec3fArray.FromNumpy(speeds))
        self._set(code, "ids", Vt.Int64Array.FromNumpy(row.ids))
        self._set(code, "widths", Vt.FloatArray.FromNumpy(widths))
        ages = row.ages.astype(np.float32)
        self._set(code, "primvars:age", Vt.FloatArray.FromNumpy(ages))
        extent = _extent(points[0], widths)
        self._set(code, "extent", Vt.Vec3fArray.FromNumpy(extent))
        report.samples += 1
        report.vertices = max(report.vertices, len(row.ids))
        report.bytes += len(row.ids) * 40 + 24
        if error > report.error:
            report.error, report.error_code, report.error_vertex = error, code, worst

    def _set(self, code: float, name: str, value: Any) -> None:
        self._layer.SetTimeSample(self._paths[name], code, value)


def _extent(points: Any, widths: Any) -> Any:
    """Return bounds of balls, as `UsdGeom.Points` has them; empty ones of none."""
    if not len(points):
        return np.zeros((2, 3), np.float32)
    half = widths[:, None] / 2
    return np.stack([(points - half).min(axis=0), (points + half).max(axis=0)])

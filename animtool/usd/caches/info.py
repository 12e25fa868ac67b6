"""Describes the animated points of a stage: meshes, curves, particles."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from pxr import Sdf, Usd, UsdGeom

from animtool.core.clock import time_fraction
from animtool.core.errors import Fault, Severity, listed
from animtool.core.files.reading import note_input
from animtool.core.rates import rate_from_float
from animtool.core.record import dataclass
from animtool.core.units import unit_name
from animtool.usd.caches.reader import (
    PointReader,
    all_prims,
    codes_of,
    copied_meshes,
    has_character,
    lengths,
    point_prims,
)
from animtool.usd.layers.sdf import usd_errors
from animtool.usd.layers.stderr import without_usd_warnings
from animtool.usd.rigs.prims import (
    array_value,
    composition_notices,
    open_stage,
    up_axis,
)

# What points are joined to, and the attribute with an entry for each.
_PIECES = {
    "Mesh": ("faces", "faceVertexCounts"),
    "BasisCurves": ("curves", "curveVertexCounts"),
    "NurbsCurves": ("curves", "curveVertexCounts"),
    "HermiteCurves": ("curves", "curveVertexCounts"),
}


@dataclass(frozen=True, slots=True)
class PointPrim:
    """Summary of one prim with points."""

    path: str  # of the prim
    type: str  # of the prim; empty of one that only goes over another layer's
    points: tuple[int, int]  # least and most points at a sample
    # What they are joined to, `faces` or `curves`, or what stands at them: the
    # `meshes` of a PointInstancer; empty where there is none.
    pieces: str
    piece_count: tuple[int, int]  # least and most of these
    samples: int  # of points and transforms; 0 if static
    first: float | None  # time code of the first sample; None without
    last: float | None  # time code of the last; likewise
    # Whether the same points stay, joined alike, as far as numbers of points, ids at
    # both ends and what may change tell.
    fixed: bool
    velocities: bool  # whether there are any
    widths: bool  # likewise
    ids: bool  # likewise
    normals: bool  # likewise
    orientations: bool  # likewise
    primvars: list[str]  # names of those that it has
    # Lowest and highest corner over all samples, in its own space, as it is stated;
    # None where none is.
    extent: tuple[list[float], list[float]] | None


@dataclass(frozen=True, slots=True)
class ChunkSet:
    """Clip files that hold the samples of a prim and its descendants."""

    path: str  # of the prim
    name: str  # of the set
    files: list[str]  # as the layer names them
    missing: list[str]  # those that are not there


@dataclass(frozen=True, slots=True)
class PointsDescription:
    """Summary of the animated points in a USD file."""

    path: str  # the file
    format: str  # USD
    frames: int  # most samples of any of its prims; 0 where nothing moves
    fps: Fraction  # time codes a second, exact
    start: Fraction  # time code of the first frame
    end: Fraction  # time code of the last frame
    duration: Fraction  # from the first to the last [s]
    types: dict[str, int]  # how many prims there are, by type
    prims: list[PointPrim]  # what there is of each
    chunks: list[ChunkSet]  # clip files in time order
    units: str  # unit of the file
    up: str  # up axis of the file
    notices: list[Fault]  # warnings and notes
    json_keys: ClassVar[str] = "* rate=fps#"


def describe_points(path: Path) -> PointsDescription | None:
    """Describe a USD file that has points and no character; otherwise None.

    Arrays of crates are looked at, not read: only their lengths and the extents are
    taken of each sample.
    """
    note_input(path)
    with usd_errors(path), without_usd_warnings():
        stage = open_stage(path)
        pointed = () if has_character(stage) else point_prims(stage)
        prims = [_described(prim) for prim in pointed]
        if not prims:
            return None
        chunks = [one for prim in all_prims(stage) for one in _chunks(prim)]
        codes = [code for one in prims for code in (one.first, one.last)]
        known = [code for code in codes if code is not None]
        start, end = stage.GetStartTimeCode(), stage.GetEndTimeCode()
        if known and not stage.HasAuthoredTimeCodeRange():
            start, end = min(known), max(known)
        fps = rate_from_float(stage.GetTimeCodesPerSecond())
        return PointsDescription(
            str(path),
            "USD",
            max(prim.samples for prim in prims),
            fps,
            time_fraction(start),
            time_fraction(end),
            (time_fraction(end) - time_fraction(start)) / fps,
            dict(Counter(prim.type for prim in prims)),
            prims,
            chunks,
            unit_name(UsdGeom.GetStageMetersPerUnit(stage)),
            up_axis(stage).value,
            composition_notices(stage, str(path)) + _gone(chunks, str(path)),
        )


def displaced_points(path: Path) -> list[PointPrim]:
    """Return the prims of a stage whose points have samples."""
    with usd_errors(path):
        stage = open_stage(path)
        moving = (prim for prim in point_prims(stage) if PointReader(prim).times)
        return [_described(prim) for prim in moving]


def _described(prim: Any) -> PointPrim:
    reader = PointReader(prim)
    times, copies, has = reader.times, reader.copies, reader.has
    codes = reader.codes
    rows_at = codes_of(times)
    counts = lengths(reader.attr, rows_at)
    kind = str(prim.GetTypeName())
    pieces, name = ("meshes", "") if copies else _PIECES.get(kind, ("", ""))
    shape = prim.GetAttribute(name) if name else None
    # Those of many samples are packed: the ends tell as much as all.
    many = lengths(shape, codes_of([*times[:1], *times[1:][-1:]])) if shape else []
    if copies:
        many = [len(copied_meshes(prim))]
    primvars = UsdGeom.PrimvarsAPI(prim).GetPrimvarsWithAuthoredValues()
    return PointPrim(
        str(prim.GetPath()),
        kind,
        _span(counts),
        pieces,
        _span(many),
        len(codes),
        codes[0] if codes else None,
        codes[-1] if codes else None,
        len({*counts} - {None}) < 2
        and not (shape and shape.ValueMightBeTimeVarying())
        and _same_ids(prim, times),
        has("velocities"),
        has("widths"),
        has("ids"),
        has("normals"),
        has("orientations") or has("orientationsf"),
        sorted(str(primvar.GetPrimvarName()) for primvar in primvars),
        _extent(prim, [code for code, n in zip(rows_at, counts, strict=True) if n]),
    )


def _span(counts: Sequence[int | None]) -> tuple[int, int]:
    known = [count for count in counts if count is not None]
    return min(known, default=0), max(known, default=0)


def _same_ids(prim: Any, times: Sequence[float]) -> bool:
    """Return whether ids are absent, or equal at the first and last sample."""
    ids = prim.GetAttribute("ids")
    if not (ids and times):
        return True
    first, last = (np.array(array_value(ids, times[i])) for i in (0, -1))
    return np.array_equal(first, last)


def _extent(prim: Any, codes: Sequence[Any]) -> tuple[list[float], list[float]] | None:
    """Return the union of all authored extents; None if any of them is invalid."""
    attribute = prim.GetAttribute("extent")
    stated = [array_value(attribute, code) for code in codes] if attribute else []
    pairs = [np.array(two) for two in stated if len(two) == 2]
    corners = np.array([pair for pair in pairs if pair.dtype.kind == "f"])
    if corners.shape[1:] != (2, 3) or not np.isfinite(corners).all():
        return None
    low, high = corners[:, 0].min(axis=0), corners[:, 1].max(axis=0)
    return low.astype(float).tolist(), high.astype(float).tolist()


def _gone(chunks: Sequence[ChunkSet], where: str) -> list[Fault]:
    """Report missing chunk files."""
    return [
        Fault(
            "USD276",
            f"chunks of {chunk.path} are missing: {listed(chunk.missing)}",
            where,
            hint="points are static between them",
            severity=Severity.WARNING,
        )
        for chunk in chunks
        if chunk.missing
    ]


def _chunks(prim: Any) -> Iterator[ChunkSet]:
    """Yield the value clips of a prim."""
    if not prim.HasAuthoredMetadata("clips"):
        return
    clips = Usd.ClipsAPI(prim)
    for name in sorted(clips.GetClips()):
        assets = clips.ComputeClipAssetPaths(name)
        missing = [
            asset.path
            for asset in assets
            if Sdf.Layer.FindOrOpen(asset.resolvedPath or asset.path) is None
        ]
        yield ChunkSet(
            str(prim.GetPath()), name, [asset.path for asset in assets], missing
        )

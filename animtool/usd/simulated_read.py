"""What a stage shows of points that move: meshes, curves, particles, over time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdSkel

from animtool.clock import time_fraction
from animtool.errors import Fault, Severity, listed
from animtool.rates import rate_from_float
from animtool.units import unit_name
from animtool.usd.layers import usd_errors
from animtool.usd.rig_prims import (
    array_of,
    array_value,
    composition_notices,
    find_skeletons,
    open_stage,
    up_axis,
)
from animtool.usd.stderr import without_usd_warnings

# What points are joined to, and the attribute with an entry for each.
_PIECES = {
    "Mesh": ("faces", "faceVertexCounts"),
    "BasisCurves": ("curves", "curveVertexCounts"),
    "NurbsCurves": ("curves", "curveVertexCounts"),
    "HermiteCurves": ("curves", "curveVertexCounts"),
}


@dataclass(frozen=True, slots=True)
class PointPrim:
    """A prim of points."""

    path: str  # of the prim
    type: str  # of the prim; empty of one that only goes over another layer's
    points: tuple[int, int]  # least and most points at a sample
    # What they are joined to, `faces` or `curves`; empty where they are not.
    pieces: str
    piece_count: tuple[int, int]  # least and most of these
    samples: int  # of the points; 0 where they never move
    first: float | None  # time code of the first; None where there is none
    last: float | None  # time code of the last; likewise
    # Whether the same points stay, joined alike, as far as numbers of points, ids at
    # both ends and what may change tell.
    fixed: bool
    velocities: bool  # whether there are any
    widths: bool  # likewise
    ids: bool  # likewise
    normals: bool  # likewise
    primvars: list[str]  # names of those that it has
    # Lowest and highest corner over all samples, in its own space, as it is stated;
    # None where none is.
    extent: tuple[list[float], list[float]] | None

    def as_dict(self) -> dict[str, object]:
        """Return plain values for a JSON report."""
        values = asdict(self)
        extent = None if self.extent is None else [list(each) for each in self.extent]
        values.update(
            points=list(self.points), piece_count=list(self.piece_count), extent=extent
        )
        return values


@dataclass(frozen=True, slots=True)
class ChunkSet:
    """Files that hold the samples of a prim and what is below it, in turn."""

    path: str  # of the prim
    name: str  # of the set
    files: list[str]  # as the layer names them
    missing: list[str]  # those that are not there


@dataclass(frozen=True, slots=True)
class PointStage:
    """A stage without a character."""

    fps: Fraction  # time codes a second, exact
    start: Fraction  # first time code: of the stage, or of the samples
    end: Fraction  # last time code; likewise
    unit: str  # unit of the stage
    up: str  # its up axis
    prims: list[PointPrim]  # of points
    chunks: list[ChunkSet]  # sets of value clips
    notices: list[Fault]  # what is odd


def read_points(path: Path) -> PointStage | None:
    """Return what a stage shows that has points and no character; None of others.

    Arrays of crates are looked at, not read: only their lengths and the extents are
    taken of each sample.

    Raises:
        FormatError: The file cannot be read.
    """
    with usd_errors(path), without_usd_warnings():
        stage = open_stage(path)
        if find_skeletons(stage) or any(map(_animates, _prims(stage))):
            return None
        found = [_described(prim) for prim in _prims(stage) if _has_points(prim)]
        if not found:
            return None
        chunks = [one for prim in _prims(stage) for one in _chunks(prim)]
        codes = [code for one in found for code in (one.first, one.last)]
        known = [code for code in codes if code is not None]
        start, end = stage.GetStartTimeCode(), stage.GetEndTimeCode()
        if known and not stage.HasAuthoredTimeCodeRange():
            start, end = min(known), max(known)
        return PointStage(
            rate_from_float(stage.GetTimeCodesPerSecond()),
            time_fraction(start),
            time_fraction(end),
            unit_name(UsdGeom.GetStageMetersPerUnit(stage)),
            up_axis(stage).value,
            found,
            chunks,
            composition_notices(stage, str(path)) + _gone(chunks, str(path)),
        )


def displaced_points(path: Path) -> list[PointPrim]:
    """Return the prims of a stage whose points have samples.

    Raises:
        FormatError: The file cannot be read.
    """
    with usd_errors(path):
        stage = open_stage(path)
        found = [_described(prim) for prim in _prims(stage) if _has_points(prim)]
        return [one for one in found if one.samples]


def _prims(stage: Any) -> Iterator[Any]:
    """Yield every prim, overs of an animation layer and those of instances too."""
    yield from Usd.PrimRange.Stage(
        stage, Usd.TraverseInstanceProxies(Usd.PrimAllPrimsPredicate)
    )


def _animates(prim: Any) -> bool:
    return bool(prim.IsA(UsdSkel.Animation))


def _has_points(prim: Any) -> bool:
    if prim.IsAbstract():
        return False
    points = prim.GetAttribute("points")
    bare = not prim.GetTypeName() and points and points.HasAuthoredValue()
    return bool(prim.IsA(UsdGeom.PointBased) or bare)


def _described(prim: Any) -> PointPrim:
    points = prim.GetAttribute("points")
    times = points.GetTimeSamples()
    counts = _lengths(points, _codes(times))
    kind = str(prim.GetTypeName())
    pieces, name = _PIECES.get(kind, ("", ""))
    shape = prim.GetAttribute(name) if name else None
    # Those of many samples are packed: the ends tell as much as all.
    many = _lengths(shape, _codes([*times[:1], *times[1:][-1:]])) if shape else []
    primvars = UsdGeom.PrimvarsAPI(prim).GetPrimvarsWithAuthoredValues()
    return PointPrim(
        str(prim.GetPath()),
        kind,
        _span(counts),
        pieces,
        _span(many),
        len(times),
        times[0] if times else None,
        times[-1] if times else None,
        len({*counts} - {None}) < 2
        and not (shape and shape.ValueMightBeTimeVarying())
        and _same_ids(prim, times),
        _has(prim, "velocities"),
        _has(prim, "widths"),
        _has(prim, "ids"),
        _has(prim, "normals"),
        sorted(str(primvar.GetPrimvarName()) for primvar in primvars),
        _extent(
            prim, [code for code, n in zip(_codes(times), counts, strict=True) if n]
        ),
    )


def _has(prim: Any, name: str) -> bool:
    return bool(prim.GetAttribute(name).HasAuthoredValue())


def _codes(times: Sequence[float]) -> list[Any]:
    return [Usd.TimeCode(time) for time in times] or [Usd.TimeCode.Default()]


def _lengths(attribute: Any, codes: Sequence[Any]) -> list[int | None]:
    """Return how many values an array has at each of some times, None of none."""
    values = (attribute.Get(code) for code in codes)
    return [None if value is None else len(array_of(value)) for value in values]


def _span(counts: Sequence[int | None]) -> tuple[int, int]:
    known = [count for count in counts if count is not None]
    return min(known, default=0), max(known, default=0)


def _same_ids(prim: Any, times: Sequence[float]) -> bool:
    """Return whether points have no ids, or at the last sample those of the first."""
    ids = prim.GetAttribute("ids")
    if not (ids and times):
        return True
    first, last = (np.array(array_value(ids, times[i])) for i in (0, -1))
    return np.array_equal(first, last)


def _extent(prim: Any, codes: Sequence[Any]) -> tuple[list[float], list[float]] | None:
    """Return the bounds of all extents that are stated, None where one makes none."""
    attribute = prim.GetAttribute("extent")
    stated = [array_value(attribute, code) for code in codes] if attribute else []
    pairs = [np.array(two) for two in stated if len(two) == 2]
    corners = np.array([pair for pair in pairs if pair.dtype.kind == "f"])
    if corners.shape[1:] != (2, 3) or not np.isfinite(corners).all():
        return None
    low, high = corners[:, 0].min(axis=0), corners[:, 1].max(axis=0)
    return low.astype(float).tolist(), high.astype(float).tolist()


def _gone(chunks: Sequence[ChunkSet], where: str) -> list[Fault]:
    """Name the files of chunks that are not there."""
    return [
        Fault(
            "USD276",
            f"chunks of {chunk.path} are not there: {listed(chunk.missing)}",
            where,
            hint="points between them hold still",
            severity=Severity.WARNING,
        )
        for chunk in chunks
        if chunk.missing
    ]


def _chunks(prim: Any) -> Iterator[ChunkSet]:
    """Yield the value clips that a prim states."""
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

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
from animtool.core.files.reading import record_input
from animtool.core.rates import rate_from_float
from animtool.core.record import dataclass
from animtool.core.units import unit_name
from animtool.usd.caches.reader import (
    PointReader,
    all_prims,
    array_lengths,
    has_character,
    point_prims,
    prototype_paths,
    time_codes_of,
)
from animtool.usd.layers.sdf import usd_errors
from animtool.usd.layers.stderr import without_usd_warnings
from animtool.usd.rigs.prims import (
    array_value,
    composition_notices,
    open_stage,
    up_axis,
)

# Noun of a prim's elements, and the attribute with one entry per element.
_ELEMENT_COUNTS = {
    "Mesh": ("faces", "faceVertexCounts"),
    "BasisCurves": ("curves", "curveVertexCounts"),
    "NurbsCurves": ("curves", "curveVertexCounts"),
    "HermiteCurves": ("curves", "curveVertexCounts"),
}


@dataclass(frozen=True, slots=True)
class PointPrimSummary:
    """Summary of the animated points of one prim."""

    path: str  # path of the prim
    type: str  # type of the prim; empty for an over
    points: tuple[int, int]  # fewest and most points of a sample
    # What the points form, `faces` or `curves`, or the `meshes` of a PointInstancer;
    # empty for separate points.
    pieces: str
    piece_count: tuple[int, int]  # fewest and most pieces of a sample
    samples: int  # samples of points and transforms; 0 if static
    first: float | None  # time code of the first sample; None if static
    last: float | None  # time code of the last sample; None if static
    # Whether the points and their topology stay the same, judged by counts, ids at both
    # ends and varying attributes.
    fixed: bool
    velocities: bool  # whether it has velocities
    widths: bool  # whether it has widths
    ids: bool  # whether it has ids
    normals: bool  # whether it has normals
    orientations: bool  # whether it has orientations
    primvars: list[str]  # names of its primvars
    # Lowest and highest corner of its authored extents over all samples, in local
    # space; None if there is none.
    extent: tuple[list[float], list[float]] | None


@dataclass(frozen=True, slots=True)
class ChunkSet:
    """Clip files with the samples of a prim and its descendants."""

    path: str  # path of the prim
    name: str  # name of the clip set
    files: list[str]  # asset paths in the layer
    missing: list[str]  # files that do not exist


@dataclass(frozen=True, slots=True)
class PointsDescription:
    """Summary of the animated points in a USD file."""

    path: str  # path of the file
    format: str  # USD
    frames: int  # most samples of any prim; 0 if all are static
    fps: Fraction  # time codes per second, exact
    start: Fraction  # time code of the first frame
    end: Fraction  # time code of the last frame
    duration: Fraction  # from the first to the last frame [s]
    types: dict[str, int]  # number of prims by type
    prims: list[PointPrimSummary]  # prims with points
    chunks: list[ChunkSet]  # clip files in time order
    units: str  # unit of the file
    up: str  # up axis of the file
    notices: list[Fault]  # warnings and notes
    json_keys: ClassVar[str] = "* rate=fps#"


def describe_points(path: Path) -> PointsDescription | None:
    """Describe a USD file with points but no character; None for other files.

    Only array lengths and extents are read of each sample of a crate file.
    """
    record_input(path)
    with usd_errors(path), without_usd_warnings():
        stage = open_stage(path)
        prims_with_points = () if has_character(stage) else point_prims(stage)
        prim_summaries = [_summarize_prim(prim) for prim in prims_with_points]
        if not prim_summaries:
            return None
        chunks = [chunk for prim in all_prims(stage) for chunk in _chunk_sets(prim)]
        range_codes = [
            code for prim in prim_summaries for code in (prim.first, prim.last)
        ]
        sample_codes = [code for code in range_codes if code is not None]
        start, end = stage.GetStartTimeCode(), stage.GetEndTimeCode()
        if sample_codes and not stage.HasAuthoredTimeCodeRange():
            start, end = min(sample_codes), max(sample_codes)
        fps = rate_from_float(stage.GetTimeCodesPerSecond())
        return PointsDescription(
            str(path),
            "USD",
            max(prim.samples for prim in prim_summaries),
            fps,
            time_fraction(start),
            time_fraction(end),
            (time_fraction(end) - time_fraction(start)) / fps,
            dict(Counter(prim.type for prim in prim_summaries)),
            prim_summaries,
            chunks,
            unit_name(UsdGeom.GetStageMetersPerUnit(stage)),
            up_axis(stage).value,
            composition_notices(stage, str(path)) + _missing_chunks(chunks, str(path)),
        )


def animated_point_prims(path: Path) -> list[PointPrimSummary]:
    """Return the prims of a stage whose points have samples."""
    with usd_errors(path):
        stage = open_stage(path)
        animated_prims = (
            prim for prim in point_prims(stage) if PointReader(prim).times
        )
        return [_summarize_prim(prim) for prim in animated_prims]


def _summarize_prim(prim: Any) -> PointPrimSummary:
    reader = PointReader(prim)
    times, codes = reader.times, reader.codes
    has_values, is_instancer = reader.has_value, reader.is_instancer
    sample_codes = time_codes_of(times)
    point_counts = array_lengths(reader.points_attr, sample_codes)
    type_name = str(prim.GetTypeName())
    element_noun, count_attr_name = (
        ("meshes", "") if is_instancer else _ELEMENT_COUNTS.get(type_name, ("", ""))
    )
    count_attr = prim.GetAttribute(count_attr_name) if count_attr_name else None
    # Arrays of many samples are compressed; the lengths at both ends are enough.
    element_counts: list[int | None] = []
    if count_attr:
        element_counts = array_lengths(
            count_attr, time_codes_of([*times[:1], *times[1:][-1:]])
        )
    if is_instancer:
        element_counts = [len(prototype_paths(prim))]
    primvars = UsdGeom.PrimvarsAPI(prim).GetPrimvarsWithAuthoredValues()
    return PointPrimSummary(
        str(prim.GetPath()),
        type_name,
        _min_max(point_counts),
        element_noun,
        _min_max(element_counts),
        len(codes),
        codes[0] if codes else None,
        codes[-1] if codes else None,
        len({*point_counts} - {None}) < 2
        and not (count_attr and count_attr.ValueMightBeTimeVarying())
        and _has_constant_ids(prim, times),
        has_values("velocities"),
        has_values("widths"),
        has_values("ids"),
        has_values("normals"),
        has_values("orientations") or has_values("orientationsf"),
        sorted(str(primvar.GetPrimvarName()) for primvar in primvars),
        _extent_union(
            prim,
            [code for code, n in zip(sample_codes, point_counts, strict=True) if n],
        ),
    )


def _min_max(counts: Sequence[int | None]) -> tuple[int, int]:
    known_counts = [count for count in counts if count is not None]
    return min(known_counts, default=0), max(known_counts, default=0)


def _has_constant_ids(prim: Any, times: Sequence[float]) -> bool:
    """Return whether ids are absent, or equal at the first and last sample."""
    ids = prim.GetAttribute("ids")
    if not (ids and times):
        return True
    first, last = (np.array(array_value(ids, times[i])) for i in (0, -1))
    return np.array_equal(first, last)


def _extent_union(
    prim: Any, codes: Sequence[Any]
) -> tuple[list[float], list[float]] | None:
    """Return the union of all authored extents; None if any of them is invalid."""
    attribute = prim.GetAttribute("extent")
    extents = [array_value(attribute, code) for code in codes] if attribute else []
    valid_extents = [np.array(extent) for extent in extents if len(extent) == 2]
    corners = np.array([extent for extent in valid_extents if extent.dtype.kind == "f"])
    if corners.shape[1:] != (2, 3) or not np.isfinite(corners).all():
        return None
    lowest, highest = corners[:, 0].min(axis=0), corners[:, 1].max(axis=0)
    return lowest.astype(float).tolist(), highest.astype(float).tolist()


def _missing_chunks(chunks: Sequence[ChunkSet], file_path: str) -> list[Fault]:
    """Return a warning for each value clip set with missing files."""
    return [
        Fault(
            "USD276",
            f"chunks of {chunk.path} are missing: {listed(chunk.missing)}",
            file_path,
            hint="points are static between them",
            severity=Severity.WARNING,
        )
        for chunk in chunks
        if chunk.missing
    ]


def _chunk_sets(prim: Any) -> Iterator[ChunkSet]:
    """Yield a summary of each value clip set of a prim."""
    if not prim.HasAuthoredMetadata("clips"):
        return
    clips = Usd.ClipsAPI(prim)
    for name in sorted(clips.GetClips()):
        assets = clips.ComputeClipAssetPaths(name)
        missing_files = [
            asset.path
            for asset in assets
            if Sdf.Layer.FindOrOpen(asset.resolvedPath or asset.path) is None
        ]
        yield ChunkSet(
            str(prim.GetPath()), name, [asset.path for asset in assets], missing_files
        )

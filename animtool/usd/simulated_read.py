"""What a stage shows of points that move: meshes, curves, particles, over time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdSkel

from animtool._types import FloatArray, IntArray
from animtool.clock import time_fraction
from animtool.errors import Fault, Severity, listed
from animtool.maths import so3
from animtool.rates import rate_from_float
from animtool.units import unit_name
from animtool.usd.faults import Spot
from animtool.usd.layers import usd_errors
from animtool.usd.rig_prims import (
    array_of,
    array_value,
    composition_notices,
    decompose,
    find_skeletons,
    integers,
    numbers,
    open_stage,
    up_axis,
)
from animtool.usd.stderr import without_usd_warnings

# Half floats are as far from a unit quaternion as this.
UNIT_TOLERANCE = 5e-3

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
    # What they are joined to, `faces` or `curves`, or what stands at them: the
    # `meshes` of a PointInstancer; empty where there is none.
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
    orientations: bool  # likewise
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
        if _has_character(stage):
            return None
        found = [_described(prim) for prim in _point_prims(stage)]
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
        found = [_described(prim) for prim in _point_prims(stage)]
        return [one for one in found if one.samples]


def _prims(stage: Any) -> Iterator[Any]:
    """Yield every prim, overs of an animation layer and those of instances too."""
    yield from Usd.PrimRange.Stage(
        stage, Usd.TraverseInstanceProxies(Usd.PrimAllPrimsPredicate)
    )


def _has_character(stage: Any) -> bool:
    return bool(find_skeletons(stage)) or any(map(_animates, _prims(stage)))


def _animates(prim: Any) -> bool:
    return bool(prim.IsA(UsdSkel.Animation))


def _point_prims(stage: Any) -> Iterator[Any]:
    """Yield the prims of points, but those of which a PointInstancer shows copies."""
    prims = [prim for prim in _prims(stage) if _has_points(prim)]
    copied = {
        path
        for prim in prims
        if prim.IsA(UsdGeom.PointInstancer)
        for path in _meshes(prim)
        if not prim.GetPath().HasPrefix(path)
    }
    for prim in prims:
        if not any(path in copied for path in prim.GetPath().GetPrefixes()):
            yield prim


def _meshes(instancer: Any) -> list[Any]:
    """Return the paths of what a PointInstancer shows copies of."""
    prototypes = UsdGeom.PointInstancer(instancer).GetPrototypesRel()
    return list(prototypes.GetForwardedTargets())


def _has_points(prim: Any) -> bool:
    if prim.IsAbstract():
        return False
    if prim.IsA(UsdGeom.PointInstancer):
        return True
    points = prim.GetAttribute("points")
    bare = not prim.GetTypeName() and points and points.HasAuthoredValue()
    return bool(prim.IsA(UsdGeom.PointBased) or bare)


def _described(prim: Any) -> PointPrim:
    copies = prim.IsA(UsdGeom.PointInstancer)
    points = prim.GetAttribute("positions" if copies else "points")
    times = points.GetTimeSamples()
    counts = _lengths(points, _codes(times))
    kind = str(prim.GetTypeName())
    pieces, name = ("meshes", "") if copies else _PIECES.get(kind, ("", ""))
    shape = prim.GetAttribute(name) if name else None
    # Those of many samples are packed: the ends tell as much as all.
    many = _lengths(shape, _codes([*times[:1], *times[1:][-1:]])) if shape else []
    if copies:
        many = [len(_meshes(prim))]
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
        _has(prim, "orientations") or _has(prim, "orientationsf"),
        sorted(str(primvar.GetPrimvarName()) for primvar in primvars),
        _extent(
            prim, [code for code, n in zip(_codes(times), counts, strict=True) if n]
        ),
    )


def _has(prim: Any, name: str) -> bool:
    attribute = prim.GetAttribute(name)
    return bool(attribute and attribute.HasAuthoredValue())


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


@dataclass(frozen=True, slots=True)
class PointSample:
    """What a prim of points has at a time code, in the world."""

    points: FloatArray  # (N, 3) [m]
    ids: IntArray | None  # (N,); None where there are none
    orientations: FloatArray | None = None  # x, y, z, w (N, 4); None but of copies
    scales: FloatArray | None = None  # as they are stated (N, 3) [1]; likewise
    copied: IntArray | None = None  # which mesh each is a copy of (N,); likewise


class PointSource:
    """The prims of points of a stage that is open, to be looked at over time."""

    def __init__(self, path: Path, stage: Any) -> None:
        self._path, self._stage = path, stage
        root = stage.GetDefaultPrim()
        above = root.GetPath() if root else Sdf.Path.absoluteRootPath
        # What is below the default prim is the same whatever that is called.
        self._prims = {
            str(prim.GetPath().MakeRelativePath(above)): prim
            for prim in _point_prims(stage)
        }
        self.fps = rate_from_float(stage.GetTimeCodesPerSecond())
        self.unit = float(UsdGeom.GetStageMetersPerUnit(stage))
        self.up = up_axis(stage)

    @property
    def names(self) -> list[str]:
        """Paths of the prims, below the default prim."""
        return list(self._prims)

    def type(self, name: str) -> str:
        """Return the type of a prim."""
        return str(self._prims[name].GetTypeName())

    def codes(self, name: str) -> list[float]:
        """Return the time codes of a prim's samples; none where it never moves."""
        return [float(code) for code in self._points(name).GetTimeSamples()]

    def at(self, name: str, code: float | None) -> PointSample:
        """Return what a prim has at a time code; None is the default.

        Copies without orientations or scales are as if these changed nothing.

        Raises:
            FormatError: Its arrays do not fit each other (USD269), or hold what is no
                number (USD265) or no rotation (USD288).
        """
        prim = self._prims[name]
        time = Usd.TimeCode.Default() if code is None else Usd.TimeCode(code)
        spot = Spot.of(self._path, prim)
        world = UsdGeom.Imageable(prim).ComputeLocalToWorldTransform(time)
        matrix = np.array(world, np.float64)
        own = numbers(self._points(name), 3, time)
        if not (np.isfinite(own).all() and np.isfinite(matrix).all()):
            spot.fail("USD265", "points are not finite")
        points = (own @ matrix[:3, :3] + matrix[3, :3]) * self.unit
        count = len(points)

        def each(*names: str, width: int = 0) -> Any:
            """Return rows of an attribute, whole numbers without a width, or None."""
            attr = next((prim.GetAttribute(n) for n in names if _has(prim, n)), None)
            if attr is None:
                return None
            rows = numbers(attr, width, time) if width else integers(attr, time)
            if not len(rows) == len(array_value(attr, time)) in {0, count}:
                spot.at(attr).fail("USD269", f"{len(rows)} for {count} points")
            return rows if len(rows) else None

        ids = each("ids")
        if not prim.IsA(UsdGeom.PointInstancer):
            return PointSample(points, ids)
        turns = each("orientationsf", "orientations", width=4)
        if turns is None:
            turns = np.tile([0.0, 0.0, 0.0, 1.0], (count, 1))
        sizes = np.linalg.norm(turns, axis=1, keepdims=True)
        if not (np.abs(sizes - 1) < UNIT_TOLERANCE).all():
            spot.fail("USD288", "a quaternion is not of length 1")
        turns = so3.multiply(decompose(matrix[None])[1][0], turns / sizes)
        scales = each("scales", width=3)
        if scales is None:
            scales = np.ones((count, 3))
        if not np.isfinite(scales).all():
            spot.fail("USD265", "scales are not finite")
        copied = each("protoIndices")
        if copied is None:
            copied = np.full(count, -1)
        return PointSample(points, ids, turns, scales, copied)

    def _points(self, name: str) -> Any:
        prim = self._prims[name]
        copies = prim.IsA(UsdGeom.PointInstancer)
        return prim.GetAttribute("positions" if copies else "points")


def open_points(path: Path) -> PointSource | None:
    """Return a stage that has points and no character; None of others.

    Raises:
        FormatError: The file cannot be read.
    """
    with usd_errors(path), without_usd_warnings():
        stage = open_stage(path)
        source = None if _has_character(stage) else PointSource(path, stage)
    return source if source and source.names else None

"""Authoring deformed points as point caches: a stage of meshes, or overs on a rig."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pxr import Sdf

from animtool._types import Float32Array, FloatArray
from animtool.output import once_named, replacing
from animtool.rig.surfaces import Strands, Surface
from animtool.shot import Shot
from animtool.skin.deform import Deformed
from animtool.units import UpAxis
from animtool.usd.chunks import ClipFiles, author_clips, point_files
from animtool.usd.finite import Labels, rounded
from animtool.usd.layers import (
    StageMetadata,
    attribute,
    author_metadata,
    author_model,
    export_layer,
    new_layer,
    prim,
)
from animtool.usd.meshes import author_meshes, author_strands, mesh_names, strand_paths
from animtool.usd.names import RigPaths
from animtool.usd.point_based import (
    BlockWriter,
    CachedMesh,
    PointBlock,
    PointSpace,
    empty_attribute,
)

if TYPE_CHECKING:
    from animtool.usd.cache_target import CacheTarget


@dataclass(frozen=True, slots=True)
class CacheJob:
    """What `author_cache` needs beside the blocks."""

    output: Path | None  # the file; None is usda for stdout
    paths: RigPaths
    meshes: tuple[str, ...]  # prims of meshes, then of strands, as blocks count them
    fps: Fraction  # time codes a second
    frames: tuple[Fraction, Fraction] | None  # first and last; None takes the samples'
    meters_per_unit: float  # of the layer [m]
    up: UpAxis  # of a stage
    surfaces: tuple[Surface, ...] = ()  # of a stage
    strands: tuple[Strands, ...] = ()  # of a stage
    # Of a layer, whether blocks have those of meshes that have them; False blocks the
    # rig's.
    normals: bool = True
    target: CacheTarget | None = None  # of a layer, the rig; None is a stage
    shot: Shot | None = None  # that is written


def mesh_paths(
    surfaces: Sequence[Surface], strands: Sequence[Strands], paths: RigPaths
) -> tuple[str, ...]:
    """Return where a stage has meshes, then strands: as a stage with a skeleton."""
    return (*mesh_names(surfaces, paths)[0], *strand_paths(strands, paths))


def round_points(
    mesh: int,
    codes: FloatArray,
    deformed: Deformed,
    meters_per_unit: float,
    space: PointSpace,
) -> PointBlock:
    """Return frames of a mesh rounded to what USD holds, and what the rounding did.

    codes: time codes ``(F,)``; deformed: its frames [m]; meters_per_unit: unit of the
    layer [m].
    """
    points, extents = deformed.points, deformed.extents
    velocities, normals = deformed.velocities, deformed.normals
    placement = space.placement
    if placement is not None:
        linear, shift = placement[:3, :3], placement[:3, 3] * meters_per_unit
        points = points @ linear.T + shift
        extents = np.stack([points.min(axis=1), points.max(axis=1)], axis=1)
        velocities = None if velocities is None else velocities @ linear.T
        normals = None if normals is None else _turned(normals, linear)
    made, error, frame, vertex = rounded(
        points, meters_per_unit, Labels("points", "point"), codes
    )

    def alike(name: str, values: FloatArray, unit: float) -> Float32Array:
        return rounded(values, unit, Labels(name, "point"), codes)[0]

    return PointBlock(
        mesh,
        codes,
        made,
        _widened(alike("extent", extents, meters_per_unit), space.margin),
        None if normals is None else alike("normals", normals, 1.0),
        None
        if velocities is None
        else alike("velocities", velocities, meters_per_unit),
        error,
        float(codes[frame]),
        vertex,
    )


def _widened(extents: Float32Array, margin: float) -> Float32Array:
    """Return bounds of what is drawn about points, as `UsdGeom.Curves` has them."""
    with np.errstate(over="ignore"):
        return extents + np.array([[-margin], [margin]], np.float32)


def _turned(normals: FloatArray, linear: FloatArray) -> FloatArray:
    turned = normals @ np.linalg.inv(linear)
    length = np.linalg.norm(turned, axis=-1, keepdims=True)
    return np.asarray(turned / np.where(length > 0, length, 1.0))


def author_cache(
    job: CacheJob, blocks: Iterator[PointBlock]
) -> tuple[Any, list[CachedMesh]]:
    """Author a layer in memory; nothing is written yet.

    A stage has ``Xform`` prims where one with a skeleton has the model and the
    SkelRoot, and meshes and strands at the same paths, bound to nothing. A layer makes
    the SkelRoot of its rig an ``Xform``, so that UsdSkel does not deform what is
    deformed already.
    """
    layer = new_layer(job.output or Path("stdout.usda"))
    with Sdf.ChangeBlock():
        specs = author_prims(layer, job)
        writers = [BlockWriter(specs[path]) for path in job.meshes]
        whole = job.target is None
        first, last = np.inf, -np.inf
        for block in blocks:
            writers[block.mesh].add(block)
            first, last = min(first, block.codes[0]), max(last, block.codes[-1])
        reports = [writer.finish(rest=whole) for writer in writers]
        author_metadata(layer, cache_metadata(job, first, last))
    if job.target is not None:
        job.target.check(layer)
    return layer, reports


def author_prims(layer: Any, job: CacheJob) -> Mapping[str, Any]:
    """Write everything but points; return the meshes' prims by path."""
    if job.target is None:
        return _author_stage(layer, job)
    return job.target.author(layer, normals=job.normals)


def cache_metadata(job: CacheJob, first: float, last: float) -> StageMetadata:
    """Return what a layer of a cache states, for frames from first to last."""
    frames = job.frames or (Fraction(first), Fraction(last))
    default = Sdf.Path(job.paths.model).GetPrefixes()[0].name
    unit, up = job.meters_per_unit, job.up
    if job.target is not None:
        unit, up = job.target.unit, job.target.up
    return StageMetadata(default, job.fps, *frames, unit, up, job.shot)


def _author_stage(layer: Any, job: CacheJob) -> Mapping[str, Any]:
    author_model(layer, job.paths.model)
    prim(layer, job.paths.root, "Xform")
    unit = job.meters_per_unit
    author_meshes(layer, job.surfaces, job.paths, {}, unit, bound=False)
    author_strands(layer, job.strands, job.paths, {}, unit, bound=False)
    return {path: layer.GetPrimAtPath(path) for path in job.meshes}


@dataclass(frozen=True, slots=True)
class ChunkedCache:
    """A cache whose chunks are written, and a layer in memory that joins them."""

    layer: Any
    reports: list[CachedMesh]
    _job: CacheJob
    _chunks: _Chunks
    _clips: ClipFiles

    def finish(self, save: Callable[[Any, Path | None], int]) -> list[Path]:
        """Write the manifest, then the layer; return all files, the layer last."""
        output, clips = self._clips.output, self._clips
        if self._job.target is None and any(report.samples for report in self.reports):
            self.layer.subLayerPaths.append(clips.defaults)
        with replacing(clips.manifest) as temporary:
            manifest = _manifest(self._job, self._chunks)
            export_layer(manifest, temporary, clips.manifest)
        save(self.layer, output)
        once_named(lambda: clips.remove_others(self._chunks.paths))
        return [*self._chunks.paths, clips.manifest, output]


def write_chunks(
    job: CacheJob, blocks: Iterator[PointBlock], size: int
) -> ChunkedCache:
    """Write the points of a cache in files of some samples each.

    Every file also has the first sample of the next, for what lies between them.
    Nothing is there under its name before all is written, the layer last. Only then do
    chunks go that an earlier, longer bake left: a layer always has its own.
    """
    output = job.output
    assert output is not None
    clips = point_files(output)
    layer = new_layer(output)
    with Sdf.ChangeBlock():
        specs = author_prims(layer, job)
    chunks = _Chunks(job, clips, size)
    for block in blocks:
        chunks.add(block)
    chunks.finish()
    with Sdf.ChangeBlock():
        _author_still(specs, job, chunks)
        author_metadata(layer, chunks.metadata())
        author_clips(layer, job.paths.root, clips, chunks.starts, chunks.last)
    if job.target is not None:
        job.target.check(layer, points=False)
    return ChunkedCache(layer, chunks.reports, job, chunks, clips)


class _Chunk:
    """A file in the making."""

    def __init__(self, job: CacheJob, path: Path) -> None:
        self.path = path
        self.layer = new_layer(self.path)
        self.first, self.last = np.inf, -np.inf
        self.writers = [
            BlockWriter(prim(self.layer, path, over=True)) for path in job.meshes
        ]

    def add(self, block: PointBlock) -> None:
        with Sdf.ChangeBlock():
            self.writers[block.mesh].add(block)
        self.first = min(self.first, float(block.codes[0]))
        self.last = max(self.last, float(block.codes[-1]))


class _Chunks:
    """Files of a cache, each written when the next has begun for every mesh."""

    def __init__(self, job: CacheJob, clips: ClipFiles, size: int) -> None:
        self._job, self._clips, self._size = job, clips, size
        self._done = [0] * len(job.meshes)
        self._open: dict[int, _Chunk] = {}
        self._written = 0
        self.paths: list[Path] = []
        self.starts: list[float] = []
        self.last = -np.inf
        self.reports = [CachedMesh(path) for path in job.meshes]
        self.still: list[dict[str, Float32Array] | None] = [{} for _ in job.meshes]
        self.names: list[list[str]] = [[] for _ in job.meshes]

    def add(self, block: PointBlock) -> None:
        """Put frames into the files that they belong to."""
        self._count(block)
        begin, mesh = 0, block.mesh
        while begin < len(block.codes):
            number, at = divmod(self._done[mesh], self._size)
            count = min(self._size - at, len(block.codes) - begin)
            if at == 0 and number:
                self._open[number - 1].add(block.select(slice(begin, begin + 1)))
            if number not in self._open:
                path = self._clips.chunk(number)
                self._open[number] = _Chunk(self._job, path)
            self._open[number].add(block.select(slice(begin, begin + count)))
            self._done[mesh] += count
            begin += count
        while min(self._done) > (self._written + 1) * self._size:
            self._close(self._written)

    def _count(self, block: PointBlock) -> None:
        block.count(self.reports[block.mesh])
        given = dict(block.values())
        self.names[block.mesh] = list(given)
        still = self.still[block.mesh]
        if still is None:
            return
        for name, rows in given.items():
            still.setdefault(name, rows[0].copy())
        if (block.points != still["points"]).any():
            self.still[block.mesh] = None

    def _close(self, number: int) -> None:
        chunk = self._open.pop(number)
        with Sdf.ChangeBlock():
            for writer in chunk.writers:
                writer.release()
                if number == 0 and self._job.target is None:
                    writer.rest()
            metadata = cache_metadata(self._job, chunk.first, chunk.last)
            author_metadata(chunk.layer, metadata)
            chunk.layer.startTimeCode, chunk.layer.endTimeCode = chunk.first, chunk.last
        with replacing(chunk.path) as temporary:
            export_layer(chunk.layer, temporary, chunk.path)
        self.paths.append(chunk.path)
        self.starts.append(chunk.first)
        self.last = max(self.last, chunk.last)
        self._written += 1

    def finish(self) -> None:
        """Write what is left."""
        for number in sorted(self._open):
            self._close(number)
        for report, still, names in zip(
            self.reports, self.still, self.names, strict=True
        ):
            report.sampled = [] if still is not None else names
            if still is not None:
                report.samples = report.bytes = 0

    def metadata(self) -> Any:
        """Return what the layer of all files states."""
        return cache_metadata(self._job, self.starts[0], self.last)


def _author_still(specs: Any, job: CacheJob, chunks: _Chunks) -> None:
    """Declare what the files hold; what never moves has its value here, which wins."""
    for path, names, still in zip(job.meshes, chunks.names, chunks.still, strict=True):
        for name in names:
            if still is None:
                empty_attribute(specs[path], name)
            elif name != "velocities":
                empty_attribute(specs[path], name).finish(still[name])
            elif job.target is None:
                # The first chunk, a sublayer for its defaults, has zeros there.
                kind = Sdf.ValueTypeNames.Vector3fArray
                attribute(specs[path], name, kind, Sdf.ValueBlock())


def _manifest(job: CacheJob, chunks: _Chunks) -> Any:
    layer = new_layer(Path("manifest.usda"))
    with Sdf.ChangeBlock():
        for path, names, still in zip(
            job.meshes, chunks.names, chunks.still, strict=True
        ):
            spec = prim(layer, path, over=True)
            for name in names if still is None else ():
                empty_attribute(spec, name)
        author_metadata(layer, chunks.metadata())
    return layer

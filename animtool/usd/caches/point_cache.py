"""Bakes joint deformation to point caches: a stage of meshes, or overs on a rig."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pxr import Sdf

from animtool.core.array_types import Float32Array, FloatArray
from animtool.core.clock import FrameSpan
from animtool.core.files.output import replacement_path
from animtool.core.record import dataclass
from animtool.core.shot import Shot
from animtool.core.units import UpAxis
from animtool.rig.surfaces import Strands, Surface
from animtool.skin.deform import DeformedFrames, unit_normals
from animtool.usd.caches.writer import (
    CachedMesh,
    FrameBlock,
    PointSpace,
    PointWriter,
    empty_attribute,
)
from animtool.usd.layers.chunks import (
    ChunkedWriter,
    LayerWriter,
    author_span,
    point_clip_files,
    write_frames,
)
from animtool.usd.layers.finite import ValueLabels, round_to_float32
from animtool.usd.layers.names import RigPaths
from animtool.usd.layers.sdf import (
    StageMetadata,
    attribute_spec,
    author_metadata,
    author_model,
    export_layer,
    new_layer,
    prim_spec,
)
from animtool.usd.rigs.meshes import author_meshes, mesh_names
from animtool.usd.rigs.skeleton import author_strands, strand_paths

if TYPE_CHECKING:
    from animtool.usd.caches.target import CacheTarget


@dataclass(frozen=True, slots=True)
class CacheJob:
    """Settings of a point cache."""

    output: Path  # path of the file, or `STDOUT` for usda
    paths: RigPaths
    meshes: tuple[str, ...]  # prim paths of meshes, then strands, by block index
    fps: Fraction  # time codes per second
    # First and last frame; None is the range of the samples.
    frames: tuple[Fraction, Fraction] | None
    meters_per_unit: float  # unit of the layer [m]
    up: UpAxis  # up axis of a stage
    surfaces: tuple[Surface, ...] = ()  # meshes of a stage
    strands: tuple[Strands, ...] = ()  # strands of a stage
    # Whether blocks have normals; if not, a layer over a rig blocks the rig's.
    has_normals: bool = True
    target: CacheTarget | None = None  # rig below a layer; None for a stage
    shot: Shot | None = None  # shot to record in the layer


def mesh_paths(
    surfaces: Sequence[Surface], strands: Sequence[Strands], paths: RigPaths
) -> tuple[str, ...]:
    """Return the prim paths of meshes, then strands, as in a stage with a skeleton."""
    return (*mesh_names(surfaces, paths)[0], *strand_paths(strands, paths))


def round_points(
    mesh_index: int,
    codes: FloatArray,
    deformed_frames: DeformedFrames,
    meters_per_unit: float,
    space: PointSpace,
) -> FrameBlock:
    """Return frames of a mesh rounded to float32, and the rounding error.

    Args:
        mesh_index: Index of the mesh.
        codes: Time codes ``(F,)``.
        deformed_frames: Frames of the mesh [m].
        meters_per_unit: Unit of the layer [m].
        space: Space of the written points.
    """
    points, extents = deformed_frames.points, deformed_frames.extents
    velocities, normals = deformed_frames.velocities, deformed_frames.normals
    placement = space.placement
    if placement is not None:
        linear, translation = placement[:3, :3], placement[:3, 3] * meters_per_unit
        points = points @ linear.T + translation
        extents = np.stack([points.min(axis=1), points.max(axis=1)], axis=1)
        velocities = None if velocities is None else velocities @ linear.T
        if normals is not None:
            normals = unit_normals(normals @ np.linalg.inv(linear))
    rounded_points, error, frame, vertex = round_to_float32(
        points, meters_per_unit, ValueLabels("points", "point"), codes
    )

    def to_float32(name: str, values: FloatArray, unit: float) -> Float32Array:
        return round_to_float32(values, unit, ValueLabels(name, "point"), codes)[0]

    extent = to_float32("extent", extents, meters_per_unit)
    # Widened by half the width of curves, as `UsdGeom.Curves` does.
    margins = np.array([[-space.margin], [space.margin]], np.float32)
    with np.errstate(over="ignore"):
        values = {"points": rounded_points, "extent": extent + margins}
    if normals is not None:
        values["normals"] = to_float32("normals", normals, 1.0)
    if velocities is not None:
        values["velocities"] = to_float32("velocities", velocities, meters_per_unit)
    code = float(codes[frame])
    return FrameBlock(mesh_index, codes, values, points.shape[1], error, code, vertex)


def author_cache(
    job: CacheJob, blocks: Iterator[FrameBlock]
) -> tuple[Any, list[CachedMesh]]:
    """Author the cache layer in memory; nothing is saved yet.

    A stage has ``Xform`` prims in place of the model and the SkelRoot of a stage with a
    skeleton, and unbound meshes and strands at the same paths. A layer over a rig turns
    its SkelRoot into an ``Xform``, so that UsdSkel does not deform the points again.
    """
    layer = new_layer(job.output)
    reports = [CachedMesh(path) for path in job.meshes]
    writers = [PointWriter(layer, report) for report in reports]
    layer_writer = LayerWriter(writers)
    with Sdf.ChangeBlock():
        _author_prims(layer, job)
        write_frames(blocks, layer_writer, reports)
        for writer in writers:
            writer.finish(with_defaults=job.target is None)
        author_metadata(
            layer, cache_metadata(job, layer_writer.first, layer_writer.last)
        )
    if job.target is not None:
        job.target.check(layer)
    return layer, reports


def _author_prims(layer: Any, job: CacheJob) -> None:
    """Author everything except the points."""
    if job.target is not None:
        job.target.author(layer, with_normals=job.has_normals)
        return
    author_model(layer, job.paths.model)
    prim_spec(layer, job.paths.root, "Xform")
    unit = job.meters_per_unit
    author_meshes(layer, job.surfaces, job.paths, None, unit)
    author_strands(layer, job.strands, job.paths, None, unit)


def cache_metadata(job: CacheJob, first: float, last: float) -> StageMetadata:
    """Return the layer metadata of a cache, with its frame range."""
    frames = job.frames or (Fraction(first), Fraction(last))
    default_prim = Sdf.Path(job.paths.model).GetPrefixes()[0].name
    unit, up = job.meters_per_unit, job.up
    if job.target is not None:
        unit, up = job.target.unit, job.target.up
    return StageMetadata(default_prim, FrameSpan(*frames, job.fps), unit, up, job.shot)


@dataclass(frozen=True, slots=True)
class ChunkedCache:
    """A cache with written chunks, and the in-memory layer that combines them."""

    layer: Any
    reports: list[CachedMesh]
    _chunks: ChunkedWriter

    def finish(self, save: Callable[[Any, Path], int]) -> list[Path]:
        """Write the manifest, then the layer; return all files, the layer last."""
        files, output = self._chunks.finish(), self._chunks.files.output
        save(self.layer, output)
        return [*files, output]


def write_chunks(
    job: CacheJob, blocks: Iterator[FrameBlock], chunk_bytes: int
) -> ChunkedCache:
    """Write the points of a cache in chunk files.

    Files appear under their names only after all are written, the layer last.
    """
    layer = new_layer(job.output)
    with Sdf.ChangeBlock():
        _author_prims(layer, job)
    chunked_meshes = [_ChunkedMesh(path) for path in job.meshes]
    reports = [mesh.report for mesh in chunked_meshes]

    def open_chunk(path: Path, index: int) -> AbstractContextManager[list[PointWriter]]:
        return _chunk_writers(
            job, path, reports, with_defaults=index == 0 and job.target is None
        )

    files = point_clip_files(job.output)
    with ChunkedWriter(files, chunk_bytes, len(chunked_meshes), open_chunk) as chunks:
        write_frames(blocks, chunks, chunked_meshes)
    metadata = cache_metadata(job, chunks.chunk_starts[0], chunks.last)
    with Sdf.ChangeBlock():
        for mesh in chunked_meshes:
            mesh.author(
                layer.GetPrimAtPath(mesh.report.path), with_defaults=job.target is None
            )
        author_metadata(layer, metadata)

    def declare_attributes(manifest: Any) -> None:
        for report in reports:
            spec = prim_spec(manifest, report.path, is_over=True)
            for name in report.sampled:
                empty_attribute(spec, name)

    is_animated = any(report.samples for report in reports)
    use_defaults = job.target is None and is_animated
    chunks.author_value_clips(
        layer, job.paths.root, metadata, declare_attributes, use_defaults=use_defaults
    )
    if job.target is not None:
        job.target.check(layer, has_points=False)
    return ChunkedCache(layer, reports, chunks)


@contextmanager
def _chunk_writers(
    job: CacheJob, path: Path, reports: Sequence[CachedMesh], *, with_defaults: bool
) -> Iterator[list[PointWriter]]:
    """Yield one point writer per mesh for a chunk file, which is saved on exit."""
    layer = new_layer(path)
    for mesh in job.meshes:
        prim_spec(layer, mesh, is_over=True)
    writers = [PointWriter(layer, report) for report in reports]
    yield writers
    with Sdf.ChangeBlock():
        for writer in writers:
            writer.sample_all(with_defaults=with_defaults)
        author_span(layer, cache_metadata(job, 0.0, 0.0))
    with replacement_path(path) as temporary_path:
        export_layer(layer, temporary_path, path)


class _ChunkedMesh:
    """The report of a mesh of a chunked cache, and its values if they are constant."""

    def __init__(self, path: str) -> None:
        self.report = CachedMesh(path)
        # Values of the first frame; None once the points differ from them.
        self._first_values: dict[str, Float32Array] | None = None

    def add_block(self, block: FrameBlock) -> None:
        """Count a block; record its attributes and whether points change."""
        values = block.values
        if not self.report.sampled:
            self._first_values = {name: rows[0].copy() for name, rows in values.items()}
        self.report.add_block(block)
        self.report.sampled = list(values)
        first_values = self._first_values
        if (
            first_values is not None
            and (values["points"] != first_values["points"]).any()
        ):
            self._first_values = None

    def author(self, spec: Any, *, with_defaults: bool) -> None:
        """Declare the attributes of the chunks; author constant ones as defaults.

        With ``with_defaults``, velocities of static points are declared but blocked.
        """
        for name in self.report.sampled:
            if self._first_values is None:
                empty_attribute(spec, name)
            elif name != "velocities":
                empty_attribute(spec, name).finish(self._first_values[name])
            elif with_defaults:
                kind = Sdf.ValueTypeNames.Vector3fArray
                attribute_spec(spec, name, kind, Sdf.ValueBlock())
        if self._first_values is not None:
            self.report.sampled, self.report.samples, self.report.bytes = [], 0, 0

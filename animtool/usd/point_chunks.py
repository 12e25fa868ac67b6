"""Long point caches in several files, joined as value clips.

A file is written as soon as all of its frames are there, so that the points of two or
three are in memory, however long the take.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Sdf

from animtool._types import Float32Array
from animtool.output import once_named, replacing
from animtool.usd.clip_files import ClipFiles, point_files
from animtool.usd.layers import (
    attribute,
    author_metadata,
    export_layer,
    new_layer,
    prim,
)
from animtool.usd.point_based import (
    BlockWriter,
    CachedMesh,
    PointBlock,
    empty_attribute,
)
from animtool.usd.point_cache import CacheJob, author_prims, cache_metadata
from animtool.usd.value_clips import author_clips


@dataclass(frozen=True, slots=True)
class ChunkedCache:
    """A cache whose chunks are written, and a layer in memory that joins them."""

    layer: Any
    reports: list[CachedMesh]
    _job: CacheJob
    _chunks: _Chunks
    _clips: ClipFiles

    def finish(self, save: Callable[[Any, Path | None], int]) -> list[Path]:
        """Write the manifest, then the layer; return all files, the layer last.

        Raises:
            OutputError: A file cannot be written.
        """
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

    Args:
        job: What to write; with an output.
        blocks: Frames of the meshes, in time order for each.
        size: Samples a file.

    Raises:
        OutputError: A file cannot be written.
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
    """Files of a cache, each written when the next has begun for every mesh.

    Attributes:
        paths: Files written.
        starts: First time code of each.
        last: Last time code of all.
        reports: What was written of each mesh.
        still: Values of meshes that have not moved so far, by attribute.
        names: Attributes of each mesh.
    """

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

"""Writes frames, time code by time code, into one layer or into chunks.

Layers are saved while they grow, so that memory stays constant however long they get:
the samples of a saved crate are on disk.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, Self

import numpy as np
from pxr import Sdf, Tf, Vt

from animtool.core.clock import FrameSpan
from animtool.core.files.commit import output_error
from animtool.core.files.output import STDOUT, after_commit, replacement_path
from animtool.core.record import dataclass
from animtool.usd.layers.sdf import (
    StageMetadata,
    author_metadata,
    export_layer,
    new_layer,
    packaged,
    save_layer,
    usd_reason,
)

if TYPE_CHECKING:
    from animtool.usd.caches.writer import FrameBlock, PointWriter

# Samples are flushed to disk above this size [byte].
MAX_BUFFERED_BYTES = 32_000_000


class GrowingLayer:
    """A layer that receives samples, flushed to disk above a memory limit."""

    def __init__(self, layer: Any, path: Path | None = None) -> None:
        """Start without buffered samples.

        Args:
            layer: The layer.
            path: Future path of the file; None keeps all in memory.
        """
        self.layer = layer
        self._path = path
        self._buffered_bytes = 0
        self.size = 0  # size of the written file [byte]

    def count_bytes(self, size: int) -> None:
        """Add to the count of buffered bytes; flush to disk above the limit."""
        self._buffered_bytes += size
        if self._path is not None and self._buffered_bytes > MAX_BUFFERED_BYTES:
            self.save()

    def save(self) -> None:
        """Flush buffered samples to disk."""
        assert self._path is not None
        with _usd_output_errors(self._path):
            self.layer.Save()
        self._buffered_bytes = 0


@contextmanager
def open_growing_crate(temporary_path: Path, path: Path) -> Iterator[GrowingLayer]:
    """Yield a new crate file that receives samples; save it on exit."""
    with _usd_output_errors(path):
        layer = Sdf.Layer.CreateNew(str(temporary_path), args={"format": "usdc"})
    crate_layer = GrowingLayer(layer, path)
    yield crate_layer
    crate_layer.save()


@contextmanager
def open_growing_layer(layer: Any, path: Path) -> Iterator[GrowingLayer]:
    """Yield a layer that receives samples; save it on exit.

    ``path`` is the file, or `STDOUT` for usda.
    """
    if path == STDOUT or path.suffix.lower() == ".usda":
        growing_layer = GrowingLayer(layer)
        yield growing_layer
        growing_layer.size = save_layer(layer, path)
        return
    with replacement_path(path) as temporary_path:
        with (
            packaged(path, temporary_path) as file,
            open_growing_crate(file, path) as crate_layer,
        ):
            crate_layer.layer.TransferContent(layer)
            yield crate_layer
        crate_layer.size = temporary_path.stat().st_size


@contextmanager
def _usd_output_errors(path: Path) -> Iterator[None]:
    """Raise USD's write errors as `OutputError`."""
    try:
        yield
    except Tf.ErrorException as error:
        raise output_error(path, usd_reason(error)) from error


@dataclass(frozen=True, slots=True)
class ClipFiles:
    """The chunks and the manifest of one set of value clips."""

    output: Path  # layer that combines the chunks
    name: str  # name of the clip set
    manifest: Path  # layer that declares the attributes of the chunks

    def chunk(self, index: int) -> Path:
        """Return the path of a chunk, counted from 0.

        >>> system_clip_files(Path("shot.usdc")).chunk(0).name
        'shot.systems.0001.usdc'
        """
        stem = self.output.stem
        return self.output.with_name(f"{stem}.{self.name}.{index + 1:04d}.usdc")

    def existing_chunks(self) -> list[Path]:
        """Return the chunk files that exist, in time order."""
        stem, folder = re.escape(self.output.stem), self.output.parent
        pattern = re.compile(rf"{stem}\.{self.name}\.\d{{4,}}\.usdc")
        paths = folder.iterdir() if folder.is_dir() else ()
        return sorted(path for path in paths if pattern.fullmatch(path.name))

    def remove_stale_chunks(self, current_chunks: Collection[Path]) -> None:
        """Delete chunks left by an earlier, longer bake."""
        for path in set(self.existing_chunks()) - set(current_chunks):
            # Leftover files that cannot be removed do no harm.
            with suppress(OSError):
                path.unlink()


def point_clip_files(output: Path) -> ClipFiles:
    """Return the clip files of a character's point caches.

    >>> point_clip_files(Path("shot.usdc")).manifest.name
    'shot.manifest.usda'
    """
    manifest = output.with_name(f"{output.stem}.manifest.usda")
    return ClipFiles(output, "points", manifest)


def system_clip_files(output: Path) -> ClipFiles:
    """Return the clip files of a simulation.

    >>> system_clip_files(Path("shot.usdc")).manifest.name
    'shot.systems.manifest.usda'
    """
    manifest = output.with_name(f"{output.stem}.systems.manifest.usda")
    return ClipFiles(output, "systems", manifest)


class FrameReport(Protocol):
    """A report that counts the written frames of one prim."""

    def add_block(self, block: FrameBlock) -> None:
        """Add a block of written frames to the report."""


def write_frames(
    blocks: Iterable[FrameBlock],
    writer: LayerWriter | ChunkedWriter,
    reports: Sequence[FrameReport],
) -> None:
    """Write blocks of frames of all prims, and count them in the prims' reports."""
    for block in blocks:
        reports[block.prim_index].add_block(block)
        writer.add(block)


class LayerWriter:
    """Writes all samples of all prims to one layer."""

    def __init__(self, writers: Sequence[PointWriter]) -> None:
        """Start with one writer per prim."""
        self._writers = writers
        self.first, self.last = np.inf, -np.inf  # first and last time code

    def add(self, block: FrameBlock) -> None:
        """Write a block of frames of one prim."""
        self._writers[block.prim_index].add(block)
        self.first = min(self.first, block.codes[0])
        self.last = max(self.last, block.codes[-1])


class ChunkedWriter:
    """Writes samples to chunk files of fixed length.

    Each chunk also has the first sample of the next one, for interpolation. It is
    closed when all prims have reached the next chunk.
    """

    def __init__(
        self,
        files: ClipFiles,
        chunk_size: int,
        prim_count: int,
        open_writers: Callable[
            [Path, int], AbstractContextManager[Sequence[PointWriter]]
        ],
    ) -> None:
        """Start without open files.

        Args:
            files: Paths of the files.
            chunk_size: Samples per file.
            prim_count: Number of prims.
            open_writers: Yields one writer per prim for a file, numbered from 0; the
                file is complete when the context exits.
        """
        self.files = files
        self._chunk_size = chunk_size
        self._open_writers = open_writers
        self._next_samples = [0] * prim_count
        self._open_chunks: dict[int, tuple[ExitStack, Sequence[PointWriter]]] = {}
        self.chunk_starts: list[float] = []
        self.last = -np.inf
        self._manifest: Any = None  # set by `author_value_clips`

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: Any) -> None:
        """Close the open files; after an error, discard them."""
        for index in sorted(self._open_chunks):
            if error[0] is None:
                self._close_chunk(index)
            else:
                self._open_chunks.pop(index)[0].__exit__(*error)

    @property
    def paths(self) -> list[Path]:
        """Paths of the chunk files, in time order."""
        return [self.files.chunk(number) for number in range(len(self.chunk_starts))]

    def add(self, block: FrameBlock) -> None:
        """Write a block of frames to the chunk files of its time codes."""
        codes, begin = block.codes, 0
        while begin < len(codes):
            chunk, sample = divmod(
                self._next_samples[block.prim_index], self._chunk_size
            )
            frame_count = min(self._chunk_size - sample, len(codes) - begin)
            if sample == 0 and chunk:
                self._write_block(
                    chunk - 1, block.select_frames(slice(begin, begin + 1))
                )
            if chunk == len(self.chunk_starts):
                stack = ExitStack()
                context = self._open_writers(self.files.chunk(chunk), chunk)
                self._open_chunks[chunk] = stack, stack.enter_context(context)
                self.chunk_starts.append(float(codes[begin]))
            self._write_block(
                chunk, block.select_frames(slice(begin, begin + frame_count))
            )
            self._next_samples[block.prim_index] += frame_count
            begin += frame_count
        self.last = max(self.last, float(codes[-1]))
        for chunk in sorted(self._open_chunks):
            if min(self._next_samples) > (chunk + 1) * self._chunk_size:
                self._close_chunk(chunk)

    def _write_block(self, chunk: int, block: FrameBlock) -> None:
        self._open_chunks[chunk][1][block.prim_index].add(block)

    def _close_chunk(self, chunk: int) -> None:
        self._open_chunks.pop(chunk)[0].close()

    def author_value_clips(
        self,
        layer: Any,
        path: str,
        metadata: StageMetadata,
        declare_attributes: Callable[[Any], None],
        *,
        use_defaults: bool,
    ) -> None:
        """Author the files as value clips of a prim and its descendants.

        ``declare_attributes`` declares the attributes of the files in a manifest. With
        ``use_defaults``, the layer also gets the default values of the first file.
        """
        self._author_clip_metadata(layer, path)
        if use_defaults:
            # Defaults in the layer itself would be stronger than the clips.
            layer.subLayerPaths.append(f"./{self.files.chunk(0).name}")
        self._manifest = new_layer(self.files.manifest)
        declare_attributes(self._manifest)
        author_metadata(self._manifest, metadata)

    def _author_clip_metadata(self, layer: Any, path: str) -> None:
        """Author the files as value clips of a prim."""
        chunk_starts, files = self.chunk_starts, self.files
        clips = {
            "assetPaths": Sdf.AssetPathArray(
                [Sdf.AssetPath(f"./{chunk.name}") for chunk in self.paths]
            ),
            "primPath": path,
            "manifestAssetPath": Sdf.AssetPath(f"./{files.manifest.name}"),
            "active": Vt.Vec2dArray([(code, i) for i, code in enumerate(chunk_starts)]),
            "times": Vt.Vec2dArray(
                [(code, code) for code in (chunk_starts[0], self.last)]
            ),
        }
        layer.GetPrimAtPath(path).SetInfo("clips", {files.name: clips})

    def finish(self) -> list[Path]:
        """Write the manifest; return all written files.

        Stale files of an earlier, longer bake are removed only after the new files are
        in place, so that a layer always has its own chunks.
        """
        with replacement_path(self.files.manifest) as temporary_path:
            export_layer(self._manifest, temporary_path, self.files.manifest)
        files = [*self.paths, self.files.manifest]
        after_commit(lambda: self.files.remove_stale_chunks(files))
        return files


def author_span(layer: Any, metadata: StageMetadata) -> None:
    """Author metadata with the range of the layer's samples."""
    codes = layer.ListAllTimeSamples()
    span = FrameSpan(Fraction(codes[0]), Fraction(codes[-1]), metadata.span.fps)
    author_metadata(layer, replace(metadata, span=span))

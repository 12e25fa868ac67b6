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
from typing import TYPE_CHECKING, Any, Generic, Protocol, Self, TypeVar

import numpy as np
from pxr import Sdf, Tf, Vt

from animtool.core.array_types import FloatArray
from animtool.core.clock import FrameSpan
from animtool.core.files.output import STDOUT, after_commit, replacement_path
from animtool.core.files.placing import output_error
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
    from animtool.usd.caches.writer import Block

# Buffered samples that are flushed to disk [byte].
BUFFERED_BYTES = 32_000_000


class GrowingLayer:
    """A layer that receives samples."""

    def __init__(self, layer: Any, path: Path | None = None) -> None:
        """Begin a layer.

        Args:
            layer: The layer.
            path: Future path of the file; None keeps all in memory.
        """
        self.layer = layer
        self._path = path
        self._buffered = 0
        self.size = 0  # size of the written file [byte]

    def count_bytes(self, size: int) -> None:
        """Count buffered bytes; flush to disk above the limit."""
        self._buffered += size
        if self._path is not None and self._buffered > BUFFERED_BYTES:
            self.save()

    def save(self) -> None:
        """Flush buffered samples to disk."""
        assert self._path is not None
        with _as_output_error(self._path):
            self.layer.Save()
        self._buffered = 0


@contextmanager
def growing_crate(temporary: Path, path: Path) -> Iterator[GrowingLayer]:
    """Context of a new crate file that is complete at the end of the block."""
    with _as_output_error(path):
        layer = Sdf.Layer.CreateNew(str(temporary), args={"format": "usdc"})
    growing = GrowingLayer(layer, path)
    yield growing
    growing.save()


@contextmanager
def growing_layer(layer: Any, path: Path) -> Iterator[GrowingLayer]:
    """Context of a layer that receives samples; saved at the end.

    ``path`` is the file, or `STDOUT` for usda.
    """
    if path == STDOUT or path.suffix.lower() == ".usda":
        growing = GrowingLayer(layer)
        yield growing
        growing.size = save_layer(layer, path)
        return
    with replacement_path(path) as temporary:
        with (
            packaged(path, temporary) as file,
            growing_crate(file, path) as growing,
        ):
            growing.layer.TransferContent(layer)
            yield growing
        growing.size = temporary.stat().st_size


@contextmanager
def _as_output_error(path: Path) -> Iterator[None]:
    """Context that turns USD's write errors into an `OutputError`."""
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

    def chunk(self, number: int) -> Path:
        """Return the path of a chunk, counted from 0.

        >>> system_files(Path("shot.usdc")).chunk(0).name
        'shot.systems.0001.usdc'
        """
        stem = self.output.stem
        return self.output.with_name(f"{stem}.{self.name}.{number + 1:04d}.usdc")

    @property
    def defaults(self) -> str:
        """Asset path of the chunk with default values, a sublayer of the layer.

        Defaults in the layer itself would be stronger than the clips.
        """
        return f"./{self.chunk(0).name}"

    def existing_chunks(self) -> list[Path]:
        """Return the existing chunks, in order."""
        stem, folder = re.escape(self.output.stem), self.output.parent
        name = re.compile(rf"{stem}\.{self.name}\.\d{{4,}}\.usdc")
        paths = folder.iterdir() if folder.is_dir() else ()
        return sorted(path for path in paths if name.fullmatch(path.name))

    def remove_others(self, current: Collection[Path]) -> None:
        """Delete chunks left by an earlier, longer bake."""
        for path in set(self.existing_chunks()) - set(current):
            # Leftover files that cannot be removed do no harm.
            with suppress(OSError):
                path.unlink()


def point_files(output: Path) -> ClipFiles:
    """Return the clip files of a character's point caches.

    >>> point_files(Path("shot.usdc")).manifest.name
    'shot.manifest.usda'
    """
    manifest = output.with_name(f"{output.stem}.manifest.usda")
    return ClipFiles(output, "points", manifest)


def system_files(output: Path) -> ClipFiles:
    """Return the clip files of a simulation.

    >>> system_files(Path("shot.usdc")).manifest.name
    'shot.systems.manifest.usda'
    """
    manifest = output.with_name(f"{output.stem}.systems.manifest.usda")
    return ClipFiles(output, "systems", manifest)


class PrimFrames(Protocol):
    """A block of frames of one prim."""

    @property
    def prim(self) -> int:
        """Index of the prim."""

    @property
    def codes(self) -> FloatArray:
        """Time codes ``(F,)``."""


FramesT = TypeVar("FramesT", bound=PrimFrames)
FramesIn_contra = TypeVar("FramesIn_contra", contravariant=True)


class FrameWriter(Protocol[FramesIn_contra]):
    """Writer of the frames of one prim."""

    def add(self, block: FramesIn_contra) -> None:
        """Write frames."""


class FrameReport(Protocol[FramesIn_contra]):
    """Report on the frames of one prim."""

    def count(self, block: FramesIn_contra) -> None:
        """Add written frames."""


def write_frames(
    blocks: Iterable[FramesT],
    writer: FrameWriter[FramesT],
    reports: Sequence[FrameReport[FramesT]],
) -> None:
    """Write all frames of all prims; every time code of a bake passes through here.

    Args:
        blocks: Blocks of frames.
        writer: `OneLayer` or `Chunks`.
        reports: One report per prim.
    """
    for block in blocks:
        reports[block.prim].count(block)
        writer.add(block)


class OneLayer(Generic[FramesT]):
    """Writes all samples to one layer."""

    def __init__(self, writers: Sequence[FrameWriter[FramesT]]) -> None:
        """Begin with the writer of each prim."""
        self._writers = writers
        self.first, self.last = np.inf, -np.inf  # first and last time code

    def add(self, block: FramesT) -> None:
        """Write frames."""
        self._writers[block.prim].add(block)
        self.first = min(self.first, block.codes[0])
        self.last = max(self.last, block.codes[-1])


class Chunks:
    """Writes samples to files of fixed size, closed once all prims have the next one.

    Every file also has the first sample of the next, for interpolation between them.
    """

    def __init__(
        self,
        files: ClipFiles,
        size: int,
        prims: int,
        build: Callable[
            [Path, int], AbstractContextManager[Sequence[FrameWriter[Block]]]
        ],
    ) -> None:
        """Begin without files.

        Args:
            files: Paths of the files.
            size: Samples per file.
            prims: Number of prims.
            build: Context with the writers of a file, counted from 0; the file is
                complete at the end of the context.
        """
        self.files, self._size, self._build = files, size, build
        self._next_samples = [0] * prims
        self._open: dict[int, tuple[ExitStack, Sequence[FrameWriter[Block]]]] = {}
        self.starts: list[float] = []
        self.last = -np.inf
        self._manifest: Any = None  # set by `join`

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: Any) -> None:
        """Close the open files; they are kept only if no error occurred."""
        for number in sorted(self._open):
            if error[0] is None:
                self._close(number)
            else:
                self._open.pop(number)[0].__exit__(*error)

    @property
    def paths(self) -> list[Path]:
        """The files, in order."""
        return [self.files.chunk(number) for number in range(len(self.starts))]

    def add(self, block: Block) -> None:
        """Write frames to the files they belong to."""
        codes, begin = block.codes, 0
        while begin < len(codes):
            number, at = divmod(self._next_samples[block.prim], self._size)
            count = min(self._size - at, len(codes) - begin)
            if at == 0 and number:
                self._put(number - 1, block.some(slice(begin, begin + 1)))
            if number == len(self.starts):
                stack = ExitStack()
                context = self._build(self.files.chunk(number), number)
                self._open[number] = stack, stack.enter_context(context)
                self.starts.append(float(codes[begin]))
            self._put(number, block.some(slice(begin, begin + count)))
            self._next_samples[block.prim] += count
            begin += count
        self.last = max(self.last, float(codes[-1]))
        for number in sorted(self._open):
            if min(self._next_samples) > (number + 1) * self._size:
                self._close(number)

    def _put(self, number: int, block: Block) -> None:
        self._open[number][1][block.prim].add(block)

    def _close(self, number: int) -> None:
        self._open.pop(number)[0].close()

    def join(
        self,
        layer: Any,
        path: str,
        metadata: StageMetadata,
        declare: Callable[[Any], None],
        *,
        defaults: bool,
    ) -> None:
        """Use the files as value clips of a prim and its descendants.

        ``declare`` declares the attributes of the files in a manifest; ``defaults``
        says whether the defaults of the first file apply to the layer.
        """
        author_clips(layer, path, self.files, self.starts, self.last)
        if defaults:
            layer.subLayerPaths.append(self.files.defaults)
        self._manifest = new_layer(self.files.manifest)
        declare(self._manifest)
        author_metadata(self._manifest, metadata)

    def finish(self) -> list[Path]:
        """Write the manifest; return all files.

        Leftover files of an earlier, longer bake are removed only after these have
        their names: a layer always has its own chunks.
        """
        with replacement_path(self.files.manifest) as temporary:
            export_layer(self._manifest, temporary, self.files.manifest)
        files = [*self.paths, self.files.manifest]
        after_commit(lambda: self.files.remove_others(files))
        return files


def author_span(layer: Any, metadata: StageMetadata) -> None:
    """Copy a layer's metadata, with the range of the actual samples."""
    codes = layer.ListAllTimeSamples()
    span = FrameSpan(Fraction(codes[0]), Fraction(codes[-1]), metadata.span.fps)
    author_metadata(layer, replace(metadata, span=span))


def author_clips(
    layer: Any,
    path: str,
    files: ClipFiles,
    starts: Sequence[float],
    last: float,
) -> None:
    """Author chunks as value clips of a prim."""
    chunks = [Sdf.AssetPath(f"./{files.chunk(i).name}") for i in range(len(starts))]
    clips = {
        "assetPaths": Sdf.AssetPathArray(chunks),
        "primPath": path,
        "manifestAssetPath": Sdf.AssetPath(f"./{files.manifest.name}"),
        "active": Vt.Vec2dArray([(code, i) for i, code in enumerate(starts)]),
        "times": Vt.Vec2dArray([(code, code) for code in (starts[0], last)]),
    }
    layer.GetPrimAtPath(path).SetInfo("clips", {files.name: clips})

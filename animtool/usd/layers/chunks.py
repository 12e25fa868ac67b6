"""Frames on their way to files: one loop over time codes, into one layer or in chunks.

Layers may be saved while they grow, so that memory stays the same however long they
get: a crate that is saved now and then has its samples on disk.
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
from animtool.core.files.output import after_commit, replacing
from animtool.core.files.placing import output_error
from animtool.core.record import dataclass
from animtool.usd.layers.package import unpacked
from animtool.usd.layers.sdf import (
    StageMetadata,
    author_metadata,
    export_layer,
    new_layer,
    save_layer,
    usd_reason,
)

if TYPE_CHECKING:
    from animtool.usd.caches.writer import Block

# Samples in memory before they go to the disk [byte].
HELD = 32_000_000


class Growing:
    """A layer that samples are put into."""

    def __init__(self, layer: Any, path: Path | None = None) -> None:
        """Begin.

        path: what the file will be called; None keeps all in memory.
        """
        self.layer = layer
        self._path = path
        self._held = 0
        self.size = 0  # of the file, when it is written [byte]

    def added(self, size: int) -> None:
        """Note samples of a size [byte]; bring them to the disk where they are many."""
        self._held += size
        if self._path is not None and self._held > HELD:
            self.save()

    def save(self) -> None:
        """Bring to the disk what is not there."""
        assert self._path is not None
        with _written(self._path):
            self.layer.Save()
        self._held = 0


@contextmanager
def growing_crate(temporary: Path, path: Path) -> Iterator[Growing]:
    """Give a crate that is whole at the end of the block."""
    with _written(path):
        layer = Sdf.Layer.CreateNew(str(temporary), args={"format": "usdc"})
    growing = Growing(layer, path)
    yield growing
    growing.save()


@contextmanager
def growing_layer(layer: Any, path: Path | None) -> Iterator[Growing]:
    """Give what a layer has, to put samples into; it is written at the end, or not.

    path: the file; None is usda on stdout.
    """
    if path is None or path.suffix.lower() == ".usda":
        growing = Growing(layer)
        yield growing
        growing.size = save_layer(layer, path)
        return
    with replacing(path) as temporary:
        with (
            unpacked(path, temporary) as file,
            growing_crate(file, path) as growing,
        ):
            growing.layer.TransferContent(layer)
            yield growing
        growing.size = temporary.stat().st_size


@contextmanager
def _written(path: Path) -> Iterator[None]:
    """Turn what USD raises where it writes into an `OutputError`."""
    try:
        yield
    except Tf.ErrorException as error:
        raise output_error(path, usd_reason(error)) from error


@dataclass(frozen=True, slots=True)
class ClipFiles:
    """The chunks and the manifest of one set of value clips."""

    output: Path  # the layer that joins them
    name: str  # of the set
    manifest: Path  # what states which attributes the chunks have

    def chunk(self, number: int) -> Path:
        """Return a chunk, 0 being the first.

        >>> system_files(Path("shot.usdc")).chunk(0).name
        'shot.systems.0001.usdc'
        """
        stem = self.output.stem
        return self.output.with_name(f"{stem}.{self.name}.{number + 1:04d}.usdc")

    @property
    def defaults(self) -> str:
        """Asset path of the chunk with defaults, which the layer has as a sublayer.

        Defaults in the layer itself would win over the clips.
        """
        return f"./{self.chunk(0).name}"

    def there(self) -> list[Path]:
        """Return the chunks that are there, in order."""
        stem, folder = re.escape(self.output.stem), self.output.parent
        name = re.compile(rf"{stem}\.{self.name}\.\d{{4,}}\.usdc")
        paths = folder.iterdir() if folder.is_dir() else ()
        return sorted(path for path in paths if name.fullmatch(path.name))

    def remove_others(self, kept: Collection[Path]) -> None:
        """Remove chunks that an earlier, longer bake left."""
        for path in set(self.there()) - set(kept):
            # What cannot be removed is in nobody's way.
            with suppress(OSError):
                path.unlink()


def point_files(output: Path) -> ClipFiles:
    """Return the files of a character's point caches.

    >>> point_files(Path("shot.usdc")).manifest.name
    'shot.manifest.usda'
    """
    manifest = output.with_name(f"{output.stem}.manifest.usda")
    return ClipFiles(output, "points", manifest)


def system_files(output: Path) -> ClipFiles:
    """Return the files of what is simulated.

    >>> system_files(Path("shot.usdc")).manifest.name
    'shot.systems.manifest.usda'
    """
    manifest = output.with_name(f"{output.stem}.systems.manifest.usda")
    return ClipFiles(output, "systems", manifest)


class Frames(Protocol):
    """Frames of one prim."""

    @property
    def prim(self) -> int:
        """Place of the prim among those that are written."""

    @property
    def codes(self) -> FloatArray:
        """Time codes ``(F,)``."""


FramesT = TypeVar("FramesT", bound=Frames)
FramesIn_contra = TypeVar("FramesIn_contra", contravariant=True)


class Writer(Protocol[FramesIn_contra]):
    """What writes the frames of a prim."""

    def add(self, block: FramesIn_contra) -> None:
        """Write frames."""


class Report(Protocol[FramesIn_contra]):
    """What is said of the frames of a prim."""

    def count(self, block: FramesIn_contra) -> None:
        """Add frames that are written."""


def write_frames(
    blocks: Iterable[FramesT],
    writer: Writer[FramesT],
    reports: Sequence[Report[FramesT]],
) -> None:
    """Write all frames of all prims: every time code of a bake passes here.

    writer: `Whole` or `Chunks`; reports: of each prim.
    """
    for block in blocks:
        reports[block.prim].count(block)
        writer.add(block)


class Whole(Generic[FramesT]):
    """All samples in one layer."""

    def __init__(self, writers: Sequence[Writer[FramesT]]) -> None:
        """Begin: with what writes each prim."""
        self._writers = writers
        self.first, self.last = np.inf, -np.inf  # time codes

    def add(self, block: FramesT) -> None:
        """Write frames."""
        self._writers[block.prim].add(block)
        self.first = min(self.first, block.codes[0])
        self.last = max(self.last, block.codes[-1])


class Chunks:
    """Samples in files of some each, closed when every prim has samples of the next.

    Every file also has the first sample of the next, for what lies between them.
    """

    def __init__(
        self,
        files: ClipFiles,
        size: int,
        prims: int,
        build: Callable[[Path, int], AbstractContextManager[Sequence[Writer[Block]]]],
    ) -> None:
        """Begin.

        size: samples a file; prims: how many there are; build: gives what writes each
        prim to a file, 0 being the first, that is whole at the end of the block.
        """
        self.files, self._size, self._build = files, size, build
        self._done = [0] * prims
        self._open: dict[int, tuple[ExitStack, Sequence[Writer[Block]]]] = {}
        self.starts: list[float] = []
        self.last = -np.inf
        self._manifest: Any = None  # before they are joined

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: Any) -> None:
        """Close what is open, whole where all went well."""
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
        """Put frames into the files that they belong to."""
        codes, begin = block.codes, 0
        while begin < len(codes):
            number, at = divmod(self._done[block.prim], self._size)
            count = min(self._size - at, len(codes) - begin)
            if at == 0 and number:
                self._put(number - 1, block.some(slice(begin, begin + 1)))
            if number == len(self.starts):
                stack = ExitStack()
                context = self._build(self.files.chunk(number), number)
                self._open[number] = stack, stack.enter_context(context)
                self.starts.append(float(codes[begin]))
            self._put(number, block.some(slice(begin, begin + count)))
            self._done[block.prim] += count
            begin += count
        self.last = max(self.last, float(codes[-1]))
        for number in sorted(self._open):
            if min(self._done) > (number + 1) * self._size:
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
        """Let a prim of a layer, and what is below it, have the values of the files.

        declare: states in a manifest which attributes the files have; defaults: whether
        those of the first file are the layer's.
        """
        author_clips(layer, path, self.files, self.starts, self.last)
        if defaults:
            layer.subLayerPaths.append(self.files.defaults)
        self._manifest = new_layer(self.files.manifest)
        declare(self._manifest)
        author_metadata(self._manifest, metadata)

    def finish(self) -> list[Path]:
        """Write the manifest; return all files.

        Others, that an earlier, longer bake left, go once these have their names: a
        layer always has its own.
        """
        with replacing(self.files.manifest) as temporary:
            export_layer(self._manifest, temporary, self.files.manifest)
        files = [*self.paths, self.files.manifest]
        after_commit(lambda: self.files.remove_others(files))
        return files


def author_span(layer: Any, metadata: StageMetadata) -> None:
    """State of a layer what another does, and the range of its own samples."""
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
    """Let a prim, and what is below it, have the values of chunks."""
    chunks = [Sdf.AssetPath(f"./{files.chunk(i).name}") for i in range(len(starts))]
    clips = {
        "assetPaths": Sdf.AssetPathArray(chunks),
        "primPath": path,
        "manifestAssetPath": Sdf.AssetPath(f"./{files.manifest.name}"),
        "active": Vt.Vec2dArray([(code, i) for i, code in enumerate(starts)]),
        "times": Vt.Vec2dArray([(code, code) for code in (starts[0], last)]),
    }
    layer.GetPrimAtPath(path).SetInfo("clips", {files.name: clips})

"""What is simulated as prims of a layer, written while it is made."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from pxr import Sdf

from animtool._types import FloatArray
from animtool.errors import Fault, OptionError
from animtool.frames import CharactersFrame, Frame
from animtool.output import replacing
from animtool.usd.chunks import (
    Chunks,
    ClipFiles,
    Growing,
    author_span,
    growing_crate,
)
from animtool.usd.frame_forms import place_of
from animtool.usd.frame_writer import FrameWriter
from animtool.usd.layers import (
    StageMetadata,
    attribute,
    author_metadata,
    author_model,
    author_order,
    new_layer,
    prim,
    quaternion,
)
from animtool.usd.point_based import CachedMesh

# Of each frame its time code, and what each prim is then.
Rows: TypeAlias = Iterable[tuple[float, Sequence[Frame]]]


@dataclass(frozen=True, slots=True)
class SimulatedJob:
    """What to write."""

    model: str  # path of the prim above all others
    names: Sequence[str]  # of the other prims, legal and distinct
    metadata: StageMetadata  # what the layer states
    meters_per_unit: float  # unit of what is below the model [m]
    turn: FloatArray | None = None  # from y up to the up axis there (4,); None is none

    @property
    def paths(self) -> list[str]:
        """Where the prims are."""
        return [f"{self.model}/{name}" for name in self.names]

    def writers(self) -> list[FrameWriter]:
        """Return the writers at their beginning."""
        unit, turn = self.meters_per_unit, self.turn
        fps = float(self.metadata.fps)
        return [FrameWriter(path, unit, turn, fps) for path in self.paths]


def simulated_layer(job: SimulatedJob, output: Path | None) -> Any:
    """Return a layer with nothing but the prim above the others.

    output: the file that it becomes; None is usda for stdout.
    """
    layer = new_layer(output or Path("stdout.usda"))
    author_model(layer, job.model)
    author_metadata(layer, job.metadata)
    return layer


def grow_simulated(job: SimulatedJob, rows: Rows, growing: Growing) -> list[CachedMesh]:
    """Put prims into a layer, frame by frame; return what was written of each."""
    writers = job.writers()
    for code, frames in _begun(job, writers, rows, growing.layer):
        size = 0
        for writer, frame in zip(writers, frames, strict=True):
            values, own_size = writer.values(code, frame)
            writer.write(growing.layer, code, values)
            size += own_size
        growing.added(size)
    for writer in writers:
        writer.finish(growing.layer)
    return [writer.report for writer in writers]


def chunk_simulated(
    job: SimulatedJob, rows: Rows, layer: Any, files: ClipFiles, size: int
) -> tuple[list[Path], list[CachedMesh]]:
    """Write samples of prims in files of some each, and let a layer join them.

    size: samples a file. The layer, in memory, has the prim above the others, and gets
    these without samples.

    Returns the files, and what was written of each prim.
    """
    writers = job.writers()

    @contextmanager
    def chunk(path: Path, _: int) -> Iterator[Growing]:
        with replacing(path) as temporary, growing_crate(temporary, path) as growing:
            _declare(growing.layer, writers, layer)
            yield growing
            author_span(growing.layer, job.metadata)

    with Chunks(files, size, len(writers), chunk) as chunks:
        for code, frames in _begun(job, writers, rows, layer):
            _refuse_characters(frames)
            for i, (writer, frame) in enumerate(zip(writers, frames, strict=True)):
                chunks.add(i, np.array([code]), _put(writer, code, frame))
    chunks.join(layer, job.model)
    layer.subLayerPaths.append(files.defaults)
    manifest = new_layer(files.manifest)
    _declare(manifest, writers, layer)
    author_metadata(manifest, job.metadata)
    return chunks.save_manifest(manifest), [writer.report for writer in writers]


def _refuse_characters(frames: Sequence[Frame]) -> None:
    """Refuse what is not written frame by frame (SIM151)."""
    if any(isinstance(frame, CharactersFrame) for frame in frames):
        message = "characters with rigs are written as a whole, not in chunks"
        raise OptionError(Fault("SIM151", message, hint="leave --chunk out"))


def _begun(
    job: SimulatedJob, writers: Sequence[FrameWriter], rows: Rows, layer: Any
) -> Rows:
    """Yield rows; at the first a layer gets the prims, without samples.

    Each is turned as a whole where another axis is up.
    """
    types = Sdf.ValueTypeNames
    for i, (code, frames) in enumerate(rows):
        for writer, frame in () if i else zip(writers, frames, strict=True):
            writer.begin(layer, frame)
            if job.turn is not None:
                spec, turn = layer.GetPrimAtPath(writer.report.path), job.turn
                attribute(spec, "xformOp:orient", types.Quatd, quaternion(turn))
                author_order(spec, "xformOp:orient")
        yield code, frames


def _put(
    writer: FrameWriter, code: float, frame: Frame
) -> Callable[[Growing, slice], None]:
    """Return what writes a frame to a file."""
    values, size = writer.values(code, frame)

    def put(growing: Growing, _: slice) -> None:
        writer.write(growing.layer, code, values)
        growing.added(size)

    return put


def _declare(layer: Any, writers: Sequence[FrameWriter], whole: Any) -> None:
    """Make the attributes that have samples, as another layer has them."""
    for report in (writer.report for writer in writers):
        prim(layer, report.path, over=True)
        for name in report.sampled:
            path, own = place_of(report.path, name)
            kind = whole.GetPrimAtPath(path).attributes[own].typeName
            attribute(prim(layer, path, over=True), own, kind)

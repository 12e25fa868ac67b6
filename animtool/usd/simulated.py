"""What is simulated as prims of a layer, written while it is made."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any, TypeAlias

from pxr import Sdf

from animtool._types import FloatArray
from animtool.frames import Frame
from animtool.output import replacing
from animtool.usd.chunks import ClipFiles, Growing, author_clips, growing_crate
from animtool.usd.layers import (
    StageMetadata,
    attribute,
    author_metadata,
    author_order,
    export_layer,
    new_layer,
    prim,
    quaternion,
)
from animtool.usd.point_based import CachedMesh, FrameWriter

# Of each frame its time code, and what each prim is then.
Rows: TypeAlias = Iterable[tuple[float, Sequence[Frame]]]


@dataclass(frozen=True, slots=True)
class SimulatedJob:
    """What to write.

    Attributes:
        model: Path of the prim above all others.
        names: Of the other prims, legal and distinct.
        metadata: What the layer states.
        meters_per_unit: Unit of what is below the model [m].
        turn: From y up to the up axis there ``(4,)``; None is none.
    """

    model: str
    names: Sequence[str]
    metadata: StageMetadata
    meters_per_unit: float
    turn: FloatArray | None = None

    @property
    def paths(self) -> list[str]:
        """Where the prims are."""
        return [f"{self.model}/{name}" for name in self.names]

    def writers(self) -> list[FrameWriter]:
        """Return the writers at their beginning."""
        return [FrameWriter(path, self.meters_per_unit) for path in self.paths]


def simulated_layer(job: SimulatedJob, output: Path | None) -> Any:
    """Return a layer with nothing but the prim above the others.

    Args:
        job: What is to be in it.
        output: The file that it becomes; None is usda for stdout.
    """
    layer = new_layer(output or Path("stdout.usda"))
    model = Sdf.Path(job.model)
    for ancestor in model.GetPrefixes():
        kind = "component" if ancestor == model else "group"
        prim(layer, str(ancestor), "Xform").SetInfo("kind", kind)
    author_metadata(layer, job.metadata)
    return layer


def grow_simulated(job: SimulatedJob, rows: Rows, growing: Growing) -> list[CachedMesh]:
    """Put prims into a layer, frame by frame; return what was written of each.

    Raises:
        OutputError: The file cannot be written.
    """
    writers = job.writers()
    for i, (code, frame) in enumerate(rows):
        if not i:
            _begin(job, writers, growing.layer, frame)
        growing.added(_add(writers, growing.layer, code, frame))
    return [writer.report for writer in writers]


def chunk_simulated(
    job: SimulatedJob, rows: Rows, layer: Any, files: ClipFiles, size: int
) -> tuple[list[Path], list[CachedMesh]]:
    """Write samples of prims in files of some each, and let a layer join them.

    Every file also has the first sample of the next, for what lies between them.

    Args:
        job: What to write.
        rows: Of each frame its time code, and what each prim is, as its writer takes
            it.
        layer: In memory, with the prim above the others. It gets these, without
            samples.
        files: How the files are called.
        size: Samples a file.

    Returns:
        The files, and what was written of each prim.

    Raises:
        OutputError: A file cannot be written.
    """
    writers = job.writers()
    starts: list[float] = []
    code = 0.0
    with ExitStack() as last:

        def following() -> Growing:
            last.close()
            path = files.chunk(len(starts))
            starts.append(code)
            return last.enter_context(_chunk(job, writers, layer, path))

        for i, (code, frame) in enumerate(rows):
            if not i:
                _begin(job, writers, layer, frame)
                growing = following()
            growing.added(_add(writers, growing.layer, code, frame))
            if i and i % size == 0:
                growing = following()
                for writer in writers:
                    writer.repeat(growing.layer, code)
    author_clips(layer, job.model, files, starts, code)
    layer.subLayerPaths.append(files.defaults)
    with replacing(files.manifest) as temporary:
        manifest = new_layer(files.manifest)
        _declare(manifest, writers, layer)
        author_metadata(manifest, job.metadata)
        export_layer(manifest, temporary, files.manifest)
    paths = [files.chunk(i) for i in range(len(starts))]
    return [*paths, files.manifest], [writer.report for writer in writers]


def _begin(
    job: SimulatedJob,
    writers: Sequence[FrameWriter],
    layer: Any,
    frame: Sequence[Frame],
) -> None:
    """Write the prims, each turned as a whole where another axis is up."""
    types = Sdf.ValueTypeNames
    for writer, row in zip(writers, frame, strict=True):
        writer.begin(layer, row)
        if job.turn is not None:
            spec, turn = layer.GetPrimAtPath(writer.report.path), quaternion(job.turn)
            attribute(spec, "xformOp:orient", types.Quatd, turn)
            author_order(spec, "xformOp:orient")


def _add(
    writers: Sequence[FrameWriter], layer: Any, code: float, frame: Sequence[Frame]
) -> int:
    """Write a frame of all; return its size in memory [byte]."""
    return sum(
        writer.add(layer, code, row) for writer, row in zip(writers, frame, strict=True)
    )


@contextmanager
def _chunk(
    job: SimulatedJob, writers: Sequence[FrameWriter], layer: Any, path: Path
) -> Iterator[Growing]:
    """Give a file for samples, that is whole at the end of the block."""
    with replacing(path) as temporary, growing_crate(temporary, path) as growing:
        chunk = growing.layer
        _declare(chunk, writers, layer)
        yield growing
        codes = chunk.ListAllTimeSamples()
        span = Fraction(codes[0]), Fraction(codes[-1])
        author_metadata(chunk, replace(job.metadata, first=span[0], last=span[1]))


def _declare(layer: Any, writers: Sequence[FrameWriter], whole: Any) -> None:
    """Make the attributes that have samples, as another layer has them."""
    for report in (writer.report for writer in writers):
        own = whole.GetPrimAtPath(report.path).attributes
        spec = prim(layer, report.path, over=True)
        for name in report.sampled:
            attribute(spec, name, own[name].typeName)

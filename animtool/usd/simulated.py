"""A stage of what is simulated, written while it is made.

A crate that is saved now and then has its samples on disk: memory stays the same
however long a simulation is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

from pxr import Sdf

from animtool.output import replacing
from animtool.units import UpAxis
from animtool.usd.layers import (
    StageMetadata,
    author_metadata,
    new_layer,
    prim,
    save_layer,
    usd_errors,
)
from animtool.usd.point_cache import CachedMesh
from animtool.usd.prim_writer import PrimWriter

__all__ = ["SimulatedJob", "write_simulated"]

# Samples in memory before they go to the disk [byte].
HELD = 32_000_000


@dataclass(frozen=True, slots=True)
class SimulatedJob:
    """What to write.

    Attributes:
        output: The file; None is usda for stdout.
        model: Path of the prim above all others.
        names: Of the other prims, legal and distinct.
        writers: Of each, what writes it.
        fps: Time codes a second.
        frames: First and last time code.
        meters_per_unit: Unit of the layer [m].
        up: Its up axis.
    """

    output: Path | None
    model: str
    names: Sequence[str]
    writers: Sequence[type[PrimWriter]]
    fps: Fraction
    frames: tuple[Fraction, Fraction]
    meters_per_unit: float
    up: UpAxis


def write_simulated(
    job: SimulatedJob,
    rows: Iterable[tuple[float, Sequence[Any]]],
    check: Callable[[], None],
) -> tuple[list[CachedMesh], int]:
    """Write prims frame by frame, as a whole file or not at all.

    Args:
        job: What to write.
        rows: Of each frame its time code, and what each prim is, as its writer takes
            it.
        check: Called when all is authored; what it raises leaves nothing behind.

    Returns:
        What was written of each prim, and the size of the file [byte].

    Raises:
        OutputError: It cannot be written.
    """
    if job.output is None or job.output.suffix.lower() == ".usda":
        layer = new_layer(job.output or Path("stdout.usda"))
        found = _author(layer, job, rows, None)
        check()
        return found, save_layer(layer, job.output)
    with replacing(job.output) as temporary:
        with _crate(temporary, job.output) as layer:
            found = _author(layer, job, rows, layer.Save)
            check()
            layer.Save()
        return found, temporary.stat().st_size


@contextmanager
def _crate(temporary: Path, path: Path) -> Iterator[Any]:
    """Give a layer whose file is a temporary one."""
    with usd_errors(path):
        yield Sdf.Layer.CreateNew(str(temporary), args={"format": "usdc"})


def _author(
    layer: Any,
    job: SimulatedJob,
    rows: Iterable[tuple[float, Sequence[Any]]],
    save: Callable[[], object] | None,
) -> list[CachedMesh]:
    model = Sdf.Path(job.model)
    for ancestor in model.GetPrefixes():
        kind = "component" if ancestor == model else "group"
        prim(layer, str(ancestor), "Xform").SetInfo("kind", kind)
    default = model.GetPrefixes()[0].name
    author_metadata(
        layer,
        StageMetadata(default, job.fps, *job.frames, job.meters_per_unit, job.up),
    )
    writers = [
        writer(f"{job.model}/{name}", job.meters_per_unit)
        for name, writer in zip(job.names, job.writers, strict=True)
    ]
    held, begun = 0, False
    for code, frame in rows:
        before = sum(writer.report.bytes for writer in writers)
        for writer, row in zip(writers, frame, strict=True):
            if not begun:
                writer.begin(layer, row)
            writer.add(layer, code, row)
        begun = True
        held += sum(writer.report.bytes for writer in writers) - before
        if save is not None and held > HELD:
            save()
            held = 0
    return [writer.report for writer in writers]

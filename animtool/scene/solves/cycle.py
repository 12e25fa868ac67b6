"""Loops: find or measure the cycle of a take, and write its repetition."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

from animtool.core.errors import Fault, faults_in, refuse_warnings, with_notices
from animtool.core.record import dataclass
from animtool.edit.cycle import Cycle, find_cycle, measure_cycle
from animtool.edit.loop_options import LoopOptions
from animtool.edit.looping import PASS, cycle_notices
from animtool.scene.bake.files import ConvertReport
from animtool.scene.bake.progress import Progress
from animtool.scene.convert.takes import convert_with_passes
from animtool.scene.sources.open import SourceOptions, open_checked


@dataclass(frozen=True, slots=True)
class LoopResult:
    """Report of a cycle search: the cycle, its length, and warnings."""

    source: Path
    output: Path | None
    cycle: Cycle
    seconds: float  # duration of the cycle [s]
    notices: list[Fault]  # notices, including those of written frames
    written: ConvertReport | None = None
    json_keys: ClassVar[str] = (
        "'loop' source output first=cycle.first last=cycle.last seconds "
        "apart=cycle.apart share=cycle.share notices"
    )


def loop_source(
    source: Path,
    output: Path | None,
    options: LoopOptions,
    source_options: SourceOptions | None = None,
    *,
    overwrite: bool = False,
    strict: bool = False,
    progress: Progress = None,
) -> LoopResult:
    """Return the cycle of a take; with an output, write its repetition.

    Args:
        source: BVH, USD or clip.
        output: ``.bvh``, ``.clip.yaml`` or a USD file; None writes nothing.
        options: The cycle, or where to search for it.
        source_options: Properties of the source.
        overwrite: Replace outputs that exist.
        strict: Treat warnings as errors.
        progress: Called with the fraction done, 0 to 1.
    """
    for check in PASS.checks(options).values():
        check()
    stream = open_checked(source, source_options, progress=progress)
    take = stream.collect()
    with faults_in(source), with_notices(stream.notices):
        if options.find:
            lengths = {"shortest": options.shortest, "longest": options.longest}
            cycle = find_cycle(take, options.first, options.last, **lengths)
        else:
            cycle = measure_cycle(take, options.first, options.last)
    seconds = (cycle.last - cycle.first) / float(take.clock.fps)
    if output is None:
        notices = [*stream.notices, *cycle_notices(cycle, take, options)]
        refuse_warnings(notices, strict=strict)
        return LoopResult(source, output, cycle, seconds, notices)
    report = convert_with_passes(
        source,
        output,
        [(PASS, options)],
        source_options,
        overwrite=overwrite,
        strict=strict,
        progress=progress,
    )
    return LoopResult(source, output, cycle, seconds, report.notices, written=report)

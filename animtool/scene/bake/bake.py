"""The bake: plan outputs from sources and write all of them, or none."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from animtool.core.errors import Fault, OptionError, refuse_warnings, with_notices
from animtool.core.files.output import atomic_outputs
from animtool.motion.take import TakeStream
from animtool.scene.bake.frames import BakedTake
from animtool.scene.bake.options import BakeOptions
from animtool.scene.bake.plan import plan_outputs
from animtool.scene.bake.prims import BakePlan, BakeReport, BakeState
from animtool.scene.bake.progress import Progress, part_progress
from animtool.scene.bake.reading import Source, SourceSet
from animtool.scene.bake.request import BakeRequest, create_request

if TYPE_CHECKING:
    from animtool.scene.bake.files import ConvertReport

# Report of one output.
OutputReport: TypeAlias = "BakeReport | ConvertReport"


def bake(
    source: Source | Sequence[Source],
    output: Path | str | None,
    options: BakeOptions | None = None,
    *,
    progress: Progress = None,
) -> BakeReport:
    """Bake a BVH, USD file, clip or scene to a USD animation, or several to a library.

    Args:
        source: File to read, a loaded scene or an open take (`animtool.OpenTake`); or
            several, each of which becomes a take of a clip library.
        output: File to write: ``.usda``, ``.usdc``, ``.usd`` or ``.usdz``; ``-`` writes
            usda to stdout. None writes the outputs that a scene names and returns the
            report of the first USD file; without a name it is stdout.
        options: Bake options.
        progress: Called with the fraction done, 0 to 1.

    Raises:
        FormatError: A source is malformed, or the takes of a library have other joints.
        OptionError: An option is invalid, or the output exists or is no USD file.
        OutputError: The output cannot be written.
        StrictError: There were warnings, and ``strict`` is on.
        ToleranceError: A system stopped before the last frame. With ``keep_stopped``
            it is the report's ``stopped``, and the frames before are in the output.
    """
    request = create_request(source, output, options)
    if not any(entry.is_stage for entry in request.outputs):
        entry = request.outputs[0]
        hint = "animtool.convert writes files of other formats"
        if entry.location is not None:
            message = "the scene names no USD file"
            raise OptionError(entry.location.fault("SCN044", message, hint))
        message = "is not a USD file"
        raise OptionError(Fault("OUT004", message, str(entry.path), (), hint))
    reports = run_request(request, progress=progress)
    return next(report for report in reports if isinstance(report, BakeReport))


def bake_outputs(
    source: Source | Sequence[Source],
    output: Path | str | None = None,
    options: BakeOptions | None = None,
    *,
    base: Path | None = None,
    rig_file: Path | None = None,
    progress: Progress = None,
) -> list[OutputReport]:
    """Bake to the requested files and return a report of each file.

    All outputs are checked before anything is read, and renamed to their final names
    only after all are written.

    Args:
        source: As `animtool.bake` takes it.
        output: File to write, in any supported format; ``-`` is usda on stdout; None is
            what a scene names, else stdout.
        options: Options that override those of a scene, for every output.
        base: For an additive take that becomes a clip: its base take. Keys are fitted
            so that the sum is within the tolerance.
        rig_file: For a clip: a file with the take's rig, to which the clip refers; None
            writes one.
        progress: Called with the fraction done, 0 to 1.
    """
    request = create_request(source, output, options, base=base, rig_file=rig_file)
    return run_request(request, progress=progress)


def run_request(
    request: BakeRequest, *, progress: Progress = None
) -> list[OutputReport]:
    """Plan and run a requested bake, atomically; see `bake_outputs`."""
    reports: list[OutputReport] = []
    # Passes may save states as soon as a source is opened.
    with atomic_outputs():
        plans = plan_outputs(request, progress=progress)
        for i, plan in enumerate(plans):
            reads_takes = not isinstance(plan, BakePlan) or bool(plan.takes)
            output_progress = part_progress(progress, 1, 2) if reads_takes else progress
            output_progress = part_progress(output_progress, i, len(plans))
            with with_notices(plan.notices):
                if isinstance(plan, BakePlan):
                    reports.append(run_stage(plan, progress=output_progress))
                else:
                    reports.append(plan.run())
            if output_progress is not None:
                output_progress(1.0)
    return reports


def bake_take(
    stream: TakeStream, request: BakeRequest, *, progress: Progress = None
) -> OutputReport:
    """Write an open take to the single output of a request.

    The take can be read once, and its blocks may be computed while they are read. The
    request also states the file that messages name as the source.
    """
    source_set = SourceSet(request.source_set.files[:1], {}, (stream,))
    request = replace(request, source_set=source_set)
    (report,) = run_request(request, progress=progress)
    return report


def run_stage(plan: BakePlan, *, progress: Progress = None) -> BakeReport:
    """Execute the plan of a bake to one USD file and return its report with timings."""
    from animtool.usd.layers.sdf import save_layer

    start_time = time.perf_counter()
    baked_takes = [BakedTake(take, plan.recorder) for take in plan.takes]
    state = BakeState(plan, progress, baked_takes)
    for prims in plan.prims:
        prims.author(state)
        assert state.report is not None
        refuse_warnings(state.report.notices, strict=plan.options.strict)
    assert state.report is not None
    assert state.write_files is not None
    author_seconds = time.perf_counter() - start_time
    frames = state.deferred_frames
    state.write_files(save_layer if frames is None else frames.save)
    if frames is not None:
        frames.complete(state)
    total_seconds = time.perf_counter() - start_time
    read_seconds = sum(state.read_seconds)
    if not plan.takes:
        # Frames of an output with systems only are simulated while they are written.
        author_seconds = total_seconds - read_seconds
    save_seconds = total_seconds - author_seconds if plan.takes else 0.0
    state.report.seconds |= {
        "read": read_seconds,
        "author": author_seconds,
        "save": save_seconds,
        "total": total_seconds,
    }
    return state.report

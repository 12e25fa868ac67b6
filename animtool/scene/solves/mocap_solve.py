"""Marker solves between files: a capture, a rig, a template."""

from __future__ import annotations

import time
from dataclasses import field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from animtool.capture.options import SolveOptions
from animtool.capture.solve.calibration import Calibration, calibrate
from animtool.capture.solve.run import MarkerSolve, solve_markers
from animtool.capture.solve.source import rig_of_template, solve_stream
from animtool.capture.templates.file import load_template
from animtool.capture.templates.template import template_text
from animtool.core.arguments import argument
from animtool.core.errors import Fault, OptionError, faults_in
from animtool.core.files.output import (
    atomic_outputs,
    check_outputs,
    protect_inputs,
    write_parts,
)
from animtool.core.files.reading import path_from_folder
from animtool.core.record import dataclass
from animtool.formats.marker_files import marker_file_path, open_markers
from animtool.motion.take import TakeStream
from animtool.retarget.standing import with_source_warnings
from animtool.rig.placed import at_origin
from animtool.scene.bake.options import BakeOptions
from animtool.scene.bake.progress import Progress, timed_items
from animtool.scene.convert.rigs import RigFile, rig_file
from animtool.scene.solves.writing import SolvedOutput, check_file_name
from animtool.scene.sources.onto_rig import open_rig
from animtool.scene.sources.open import SourceOptions

if TYPE_CHECKING:
    from animtool.scene.bake.bake import OutputReport


@dataclass(frozen=True, slots=True)
class MocapSolveJob:
    """Arguments of `animtool mocap solve`."""

    source: Path  # marker file
    template: Path  # template file: where markers are on the rig
    rig: Path | None = None  # rig file; None is the rig that the template names
    static: Path | None = None  # take of the subject standing at rest
    calibrate: bool = False  # fit bone lengths and marker offsets first
    # Properties of the source.
    source_options: SourceOptions = field(default_factory=SourceOptions)
    options: SolveOptions = field(default_factory=SolveOptions)
    # USD file, ``.clip.yaml`` or ``.bvh``, or `STDOUT` for usda; None writes nothing.
    output: Path | None = None
    write_rig: Path | None = None  # rig file of the subject to write
    write_template: Path | None = None  # template of the subject to write
    # USD options; its `reduce`, `overwrite` and `strict` apply to all outputs.
    bake: BakeOptions = field(default_factory=BakeOptions)

    @property
    def solved_output(self) -> SolvedOutput:
        """The output and the subject's files, without the arrays of a rig."""
        subject_files = (self.write_rig, self.write_template)
        rig = self.write_rig or self.rig
        return SolvedOutput.of(self.output, self.source, self.bake, rig, subject_files)


@dataclass(slots=True)
class MocapSolveResult:
    """Report of a marker solve: its residuals and its calibration."""

    source: Path
    rig: Path
    solve: MarkerSolve
    calibration: Calibration | None
    notices: list[Fault]
    seconds: dict[str, float]  # wall time by stage
    outputs: list[Path] = field(default_factory=list)
    written: OutputReport | None = None
    json_keys: ClassVar[str] = (
        "'mocap solve' source rig outputs frames=solve.score.frames "
        "rms=solve.score.total frame_rms=solve.score.rms sparse=solve.score.sparse "
        "poor=solve.score.poor searched=solve.score.searched "
        "markers=solve.score.markers exchanged=solve.score.swapped "
        "missing=solve.match.missing unused=solve.match.unused calibration seconds "
        "notices"
    )

    @property
    def seconds_per_frame(self) -> float:
        """Mean time to solve a frame [s]."""
        return self.seconds["solve"] / max(self.solve.score.frames, 1)


def run_solve(job: MocapSolveJob, *, progress: Progress = None) -> MocapSolveResult:
    """Solve a capture on a rig and write the motion."""
    _check(job)
    solved_output = job.solved_output
    template = load_template(job.template, job.rig)
    rig_path = rig_of_template(template, job.rig, job.template)
    inputs = (job.source, job.template, rig_path, job.static, job.bake.rig_layer)
    solved_output.check(marker_file_path(path) for path in inputs if path is not None)
    with atomic_outputs():
        stream, result = _solve(job, template, rig_path, solved_output.files, progress)
        solved_output.write(stream, result, progress=progress)
        result.outputs = [*_write_subject(job, result), *solved_output.files]
        result.outputs = list(dict.fromkeys(result.outputs))
    return result


def _check(job: MocapSolveJob) -> None:
    """Refuse to write a subject's file with a wrong suffix or without a calibration."""
    for path, kind in ((job.write_rig, "rig"), (job.write_template, "markers")):
        if path is None:
            continue
        check_file_name(path, kind)
        if not job.calibrate:
            message = "without a calibration there is nothing new to write"
            hint = argument("calibrate", True)
            hint += " fits bones and offsets to the subject"
            raise OptionError(Fault("SOL009", message, str(path), (), hint))


def _write_subject(job: MocapSolveJob, result: MocapSolveResult) -> list[Path]:
    """Write the rig and the template of a calibration; return the files."""
    calibration = result.calibration
    if calibration is None:
        return []
    outputs: list[Path] = []
    if job.write_rig is not None:
        file: RigFile = rig_file(calibration.rig, job.write_rig, result.rig)
        check_outputs(file.outputs, [result.rig], overwrite=job.bake.overwrite)
        file.write()
        outputs += file.outputs
    if job.write_template is not None:
        rig = job.write_rig or result.rig
        name = path_from_folder(rig.resolve(), job.write_template.resolve().parent)
        title = f"markers of {job.source.name}, calibrated"
        text = template_text(calibration.template, title, str(name))
        write_parts(job.write_template, [text.encode()])
        outputs.append(job.write_template)
    return outputs


def _solve(
    job: MocapSolveJob,
    template: Any,
    rig_path: Path,
    outputs: list[Path],
    progress: Progress,
) -> tuple[TakeStream, MocapSolveResult]:
    seconds = {"read": 0.0, "calibrate": 0.0, "solve": 0.0}
    start_time = time.perf_counter()
    names = ("unit", "up", "fps")
    reader_options = {name: getattr(job.source_options, name) for name in names}
    calibration: Calibration | None = None
    with protect_inputs(outputs):
        rig, notices = open_rig(rig_path)
        rig = at_origin(rig)
        markers = open_markers(job.source, **reader_options)
        seconds["read"] = time.perf_counter() - start_time
        if job.calibrate:
            static_markers = None
            if job.static is not None:
                static_markers = open_markers(job.static, **reader_options)
            with faults_in(job.source):
                calibration = calibrate(
                    markers, rig, template, static=static_markers, options=job.options
                )
            rig, template = calibration.rig, calibration.template
            notices = [*notices, *calibration.notices]
            seconds["calibrate"] = time.perf_counter() - start_time - seconds["read"]
        with faults_in(job.source):
            solve = solve_markers(markers, rig, template, job.options)
    stream = solve_stream(solve, job.source, progress)
    stream.notices = [*notices, *stream.notices]
    stream = with_source_warnings(job.source, stream, job.source_options.up)
    stream.blocks = timed_items(stream.blocks, seconds, "solve")
    result = MocapSolveResult(
        job.source, rig_path, solve, calibration, list(stream.notices), seconds
    )
    return stream, result

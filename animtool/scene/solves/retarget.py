"""Retargeting between files: a take, a target rig, and the report."""

from __future__ import annotations

import time
from dataclasses import field, replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from animtool.core.errors import Fault, OptionError, faults_in
from animtool.core.files.output import atomic_outputs, protect_inputs, write_parts
from animtool.core.record import dataclass
from animtool.core.values import template_values
from animtool.motion.driving import drive_stream
from animtool.motion.reorient import placement_notice, remove_placement
from animtool.motion.take import TakeStream
from animtool.retarget.map import JointMap, map_text
from animtool.retarget.motion import Retargeting
from animtool.retarget.names import check_presets
from animtool.retarget.options import RetargetOptions
from animtool.retarget.report import RetargetReport
from animtool.retarget.take_pass import checked_blocks, retarget_stream
from animtool.retarget.verdict import FrameNumbers, Verdict, VerdictReason
from animtool.rig.placed import at_origin
from animtool.rig.skeleton import Rig
from animtool.scene.bake.files import ConvertReport
from animtool.scene.bake.options import BakeOptions
from animtool.scene.bake.progress import Progress, timed_items
from animtool.scene.solves.writing import SolvedOutput, check_file_name
from animtool.scene.sources.onto_rig import open_rig
from animtool.scene.sources.open import SourceOptions, open_source

if TYPE_CHECKING:
    from animtool.scene.bake.bake import OutputReport

# Warnings about the take that make its result doubtful, in words of the verdict.
SUSPECT_SOURCES = {
    "BVH115": "the root channels of the take",
    "BVH116": "an offset of the take",
    "BVH117": "the channel order of the take",
    "MAP010": "the map",
    "MAP115": "the map",
    "MOT209": "the height of the take",
    "MOT210": "left and right of the take",
    "MOT213": "the unit of the take",
    "MOT214": "the up axis of the take",
    "TAKE012": "the rate of the take",
    "TAKE013": "the rows of zeros in the take",
}


@dataclass(frozen=True, slots=True)
class RetargetJob:
    """Arguments of `animtool retarget`."""

    source: Path  # BVH, USD or clip with the take
    rig: Path  # target: rig file, USD file or BVH
    # Properties of the source.
    source_options: SourceOptions = field(default_factory=SourceOptions)
    options: RetargetOptions = field(default_factory=RetargetOptions)
    # USD file, ``.clip.yaml`` or ``.bvh``, or `STDOUT` for usda; None writes nothing.
    output: Path | None = None
    write_map: Path | None = None  # map file to write
    # USD options; its `fps`, `frame_range`, `start`, `reduce`, `overwrite` and `strict`
    # apply to all outputs.
    bake: BakeOptions = field(default_factory=BakeOptions)

    @property
    def solved_output(self) -> SolvedOutput:
        """The outputs, including the map file."""
        files = (self.write_map,)
        return SolvedOutput.of(self.output, self.source, self.bake, self.rig, files)


@dataclass(slots=True)
class RetargetResult:
    """Report of retargeting: the joint map, the score and the verdict."""

    source: Path
    rig: Path
    retargeting: Retargeting
    joint_map: JointMap
    source_rig: Rig
    target: Rig
    notices: list[Fault]
    seconds: dict[str, float]  # wall time by stage
    # First frame of the source, and its frames a second.
    start: Fraction = Fraction(1)
    rate: Fraction = Fraction(24)
    frame_numbers: FrameNumbers = field(default_factory=FrameNumbers)
    outputs: list[Path] = field(default_factory=list)
    written: OutputReport | None = None
    json_keys: ClassVar[str] = (
        "*verdict 'retarget' source rig outputs *score joints=pairs seconds notices"
    )

    @property
    def pairs(self) -> list[dict[str, object]]:
        """Names of each mapped pair of joints."""
        source_names, target_names = self.source_rig.names, self.target.names
        return [
            {
                "source": source_names[pair.source],
                "target": target_names[pair.target],
                **template_values(pair, "role found=evidence confidence"),
            }
            for pair in self.joint_map.pairs
        ]

    @property
    def seconds_per_frame(self) -> float:
        """Mean time to retarget a frame [s]."""
        return self.seconds["solve"] / max(self.score.frames, 1)

    @property
    def verdict(self) -> Verdict:
        """Whether the take is usable; frames are those of the output."""
        verdict = self.retargeting.verdict().in_output_frames(self.frame_numbers)
        codes = dict.fromkeys(notice.code for notice in self.notices)
        reasons = [
            VerdictReason(SUSPECT_SOURCES[code])
            for code in codes
            if code in SUSPECT_SOURCES
        ]
        return verdict.with_reasons(reasons)

    @property
    def score(self) -> RetargetReport:
        """Report of how well the target follows the source."""
        return self.retargeting.report()


def run_retarget(job: RetargetJob, *, progress: Progress = None) -> RetargetResult:
    """Retarget a take to another rig and write it."""
    if job.write_map is not None:
        check_file_name(job.write_map, "map")
    if job.source.is_dir():
        hint = "to retarget folders, run a batch of a scene with the pass retarget: "
        hint += "animtool batch"
        raise OptionError(Fault("IO001", "is a folder", str(job.source), (), hint))
    options = job.options
    check_presets(preset=options.preset, target_preset=options.target_preset)
    solved_output = job.solved_output
    solved_output.check((job.source, job.rig, job.options.map, job.bake.rig_layer))
    with atomic_outputs():
        stream, report = _retarget(job, solved_output.files, progress)
        solved_output.write(stream, report, "retarget", progress)
        if job.write_map is not None:
            text = map_text(report.joint_map, report.source_rig, report.target)
            write_parts(job.write_map, [text.encode()])
    report.outputs = solved_output.files
    report.frame_numbers = _output_frame_numbers(job, report)
    return report


def _output_frame_numbers(job: RetargetJob, report: RetargetResult) -> FrameNumbers:
    """Return the frame numbers of the take in the output."""
    start, rate = report.start, report.rate
    fps = job.bake.fps or rate
    if isinstance(report.written, ConvertReport) or report.written is None:
        start = job.bake.start or start
    else:
        span = report.written.span
        fps, start = span.fps, job.bake.start or start
        if job.bake.frame_range is None:
            start = Fraction(span.first)
        elif job.bake.start is None and job.bake.rig_layer is not None:
            from animtool.usd.rigs.target import open_target

            target = open_target(job.bake.rig_layer, job.bake.prim_path)
            start = start if target.start is None else target.start
    return FrameNumbers(start, Fraction(fps) / rate, job.bake.frame_range)


def _without_placement(stream: TakeStream, job: RetargetJob) -> TakeStream:
    """Return a take without its placement, for a rig that has one.

    As in a bake, the placement stays if an option requests it, or if the take is on a
    moving prim.
    """
    rig, layer = stream.rig, job.bake.rig_layer
    is_placed = rig.placement is not None and not rig.has_animated_parents
    if not is_placed or layer is None or job.bake.placement:
        return stream
    from animtool.usd.rigs.target import open_target

    placement = open_target(layer, job.bake.prim_path).placement()
    if placement.unsupported_reason or placement.heading_placement.is_identity:
        return stream
    notice = placement_notice(
        rig, str(job.source), is_kept=False, rig_placement=placement.heading_placement
    )
    return replace(remove_placement(stream), notices=stream.notices + notice)


def _retarget(
    job: RetargetJob, outputs: list[Path], progress: Progress
) -> tuple[TakeStream, RetargetResult]:
    seconds = {"read": 0.0, "solve": 0.0}
    start_time = time.perf_counter()
    with protect_inputs(outputs):
        rig, notices = open_rig(job.rig)
        # Placement of the take, not of the rig's stage.
        rig = at_origin(rig)
        source_options = replace(job.source_options, placement=job.bake.placement)
        stream = open_source(job.source, source_options, progress=progress)
        rig = replace(rig, has_animated_parents=stream.rig.has_animated_parents)
        stream = _without_placement(stream, job)
        seconds["read"] = time.perf_counter() - start_time
        stream.blocks = timed_items(stream.blocks, seconds, "read")
        with faults_in(job.source):
            retargeting, joint_map, map_notices = retarget_stream(
                stream, rig, job.options
            )
    seconds["solve"] = time.perf_counter() - start_time - seconds["read"]
    target_notices = joint_map.target.notices
    notices = [*notices, *stream.notices]
    for notice in map_notices:
        path = job.rig if notice in target_notices else job.source
        notices.append(notice.in_file(path))
    blocks = checked_blocks(retargeting, job.options, notices, job.source)
    solved_stream = replace(
        stream,
        rig=rig,
        unread_meshes=None,
        blocks=timed_items(blocks, seconds, "solve"),
        notices=notices,
        curve=None,
        count=0,
        control_curves={},
    )
    result = RetargetResult(
        job.source, job.rig, retargeting, joint_map, stream.rig, rig, notices, seconds
    )
    result.start = stream.first_frame
    result.rate = stream.fps / stream.step
    return drive_stream(solved_stream), result

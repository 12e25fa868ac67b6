"""Limb matching between files: poses of a rig's limbs, written as targets."""

from __future__ import annotations

import time
from dataclasses import field, replace
from fractions import Fraction
from pathlib import Path
from typing import ClassVar

from animtool.clip.channels import ClipUnits
from animtool.core.clock import Clock
from animtool.core.errors import Fault, faults_in, refuse_warnings
from animtool.core.files.output import (
    atomic_outputs,
    check_outputs,
    protect_inputs,
    write_arrays,
    write_parts,
)
from animtool.core.record import dataclass
from animtool.ik.match_take import (
    array_file_of,
    match_chains,
    match_take,
    untracked_motion_notices,
)
from animtool.ik.tracks import TargetTracks
from animtool.ik.write import targets_text
from animtool.motion.take import Take
from animtool.scene.bake.options import BakeOptions
from animtool.scene.bake.progress import Progress
from animtool.scene.solves.ik import frame_index, open_start
from animtool.scene.solves.writing import check_file_name
from animtool.scene.sources.onto_rig import open_rig
from animtool.scene.sources.open import SourceOptions


@dataclass(frozen=True, slots=True)
class MatchJob:
    """Arguments of `animtool ik --match`."""

    rig: Path  # rig file, USD file or BVH, with chains
    take: Path  # file with the poses
    output: Path  # targets file to write
    # Properties of the take that its file does not state.
    source: SourceOptions = field(default_factory=SourceOptions)
    chains: tuple[str, ...] = ()  # names of chains, or patterns; none is all
    pose: bool = False  # match one frame only
    frame: Fraction | None = None  # which; None is the first
    # Only `reduce` (for sparse keys), `overwrite` and `strict` are used.
    write_options: BakeOptions = field(default_factory=BakeOptions)


@dataclass(frozen=True, slots=True)
class MatchReport:
    """Report of limb matching: the written targets and their clock."""

    tracks: TargetTracks  # the targets
    clock: Clock  # of the poses
    outputs: list[Path]  # the files written
    notices: list[Fault]  # warnings and notes
    seconds: dict[str, float]  # wall time by stage
    json_keys: ClassVar[str] = (
        "'ik' outputs frames=clock.count first=clock.start fps=clock.fps# "
        "matched=tracks.goals{chain=name joint=goal.joint parts} notices"
    )


def run_match(job: MatchJob, *, progress: Progress = None) -> MatchReport:
    """Write targets that reproduce the limbs of a take."""
    check_file_name(job.output, "targets", allows_json=False)
    with atomic_outputs():
        return _run_match(job, progress)


def _run_match(job: MatchJob, progress: Progress) -> MatchReport:
    inputs = [job.rig, job.take]
    check_outputs([job.output], inputs, overwrite=job.write_options.overwrite)
    start_time = time.perf_counter()
    with protect_inputs([job.output, array_file_of(job.output)]):
        rig, notices = open_rig(job.rig)
        with faults_in(job.rig):
            chains = match_chains(rig, job.chains)
        take = open_start(job.take, rig, job.rig, job.source, progress=progress)
    if job.pose:
        take = _select_frame(take, frame_index(take, job.frame, job.take))
    read_end_time = time.perf_counter()
    notices = [*notices, *take.notices]
    for fault in untracked_motion_notices(take, chains):
        notices.append(replace(fault, path=str(job.take)))
    refuse_warnings(notices, strict=job.write_options.strict)
    tracks = match_take(take, chains, job.output, reduce=job.write_options.reduce)
    text = targets_text(tracks, ClipUnits.of_rig(rig))
    match_end_time = time.perf_counter()
    outputs = [job.output]
    if text.arrays:
        outputs.insert(0, array_file_of(job.output))
        check_outputs(outputs, inputs, overwrite=job.write_options.overwrite)
        arrays = {name.partition("#")[2]: array for name, array in text.arrays.items()}
        write_arrays(outputs[0], arrays)
    write_parts(job.output, [text.text.encode()])
    seconds = {
        "read": read_end_time - start_time,
        "match": match_end_time - read_end_time,
        "write": time.perf_counter() - match_end_time,
    }
    return MatchReport(tracks, take.clock, outputs, notices, seconds)


def _select_frame(take: Take, frame: int) -> Take:
    """Return one frame of a take."""
    start = take.clock.start + frame * take.clock.step
    clock = replace(take.clock, start=start, count=1)
    return replace(
        take, clock=clock, motion=take.motion.select(slice(frame, frame + 1))
    )

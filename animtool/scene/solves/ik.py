"""Inverse kinematics between files: a rig, targets and a start pose."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import field, replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from animtool.clip.clip import Clip
from animtool.core.arguments import argument, flag
from animtool.core.clock import Clock, FrameSpan
from animtool.core.config import project_roots
from animtool.core.errors import (
    Fault,
    OptionError,
    ToleranceError,
    faults_in,
    listed,
    refuse_warnings,
    warning,
)
from animtool.core.files.output import STDOUT, protect_inputs
from animtool.core.names import has_kind_suffix
from animtool.core.options import changed_options, option_marker
from animtool.core.record import dataclass
from animtool.core.shot import Shot
from animtool.documents.ignore import without_accepted
from animtool.ik.file import load_targets
from animtool.ik.on_take import solve_take
from animtool.ik.options import TakeOptions
from animtool.ik.report import (
    MISSED_ANGLE,
    MISSED_LENGTH,
    GoalReport,
    crossed_notices,
    far_target_notices,
    goal_reports,
    independent_frame_notices,
    jump_notices,
    missed_notices,
    pole_notices,
    rest_notices,
    span_notices,
)
from animtool.ik.sub_rig import within_limits
from animtool.ik.take_run import TakeIk
from animtool.ik.tracks import TargetTracks
from animtool.ik.values import KeyedValue
from animtool.maths.curves import Extrapolation
from animtool.motion.driving import drive_take
from animtool.motion.motion import Channel, Motion
from animtool.motion.reorient import reorient
from animtool.motion.take import Take, TakeStream
from animtool.rig.joints import (
    LocalTransforms,
    local_from_coordinates,
    project_to_coordinates,
)
from animtool.rig.skeleton import Rig
from animtool.scene.bake.options import BakeOptions
from animtool.scene.bake.progress import Progress
from animtool.scene.solves.writing import SolvedOutput
from animtool.scene.sources.onto_rig import map_names, open_rig
from animtool.scene.sources.open import SourceOptions, open_source, supports_option

if TYPE_CHECKING:
    from animtool.clip.key_report import ChannelDeviation
    from animtool.scene.bake.bake import OutputReport


@dataclass(frozen=True, slots=True)
class IkJob:
    """Arguments of `animtool ik`."""

    rig: Path  # rig file, USD file or BVH
    targets: Path  # targets file
    # File with the poses to start from; None is the rest pose.
    start: Path | None = None
    source: SourceOptions = field(default_factory=SourceOptions)  # format of that file
    pose: bool = False  # solve one frame only
    frame: Fraction | None = None  # which; None is the first
    options: TakeOptions = field(default_factory=TakeOptions)  # how to solve
    # Positions with a larger error count as missed, and are solved at least this
    # accurately [m]; None is 0.1 mm, or the tolerance of `options` if larger.
    tolerance: float | None = None
    # The same for orientations, aims and poles [rad]; None is 0.1 degrees.
    angle_tolerance: float | None = None
    # USD file, ``.clip.yaml`` or ``.bvh``, or `STDOUT` for usda; None writes nothing.
    output: Path | None = None
    # USD options. Its ``reduce`` and ``overwrite`` apply to all formats; with
    # ``strict``, nothing is written if a goal is missed or there are warnings.
    bake: BakeOptions = field(default_factory=BakeOptions)

    @property
    def solved_output(self) -> SolvedOutput:
        """Where to write the solved take; empty if there is no output."""
        source = self.targets if self.start is None else self.start
        rig = _named_rig(self.rig, self.output)
        return SolvedOutput.of(self.output, source, self.bake, rig)


@dataclass(slots=True)
class IkReport:
    """Report of an IK solve: the solution, its goals and their misses."""

    solution: TakeIk  # the take at its targets
    goals: list[GoalReport]  # result of each goal
    notices: list[Fault]  # warnings and notes
    seconds: dict[str, float]  # wall time by stage
    # Report of the written file; None if nothing was written.
    written: OutputReport | None = None
    json_keys: ClassVar[str] = (
        "'ik' targets=solution.tracks.path outputs frames=solution.frames "
        "first=span.first last=span.last fps=span.fps# "
        "solved=solution.take.clock.span{first last fps#} "
        "joints=solution.problem.joints degrees_of_freedom=solution.problem.degrees "
        "conditions=solution.problem.rows statuses=solution.status_counts "
        "iterations=solution{mean=mean_iterations max=max_iterations} "
        "restarts=solution.restarts "
        "microseconds_per_frame=solution.microseconds_per_frame "
        "goals{effector=name joint residuals missed=spans} "
        "on_limits=solution.limit_counts jumps=solution.jumps_at_codes channels? "
        "notices"
    )

    @property
    def channels(self) -> Sequence[ChannelDeviation] | None:
        """Approximation errors of the channels of a written clip."""
        return None if self.written is None else self.written.channels

    @property
    def outputs(self) -> list[str]:
        """Written files, or ``stdout``; empty if the solve had no output."""
        if self.written is None:
            return []
        return [str(path) for path in self.written.named] or ["stdout"]

    @property
    def is_renumbered(self) -> bool:
        """Whether the written frame numbers differ from the solved ones."""
        clock, span = self.solution.take.clock, self.span
        is_same_clock = (span.first, span.fps) == (clock.start, clock.fps)
        return self.written is not None and not is_same_clock

    @property
    def span(self) -> FrameSpan:
        """Written frames, or solved frames if nothing was written."""
        return (
            self.solution.take.clock.span if self.written is None else self.written.span
        )


class MissedGoalsError(ToleranceError):
    """Goals are missed by more than the tolerance, and ``strict`` is on.

    Attributes:
        report: The report of the solve.
    """

    def __init__(self, faults: list[Fault], report: IkReport) -> None:
        super().__init__(faults)
        self.report = report


@dataclass(frozen=True, slots=True)
class IkInputs:
    """A rig, its targets, and the take to solve."""

    tracks: TargetTracks  # the targets
    take: Take  # the poses to start from
    is_at_rest: bool  # whether these poses are the rest pose
    only_index: int | None  # index of the one frame to solve; None is all
    notices: list[Fault]  # warnings collected so far


def open_ik(job: IkJob, *, progress: Progress = None) -> IkInputs:
    """Open the rig, the targets and the start poses of a job."""
    if job.start is None:
        _refuse_source_options(job.source)
    rig, notices = open_rig(job.rig)
    tracks = load_targets(job.targets, rig)
    notices = [*notices, *tracks.notices]
    if job.start is None:
        clock = tracks.clock
        if job.pose and job.frame is not None:
            notices += _outside_targets_warning(job, tracks)
            clock = replace(clock, start=job.frame, count=1)
            tracks = tracks.at_clock(tracks.clock)
        take = rest_take(rig, clock)
        return IkInputs(tracks, take, True, 0 if job.pose else None, notices)
    take = open_start(job.start, rig, job.rig, job.source, progress=progress)
    notices += take.notices
    only_index = frame_index(take, job.frame, job.start) if job.pose else None
    return IkInputs(tracks, take, False, only_index, notices)


def _refuse_source_options(options: SourceOptions) -> None:
    """Refuse options of a start take if there is none (CLI002)."""
    start, hint = argument("start"), "remove it; a rig file has its own units and axis"
    faults = [
        Fault("CLI002", f"{name} describes {start}, and there is none", hint=hint)
        for name in (
            option_marker(f"source.{key}", option)
            for key, option in changed_options(options).items()
        )
    ]
    if faults:
        raise OptionError(faults)


def _outside_targets_warning(job: IkJob, tracks: TargetTracks) -> list[Fault]:
    """Warn if the solved frame is outside the frames of the targets (TGT107).

    Curves that extrapolate there, by their ``pre`` or ``post``, cause no warning.
    """
    assert job.frame is not None
    clock = tracks.clock
    is_later = job.frame > clock.last
    if clock.count == 1 or clock.start <= job.frame <= clock.last:
        return []
    curves = [
        value.channel
        for goal in tracks.goals
        for value in goal.values.values()
        if isinstance(value, KeyedValue)
    ]
    extrapolations = [curve.post if is_later else curve.pre for curve in curves]
    if extrapolations and Extrapolation.HOLD not in extrapolations:
        return []
    message = f"frame {float(job.frame):g} is outside the targets, which run from "
    message += f"frame {float(clock.start):g} to {float(clock.last):g}; their nearest "
    message += "values are used"
    hint = f"use a frame of the targets with {argument('command.pose')}, or add keys"
    return [warning("TGT107", message, hint).in_file(job.targets)]


def frame_index(take: Take, frame: Fraction | None, path: Path) -> int:
    """Return the index of a time code in a take of a file; None is the first frame."""
    clock = take.clock
    if frame is None:
        return 0
    index = (frame - clock.start) / clock.step
    if index.denominator != 1 or not 0 <= index < clock.count:
        message = f"frame {float(frame):g} is not one of the frames "
        message += f"{float(clock.start):g} to {float(clock.last):g}"
        raise OptionError(Fault("SCN013", message, str(path)))
    return int(index)


def run_ik(job: IkJob, *, progress: Progress = None) -> IkReport:
    """Solve the targets of a job and write the take.

    Outputs are checked before the solve. With ``strict``, nothing is written if there
    are warnings.
    """
    solved_output = job.solved_output
    solved_output.check((job.rig, job.targets, job.start, job.bake.rig_layer))
    report = _solve(job, progress)
    if solved_output.request is None:
        return report
    start_time = time.perf_counter()
    take = replace(report.solution.take, notices=())
    solved_output.write(TakeStream.of(take), report, "ik", progress)
    report.seconds["write"] = time.perf_counter() - start_time
    return report


def _named_rig(rig: Path, output: Path | None) -> Path | None:
    """Return the rig file if a clip at the output path can refer to it, else None."""
    if output in {None, STDOUT}:
        return None
    roots = project_roots(output)
    is_in_project = any(rig.resolve().is_relative_to(root) for root in roots)
    return rig if has_kind_suffix(rig, "rig") and is_in_project else None


def _solve(job: IkJob, progress: Progress) -> IkReport:
    start_time = time.perf_counter()
    with protect_inputs(job.solved_output.files):
        inputs = open_ik(job, progress=progress)
    read_end_time = time.perf_counter()
    with faults_in(job.rig):
        solution = solve_take(
            inputs.take,
            inputs.tracks,
            _with_goal_tolerances(job),
            static=inputs.is_at_rest,
            only=inputs.only_index,
            progress=progress,
        )
    solve_seconds = time.perf_counter() - read_end_time
    seconds = {"read": read_end_time - start_time, "solve": solve_seconds}
    goals = goal_reports(solution, *_goal_tolerances(job))
    missed_goal_notices = missed_notices(solution, goals)
    notices = [
        *inputs.notices,
        *span_notices(solution),
        *(rest_notices(solution) if inputs.is_at_rest else ()),
        *independent_frame_notices(solution, is_smoothed=job.options.smooth > 0),
        *far_target_notices(solution, goals),
        *pole_notices(solution),
        *crossed_notices(solution),
        *jump_notices(solution),
    ]
    notices = without_accepted(notices) if notices else []
    report = IkReport(solution, goals, [*notices, *missed_goal_notices], seconds)
    if job.bake.strict and missed_goal_notices:
        raise MissedGoalsError(missed_goal_notices, report)
    refuse_warnings(notices, strict=job.bake.strict)
    return report


def _with_goal_tolerances(job: IkJob) -> TakeOptions:
    """Return options whose tolerances are at least as strict as those of the goals."""
    options, (tolerance, angle_tolerance) = job.options, _goal_tolerances(job)
    return replace(
        options,
        tolerance=min(options.tolerance, tolerance or math.inf),
        angle_tolerance=min(options.angle_tolerance, angle_tolerance or math.inf),
    )


def _goal_tolerances(job: IkJob) -> tuple[float, float]:
    """Return the errors above which a goal counts as missed [m], [rad]."""
    position_tolerance, angle_tolerance = job.tolerance, job.angle_tolerance
    if position_tolerance is None:
        position_tolerance = max(MISSED_LENGTH, job.options.tolerance)
    if angle_tolerance is None:
        angle_tolerance = max(MISSED_ANGLE, job.options.angle_tolerance)
    return position_tolerance, angle_tolerance


MAX_LISTED_NAMES = 6
# Smaller distances of the rest pose from limits are rounding [rad], [m].
LIMIT_TOLERANCE = 1e-6


def rest_take(rig: Rig, clock: Clock) -> Take:
    """Return a take of the rest pose within limits, with controls at their defaults."""
    empty_clip = Clip("rest", clock.fps, clock.start, clock.last, ())
    take = empty_clip.sample(rig, step=clock.step)
    translations, rotations, _ = take.motion.select(slice(0, 1)).dense()
    rest = project_to_coordinates(rig, LocalTransforms(translations, rotations))
    start = within_limits(rig, rest)
    # Limits are often rounded.
    if np.allclose(start, rest, rtol=0.0, atol=LIMIT_TOLERANCE):
        return take
    local = local_from_coordinates(rig, start)
    motion = replace(
        take.motion,
        translations=Channel.static(local.translations[0], len(take)),
        rotations=Channel.static(local.rotations[0], len(take)),
    )
    return replace(take, motion=motion)


def open_start(
    path: Path,
    rig: Rig,
    rig_path: Path,
    options: SourceOptions,
    *,
    progress: Progress = None,
) -> Take:
    """Return a take of a rig: its clip, or motion mapped by joint names.

    Joints that the motion lacks stay at rest; joints that the rig lacks are ignored.
    The take's notices report both.
    """
    if options.rig is None and supports_option(path, "rig"):
        options = replace(options, rig=rig_path)
    stream = open_source(path, options, progress=progress)
    if stream.rig.up is not rig.up:
        stream = reorient(stream, rig.up)
    # Some notices appear only while blocks are read.
    take = _crop_to_shot(stream.collect(), options.shot)
    if take.rig.names == rig.names and take.rig.controls == rig.controls:
        return drive_take(replace(take, rig=rig))
    motion, unmapped_notices = _map_motion(take, rig, path, rig_path)
    return drive_take(Take(rig, take.clock, motion, (*take.notices, *unmapped_notices)))


def _crop_to_shot(take: Take, shot: Shot | None) -> Take:
    """Return a take cropped to the samples that cover the frames of a shot."""
    if shot is None:
        return take
    clock = take.clock
    first = math.floor((shot.start - clock.start) / clock.step)
    last = math.ceil((shot.end - clock.start) / clock.step)
    kept_samples = slice(max(first, 0), min(last, clock.count - 1) + 1)
    if kept_samples.start >= kept_samples.stop:
        return take
    start = clock.start + kept_samples.start * clock.step
    clock = replace(clock, start=start, count=kept_samples.stop - kept_samples.start)
    return replace(take, clock=clock, motion=take.motion.select(kept_samples))


# With a smaller fraction of the joints of the smaller rig, a take is of another one.
MIN_COMMON_FRACTION = 0.25


def _map_motion(
    take: Take, rig: Rig, path: Path, rig_path: Path
) -> tuple[Motion, list[Fault]]:
    """Return the motion of the joints common to both rigs, and notices of the rest."""
    name_map = map_names(rig, take.rig)
    transfer_hint = f"first move it to this rig: animtool retarget {path} "
    transfer_hint += f"{flag('to')} {rig_path}"
    if (name_map.joints < 0).all():
        message = f"has no joint of {rig.name!r}"
        hint = f"its joints are {listed(take.rig.names, MAX_LISTED_NAMES)}; "
        hint += transfer_hint
        raise OptionError(Fault("TGT017", message, str(path), (), hint))
    notices = []
    missing_joints = [
        rig.names[i] for i in np.flatnonzero(name_map.joints < 0).tolist()
    ]
    unmatched_joints = [take.rig.names[index] for index in name_map.unmatched_joints]
    common_count = len(rig.names) - len(missing_joints)
    if common_count < MIN_COMMON_FRACTION * min(len(rig.names), len(take.rig.names)):
        common_names = [name for name in rig.names if name not in missing_joints]
        message = f"is a take of another skeleton: it has {common_count} of the "
        message += (
            f"{len(rig.names)} joints of {rig.name!r} ({listed(common_names, 3)})"
        )
        message += "; the others stay at rest"
        notices.append(warning("TGT102", message, transfer_hint))
        missing_joints = unmatched_joints = []
    for joint_names, message_template in (
        (missing_joints, "does not have {}: they stay at rest"),
        (unmatched_joints, "moves {}, which the rig does not have: they are ignored"),
    ):
        if joint_names:
            message = message_template.format(listed(joint_names, MAX_LISTED_NAMES))
            notices.append(warning("TGT102", message))
    notices = [notice.in_file(path) for notice in notices]
    motion = replace(name_map.apply(take.motion), weights=None, controls=None)
    return motion.map(Channel.compact), notices

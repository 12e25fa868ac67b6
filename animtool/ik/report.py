"""Reports where a solved take misses its targets."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from typing import ClassVar

import numpy as np

from animtool.core.arguments import argument
from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.clock import frame_label, span_label
from animtool.core.errors import Fault, Severity, counted, listed
from animtool.core.quantities import angle_text, length_text
from animtool.core.record import dataclass
from animtool.core.units import parse_length
from animtool.ik.axes import (
    crossed_goals,
    limb_target,
    pole_hint,
    space_hint,
    unit_hint,
    up_axis_hint,
)
from animtool.ik.goals import GOAL_PARTS, IS_LENGTH, by_unit
from animtool.ik.jumps import Jump
from animtool.ik.limbs import find_limbs
from animtool.ik.options import REPORTED_MISS, REPORTED_MISS_DEGREES
from animtool.ik.result import IkStatus
from animtool.ik.take_run import TakeIk
from animtool.ik.tracks import GoalTrack
from animtool.maths.runs import runs
from animtool.rig.skeleton import JointType

# Default misses above which a goal is reported [m], [rad].
MISSED_LENGTH = parse_length(REPORTED_MISS)
MISSED_ANGLE = math.radians(REPORTED_MISS_DEGREES)
# MissStatistics above this many chain lengths suggest wrong units.
FAR_MISS_RATIO = 10.0
UNITS_QUESTION = "do the targets use these units and this space?"
# So do targets farther than this many rig sizes from the rig in every frame.
FAR_TARGET_RATIO = 20.0
# Shots often begin at frame 1001, and takes at 1.
SHOT_OFFSET = 1000
# Suggested fraction of a limb's reach for `soft`.
SUGGESTED_SOFT = 0.1
# Distances above this have squares that overflow [m].
OVERFLOW_DISTANCE = 1e150


@dataclass(frozen=True, slots=True)
class MissStatistics:
    """Statistics of the misses of one part of a goal, over the frames that use it."""

    part: str  # ``position`` [m], ``orientation``, ``aim`` or ``pole`` [rad]
    frames: int  # number of frames that use the part
    mean: float  # mean miss over those frames
    p95: float  # 95th percentile
    max: float  # miss in the worst frame
    frame: float  # time code of the worst frame

    json_keys: ClassVar[str] = "unit frames mean p95 max frame"

    @property
    def is_length(self) -> bool:
        """Whether the miss is a length [m], not an angle [rad]."""
        return bool(IS_LENGTH[GOAL_PARTS.index(self.part)])

    @property
    def unit(self) -> str:
        """Unit of the statistics: ``m`` for a position, else ``rad``."""
        return "m" if self.is_length else "rad"


@dataclass(frozen=True, slots=True)
class MissedSpan:
    """Consecutive frames in which a goal is not reached."""

    first: float  # time code of the first frame
    last: float  # time code of the last frame
    # Distance from the target to the reached point, of the worst frame [m].
    distance: float
    angle: float  # angular miss in the worst frame [rad]
    frame: float  # time code of the worst frame
    # Status of the worst frame; STEADIER if any frame has it.
    status: IkStatus


@dataclass(frozen=True, slots=True)
class GoalReport:
    """MissStatistics of one goal over a take, and the spans in which it is missed."""

    name: str  # name of the effector
    joint: str  # joint of the effector
    location: tuple[int, int]  # line and column in the targets file
    misses: tuple[MissStatistics, ...]  # one for each part that is used
    spans: tuple[MissedSpan, ...]  # spans in which a tolerance is exceeded

    @property
    def residuals(self) -> dict[str, MissStatistics]:
        """Miss statistics by goal part: ``position``, ``orientation`` and so on."""
        return {miss.part: miss for miss in self.misses}


def goal_reports(
    solved_take: TakeIk,
    tolerance: float = MISSED_LENGTH,
    angle_tolerance: float = MISSED_ANGLE,
) -> list[GoalReport]:
    """Return a report of each goal.

    A goal that is soft, or of a priority above 0, is not reported as missed where it
    yields.

    Args:
        solved_take: The solved take.
        tolerance: Tolerance of positions [m].
        angle_tolerance: Tolerance of orientations, aims and poles [rad].
    """
    times = solved_take.take.clock.times
    tolerances = by_unit(tolerance, angle_tolerance)
    reports = []
    statuses = solved_take.statuses
    is_yielded = np.array([s is IkStatus.YIELDED for s in statuses], np.bool_)
    for e, track in enumerate(solved_take.tracks.goals):
        is_targeted, misses = solved_take.active[:, e], solved_take.misses[:, e]
        miss_reports = tuple(
            _miss_statistics(
                part, times[is_targeted[:, i]], misses[is_targeted[:, i], i]
            )
            for i, part in enumerate(GOAL_PARTS)
            if is_targeted[:, i].any()
        )
        goal = track.goal
        is_missed = np.any(is_targeted & (misses > tolerances), axis=1)
        if goal.priority > 0 or goal.soft > 0:
            is_missed = np.asarray(is_missed & ~is_yielded, np.bool_)
        targeted_misses = np.where(is_targeted, misses, 0.0)
        spans = tuple(_missed_spans(solved_take, targeted_misses, is_missed))
        reports.append(
            GoalReport(track.name, goal.joint, track.location, miss_reports, spans)
        )
    return reports


def _miss_statistics(
    part: str, times: FloatArray, misses: FloatArray
) -> MissStatistics:
    """Return the statistics of one part's misses."""
    worst_index = int(np.argmax(misses))
    return MissStatistics(
        part,
        len(misses),
        float(misses.mean()),
        # Without interpolation, which fails between infinite misses.
        float(np.percentile(misses, 95, method="inverted_cdf")),
        float(misses[worst_index]),
        float(times[worst_index]),
    )


def _missed_spans(
    solved_take: TakeIk, misses: FloatArray, is_missed: BoolArray
) -> list[MissedSpan]:
    """Return the runs of frames in which a goal is missed, from misses ``(F, 4)``."""
    times = solved_take.take.clock.times
    spans = []
    for first, end in runs(is_missed):
        span_misses = misses[first:end]
        # Metres are compared with radians, but only to choose the reported frame.
        worst_frame = first + int(np.argmax(span_misses.sum(axis=1)))
        spans.append(
            MissedSpan(
                float(times[first]),
                float(times[end - 1]),
                float(span_misses[:, IS_LENGTH].max()),
                float(span_misses[:, ~IS_LENGTH].max()),
                float(times[worst_frame]),
                IkStatus.STEADIER
                if IkStatus.STEADIER in solved_take.statuses[first:end]
                else solved_take.statuses[worst_frame],
            )
        )
    return spans


def take_notices(
    solved_take: TakeIk, reports: list[GoalReport], *, is_smoothed: bool = False
) -> list[Fault]:
    """Return all warnings of a solved take."""
    return [
        *span_notices(solved_take),
        *independent_frame_notices(solved_take, is_smoothed=is_smoothed),
        *far_target_notices(solved_take, reports),
        *missed_notices(solved_take, reports),
        *pole_notices(solved_take),
        *crossed_notices(solved_take),
        *jump_notices(solved_take),
    ]


def missed_notices(solved_take: TakeIk, reports: list[GoalReport]) -> list[Fault]:
    """Return a warning for each goal that is missed."""
    notices = []
    for i, report in enumerate(reports):
        if report.spans:
            message, hint = _miss_text(report), _miss_hint(solved_take, report, i)
            notices.append(_goal_warning(solved_take, "IK101", i, message, hint))
    return notices


def pole_notices(solved_take: TakeIk) -> list[Fault]:
    """Return a warning for each pole that leaves a limb's plane undefined (IK103)."""
    if solved_take.open_poles is None:
        return []
    times, notices = solved_take.take.clock.times, []
    for goal_index, track in enumerate(solved_take.tracks.goals):
        is_open = solved_take.open_poles[:, goal_index]
        if not is_open.any():
            continue
        span_texts = [
            _span_text(times[first], times[end - 1]) for first, end in runs(is_open)
        ]
        noun = "frame" if is_open.sum() == 1 else "frames"
        message = (
            f"the pole of {track.name!r} is on the line from the root of the limb to "
            f"its end at {noun} {listed(span_texts, 4)}: the limb may bend in any "
            "direction"
        )
        hint = "move the pole to the side on which the middle joint is to be"
        notices.append(_goal_warning(solved_take, "IK103", goal_index, message, hint))
    return notices


def crossed_notices(solved_take: TakeIk) -> list[Fault]:
    """Return a warning for goals whose limbs cross in all frames (TGT111)."""
    notices = []
    for left, right in crossed_goals(solved_take):
        names = [solved_take.tracks.goals[e].name for e in (left, right)]
        message = f"{names[0]!r} and {names[1]!r} cross in all frames, with joints on "
        message += "their limits"
        hint = "if the targets of left and right are exchanged, swap the effectors, or "
        hint += "their offsets"
        goal_index = min(left, right)
        notices.append(_goal_warning(solved_take, "TGT111", goal_index, message, hint))
    return notices


def _miss_hint(solved_take: TakeIk, report: GoalReport, goal_index: int) -> str | None:
    """Return a hint that may bring a missed goal into reach; None if unknown."""
    worst_span = max(report.spans, key=lambda span: span.distance)
    if worst_span.distance > 0:
        rig = solved_take.take.rig
        target = limb_target(solved_take, goal_index, worst_span.frame)
        hint = up_axis_hint(rig, target)
        hint = hint or pole_hint(solved_take, goal_index, worst_span.frame, target)
        hint = hint or space_hint(rig, target)
        if (
            hint is None
            and worst_span.distance > FAR_MISS_RATIO * solved_take.problem.length
        ):
            hint = unit_hint(rig, target)
            hint = hint or f"far out of reach: {UNITS_QUESTION}"
        if hint is not None:
            return hint
    if any(span.status is IkStatus.BUDGET for span in report.spans):
        hint = f"the step or time limit was reached: raise {argument('seconds')}, "
        return f"{hint}remove it, or use a start that is nearer"
    if any(span.status is IkStatus.CONFLICT for span in report.spans):
        return _root_hint(solved_take)
    return None


def _root_hint(solved_take: TakeIk) -> str | None:
    """Return a hint if a goal without root moves a free joint above other goals."""
    rig = solved_take.take.rig
    goals = [track.goal for track in solved_take.tracks.goals]
    ancestor_lists = [rig.upwards(rig.index(goal.joint)) for goal in goals]
    for goal_index, (goal, ancestors) in enumerate(
        zip(goals, ancestor_lists, strict=True)
    ):
        if goal.root is not None:
            continue
        for child, joint in pairwise(ancestors):
            moves_other_goals = any(
                joint in other_ancestors
                for k, other_ancestors in enumerate(ancestor_lists)
                if k != goal_index
            )
            if moves_other_goals and rig.joints[joint].type is JointType.FREE:
                name = solved_take.tracks.goals[goal_index].name
                return (
                    f"the free joint {rig.names[joint]!r} moves for {name!r} and moves "
                    f"other goals too: 'root: {rig.names[child]}' keeps it still"
                )
    return None


def span_notices(solved_take: TakeIk) -> list[Fault]:
    """Return a warning for each hold span that lies outside the frames of the take.

    A single pose has no such warnings: the spans may be meant for other frames.
    """
    times = solved_take.take.clock.times
    if len(times) == 1:
        return []
    frames_text = f"the frames {times[0]:g} to {times[-1]:g}"
    notices = []
    for i, track in enumerate(solved_take.tracks.goals):
        for first, last in track.spans:
            if last >= times[0] and first <= times[-1]:
                continue
            message = f"the span from {span_label(first, last)}, to hold "
            message += f"{track.name!r}, contains none of {frames_text}"
            offset = SHOT_OFFSET * round((first - times[0]) / SHOT_OFFSET)
            hint = "write spans in frames of the take"
            if offset and first - offset >= times[0] and last - offset <= times[-1]:
                span = f"[{first - offset:g}, {last - offset:g}]"
                hint += f"; without an offset of {offset:g} it is {span}"
            notices.append(_goal_warning(solved_take, "TGT104", i, message, hint))
    return notices


def rest_notices(solved_take: TakeIk) -> list[Fault]:
    """Return a warning if all goals only hold the rest pose (TGT109).

    It concerns targets that are solved without a motion to start from.
    """
    goals = solved_take.tracks.goals
    if not goals or any(goal.parts or not goal.spans for goal in goals):
        return []
    message = f"holding {listed([goal.name for goal in goals])} changes nothing: "
    message += "without a start clip, all frames are the rest pose"
    hint = f"pass the motion with {argument('clip')}"
    return [_goal_warning(solved_take, "TGT109", 0, message, hint)]


def jump_notices(solved_take: TakeIk) -> list[Fault]:
    """Return a warning about the largest jump of a joint."""
    jumps = solved_take.jumps
    if not jumps:
        return []
    length = solved_take.problem.length
    largest_jump = max(jumps, key=lambda jump: _jump_order(jump, length))
    times, frame = solved_take.take.clock.times, largest_jump.frame
    verb = "slides" if largest_jump.slides else "rotates"
    message = f"joint {largest_jump.joint!r} {verb} by "
    message += f"{_step_text(largest_jump, largest_jump.size)} from frame "
    message += span_label(times[frame - 1], times[frame])
    if largest_jump.source > 0:
        message += f" ({_step_text(largest_jump, largest_jump.source)} in the source)"
    frame_count = len({jump.frame for jump in jumps} - {frame})
    if frame_count:
        message += f"; joints jump in {counted(frame_count, 'other frame')} too"
    other_joints = sorted({jump.joint for jump in jumps} - {largest_jump.joint})
    if other_joints:
        message += f"; also {listed(other_joints)}"
    path = str(solved_take.tracks.path)
    is_by_goals = all(jump.by_goals for jump in jumps)
    severity = Severity.NOTE if is_by_goals else Severity.WARNING
    hint = _jump_hint(solved_take, largest_jump)
    return [Fault("IK102", message, path, (), hint, severity)]


def _jump_order(jump: Jump, length: float) -> tuple[bool, float]:
    """Return whether goals do not explain a jump, and its excess [rad], [length]."""
    unit = length if jump.slides else 1.0
    return (not jump.by_goals, (jump.size - jump.source) / unit)


def _step_text(jump: Jump, size: float) -> str:
    """Return the size of a step as text with its unit."""
    return length_text(size) if jump.slides else angle_text(math.degrees(size), 3)


def _jump_hint(solved_take: TakeIk, worst_jump: Jump) -> str:
    """Return a hint that reduces the jumps of a take."""
    smoothing = solved_take.steadier
    if smoothing is not None:
        remaining_text = "leaves no jump"
        if smoothing.max_jump > 0:
            remaining_text = "leaves rotations of "
            remaining_text += (
                f"{angle_text(math.degrees(smoothing.max_jump), 3)} at most"
            )
        return f"{argument('smooth', f'{smoothing.seconds:g}')} {remaining_text}"
    track = _fading_goal(solved_take, worst_jump)
    if track is not None:
        hint = f"the goal {track.name!r} starts or ends there within "
        return f"{hint}{counted(round(track.ease), 'frame')}: a longer ease: slows it"
    if worst_jump.by_goals:
        return "its goals move or rotate as fast there: space their keys farther apart"
    goal = _straightening_goal(solved_take, worst_jump)
    if goal is not None:
        hint = f"the limb becomes straight there: soft: {SUGGESTED_SOFT:g} on the goal "
        return f"{hint}{goal!r} eases it, and stops slightly short of its target"
    if solved_take.moving_between:
        return "each frame is solved on its own; let the joints between move (TGT105)"
    hint = f"no smoother path was found, nor with {argument('smooth')}; a target that "
    hint += (
        f"passes farther from {worst_jump.joint!r}, moves earlier or has less weight "
    )
    return f"{hint}may help"


def _fading_goal(solved_take: TakeIk, worst_jump: Jump) -> GoalTrack | None:
    """Return a goal of the joint that fades in or out at a jump."""
    time_code = float(solved_take.take.clock.times[worst_jump.frame])
    for track in solved_take.tracks.goals:
        fade_ranges = [(first - track.ease, first) for first, _ in track.during]
        fade_ranges += [(last, last + track.ease) for _, last in track.during]
        is_fading = any(start < time_code <= end + 1 for start, end in fade_ranges)
        if is_fading and worst_jump.joint in _names_to_root(solved_take, track):
            return track
    return None


def _names_to_root(solved_take: TakeIk, track: GoalTrack) -> list[str]:
    """Return the names of a goal's joint and the joints above it."""
    rig = solved_take.take.rig
    return [rig.names[j] for j in rig.upwards(rig.index(track.goal.joint))]


def _straightening_goal(solved_take: TakeIk, worst_jump: Jump) -> str | None:
    """Return the name of a goal whose limb snaps straight at a jump, or None."""
    rig = solved_take.take.rig
    if rig.joints[rig.index(worst_jump.joint)].type is not JointType.PIN:
        return None
    rows = slice(worst_jump.frame - 1, worst_jump.frame + 1)
    for goal_index, track in enumerate(solved_take.tracks.goals):
        is_missed = solved_take.misses[rows, goal_index, 0] > MISSED_LENGTH
        is_always_active = solved_take.active[rows, goal_index, 0].all()
        snaps_straight = (
            is_always_active and is_missed[0] != is_missed[1] and not track.goal.soft
        )
        if (
            snaps_straight
            and worst_jump.joint in _names_to_root(solved_take, track)
            and _may_be_soft(solved_take, goal_index)
        ):
            return track.name
    return None


def _may_be_soft(solved_take: TakeIk, goal_index: int) -> bool:
    """Return whether a goal's limb supports soft extension."""
    problem = solved_take.problem
    goals = list(problem.goals)
    goals[goal_index] = replace(goals[goal_index], soft=SUGGESTED_SOFT)
    moving_joints = {problem.rig.index(name) for name in problem.joints}
    return not find_limbs(problem.rig, goals, moving_joints, problem.chain)[1]


def far_target_notices(solved_take: TakeIk, reports: list[GoalReport]) -> list[Fault]:
    """Return a warning for each goal whose targets are far from its effector's start.

    Missed goals get another warning.
    """
    notices = []
    for i, (report, target_distance) in enumerate(
        zip(reports, solved_take.target_distances, strict=True)
    ):
        if report.spans or not target_distance > FAR_TARGET_RATIO * solved_take.size:
            continue
        message = (
            f"the targets of {report.name!r} are at least "
            f"{length_text(target_distance)} from its start, but the rig is "
            f"{length_text(solved_take.size)} large"
        )
        notice = _goal_warning(solved_take, "TGT106", i, message, UNITS_QUESTION)
        notices.append(notice)
    return notices


def independent_frame_notices(
    solved_take: TakeIk, *, is_smoothed: bool = False
) -> list[Fault]:
    """Return a notice if each frame was solved on its own; a warning with smoothing.

    Args:
        solved_take: The solved take.
        is_smoothed: Whether smoothing was requested, which needs connected frames.
    """
    frame_count = len(solved_take.statuses)
    if not solved_take.moving_between or frame_count == 1:
        return []
    names = [repr(name) for name in solved_take.moving_between]
    message = (
        f"each of {counted(frame_count, 'frame')} is solved on its own, as "
        f"{listed(names, max_items=6)} between the joints that may move "
        f"{'moves' if len(names) == 1 else 'move'} too"
    )
    hint = "that takes longer, no smoother path is searched for, and nothing is "
    hint += "smoothed; let these joints move, or move by what their types have"
    severity = Severity.WARNING if is_smoothed else Severity.NOTE
    return [Fault("TGT105", message, str(solved_take.tracks.path), (), hint, severity)]


def _goal_warning(
    solved_take: TakeIk,
    code: str,
    goal_index: int,
    message: str,
    hint: str | None = None,
) -> Fault:
    """Return a warning that points at a goal in the targets file."""
    line, column = solved_take.tracks.goals[goal_index].location
    path = str(solved_take.tracks.path)
    where = f"goals[{goal_index}]"
    severity = Severity.WARNING
    return Fault(
        code, message, path, (line,), hint, severity, column=column, where=where
    )


def _miss_text(report: GoalReport) -> str:
    """Return text that states the frames, the part and the size of a goal's miss."""
    worst_span = max(report.spans, key=lambda span: span.distance + span.angle)
    spans_text = listed(
        [
            f"{'frame' if span.first == span.last else 'frames'} "
            f"{_span_text(span.first, span.last)}"
            for span in report.spans
        ],
        max_items=6,
    )
    amount_texts = []
    distance = worst_span.distance
    if distance > 0:
        overflow_text = f"over {OVERFLOW_DISTANCE:g} m"
        text = length_text(distance) if np.isfinite(distance) else overflow_text
        amount_texts.append(text)
    if worst_span.angle > 0:
        amount_texts.append(angle_text(float(np.degrees(worst_span.angle))))
    message = f"{report.name!r} does not reach its target at {spans_text}: it is "
    message += " and ".join(amount_texts)
    message += f" off at frame {frame_label(worst_span.frame)}"
    is_steadier = any(span.status is IkStatus.STEADIER for span in report.spans)
    return f"{message} ({IkStatus.STEADIER if is_steadier else worst_span.status})"


def _span_text(first: float, last: float) -> str:
    """Return the frames of a span as text."""
    return frame_label(first) if first == last else span_label(first, last)


def status_text(solved_take: TakeIk) -> str:
    """Return the number of frames by status, as text.

    NEAREST and STEADIER frames are reported together if there are both.
    """
    count_by_status = {
        IkStatus(name): count for name, count in solved_take.status_counts.items()
    }
    steadier_count = count_by_status.pop(IkStatus.STEADIER, 0)
    nearest_count = count_by_status.pop(IkStatus.NEAREST, 0) if steadier_count else 0
    texts = [f"{count} {status}" for status, count in count_by_status.items()]
    if steadier_count:
        text = f"{steadier_count + nearest_count} out of reach ({steadier_count} of "
        texts.append(f"{text}them on a smoother path than the nearest poses give)")
    return ", ".join(texts)

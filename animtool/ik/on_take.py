"""Solves a take for targets; each frame starts at its source pose."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from fnmatch import fnmatchcase

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.errors import Fault, OptionError
from animtool.core.loaded import check_loaded
from animtool.core.old_names import renamed_arguments
from animtool.ik.chain_frame import check_scales, spans_of_take
from animtool.ik.goals import GOAL_PARTS, Goal, Targets, targets_of_frames
from animtool.ik.options import TakeOptions
from animtool.ik.solving import raise_faults
from animtool.ik.sub_rig import sub_rig, with_ball_joints
from animtool.ik.take_run import (
    SpanSolution,
    TakeIk,
    TakeSolver,
    join_spans,
    take_option_faults,
)
from animtool.ik.tracks import FreeEffector, GoalTrack, TargetTracks
from animtool.motion.driving import drive_take
from animtool.motion.take import Take
from animtool.rig.driver_plan import plan_of
from animtool.rig.joints import LocalTransforms
from animtool.rig.kinematics import WorldTransforms, forward_kinematics
from animtool.rig.skeleton import Rig

# A pole this near to the line is on it, and a middle joint this near is on a straight
# limb, whose pole does not matter; in lengths of the limb.
ON_LINE_TOLERANCE, STRAIGHT_TOLERANCE = 0.02, 0.02
# Maps tracks, and for each goal the take it fades from, to the solved take.
SolveTracks = Callable[[TargetTracks, tuple[Take, ...]], Take]


def count_solves(tracks: TargetTracks) -> int:
    """Return the number of solves of a take; more than one if goals have spans.

    Goals with the same spans fade together and need one more solve if there are other
    goals. With several different spans, each needs one, with the others active.
    """
    span_count = len(_distinct_spans(tracks.goals))
    needs_bare_take = span_count > 0 and any(not track.during for track in tracks.goals)
    return 1 + needs_bare_take + (span_count if span_count > 1 else 0)


def solve_fade_sources(
    take: Take, tracks: TargetTracks, solve_tracks: SolveTracks
) -> tuple[Take, ...]:
    """Return, for each goal, the take from which it fades in and to which it fades out.

    That is the take solved for all goals except those with the same spans. Where two
    spans overlap in their eases, the other's ease is ignored.
    """
    spans = _distinct_spans(tracks.goals)
    take_by_span: dict[object, Take] = {_ALWAYS_ACTIVE: take}
    if spans:
        always_active = [track for track in tracks.goals if not track.during]
        bare_take = _solve_for_goals(take, tracks, always_active, take, solve_tracks)
        take_by_span |= dict.fromkeys(spans, bare_take)
    if len(spans) > 1:
        for span in spans:
            other_goals = [track for track in tracks.goals if _span_key(track) != span]
            take_by_span[span] = _solve_for_goals(
                take, tracks, other_goals, bare_take, solve_tracks
            )
    return tuple(take_by_span[_span_key(track)] for track in tracks.goals)


_ALWAYS_ACTIVE: object = ()


def _span_key(track: GoalTrack) -> object:
    """Return the key of goals that fade together: their active spans and ease."""
    return (track.during, track.ease) if track.during else _ALWAYS_ACTIVE


def _distinct_spans(goals: Sequence[GoalTrack]) -> list[object]:
    """Return the distinct spans and eases of goals."""
    return list(dict.fromkeys(_span_key(track) for track in goals if track.during))


def _solve_for_goals(
    take: Take,
    tracks: TargetTracks,
    goals: Sequence[GoalTrack],
    bare_take: Take,
    solve_tracks: SolveTracks,
) -> Take:
    """Return the take solved for some of its goals.

    Goals with active spans fade in from ``bare_take``, the others from ``take``.
    """
    if not goals:
        return take
    fade_sources = tuple(bare_take if track.during else take for track in goals)
    return solve_tracks(replace(tracks, goals=tuple(goals)), fade_sources)


# Pattern of goals in fault messages.
_GOAL_LOCATION = re.compile(r"goals\[(\d+)\]")


@renamed_arguments(still="static")
def solve_take(
    take: Take,
    tracks: TargetTracks,
    options: TakeOptions | None = None,
    *,
    static: bool = False,
    only: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> TakeIk:
    """Solve a take for targets, and return the solved take with its misses.

    Each frame starts at its source pose. Joints that move no goal keep it, and so do
    all joints in frames without active goals, except that joints that move a goal are
    clamped to their limits.

    Args:
        take: F frames.
        tracks: Target tracks of the take.
        options: Tolerances, budget, and which joints may move.
        static: The take is a single pose that need not be kept: each frame starts at
            the previous solution, and chains bend towards their ``pole_dir``.
        only: Index of the only frame to solve; None solves all.
        progress: Called with the fraction done, 0 to 1.

    Raises:
        OptionError: The targets have another rate or length (TGT014, TGT015), a joint
            above a goal is scaled (TGT016), or a goal or option is invalid (IK codes).
        FormatError: A prim's transform is not finite.
    """
    check_loaded(take, Take, "take")
    check_loaded(tracks, TargetTracks, "tracks")
    options = options or TakeOptions()
    check_loaded(options, TakeOptions, "options")
    raise_faults(take_option_faults(options))
    tracks = tracks.at_clock(take.clock)
    effectors = [(track.name, track.goal.joint) for track in tracks.goals]
    check_scales(take, effectors, tracks.path)
    solve_count, done_count = count_solves(tracks), 0
    seconds_spent = 0.0

    def solve_for_tracks(
        tracks: TargetTracks, fade_sources: tuple[Take, ...]
    ) -> TakeIk:
        """Return the take solved for tracks; progress covers all solves."""

        def report_progress(fraction: float) -> None:
            if progress is not None:
                progress((done_count + fraction) / solve_count)

        return _solve_take(
            take, tracks, fade_sources, options, static, only, report_progress
        )

    def solve_fade_source(tracks: TargetTracks, fade_sources: tuple[Take, ...]) -> Take:
        """Return the solved take that a goal fades from."""
        nonlocal done_count, seconds_spent
        solution = solve_for_tracks(tracks, fade_sources)
        done_count, seconds_spent = done_count + 1, seconds_spent + solution.seconds
        return solution.take

    fade_sources = solve_fade_sources(take, tracks, solve_fade_source)
    result = solve_for_tracks(tracks, fade_sources)
    driven_take = drive_take(result.take)
    return replace(result, take=driven_take, seconds=seconds_spent + result.seconds)


def _solve_take(
    take: Take,
    tracks: TargetTracks,
    fade_sources: tuple[Take, ...],
    options: TakeOptions,
    static: bool,
    only: int | None,
    progress: Callable[[float], None],
) -> TakeIk:
    """Solve a take for targets that fade from and to the given takes."""
    goals = [track.goal for track in tracks.goals]
    typed_rig = with_ball_joints(take.rig)
    rig, joint_indices = sub_rig(typed_rig, [goal.joint for goal in goals])
    movable_names = _movable_joint_names(take.rig, rig, options)
    local = LocalTransforms(
        take.motion.translations.gather(joint_indices),
        take.motion.rotations.gather(joint_indices),
    )
    world = forward_kinematics(rig, local.translations, local.rotations)
    span_solutions: list[SpanSolution] = []
    with _locate_faults(tracks):
        fade_transforms = tuple(
            _broadcast_world(rig, joint_indices, fade_take, world)
            for fade_take in fade_sources
        )
        targets = tracks.sample(rig, take.clock, world, fade_transforms)
        if only is not None:
            selection = _select_frame(take, local, world, targets, only)
            take, local, world, targets = selection
        rate = float(take.clock.rate)
        solver = TakeSolver(
            rig, tracks, targets, world, options, movable_names, static, rate
        )
        controls = _control_values(rig, take)
        solve_spans = spans_of_take(rig, local, world, goals, movable_names, controls)
        for span in solve_spans.spans:
            span_solutions.append(solver.solve_span(span))
            progress(span_solutions[-1].span.frames.stop / take.clock.count)
    solved_take = join_spans(
        take, joint_indices, local, tracks, targets, span_solutions, rate
    )
    rig_size = float(np.ptp(world.positions[0], axis=0).max())
    open_poles = None
    if solved_take.active[:, :, GOAL_PARTS.index("pole")].any():
        open_poles = _find_open_poles(rig, joint_indices, solved_take, targets)
    return replace(
        solved_take,
        open_poles=open_poles,
        moving_between=solve_spans.moving_between,
        target_distances=_min_target_distances(goals, rig, world, targets),
        size=max(rig_size, solved_take.problem.length),
    )


def _find_open_poles(
    rig: Rig, joint_indices: IntArray, solved_take: TakeIk, targets: Targets
) -> BoolArray:
    """Return a mask of poles on the line from root to end of a bent limb ``(F, E)``.

    Such poles do not determine the limb's bend.
    """
    motion, is_part_active = solved_take.take.motion, solved_take.active
    world = forward_kinematics(
        rig,
        motion.translations.gather(joint_indices),
        motion.rotations.gather(joint_indices),
    )
    is_on_line = np.zeros(is_part_active.shape[:2], np.bool_)
    for goal_index, track in enumerate(solved_take.tracks.goals):
        is_active = is_part_active[:, goal_index, GOAL_PARTS.index("pole")]
        effector = FreeEffector(rig, track.goal, world)
        limb = effector.limb() if is_active.any() else None
        if limb is None:
            continue
        goal_points = effector.position()
        root, middle = (world.positions[:, j] for j in limb)
        # The effector is off its position where the pole leads astray.
        has_position = is_part_active[:, goal_index, GOAL_PARTS.index("position")]
        positions = np.asarray(targets.positions)[:, goal_index]
        ends = np.where(has_position[:, None], positions, goal_points)
        length = np.linalg.norm(middle - root, axis=1)
        length += np.linalg.norm(goal_points - middle, axis=1)
        pole_distance = _line_distances(
            np.asarray(targets.poles)[:, goal_index], root, ends
        )
        is_bent = (
            _line_distances(middle, root, goal_points) > STRAIGHT_TOLERANCE * length
        )
        is_on_line[:, goal_index] = (
            is_active & is_bent & (pole_distance < ON_LINE_TOLERANCE * length)
        )
    return is_on_line


def _line_distances(
    points: FloatArray, root: FloatArray, end: FloatArray
) -> FloatArray:
    """Return distances of points from the line through root and end ``(F,)`` [m]."""
    line = end - root
    length = np.maximum(np.linalg.norm(line, axis=1), 1e-300)
    cross_products = np.cross(points - root, line / length[:, None])
    return np.asarray(np.linalg.norm(cross_products, axis=1))


def _control_values(rig: Rig, take: Take) -> dict[str, FloatArray]:
    """Return the values ``(F,)`` of controls that drivers of joints read."""
    channel = take.motion.controls
    if channel is None or not rig.is_driven:
        return {}
    read_names = plan_of(rig).controls_read()
    values = channel.gather(np.arange(len(channel.rest)))[:, :, 0]
    return {
        control.name: values[:, i]
        for i, control in enumerate(take.rig.controls)
        if control.name in read_names
    }


def _min_target_distances(
    goals: Sequence[Goal], rig: Rig, world: WorldTransforms, targets: Targets
) -> tuple[float, ...]:
    """Return the smallest distance of each goal's targets from its effector [m]."""
    smallest_distances = []
    for e, goal in enumerate(goals):
        is_active = np.asarray(targets.weights)[:, e, 0] * goal.position > 0
        points = FreeEffector(rig, goal, world).position()[is_active]
        offsets = np.asarray(targets.positions)[is_active, e] - points
        # The largest component needs no square, which would overflow for huge numbers.
        smallest_distances.append(
            float(np.abs(offsets).max(axis=1).min(initial=np.inf))
        )
    return tuple(
        0.0 if distance == np.inf else distance for distance in smallest_distances
    )


def _broadcast_world(
    rig: Rig, joint_indices: IntArray, take: Take, reference: WorldTransforms
) -> WorldTransforms:
    """Return a take's world transforms; a single frame is repeated as needed."""
    motion = take.motion
    world = forward_kinematics(
        rig,
        motion.translations.gather(joint_indices),
        motion.rotations.gather(joint_indices),
    )
    return WorldTransforms(
        np.broadcast_to(world.positions, reference.positions.shape),
        np.broadcast_to(world.linear, reference.linear.shape),
    )


@contextmanager
def _locate_faults(tracks: TargetTracks) -> Iterator[None]:
    """Locate faults of goals in the targets file."""
    try:
        yield
    except OptionError as error:
        faults = [_locate_fault(fault, tracks) for fault in error.faults]
        raise OptionError(faults) from error


def _locate_fault(fault: Fault, tracks: TargetTracks) -> Fault:
    """Return a fault located at its goal in the targets file."""
    location_match = _GOAL_LOCATION.match(fault.where or "")
    if fault.path is not None or location_match is None:
        return fault.in_file(tracks.path)
    line, column = tracks.goals[int(location_match[1])].location
    return replace(fault, path=str(tracks.path), lines=(line,), column=column)


def _select_frame(
    take: Take,
    local: LocalTransforms,
    world: WorldTransforms,
    targets: Targets,
    frame: int,
) -> tuple[Take, LocalTransforms, WorldTransforms, Targets]:
    """Return one frame of a take, its transforms and targets."""
    rows = slice(frame, frame + 1)
    start = take.clock.start + frame * take.clock.step
    clock = replace(take.clock, start=start, count=1)
    return (
        replace(take, clock=clock, motion=take.motion.select(rows)),
        LocalTransforms(local.translations[rows], local.rotations[rows]),
        WorldTransforms(world.positions[rows], world.linear[rows]),
        targets_of_frames(targets, rows),
    )


def _movable_joint_names(
    full_rig: Rig, rig: Rig, options: TakeOptions
) -> list[str] | None:
    """Return the names of the joints that may move; None is all that move a goal."""
    if not options.joints:
        return None
    matching_names: set[str] = set()
    faults = []
    for pattern in options.joints:
        matches = {name for name in full_rig.names if fnmatchcase(name, pattern)}
        if not matches:
            message = f"no joint of {full_rig.name!r} matches {pattern!r}"
            hint = full_rig.joint_hint(pattern)
            faults.append(Fault("TGT001", message, hint=hint))
        matching_names |= matches
    if faults:
        raise OptionError(faults)
    return [name for name in rig.names if name in matching_names]

"""Solves clips: poses that follow targets through time without jumps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from animtool.core.array_types import ArrayLike, FloatArray
from animtool.core.errors import Fault, OptionError
from animtool.ik.branches import (
    EQUAL_COST_TOLERANCE,
    Interval,
    branch_tracks,
    equalize_near_misses,
    find_branches,
    search_long_interval,
    track_both_directions,
)
from animtool.ik.clip_path import MAX_SMOOTH_JUMP_RATIO, ClipPath, FollowOptions
from animtool.ik.goals import Targets
from animtool.ik.nearest import frames_out_of_reach, with_nearest_poses
from animtool.ik.path import find_clip_jumps, smooth, smoothing_faults
from animtool.ik.problem import Problem
from animtool.ik.result import IkResult
from animtool.ik.solving import check_fixed_joints, checks_arguments

# The first searched interval begins this long before a jump [s]; each next one is twice
# as long.
FIRST_INTERVAL = 0.25
# A searched interval ends at most this long after the jump [s].
MAX_INTERVAL_AFTER = 0.5
# A new path must reduce the jump below this fraction of its size.
MIN_REDUCTION = 0.9
# Cost of a squared radian from the source clip for each frame on another branch: a flip
# of 180 degrees costs as much as minutes on that branch.
BRANCH_COST = 1e-2
# Chains with at most this many redundant degrees of freedom are searched over the full
# clip, from new starts at this interval [s], at most this many times.
MAX_REDUNDANCY, SEARCH_INTERVAL, MAX_SEARCHES = 2, 0.5, 4


@checks_arguments(FollowOptions)
def follow(
    problem: Problem,
    start: ArrayLike | None,
    targets: Targets,
    options: FollowOptions | None = None,
    *,
    prefer: ArrayLike | None = None,
) -> IkResult:
    """Return the poses of F consecutive frames, without avoidable jumps.

    Each frame starts from the previous solution. Where that pose cannot reach the
    goals, the solution jumps to another branch. Then other paths are searched over ever
    longer intervals before the jump, until one avoids it: solutions from seeded starts,
    tracked forward and backward in time, and blends to these that stay on the goals.
    The path with the least sum of squared steps is chosen and its speed evened out.
    Reaching goals takes precedence over avoiding jumps. No path is searched where no
    other solution of the frame jumps less.

    Args:
        problem: E goals over a rig of Q coordinates.
        start: Start of the first frame ``(Q,)``; None is the problem's pose. If every
            path from its solution jumps, another solution is taken. Or the poses of a
            clip ``(F, Q)``: then each frame starts from its pose, and the change from
            it is tracked and smoothed.
        targets: Targets of F frames.
        options: Rate, smoothing, and how to solve.
        prefer: Preferred pose ``(Q,)`` or ``(F, Q)``, weighted by the problem's
            ``rest_weight``; None is the start.

    Returns:
        Poses and their misses; ``jumps`` lists those that no path avoids, see
        `find_jumps`.

    Raises:
        OptionError: As for `solve`, or invalid ``fps``, ``smooth``, ``branches`` or
            ``back`` (IK014).

    Limits of the method: a frame that the search from many starts does not solve counts
    as out of reach; a path that must switch branches more than ``back`` before the jump
    is not found.

    >>> from animtool.ik.goals import Goal
    >>> from animtool.ik.problem import build
    >>> from animtool.rig.skeleton import Joint, JointType, Rig
    >>> upper = Joint("upper", -1, JointType.PIN)
    >>> lower = Joint("lower", 0, JointType.PIN, translation=(1, 0, 0))
    >>> problem = build(Rig("arm", (upper, lower)), [Goal("lower", offset=(1, 0, 0))])
    >>> turn = np.linspace(0, 1, 25)[:, None, None]
    >>> circle = np.concatenate([np.cos(turn), np.sin(turn), 0 * turn], axis=2)
    >>> result = follow(problem, [0.0, 0.5], Targets(1.5 * circle))
    >>> bool(result.converged.all()), result.jumps
    (True, ())
    """
    check_fixed_joints(problem, start)
    return follow_in_frame(problem, start, targets, options, prefer=prefer)


def follow_in_frame(
    problem: Problem,
    start: ArrayLike | None,
    targets: Targets,
    options: FollowOptions | None = None,
    *,
    prefer: ArrayLike | None = None,
) -> IkResult:
    """Follow targets relative to the problem's pose, wherever starts have its frame."""
    options = options or FollowOptions()
    _check_options(options)
    clip = ClipPath(problem, start, targets, options, prefer)
    result = _solve_in_order(clip)
    if options.smooth > 0:
        source_motion = start if clip.is_motion else None
        result = smooth(
            result, targets, options.smooth,
            fps=options.fps, start=source_motion, options=options.solving,
        )  # fmt: skip
    return replace(result, jumps=find_clip_jumps(result, targets, start, options.fps))


def _check_options(options: FollowOptions) -> None:
    """Raise if options are invalid."""
    faults = smoothing_faults(options.smooth, options.fps)
    faults += [
        Fault("IK014", f"{name} must be at least 0, not {getattr(options, name)}")
        for name in ("branches", "back")
        if not getattr(options, name) >= 0
    ]
    if faults:
        raise OptionError(faults)


def _solve_in_order(clip: ClipPath) -> IkResult:
    """Solve the frames in order, then remove the jumps that another path avoids."""
    result = clip.solve_frames(slice(0, len(clip)), clip.start)
    for attempt in range(MAX_SEARCHES if _has_small_solution_set(clip) else 0):
        if not _is_worth_searching(clip, clip.chain_poses(result), attempt):
            break
        previous_result, result = result, _search_full_clip(clip, result, attempt)
        if result is previous_result:
            break
    result = _with_nearer_frames(clip, result)
    last_checked_frame = 0
    while True:
        poses = clip.chain_poses(result)
        jumping_frames = clip.find_jumping_frames(poses)
        remaining_frames = jumping_frames[jumping_frames > last_checked_frame]
        if not len(remaining_frames):
            break
        last_checked_frame = int(remaining_frames[0])
        if _is_avoidable(clip, poses, last_checked_frame):
            result = _with_shorter_jump(clip, result, last_checked_frame)
    if clip.is_motion:
        result = _switch_branches(clip, result)
    return clip.with_steadier_status(result)


def _has_small_solution_set(clip: ClipPath) -> bool:
    """Return whether a frame's solution set is small enough to search exhaustively."""
    redundancy = clip.problem.degrees - clip.problem.rows
    return not clip.is_motion and redundancy <= MAX_REDUNDANCY


def _is_worth_searching(clip: ClipPath, poses: FloatArray, attempt: int) -> bool:
    """Return whether the largest step is a jump that another path may avoid."""
    ratios = clip.jump_ratios(poses)
    if not len(ratios) or ratios.max() <= (MAX_SMOOTH_JUMP_RATIO if attempt else 1.0):
        return False
    return _is_avoidable(clip, poses, int(ratios.argmax()) + 1)


def _is_avoidable(clip: ClipPath, poses: FloatArray, frame: int) -> bool:
    """Return whether a frame has other solutions with a smaller jump.

    Without such solutions, as where targets return into reach and straight limbs bend,
    no path can avoid the jump.
    """
    window = slice(frame - 1, frame + 1)
    interval = clip.interval(poses[window], window, frame)
    options = clip.options
    frame_pairs, costs = find_branches(interval, options.branches, options.solving.seed)
    frame_pairs = frame_pairs[
        (costs <= interval.costs + EQUAL_COST_TOLERANCE).all(axis=1)
    ]
    current_ratio = clip.max_jump_ratio(poses[window], window.start)
    return any(
        clip.max_jump_ratio(frame_pair, window.start) < MIN_REDUCTION * current_ratio
        for frame_pair in frame_pairs
    )


def _search_full_clip(clip: ClipPath, result: IkResult, attempt: int) -> IkResult:
    """Return the best path through the full clip, if it jumps less."""
    poses = clip.chain_poses(result)
    all_frames = slice(0, len(clip))
    interval = clip.interval(poses, all_frames, 0)
    frame_spacing = max(round(SEARCH_INTERVAL * clip.options.fps), 1)
    seed = clip.options.solving.seed + attempt * len(clip)
    paths, costs = search_long_interval(interval, frame_spacing, seed)
    path = _best_even_path(clip, interval, paths, costs, is_end_fixed=False)
    if clip.max_jump_ratio(path, 0) < MIN_REDUCTION * clip.max_jump_ratio(poses, 0):
        return clip.with_window(result, all_frames, path)
    return result


def _with_nearer_frames(clip: ClipPath, result: IkResult) -> IkResult:
    """Search the frames that miss goals individually, and return the improved result.

    A frame solved from a missed one stays on its branch; here it may switch to a nearer
    one.
    """
    frames = frames_out_of_reach(result, clip.options.solving)
    if not len(frames):
        return result
    independent_result = with_nearest_poses(
        clip.problem, result, clip.targets, clip.options.solving, clip.prefer
    )
    poses = clip.chain_poses(result)
    independent_poses = clip.chain_poses(independent_result)
    all_frames = slice(0, len(clip))
    interval = clip.interval(poses, all_frames, int(frames[0]))
    costs = clip.interval(independent_poses, all_frames, int(frames[0])).costs
    clip.least_costs = np.minimum(interval.costs, costs)
    all_costs = np.stack([interval.costs, costs])
    current_costs, independent_costs = equalize_near_misses(all_costs, clip.slack)
    improvements = np.where(
        current_costs > independent_costs, interval.costs - costs, 0.0
    )
    if not improvements.any():
        return result
    paths, path_costs = [poses[None], independent_poses[None]], [all_costs]
    for row in np.argsort(-improvements, kind="stable")[:MAX_SEARCHES]:
        if improvements[row] > 0:
            tracks, track_costs = track_both_directions(
                interval, independent_poses[row : row + 1], int(row)
            )
            paths.append(tracks)
            path_costs.append(track_costs)
    candidates = np.concatenate(paths), np.concatenate(path_costs)
    route = clip.best_route(interval, *candidates, is_start_free=True)
    return clip.with_window(result, all_frames, route)


def _with_shorter_jump(clip: ClipPath, result: IkResult, frame: int) -> IkResult:
    """Search windows before a jump for a better path; return the improved result."""
    poses = clip.chain_poses(result)
    smallest_ratio = clip.max_jump_ratio(poses[frame - 1 : frame + 1], frame - 1)
    best_window_path: tuple[slice, FloatArray] | None = None
    window_starts: list[int] = []
    seconds_before = FIRST_INTERVAL
    while seconds_before <= clip.options.back and (
        not window_starts or window_starts[-1] > 0
    ):
        window_start = max(frame - max(round(seconds_before * clip.options.fps), 2), 0)
        if window_start < frame and window_start not in window_starts:
            window_starts.append(window_start)
        seconds_before *= 2
    for first in window_starts:
        frames_after = min(frame - first, round(MAX_INTERVAL_AFTER * clip.options.fps))
        window = slice(first, min(frame + frames_after + 1, len(clip)))
        interval = clip.interval(poses[window], window, frame)
        options = clip.options
        paths, costs = find_branches(interval, options.branches, options.solving.seed)
        is_inside = window.stop < len(clip)
        is_end_fixed = is_inside and (clip.is_motion or _has_small_solution_set(clip))
        even_path = _best_even_path(
            clip, interval, paths, costs, is_end_fixed=is_end_fixed
        )
        ratio = clip.max_jump_ratio(even_path, first)
        if ratio < MIN_REDUCTION * smallest_ratio:
            smallest_ratio, best_window_path = ratio, (window, even_path)
        if smallest_ratio <= MAX_SMOOTH_JUMP_RATIO:
            break
    if best_window_path is None:
        return result
    return clip.with_window(result, *best_window_path)


def _best_even_path(
    clip: ClipPath,
    interval: Interval,
    paths: FloatArray,
    costs: FloatArray,
    *,
    is_end_fixed: bool,
) -> FloatArray:
    """Return the best of candidate paths, with its speed evened out.

    If it still jumps and begins with the clip, its first pose is free.
    """
    window = slice(interval.frames.start, interval.frames.stop)
    window_path = clip.frame_path.select_frames(window)
    route = clip.best_route(interval, paths, costs, is_end_fixed=is_end_fixed)
    best_even_path = window_path.with_even_speed(route)[0]
    smallest_ratio = clip.max_jump_ratio(best_even_path, window.start)
    if window.start > 0 or smallest_ratio <= 1:
        return best_even_path
    free_start_route = clip.best_route(
        interval, paths, costs, is_end_fixed=is_end_fixed, is_start_free=True
    )
    free_start_route = window_path.with_even_speed(
        free_start_route, is_start_free=True
    )[0]
    ratio = clip.max_jump_ratio(free_start_route, window.start)
    return (
        free_start_route if ratio < MIN_REDUCTION * smallest_ratio else best_even_path
    )


def _switch_branches(clip: ClipPath, result: IkResult) -> IkResult:
    """Return the best path of a moving clip across branches, if it jumps less.

    It may begin and end on any branch, and stays as near to the clip as steps allow.
    """
    all_frames = slice(0, len(clip))
    for attempt in range(MAX_SEARCHES):
        poses = clip.chain_poses(result)
        squared_ratios = _squared_jump_ratios(clip, poses)
        if not squared_ratios.any():
            break
        rows = np.sort(np.argsort(-squared_ratios, kind="stable")[: 1 + attempt]) + 1
        rows = rows[squared_ratios[rows - 1] > 0]
        interval = clip.interval(poses, all_frames, int(rows[0]))
        seed = clip.options.solving.seed + attempt * len(clip)
        paths, costs = branch_tracks(interval, rows, clip.options.branches, seed)
        path = clip.best_route(
            interval, paths, costs, is_start_free=True, source_weight=BRANCH_COST
        )
        path = _with_even_speed(clip, path)
        ratio_sum = _squared_jump_ratios(clip, path).sum()
        if ratio_sum < MIN_REDUCTION * squared_ratios.sum():
            result = clip.with_window(result, all_frames, path)
    return result


def _squared_jump_ratios(clip: ClipPath, poses: FloatArray) -> FloatArray:
    """Return the squared jump ratio of each step ``(F - 1,)``; 0 if it is no jump."""
    ratios = np.zeros(max(len(poses) - 1, 0))
    rows = clip.find_jumping_frames(poses) - 1
    ratios[rows] = clip.jump_ratios(poses)[rows] ** 2
    return ratios


def _with_even_speed(clip: ClipPath, poses: FloatArray) -> FloatArray:
    """Even out the speed around each jump of a path, where that reduces the jump."""
    poses = poses.copy()
    for frame in clip.find_jumping_frames(poses).tolist():
        for seconds in (FIRST_INTERVAL, 2 * FIRST_INTERVAL, 4 * FIRST_INTERVAL):
            half_width = max(round(seconds * clip.options.fps), 2)
            end = min(frame + half_width, len(clip))
            window = slice(max(frame - half_width, 0), end)
            window_path = clip.frame_path.select_frames(window)
            smallest_ratio = clip.max_jump_ratio(poses[window], window.start)
            # The first pose of the clip moves only if that reduces a jump.
            for is_start_free in (False, True)[: 2 if window.start == 0 else 1]:
                even_path = window_path.with_even_speed(
                    poses[window], is_start_free=is_start_free
                )[0]
                ratio = clip.max_jump_ratio(even_path, window.start)
                if ratio < MIN_REDUCTION * smallest_ratio:
                    poses[window], smallest_ratio = even_path, ratio
            if smallest_ratio <= MAX_SMOOTH_JUMP_RATIO:
                break
    return poses

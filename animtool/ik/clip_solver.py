"""Solves clips: poses that follow targets through time without jumps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from animtool.core.array_types import ArrayLike, FloatArray
from animtool.core.errors import Fault, OptionError
from animtool.ik.branches import (
    EQUAL_COST,
    Interval,
    branch_tracks,
    branches,
    follow_in_both_directions,
    forgiving,
    search_branches,
)
from animtool.ik.clip_path import SMOOTH_ENOUGH, ClipPath, FollowOptions
from animtool.ik.goals import Targets
from animtool.ik.nearest import frames_out_of_reach, with_nearest_poses
from animtool.ik.path import jumps_of, rate_faults, smooth
from animtool.ik.problem import Problem
from animtool.ik.result import IkResult

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
    The path with the least sum of squared steps is taken and its speed evened out.
    Reaching goals takes precedence over avoiding jumps. No path is searched where no
    other solution of the frame jumps less.

    Args:
        problem: E goals over a rig of Q coordinates.
        start: Start of the first frame ``(Q,)``; None is the rest pose. If every path
            from its solution jumps, another solution is taken. Or the poses of a clip
            ``(F, Q)``: then each frame starts from its pose, and the change from it is
            tracked and smoothed.
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
    options = options or FollowOptions()
    _check(options)
    clip = ClipPath(problem, start, targets, options, prefer)
    result = _solve_in_order(clip)
    if options.smooth > 0:
        source_motion = start if clip.moving else None
        result = smooth(
            result,
            targets,
            options.smooth,
            fps=options.fps,
            start=source_motion,
            options=options.solving,
        )
    return replace(result, jumps=jumps_of(result, targets, start, options.fps))


def _check(options: FollowOptions) -> None:
    faults = rate_faults(options.smooth, options.fps)
    faults += [
        Fault("IK014", f"{name} must be at least 0, not {getattr(options, name)}")
        for name in ("branches", "back")
        if not getattr(options, name) >= 0
    ]
    if faults:
        raise OptionError(faults)


def _solve_in_order(clip: ClipPath) -> IkResult:
    """Return the frames solved in order, with avoidable jumps removed."""
    result = clip.solved(slice(0, len(clip)), clip.start)
    for attempt in range(MAX_SEARCHES if _is_thin(clip) else 0):
        if not _is_worth_search(clip, clip.poses(result), attempt):
            break
        previous, result = result, _searched(clip, result, attempt)
        if result is previous:
            break
    result = _nearest(clip, result)
    last_checked = 0
    while True:
        poses = clip.poses(result)
        jumps = clip.jumping(poses)
        remaining_jumps = jumps[jumps > last_checked]
        if not len(remaining_jumps):
            break
        last_checked = int(remaining_jumps[0])
        if _can_be_passed(clip, poses, last_checked):
            result = _with_detour(clip, result, last_checked)
    if clip.moving:
        result = _branch_switched(clip, result)
    return clip.judged(result)


def _is_thin(clip: ClipPath) -> bool:
    """Whether the solution set of a frame is small enough to search exhaustively."""
    redundancy = clip.problem.degrees - clip.problem.rows
    return not clip.moving and redundancy <= MAX_REDUNDANCY


def _is_worth_search(clip: ClipPath, poses: FloatArray, attempt: int) -> bool:
    """Whether the worst step is a jump that another path may avoid."""
    strains = clip.strains(poses)
    if not len(strains) or strains.max() <= (SMOOTH_ENOUGH if attempt else 1.0):
        return False
    return _can_be_passed(clip, poses, int(strains.argmax()) + 1)


def _can_be_passed(clip: ClipPath, poses: FloatArray, frame: int) -> bool:
    """Whether a frame has other solutions with a smaller jump.

    Without any, as where targets return into reach and straight limbs bend, searching
    for a path that avoids the jump is useless.
    """
    window = slice(frame - 1, frame + 1)
    interval = clip.interval(poses[window], window, frame)
    options = clip.options
    frame_pairs, costs = branches(interval, options.branches, options.solving.seed)
    current_strain = clip.strain(poses[window], window.start)
    return any(
        clip.strain(frame_pair, window.start) < MIN_REDUCTION * current_strain
        for frame_pair in frame_pairs[
            (costs <= interval.costs + EQUAL_COST).all(axis=1)
        ]
    )


def _searched(clip: ClipPath, result: IkResult, attempt: int) -> IkResult:
    """Return the best path through the full clip, if it jumps less."""
    poses = clip.poses(result)
    all_frames = slice(0, len(clip))
    interval = clip.interval(poses, all_frames, 0)
    spacing = max(round(SEARCH_INTERVAL * clip.options.fps), 1)
    seed = clip.options.solving.seed + attempt * len(clip)
    paths, costs = search_branches(interval, spacing, seed)
    path = _best_even_path(clip, interval, paths, costs, fixed_end=False)
    if clip.strain(path, 0) < MIN_REDUCTION * clip.strain(poses, 0):
        return clip.joined(result, all_frames, path)
    return result


def _nearest(clip: ClipPath, result: IkResult) -> IkResult:
    """Return a result whose frames that miss goals are searched individually.

    A frame solved from a missed one stays on its branch; here it may switch to a nearer
    one.
    """
    frames = frames_out_of_reach(result, clip.options.solving)
    if not len(frames):
        return result
    independent = with_nearest_poses(
        clip.problem, result, clip.targets, clip.options.solving, clip.prefer
    )
    poses, independent_poses = clip.poses(result), clip.poses(independent)
    all_frames = slice(0, len(clip))
    interval = clip.interval(poses, all_frames, int(frames[0]))
    costs = clip.interval(independent_poses, all_frames, int(frames[0])).costs
    clip.least = np.minimum(interval.costs, costs)
    smallest = forgiving(np.stack([interval.costs, costs]), clip.slack)
    gains = np.where(smallest[0] > smallest[1], interval.costs - costs, 0.0)
    if not gains.any():
        return result
    paths, prices = (
        [poses[None], independent_poses[None]],
        [interval.costs[None], costs[None]],
    )
    for row in np.argsort(-gains, kind="stable")[:MAX_SEARCHES]:
        if gains[row] > 0:
            tracks, cost = follow_in_both_directions(
                interval, independent_poses[row : row + 1], int(row)
            )
            paths.append(tracks)
            prices.append(cost)
    candidates = np.concatenate(paths), np.concatenate(prices)
    return clip.joined(
        result, all_frames, clip.best(interval, *candidates, free_start=True)
    )


def _with_detour(clip: ClipPath, result: IkResult, frame: int) -> IkResult:
    """Return a result with a better path to a frame that jumps."""
    poses = clip.poses(result)
    smallest = clip.strain(poses[frame - 1 : frame + 1], frame - 1)
    best_result: tuple[slice, FloatArray] | None = None
    for first in _beginnings(clip, frame):
        frames_after = min(frame - first, round(MAX_INTERVAL_AFTER * clip.options.fps))
        window = slice(first, min(frame + frames_after + 1, len(clip)))
        detour = _detour(clip, poses, window, frame)
        strain = clip.strain(detour, first)
        if strain < MIN_REDUCTION * smallest:
            smallest, best_result = strain, (window, detour)
        if smallest <= SMOOTH_ENOUGH:
            break
    return result if best_result is None else clip.joined(result, *best_result)


def _beginnings(clip: ClipPath, frame: int) -> list[int]:
    """Return the first frames of the intervals to search, the shortest first."""
    beginnings: list[int] = []
    seconds_before = FIRST_INTERVAL
    while seconds_before <= clip.options.back and (
        not beginnings or beginnings[-1] > 0
    ):
        first = max(frame - max(round(seconds_before * clip.options.fps), 2), 0)
        if first < frame and first not in beginnings:
            beginnings.append(first)
        seconds_before *= 2
    return beginnings


def _detour(clip: ClipPath, poses: FloatArray, window: slice, frame: int) -> FloatArray:
    """Return the best path through a window, with its speed evened out."""
    interval = clip.interval(poses[window], window, frame)
    options = clip.options
    paths, costs = branches(interval, options.branches, options.solving.seed)
    fixed_end = (clip.moving or _is_thin(clip)) and window.stop < len(clip)
    return _best_even_path(clip, interval, paths, costs, fixed_end=fixed_end)


def _best_even_path(
    clip: ClipPath,
    interval: Interval,
    paths: FloatArray,
    costs: FloatArray,
    *,
    fixed_end: bool,
) -> FloatArray:
    """Return the best of candidate paths, with its speed evened out.

    If it still jumps and begins with the clip, its first pose is free.
    """
    window = slice(interval.frames.start, interval.frames.stop)
    path = clip.path.frames(window)
    smoothest = path.evened(clip.best(interval, paths, costs, fixed_end=fixed_end))[0]
    smallest = clip.strain(smoothest, window.start)
    if window.start > 0 or smallest <= 1:
        return smoothest
    free_route = clip.best(interval, paths, costs, fixed_end=fixed_end, free_start=True)
    free_route = path.evened(free_route, free_start=True)[0]
    return (
        free_route
        if clip.strain(free_route, window.start) < MIN_REDUCTION * smallest
        else smoothest
    )


def _branch_switched(clip: ClipPath, result: IkResult) -> IkResult:
    """Return the best path of a moving clip across branches, if steadier.

    It may begin and end on any branch, and stays as near to the clip as steps allow.
    """
    all_frames = slice(0, len(clip))
    for attempt in range(MAX_SEARCHES):
        poses = clip.poses(result)
        strains = _jump_strains(clip, poses)
        if not strains.any():
            break
        rows = np.sort(np.argsort(-strains, kind="stable")[: 1 + attempt]) + 1
        rows = rows[strains[rows - 1] > 0]
        interval = clip.interval(poses, all_frames, int(rows[0]))
        seed = clip.options.solving.seed + attempt * len(clip)
        paths, costs = branch_tracks(interval, rows, clip.options.branches, seed)
        path = clip.best(
            interval, paths, costs, free_start=True, source_weight=BRANCH_COST
        )
        path = _even_speed(clip, path)
        if _jump_strains(clip, path).sum() < MIN_REDUCTION * strains.sum():
            result = clip.joined(result, all_frames, path)
    return result


def _jump_strains(clip: ClipPath, poses: FloatArray) -> FloatArray:
    """Return squared strains of jumps, 0 for other steps ``(F - 1,)``."""
    strains = np.zeros(max(len(poses) - 1, 0))
    rows = clip.jumping(poses) - 1
    strains[rows] = clip.strains(poses)[rows] ** 2
    return strains


def _even_speed(clip: ClipPath, poses: FloatArray) -> FloatArray:
    """Return a path with its speed evened out around each jump, where that helps."""
    poses = poses.copy()
    for frame in clip.jumping(poses).tolist():
        for seconds in (FIRST_INTERVAL, 2 * FIRST_INTERVAL, 4 * FIRST_INTERVAL):
            half_width = max(round(seconds * clip.options.fps), 2)
            window = slice(
                max(frame - half_width, 0), min(frame + half_width, len(clip))
            )
            path = clip.path.frames(window)
            smallest = clip.strain(poses[window], window.start)
            # The first pose of the clip moves only if that reduces a jump.
            for free_start in (False, True)[: 2 if window.start == 0 else 1]:
                even_path = path.evened(poses[window], free_start=free_start)[0]
                strain = clip.strain(even_path, window.start)
                if strain < MIN_REDUCTION * smallest:
                    poses[window], smallest = even_path, strain
            if smallest <= SMOOTH_ENOUGH:
                break
    return poses

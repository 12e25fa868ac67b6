"""Whole clips: poses that follow targets through time without jumps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from animtool.core.array_types import ArrayLike, FloatArray
from animtool.core.errors import Fault, OptionError
from animtool.ik.branches import (
    NO_WORSE,
    Interval,
    branch_tracks,
    branches,
    follow_both_ways,
    forgiving,
    search_branches,
)
from animtool.ik.clip_path import SMOOTH_ENOUGH, ClipPath, FollowOptions
from animtool.ik.goals import Targets
from animtool.ik.nearest import frames_out_of_reach, settled
from animtool.ik.path import jumps_of, rate_faults, smooth
from animtool.ik.problem import Problem
from animtool.ik.result import IkResult

# An interval that is searched begins this long before a jump [s], then twice that.
FIRST_BACK = 0.25
# It ends this long after it, at most [s].
MAX_AHEAD = 0.5
# Only a jump that becomes this much smaller is worth another path.
SMALLER = 0.9
# What a squared radian from the clip costs in each frame, where a path stays on another
# branch: a flip of half a turn costs as much as minutes there.
NEARNESS = 1e-2
# Chains with so many more degrees of freedom than residuals are searched through from
# end to end, from new starts so many seconds apart, at most so many times.
MAX_FREE, SEARCH_INTERVAL, MAX_SEARCHES = 2, 0.5, 4


def follow(
    problem: Problem,
    start: ArrayLike | None,
    targets: Targets,
    options: FollowOptions | None = None,
    *,
    prefer: ArrayLike | None = None,
) -> IkResult:
    """Return the poses of F frames in the order of time, without needless jumps.

    Each frame starts where the one before it ended. Where that ends in a pose from
    which the goals are out of reach, the next one jumps to another branch of solutions;
    then other paths through the time about the jump are looked for, longer before it
    each time, until one is without it: solutions from seeded starts, followed forward
    and backward in time, and paths that pass over to these while they keep to the
    goals. Of all, the way with the least sum of squared distances is taken, and its
    speed evened out. Frames that reach their goals come before jumps that are avoided.
    No path is looked for where no solution of a frame has less of a jump.

    Args:
        problem: E goals over a rig of Q coordinates.
        start: Where the first frame is looked for ``(Q,)``; None is the rest pose. If
            no way from the pose found there is without a jump, another is taken. Or the
            poses of a clip ``(F, Q)``: then every frame starts at its own, and what is
            followed and smoothed is the change from it.
        targets: Of F frames.
        options: Rate, smoothing, and how to solve.
        prefer: Pose ``(Q,)`` or ``(F, Q)`` that the problem's ``rest_weight`` draws
            to; None is the start.

    Returns:
        Poses and what they miss; its ``jumps`` are those that no path was found
        without, see `find_jumps`.

    Raises:
        OptionError: As of `solve`, and ``fps``, ``smooth``, ``branches`` or ``back``
            make no sense (IK014).

    Limits of the method: a frame that the search from many starts does not solve is
    taken to be out of reach, and so is what 16 other starts end no nearer to; a path
    that is needed but leaves more than ``back`` before the jump is not found.

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
    result = _followed(clip)
    if options.smooth > 0:
        kept = start if clip.moving else None
        result = smooth(
            result,
            targets,
            options.smooth,
            fps=options.fps,
            start=kept,
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


def _followed(clip: ClipPath) -> IkResult:
    """Return the frames one after the other, jumps taken out where that can be."""
    result = clip.solved(slice(0, len(clip)), clip.start)
    for attempt in range(MAX_SEARCHES if _is_thin(clip) else 0):
        if not _is_worth_search(clip, clip.poses(result), attempt):
            break
        before, result = result, _searched(clip, result, attempt)
        if result is before:
            break
    result = _nearest(clip, result)
    done = 0
    while True:
        poses = clip.poses(result)
        jumps = clip.jumping(poses)
        left = jumps[jumps > done]
        if not len(left):
            break
        done = int(left[0])
        if _can_be_passed(clip, poses, done):
            result = _mended(clip, result, done)
    if clip.moving:
        result = _rewoven(clip, result)
    return clip.judged(result)


def _is_thin(clip: ClipPath) -> bool:
    """Whether poses that reach the goals of a frame lie close enough to try all."""
    free = clip.problem.degrees - clip.problem.rows
    return not clip.moving and free <= MAX_FREE


def _is_worth_search(clip: ClipPath, poses: FloatArray, attempt: int) -> bool:
    """Whether poses jump, or did, and another path may be found for the worst."""
    strains = clip.strains(poses)
    if not len(strains) or strains.max() <= (SMOOTH_ENOUGH if attempt else 1.0):
        return False
    return _can_be_passed(clip, poses, int(strains.argmax()) + 1)


def _can_be_passed(clip: ClipPath, poses: FloatArray, frame: int) -> bool:
    """Whether a frame has solutions to which there is less of a jump.

    Where there are none, as where targets come back into reach and limbs that were
    straight bend, a path that avoids the jump is not worth looking for.
    """
    window = slice(frame - 1, frame + 1)
    interval = clip.interval(poses[window], window, frame)
    options = clip.options
    pairs, costs = branches(interval, options.branches, options.solving.seed)
    own = clip.strain(poses[window], window.start)
    return any(
        clip.strain(pair, window.start) < SMALLER * own
        for pair in pairs[(costs <= interval.costs + NO_WORSE).all(axis=1)]
    )


def _searched(clip: ClipPath, result: IkResult, attempt: int) -> IkResult:
    """Return the best path through the whole clip, if it jumps less."""
    poses = clip.poses(result)
    whole = slice(0, len(clip))
    interval = clip.interval(poses, whole, 0)
    spacing = max(round(SEARCH_INTERVAL * clip.options.fps), 1)
    seed = clip.options.solving.seed + attempt * len(clip)
    paths, costs = search_branches(interval, spacing, seed)
    path = _evened(clip, interval, paths, costs, closed=False)
    if clip.strain(path, 0) < SMALLER * clip.strain(poses, 0):
        return clip.joined(result, whole, path)
    return result


def _nearest(clip: ClipPath, result: IkResult) -> IkResult:
    """Return a result whose frames that miss goals are each searched by themselves.

    A frame that follows one short of its goals stays on that branch; here it leaves
    for one that is nearer.
    """
    frames = frames_out_of_reach(result, clip.options.solving)
    if not len(frames):
        return result
    alone = settled(
        clip.problem, result, clip.targets, clip.options.solving, clip.prefer
    )
    poses, other = clip.poses(result), clip.poses(alone)
    whole = slice(0, len(clip))
    interval = clip.interval(poses, whole, int(frames[0]))
    costs = clip.interval(other, whole, int(frames[0])).costs
    clip.least = np.minimum(interval.costs, costs)
    least = forgiving(np.stack([interval.costs, costs]), clip.slack)
    gains = np.where(least[0] > least[1], interval.costs - costs, 0.0)
    if not gains.any():
        return result
    paths, prices = [poses[None], other[None]], [interval.costs[None], costs[None]]
    for row in np.argsort(-gains, kind="stable")[:MAX_SEARCHES]:
        if gains[row] > 0:
            tracks, cost = follow_both_ways(interval, other[row : row + 1], int(row))
            paths.append(tracks)
            prices.append(cost)
    candidates = np.concatenate(paths), np.concatenate(prices)
    return clip.joined(result, whole, clip.best(interval, *candidates, opened=True))


def _mended(clip: ClipPath, result: IkResult, frame: int) -> IkResult:
    """Return a result with a better path to a frame that is jumped to."""
    poses = clip.poses(result)
    least = clip.strain(poses[frame - 1 : frame + 1], frame - 1)
    best: tuple[slice, FloatArray] | None = None
    for first in _beginnings(clip, frame):
        ahead = min(frame - first, round(MAX_AHEAD * clip.options.fps))
        window = slice(first, min(frame + ahead + 1, len(clip)))
        detour = _detour(clip, poses, window, frame)
        strain = clip.strain(detour, first)
        if strain < SMALLER * least:
            least, best = strain, (window, detour)
        if least <= SMOOTH_ENOUGH:
            break
    return result if best is None else clip.joined(result, *best)


def _beginnings(clip: ClipPath, frame: int) -> list[int]:
    """Return where intervals before a frame begin, the shortest first."""
    beginnings: list[int] = []
    back = FIRST_BACK
    while back <= clip.options.back and (not beginnings or beginnings[-1] > 0):
        first = max(frame - max(round(back * clip.options.fps), 2), 0)
        if first < frame and first not in beginnings:
            beginnings.append(first)
        back *= 2
    return beginnings


def _detour(clip: ClipPath, poses: FloatArray, window: slice, frame: int) -> FloatArray:
    """Return the best path through a window, its speed evened out."""
    interval = clip.interval(poses[window], window, frame)
    options = clip.options
    paths, costs = branches(interval, options.branches, options.solving.seed)
    closed = (clip.moving or _is_thin(clip)) and window.stop < len(clip)
    return _evened(clip, interval, paths, costs, closed=closed)


def _evened(
    clip: ClipPath,
    interval: Interval,
    paths: FloatArray,
    costs: FloatArray,
    *,
    closed: bool,
) -> FloatArray:
    """Return the best path, its speed evened out.

    Where it still jumps and begins with the clip, its first pose is any.
    """
    window = slice(interval.frames.start, interval.frames.stop)
    path = clip.path.frames(window)
    best = path.evened(clip.best(interval, paths, costs, closed=closed))[0]
    least = clip.strain(best, window.start)
    if window.start > 0 or least <= 1:
        return best
    other = clip.best(interval, paths, costs, closed=closed, opened=True)
    other = path.evened(other, opened=True)[0]
    return other if clip.strain(other, window.start) < SMALLER * least else best


def _rewoven(clip: ClipPath, result: IkResult) -> IkResult:
    """Return the best path through a moving clip on other branches, if steadier.

    It may begin and end on any branch, and is near the clip as far as steps let it.
    """
    whole = slice(0, len(clip))
    for attempt in range(MAX_SEARCHES):
        poses = clip.poses(result)
        strains = _jump_strains(clip, poses)
        if not strains.any():
            break
        rows = np.sort(np.argsort(-strains, kind="stable")[: 1 + attempt]) + 1
        rows = rows[strains[rows - 1] > 0]
        interval = clip.interval(poses, whole, int(rows[0]))
        seed = clip.options.solving.seed + attempt * len(clip)
        paths, costs = branch_tracks(interval, rows, clip.options.branches, seed)
        path = clip.best(interval, paths, costs, opened=True, near=NEARNESS)
        path = _eased(clip, path)
        if _jump_strains(clip, path).sum() < SMALLER * strains.sum():
            result = clip.joined(result, whole, path)
    return result


def _jump_strains(clip: ClipPath, poses: FloatArray) -> FloatArray:
    """Return squared strains of steps that are jumps, 0 of others ``(F - 1,)``."""
    strains = np.zeros(max(len(poses) - 1, 0))
    rows = clip.jumping(poses) - 1
    strains[rows] = clip.strains(poses)[rows] ** 2
    return strains


def _eased(clip: ClipPath, poses: FloatArray) -> FloatArray:
    """Return a path whose speed is evened out about each jump, where that helps."""
    poses = poses.copy()
    for frame in clip.jumping(poses).tolist():
        for seconds in (FIRST_BACK, 2 * FIRST_BACK, 4 * FIRST_BACK):
            reach = max(round(seconds * clip.options.fps), 2)
            window = slice(max(frame - reach, 0), min(frame + reach, len(clip)))
            path = clip.path.frames(window)
            best = clip.strain(poses[window], window.start)
            # The first pose of the clip moves only where that makes a jump smaller.
            for opened in (False, True)[: 2 if window.start == 0 else 1]:
                eased = path.evened(poses[window], opened=opened)[0]
                strain = clip.strain(eased, window.start)
                if strain < SMALLER * best:
                    poses[window], best = eased, strain
            if best <= SMOOTH_ENOUGH:
                break
    return poses

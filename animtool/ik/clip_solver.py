"""Whole clips: poses that follow targets through time without jumps."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from animtool._types import ArrayLike, FloatArray
from animtool.errors import Fault, OptionError
from animtool.ik.branches import Interval, best_path, branches, price, search_branches
from animtool.ik.chain import difference
from animtool.ik.goals import Targets, rows_of
from animtool.ik.options import IkMethod
from animtool.ik.path import (
    at_poses,
    explained,
    jumping,
    named,
    path_of,
    rate_faults,
    smooth,
    strain,
)
from animtool.ik.problem import Problem
from animtool.ik.result import IkResult
from animtool.ik.solving import IkOptions, pose_rows, solve

# A interval that is looked through begins this long before a jump [s], then twice that.
FIRST_BACK = 0.25
# It ends this long after it, at most [s].
MAX_AHEAD = 0.5
# Only a jump that becomes this much smaller is worth another path; at this share of
# what is taken for a jump, none is looked for that is better still.
SMALLER, SMOOTH_ENOUGH = 0.9, 0.4
# Poses that cost no more than this much more miss their goals by as much, see `price`.
NO_WORSE = 1e-3
# Chains with so many more degrees of freedom than residuals are searched through from
# end to end, from new starts so many seconds apart, at most so many times.
MAX_FREE, SEARCH_INTERVAL, MAX_SEARCHES = 2, 0.5, 4
# Poses nearer than this are the same [rad], [share of the length].
UNCHANGED = 1e-9


@dataclass(frozen=True, slots=True)
class FollowOptions:
    """How to follow targets through a clip.

    Attributes:
        solving: Of the frames; ``ordered`` and ``warm`` have no say.
        fps: Frames a second.
        smooth: Time over which motion that the goals leave free is evened out [s], as
            of `animtool.ik.smooth`; 0 leaves it.
        branches: Other poses tried where a joint jumps.
        back: How long before a jump the path may leave for another [s].
    """

    solving: IkOptions = field(default_factory=IkOptions)
    fps: float = 24.0
    smooth: float = 0.0
    branches: int = 20
    back: float = 8.0


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
        without: steps beyond 0.1 rad, 8 rad/s and four times what the targets move by,
        all together; and slower ones that are four times what the joint moves by just
        before and after.

    Raises:
        OptionError: As of `solve`, and ``fps``, ``smooth``, ``branches`` or ``back``
            make no sense (IK014).

    Limits of the method: a frame that the search from many starts does not solve is
    taken to be out of reach, and a path that is needed but leaves more than ``back``
    before the jump is not found.

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
    clip = _Clip(problem, start, targets, options, prefer)
    result = clip.followed()
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
    poses = problem.chain.from_rig(result.coordinates)
    return replace(result, jumps=named(clip.path, poses, clip.allowed))


def _check(options: FollowOptions) -> None:
    faults = rate_faults(options.smooth, options.fps)
    faults += [
        Fault("IK014", f"{name} must be at least 0, not {getattr(options, name)}")
        for name in ("branches", "back")
        if not getattr(options, name) >= 0
    ]
    if faults:
        raise OptionError(faults)


class _Clip:
    """A clip on its way from the first solution to the last path."""

    def __init__(
        self,
        problem: Problem,
        start: ArrayLike | None,
        targets: Targets,
        options: FollowOptions,
        prefer: ArrayLike | None,
    ) -> None:
        self.problem = problem
        self.targets = targets
        self.options = options
        self.path = path_of(problem, targets, start, options.solving)
        self.allowed = explained(self.path, options.fps)
        self.count = len(self.path.targets)
        self.start = pose_rows(problem, start, self.count, "start")
        self.moving = start is not None and np.ndim(start) == 2
        self.prefer = (
            self.start
            if prefer is None
            else pose_rows(problem, prefer, self.count, "prefer")
        )
        self.reference = problem.chain.from_rig(self.start)

    def followed(self) -> IkResult:
        """Return the frames one after the other, jumps taken out where that can be."""
        result = self._solved(slice(0, self.count), self.start)
        for attempt in range(MAX_SEARCHES if self._is_thin() else 0):
            if not self._is_worth_weaving(self._poses(result), attempt):
                break
            before, result = result, self._search_branches(result, attempt)
            if result is before:
                break
        done = 0
        while True:
            poses = self._poses(result)
            jumps = jumping(self.path, poses, self.allowed)
            left = jumps[jumps > done]
            if not len(left):
                return result
            done = int(left[0])
            if self._can_be_passed(poses, done):
                result = self._mended(result, done)

    def _is_worth_weaving(self, poses: FloatArray, attempt: int) -> bool:
        """Whether poses jump, or did, and another way may be found for the worst."""
        steps = np.abs(self.path.steps(poses)).max(axis=1, initial=0.0) / self.allowed
        if not len(steps) or steps.max() <= (SMOOTH_ENOUGH if attempt else 1.0):
            return False
        return self._can_be_passed(poses, int(steps.argmax()) + 1)

    def _can_be_passed(self, poses: FloatArray, frame: int) -> bool:
        """Whether a frame has solutions to which there is less of a jump.

        Where there are none, as where targets come back into reach and limbs that
        were straight bend, a path that avoids the jump is not worth looking for.
        """
        window = slice(frame - 1, frame + 1)
        interval = self._stretch(poses[window], window, frame)
        options = self.options
        pairs, costs = branches(interval, options.branches, options.solving.seed)
        own = self._strain(poses[window], window.start)
        return any(
            self._strain(pair, window.start) < SMALLER * own
            for pair in pairs[(costs <= interval.costs + NO_WORSE).all(axis=1)]
        )

    def _is_thin(self) -> bool:
        """Whether poses that reach the goals of a frame lie close enough to try all."""
        free = self.problem.degrees - self.problem.rows
        return not self.moving and free <= MAX_FREE

    def _search_branches(self, result: IkResult, attempt: int) -> IkResult:
        """Return the best way through the whole clip, if it jumps less."""
        poses = self._poses(result)
        whole = slice(0, self.count)
        interval = self._stretch(poses, whole, 0)
        spacing = max(round(SEARCH_INTERVAL * self.options.fps), 1)
        seed = self.options.solving.seed + attempt * self.count
        paths, costs = search_branches(interval, spacing, seed)
        path = self._way(interval, paths, costs, closed=False)
        if self._strain(path, 0) < SMALLER * self._strain(poses, 0):
            return self._joined(result, whole, path)
        return result

    def _poses(self, result: IkResult) -> FloatArray:
        return self.problem.chain.from_rig(result.coordinates)

    def _solved(self, frames: slice, starts: FloatArray) -> IkResult:
        """Return frames solved each after the one before it, or from its own start."""
        chosen = replace(self.options.solving, ordered=True, warm=not self.moving)
        return solve(
            self.problem,
            starts[frames] if self.moving or not len(starts) else starts[frames.start],
            rows_of(self.targets, frames),
            chosen,
            prefer=self.prefer[frames],
        )

    def _mended(self, result: IkResult, frame: int) -> IkResult:
        """Return a result with a better path to a frame that is jumped to."""
        poses = self._poses(result)
        least = self._strain(poses[frame - 1 : frame + 1], frame - 1)
        best: tuple[slice, FloatArray] | None = None
        for first in self._beginnings(frame):
            ahead = min(frame - first, round(MAX_AHEAD * self.options.fps))
            window = slice(first, min(frame + ahead + 1, self.count))
            detour = self._detour(poses, window, frame)
            strain = self._strain(detour, first)
            if strain < SMALLER * least:
                least, best = strain, (window, detour)
            if least <= SMOOTH_ENOUGH:
                break
        return result if best is None else self._joined(result, *best)

    def _beginnings(self, frame: int) -> list[int]:
        """Return where stretches before a frame begin, the shortest first."""
        beginnings: list[int] = []
        back = FIRST_BACK
        while back <= self.options.back and (not beginnings or beginnings[-1] > 0):
            first = max(frame - max(round(back * self.options.fps), 2), 0)
            if first < frame and first not in beginnings:
                beginnings.append(first)
            back *= 2
        return beginnings

    def _strain(self, poses: FloatArray, first: int) -> float:
        """Return the largest step from a frame on, in shares of what is a jump."""
        frames = slice(first, first + len(poses))
        allowed = self.allowed[first : frames.stop - 1]
        return strain(self.path.frames(frames), poses, allowed)

    def _stretch(self, poses: FloatArray, window: slice, frame: int) -> Interval:
        path = self.path.frames(window)
        misses = path.measured(poses)
        return Interval(
            self.problem,
            self.targets,
            range(window.start, window.stop),
            frame,
            poses,
            price(misses, path.excess(misses) <= 1),
            self.reference[window],
            SMOOTH_ENOUGH * self.allowed[window.start : window.stop - 1],
            self.prefer,
            replace(self.options.solving, method=IkMethod.DAMPED),
        )

    def _detour(self, poses: FloatArray, window: slice, frame: int) -> FloatArray:
        """Return the best path through a window, its speed evened out."""
        interval = self._stretch(poses[window], window, frame)
        options = self.options
        paths, costs = branches(interval, options.branches, options.solving.seed)
        closed = (self.moving or self._is_thin()) and window.stop < self.count
        return self._way(interval, paths, costs, closed=closed)

    def _way(
        self, interval: Interval, paths: FloatArray, costs: FloatArray, *, closed: bool
    ) -> FloatArray:
        """Return the best way, its speed evened out.

        Where it still jumps and begins with the clip, its first pose is any, as no
        motion has to be kept.
        """
        window = slice(interval.frames.start, interval.frames.stop)
        path = self.path.frames(window)
        best = best_path(interval, paths, costs, closed=closed)
        best = path.evened(best)[0]
        least = self._strain(best, window.start)
        if window.start > 0 or self.moving or least <= 1:
            return best
        other = best_path(interval, paths, costs, closed=closed, opened=True)
        other = path.evened(other, opened=True)[0]
        better = self._strain(other, window.start) < SMALLER * least
        return other if better else best

    def _joined(self, result: IkResult, window: slice, poses: FloatArray) -> IkResult:
        """Return a result with a window replaced, and what comes after it."""
        chain = self.problem.chain
        own = self._poses(result)
        misses = self.path.frames(window).measured(poses)
        part = at_poses(_frames(result, window), poses, misses, self.path)
        parts = [_frames(result, slice(0, window.start)), part]
        rest = slice(window.stop, self.count)
        if rest.start < self.count:
            same = np.abs(difference(chain, own[rest.start - 1], poses[-1])).max()
            if self.moving or same < UNCHANGED:
                parts.append(_frames(result, rest))
            else:
                starts = np.broadcast_to(part.coordinates[-1], self.start.shape)
                parts.append(self._solved(rest, starts))
        return _concatenated(parts)


def _frames(result: IkResult, frames: slice) -> IkResult:
    """Return some of the frames of a result."""
    own = {name: getattr(result, name)[frames] for name in _by_frame()}
    return replace(result, **own)


def _concatenated(parts: list[IkResult]) -> IkResult:
    """Return the frames of some results, one after the other."""
    own: dict[str, Any] = {}
    for name in _by_frame():
        values = [getattr(part, name) for part in parts]
        if name == "statuses":
            own[name] = tuple(status for part in values for status in part)
        else:
            own[name] = np.concatenate(values)
    return replace(parts[0], **own)


def _by_frame() -> list[str]:
    """Return the names of what a result has for each frame."""
    return [f.name for f in fields(IkResult) if f.name not in {"problem", "jumps"}]

"""A clip that follows targets, and the cost of a path through its frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field, fields, replace
from typing import Any

import numpy as np

from animtool.core.array_types import ArrayLike, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.ik.branches import (
    Interval,
    best_path,
    forgiving,
    missed_by,
    price,
    weighed,
)
from animtool.ik.chain import difference
from animtool.ik.goals import Targets, by_unit, rows_of
from animtool.ik.jumps import largest_step
from animtool.ik.options import IkMethod, IkOptions
from animtool.ik.path import at_poses, jumping_frames, path_of
from animtool.ik.problem import Problem
from animtool.ik.result import IkResult, IkStatus
from animtool.ik.solving import pose_rows, solve

# A step below this fraction of the jump threshold is smooth: no smoother path is
# searched.
SMOOTH_ENOUGH = 0.4
# Extra miss allowed for an unreachable goal where that makes a path smoother [m]: a few
# such changes stay within the millimetre up to which a pose counts as nearest.
MISS_SLACK = 2.5e-4
# A pose nearer to the goals by more than this is better [m].
NEARER_BY = 1e-3
# Poses nearer than this are equal [rad], [fraction of the length].
UNCHANGED = 1e-9


@dataclass(frozen=True, slots=True)
class FollowOptions:
    """How to follow targets through a clip.

    Attributes:
        solving: Options of each frame; ``ordered`` and ``warm`` are ignored.
        fps: Frames a second.
        smooth: Time over which motion that the goals leave free is smoothed [s], see
            `animtool.ik.smooth`; 0 disables it.
        branches: Number of alternative poses tried where a joint jumps.
        back: Longest time before a jump at which the path may switch branches [s].
    """

    solving: IkOptions = field(default_factory=IkOptions)
    fps: float = 24.0
    smooth: float = 0.0
    branches: int = 20
    back: float = 8.0


class ClipPath:
    """The frames of a clip, and the costs that compare paths through them.

    Attributes:
        problem: Goals and joints.
        targets: Targets of F frames.
        options: Frame rate and solve options.
        path: Kernel arguments of the frames.
        start: Start poses of the solve ``(F, Q)``.
        moving: Whether the starts are a motion whose change is solved.
        prefer: Preferred poses, weighted by ``rest_weight`` ``(F, Q)``.
        reference: Chain coordinates of the start ``(F, C)``.
        largest: Jump threshold [rad], [fraction of the length].
        least: Smallest known cost of each frame ``(F,)``, see `price`.
    """

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
        self.start = pose_rows(problem, start, len(self.path.targets), "start")
        self.moving = start is not None and np.ndim(start) == 2
        self.prefer = (
            self.start
            if prefer is None
            else pose_rows(problem, prefer, len(self.start), "prefer")
        )
        self.reference = problem.chain.from_rig(self.start)
        self.largest = largest_step(options.fps)
        self.least = np.full(len(self.start), np.inf)

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self.start)

    @property
    def slack(self) -> float:
        """Extra miss allowed for a smoother path [fraction of the length]."""
        return MISS_SLACK / self.problem.length

    def poses(self, result: IkResult) -> FloatArray:
        """Return the chain coordinates of a result ``(F, C)``."""
        return self.problem.chain.from_rig(result.coordinates)

    def solved(self, frames: slice, starts: FloatArray) -> IkResult:
        """Return frames solved in order, or each from its start if the clip moves."""
        frame_options = replace(
            self.options.solving, ordered=True, warm=not self.moving
        )
        return solve(
            self.problem,
            starts[frames] if self.moving or not len(starts) else starts[frames.start],
            rows_of(self.targets, frames),
            frame_options,
            prefer=self.prefer[frames],
        )

    def jumping(self, poses: FloatArray) -> IntArray:
        """Return the frames to which a joint jumps, ascending."""
        source = self.start if self.moving else None
        return jumping_frames(self.path, poses, self.start, source, self.options.fps)

    def strains(self, poses: FloatArray, first: int = 0) -> FloatArray:
        """Return the largest step to each next frame over the jump threshold [1].

        ``poses`` ``(L, C)`` of the frames from the first on.
        """
        steps = self.path.frames(slice(first, first + len(poses))).steps(poses)
        return np.asarray(np.abs(steps).max(axis=1, initial=0.0) / self.largest)

    def strain(self, poses: FloatArray, first: int) -> float:
        """Return the maximum of `strains`."""
        return float(self.strains(poses, first).max(initial=0.0))

    def interval(self, poses: FloatArray, window: slice, frame: int) -> Interval:
        """Return an interval of the clip with poses ``(L, C)`` that jump at a frame."""
        path = self.path.frames(window)
        shares = path.measured(poses)
        misses = shares * by_unit(self.problem.length, 1.0)
        counts = weighed(self.problem, misses, rows_of(self.targets, window))
        return Interval(
            self.problem,
            self.targets,
            range(window.start, window.stop),
            frame,
            poses,
            price(counts, path.excess(shares) <= 1),
            self.reference[window],
            np.full(len(path.drifts), SMOOTH_ENOUGH * self.largest),
            self.prefer,
            replace(self.options.solving, method=IkMethod.DAMPED),
        )

    def best(
        self,
        interval: Interval,
        paths: FloatArray,
        costs: FloatArray,
        *,
        fixed_end: bool = False,
        free_start: bool = False,
        source_weight: float = 0.0,
    ) -> FloatArray:
        """Return the best route across candidate paths; see `best_path`.

        Misses within the slack of the smallest count as equal, and ``source_weight`` is
        the cost per squared radian of distance from the source clip.
        """
        costs = forgiving(costs, self.slack)
        if source_weight > 0:
            source_distances = difference(self.problem.chain, interval.reference, paths)
            costs = costs + source_weight * (source_distances**2).sum(axis=2)
        return best_path(
            interval, paths, costs, fixed_end=fixed_end, free_start=free_start
        )

    def judged(self, result: IkResult) -> IkResult:
        """Return a result with STEADIER status where a nearer pose is known."""
        all_frames = slice(0, len(self))
        costs = self.interval(self.poses(result), all_frames, 0).costs
        path_misses, least_misses = missed_by(costs), missed_by(self.least)
        # Misses that overflow are infinite at the nearest pose, too.
        excess = np.subtract(
            path_misses,
            least_misses,
            out=np.zeros_like(path_misses),
            where=path_misses > least_misses,
        )
        excess = excess * self.problem.length
        statuses = tuple(
            IkStatus.STEADIER if status is IkStatus.NEAREST and is_beyond else status
            for status, is_beyond in zip(
                result.statuses, excess > NEARER_BY, strict=True
            )
        )
        return replace(result, statuses=statuses)

    def joined(self, result: IkResult, window: slice, poses: FloatArray) -> IkResult:
        """Return a result with a window replaced and later frames solved again."""
        chain = self.problem.chain
        current = self.poses(result)
        misses = self.path.frames(window).measured(poses)
        part = at_poses(_frames(result, window), poses, misses, self.path)
        results = [_frames(result, slice(0, window.start)), part]
        later_frames = slice(window.stop, len(self))
        if later_frames.start < len(self):
            is_unchanged = np.abs(
                difference(chain, current[later_frames.start - 1], poses[-1])
            ).max()
            if self.moving or is_unchanged < UNCHANGED:
                results.append(_frames(result, later_frames))
            else:
                starts = np.broadcast_to(part.coordinates[-1], self.start.shape)
                results.append(self.solved(later_frames, starts))
        return _concatenated(results)


def _frames(result: IkResult, frames: slice) -> IkResult:
    """Return some of the frames of a result."""
    values = {name: getattr(result, name)[frames] for name in _by_frame()}
    return replace(result, **values)


def _concatenated(parts: Sequence[IkResult]) -> IkResult:
    """Return the concatenated frames of results."""
    values: dict[str, Any] = {}
    for name in _by_frame():
        parts_values = [getattr(part, name) for part in parts]
        if name == "statuses":
            values[name] = tuple(status for part in parts_values for status in part)
        else:
            values[name] = np.concatenate(parts_values)
    return replace(parts[0], **values)


def _by_frame() -> list[str]:
    """Return the names of the per-frame fields of a result."""
    return [f.name for f in fields(IkResult) if f.name not in {"problem", "jumps"}]

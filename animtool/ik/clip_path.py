"""A clip that follows targets, and the cost of a path through its frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field, replace
from typing import Any

import numpy as np

from animtool.core.array_types import ArrayLike, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.ik.branches import (
    Interval,
    best_path,
    equalize_near_misses,
    miss_cost,
    miss_of_cost,
    weight_misses,
)
from animtool.ik.chain import joint_steps
from animtool.ik.goals import Targets, by_unit, targets_of_frames
from animtool.ik.jumps import jump_threshold
from animtool.ik.options import IkMethod, IkOptions
from animtool.ik.path import build_frame_path, find_jumping_frames, with_poses
from animtool.ik.problem import Problem
from animtool.ik.result import PER_PROBLEM_ARRAYS, IkResult, IkStatus
from animtool.ik.solving import pose_rows, solve_in_frame

# A step below this fraction of the jump threshold is smooth: no smoother path is
# searched.
MAX_SMOOTH_JUMP_RATIO = 0.4
# Extra miss allowed for an unreachable goal where that makes a path smoother [m]: a few
# such changes stay within the millimetre up to which a pose counts as nearest.
MISS_SLACK = 2.5e-4
# A pose nearer to the goals by more than this is better [m].
MIN_IMPROVEMENT = 1e-3
# Poses nearer than this are equal [rad], [fraction of the length].
EQUAL_POSE_TOLERANCE = 1e-9


@dataclass(frozen=True, slots=True)
class FollowOptions:
    """Options for following targets through a clip.

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
    """The frames of a clip, and the costs by which paths through them are compared.

    Attributes:
        problem: Goals and joints.
        targets: Targets of F frames.
        options: Frame rate and solve options.
        frame_path: Kernel arguments of the frames.
        start: Start poses of the solve ``(F, Q)``.
        is_motion: Whether the starts are a motion that the solve modifies.
        prefer: Preferred poses, weighted by ``rest_weight`` ``(F, Q)``.
        reference_poses: Chain coordinates of the start ``(F, C)``.
        jump_threshold: Jump threshold [rad], [fraction of the length].
        least_costs: Smallest known cost of each frame ``(F,)``, see `miss_cost`.
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
        self.frame_path = build_frame_path(problem, targets, start, options.solving)
        self.start = pose_rows(problem, start, len(self.frame_path.targets), "start")
        self.is_motion = start is not None and np.ndim(start) == 2
        self.prefer = self.start
        if prefer is not None:
            self.prefer = pose_rows(problem, prefer, len(self.start), "prefer")
        self.reference_poses = problem.chain.from_rig(self.start)
        self.jump_threshold = jump_threshold(options.fps)
        self.least_costs = np.full(len(self.start), np.inf)

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self.start)

    @property
    def slack(self) -> float:
        """Additional miss accepted for a smoother path [fraction of the length]."""
        return MISS_SLACK / self.problem.length

    def chain_poses(self, result: IkResult) -> FloatArray:
        """Return the chain coordinates of a result ``(F, C)``."""
        return self.problem.chain.from_rig(result.coordinates)

    def solve_frames(self, frames: slice, starts: FloatArray) -> IkResult:
        """Solve frames in order, or each from its start if the clip is a motion."""
        frame_options = replace(
            self.options.solving, ordered=True, warm=not self.is_motion
        )
        is_per_frame = self.is_motion or not len(starts)
        return solve_in_frame(
            self.problem,
            starts[frames] if is_per_frame else starts[frames.start],
            targets_of_frames(self.targets, frames),
            frame_options,
            prefer=self.prefer[frames],
        )

    def find_jumping_frames(self, poses: FloatArray) -> IntArray:
        """Return the frames at which a joint jumps, ascending."""
        source = self.start if self.is_motion else None
        return find_jumping_frames(
            self.frame_path, poses, self.start, source, self.options.fps
        )

    def jump_ratios(self, poses: FloatArray, first: int = 0) -> FloatArray:
        """Return the largest joint step to each next frame over the jump threshold [1].

        ``poses`` ``(L, C)`` are those of consecutive frames that start at ``first``.
        """
        frames = slice(first, first + len(poses))
        steps = self.frame_path.select_frames(frames).steps(poses)
        return np.asarray(np.abs(steps).max(axis=1, initial=0.0) / self.jump_threshold)

    def max_jump_ratio(self, poses: FloatArray, first: int) -> float:
        """Return the largest of `jump_ratios`."""
        return float(self.jump_ratios(poses, first).max(initial=0.0))

    def interval(self, poses: FloatArray, window: slice, frame: int) -> Interval:
        """Return an interval of the clip with poses ``(L, C)`` that jump at a frame."""
        frame_path = self.frame_path.select_frames(window)
        misses_in_tolerances = frame_path.measure_misses(poses)
        misses = misses_in_tolerances * by_unit(self.problem.length, 1.0)
        targets = targets_of_frames(self.targets, window)
        weighted_misses = weight_misses(self.problem, misses, targets)
        is_reached = frame_path.max_tolerance_ratio(misses_in_tolerances) <= 1
        unpenalized_step = MAX_SMOOTH_JUMP_RATIO * self.jump_threshold
        return Interval(
            self.problem,
            self.targets,
            range(window.start, window.stop),
            frame,
            poses,
            miss_cost(weighted_misses, is_reached),
            self.reference_poses[window],
            np.full(len(frame_path.preserved_steps), unpenalized_step),
            self.prefer,
            replace(self.options.solving, method=IkMethod.DAMPED),
        )

    def best_route(
        self,
        interval: Interval,
        paths: FloatArray,
        costs: FloatArray,
        *,
        is_end_fixed: bool = False,
        is_start_free: bool = False,
        source_weight: float = 0.0,
    ) -> FloatArray:
        """Return the best route across candidate paths; see `best_path`.

        Misses within the slack of the smallest count as equal, and ``source_weight`` is
        the cost per squared radian of distance from the source clip.
        """
        costs = equalize_near_misses(costs, self.slack)
        if source_weight > 0:
            steps = joint_steps(self.problem.chain, interval.reference_poses, paths)
            costs = costs + source_weight * (steps**2).sum(axis=2)
        return best_path(
            interval,
            paths,
            costs,
            is_end_fixed=is_end_fixed,
            is_start_free=is_start_free,
        )

    def with_steadier_status(self, result: IkResult) -> IkResult:
        """Return a result with status STEADIER in frames with a known nearer pose."""
        all_frames = slice(0, len(self))
        costs = self.interval(self.chain_poses(result), all_frames, 0).costs
        path_misses, least_misses = miss_of_cost(costs), miss_of_cost(self.least_costs)
        # Misses that overflow are infinite at the nearest pose, too.
        excess_misses = np.zeros_like(path_misses)
        is_larger = path_misses > least_misses
        np.subtract(path_misses, least_misses, out=excess_misses, where=is_larger)
        excess_misses *= self.problem.length
        statuses = list(result.statuses)
        for row in np.flatnonzero(excess_misses > MIN_IMPROVEMENT):
            if statuses[row] is IkStatus.NEAREST:
                statuses[row] = IkStatus.STEADIER
        return replace(result, statuses=tuple(statuses))

    def with_window(
        self, result: IkResult, window: slice, poses: FloatArray
    ) -> IkResult:
        """Replace the poses of a window in a result, and solve later frames again."""
        chain = self.problem.chain
        current_poses = self.chain_poses(result)
        misses = self.frame_path.select_frames(window).measure_misses(poses)
        window_result = with_poses(
            result.select(window), poses, misses, self.frame_path
        )
        partial_results = [result.select(slice(0, window.start)), window_result]
        later_frames = slice(window.stop, len(self))
        if later_frames.start < len(self):
            previous_end = current_poses[later_frames.start - 1]
            change = np.abs(joint_steps(chain, previous_end, poses[-1])).max()
            if self.is_motion or change < EQUAL_POSE_TOLERANCE:
                partial_results.append(result.select(later_frames))
            else:
                last_pose = window_result.coordinates[-1]
                starts = np.broadcast_to(last_pose, self.start.shape)
                partial_results.append(self.solve_frames(later_frames, starts))
        return _concatenate(partial_results)


def _concatenate(results: Sequence[IkResult]) -> IkResult:
    """Concatenate results along the frame axis."""
    array_by_field: dict[str, Any] = {
        name: np.concatenate([getattr(result, name) for result in results])
        for name in PER_PROBLEM_ARRAYS
    }
    statuses = tuple(status for result in results for status in result.statuses)
    return replace(results[0], statuses=statuses, **array_by_field)

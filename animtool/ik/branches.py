"""Searches a clip for other solution branches, and for the best path across them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from animtool import _kernels
from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.ik.chain import (
    BALL,
    Chain,
    apply_steps,
    joint_steps,
    unwrap_angles,
    with_geared_limits,
    with_periods,
)
from animtool.ik.goals import Targets, by_unit, targets_of_frames
from animtool.ik.options import IkOptions
from animtool.ik.problem import Problem
from animtool.ik.result import IkResult
from animtool.ik.solving import solve_in_frame

# Cost of a frame that misses its goals, in squared radians: more than any jump.
MISS_COST = 1e4
# Weight factor per priority level [1].
PRIORITY_FACTOR = 1e-2
# Costs that differ by at most this count as equal misses, see `miss_cost`.
EQUAL_COST_TOLERANCE = 1e-3
# Poses nearer than this belong to one branch [rad], [fraction of the length].
SAME_BRANCH_DISTANCE = 1e-3
# Maximum iterations from any start, and from the neighbouring frame; a branch that
# needs more ends there.
START_ITERATIONS, TRACK_ITERATIONS = 100, 30
# Number of solutions searched at each sample of a clip, and of branches tracked in
# parallel.
SOLUTIONS_PER_SAMPLE, MAX_LAYERS = 12, 8
# Number of frames per tracking batch; a branch may end at any of them.
TRACK_BATCH = 48
# Standard deviations of random rotations of unlimited joints [rad], used cyclically.
RANDOM_SPREADS = (0.5, 1.5, 3.0)


@dataclass(frozen=True)
class Interval:
    """Consecutive frames in which the search looks for another solution branch."""

    problem: Problem  # goals and joints
    targets: Targets  # targets of all F frames of the clip
    frames: range  # frames of the interval; paths differ from the first on
    jump_frame: int  # the frame that should be reached without a jump
    poses: FloatArray  # the current path, chain coordinates ``(L, C)``
    costs: FloatArray  # miss cost of each frame, see `miss_cost` ``(L,)``
    # Source motion that the path modifies ``(L, C)``; a repeated pose if there is none.
    reference_poses: FloatArray
    # Largest joint step without penalty, for each frame pair ``(L - 1,)``.
    unpenalized_step: FloatArray
    # Preferred poses of all frames, weighted by ``rest_weight`` ``(F, Q)``.
    preferred_poses: FloatArray
    options: IkOptions  # solver options of a frame

    @property
    def chain(self) -> Chain:
        """The kinematic chain of the problem."""
        return self.problem.chain

    def solve_frames(
        self, starts: FloatArray, frames: IntArray, iterations: int = START_ITERATIONS
    ) -> tuple[FloatArray, FloatArray]:
        """Solve frames of the clip from starts; return poses ``(B, C)`` and costs."""
        rows = self._rig_rows(starts)
        frame_options = replace(
            self.options, warm=False, restarts=0, iterations=iterations
        )
        result = self._solve(rows, frames, frame_options)
        poses = self.chain.from_rig(result.coordinates)
        targets = targets_of_frames(self.targets, frames)
        misses = weight_misses(self.problem, result.misses, targets)
        return poses, miss_cost(misses, result.converged)

    def track(self, pose: FloatArray, rows: IntArray) -> tuple[FloatArray, int]:
        """Solve rows in order from a pose; return poses and the count before a miss."""
        frame_options = replace(
            self.options, warm=True, restarts=0, iterations=TRACK_ITERATIONS
        )
        start = self._rig_rows(pose[None])[0]
        poses = np.zeros((len(rows), len(pose)))
        for first in range(0, len(rows), TRACK_BATCH):
            batch = slice(first, min(first + TRACK_BATCH, len(rows)))
            result = self._solve(start, self.frames.start + rows[batch], frame_options)
            poses[batch] = self.chain.from_rig(result.coordinates)
            missed_rows = np.flatnonzero(~result.converged)
            if len(missed_rows):
                return poses, first + int(missed_rows[0])
            start = result.coordinates[-1]
        return poses, len(rows)

    def _solve(
        self, starts: FloatArray, frames: IntArray, options: IkOptions
    ) -> IkResult:
        """Return the IK solutions of the given frames from their starts."""
        targets = targets_of_frames(self.targets, frames)
        preferred_rows = self.preferred_poses[frames]
        return solve_in_frame(
            self.problem, starts, targets, options, prefer=preferred_rows
        )

    def _rig_rows(self, poses: FloatArray) -> FloatArray:
        """Return chain poses as rig coordinates ``(B, Q)``; other joints are 0."""
        rows = np.zeros((len(poses), self.problem.coordinates))
        return self.chain.into_rig(poses, rows)


def weight_misses(problem: Problem, misses: FloatArray, targets: Targets) -> FloatArray:
    """Return misses ``(F, E, 4)`` [m], [rad] weighted for a search ``(F, E, 4)`` [1].

    As in the solver, misses are scaled by goal weights, and goals of lower priority
    have small weights. The largest weight of a frame is normalised to 1; lengths are
    fractions of the problem's length.
    """
    goal_weights = np.array([goal.weights for goal in problem.goals])
    goal_weights = goal_weights * PRIORITY_FACTOR ** problem.chain.goal_nodes[:, 3:4]
    if targets.weights is not None:
        goal_weights = goal_weights * np.asarray(targets.weights, np.float64)
    largest_weight = goal_weights.max(axis=(-2, -1), keepdims=True)
    goal_weights = np.divide(
        goal_weights,
        largest_weight,
        out=np.zeros_like(goal_weights),
        where=largest_weight > 0,
    )
    relative_misses = misses / by_unit(problem.length, 1.0)
    # Misses of weight 0 may be infinite.
    return np.asarray(
        np.where(goal_weights > 0, relative_misses, 0.0) * goal_weights, np.float64
    )


def miss_cost(misses: FloatArray, is_reached: BoolArray) -> FloatArray:
    """Return the cost of weighted misses ``(F,)``; 0 where goals are reached."""
    costs = MISS_COST * (1.0 + (misses**2).sum(axis=(1, 2)))
    return np.where(is_reached, 0.0, costs)


def equalize_near_misses(costs: FloatArray, slack: float) -> FloatArray:
    """Equalize the costs of paths ``(K, L)`` whose misses are near the smallest.

    In each frame, a path whose miss exceeds the smallest by at most ``slack``
    [fraction of the length] costs as little as that one.
    """
    smallest_costs = costs.min(axis=0)
    slack_cost = MISS_COST * (1.0 + (miss_of_cost(smallest_costs) + slack) ** 2)
    cost_limits = np.where(smallest_costs > 0, slack_cost, 0.0)
    return np.where(costs <= cost_limits, smallest_costs, costs)


def miss_of_cost(costs: FloatArray) -> FloatArray:
    """Return the weighted miss that has a given cost: the inverse of `miss_cost`."""
    return np.sqrt(np.maximum(costs / MISS_COST - 1.0, 0.0))


def find_branches(
    interval: Interval, start_count: int, seed: int
) -> tuple[FloatArray, FloatArray]:
    """Return candidate paths through an interval ``(K, L, C)``, and costs ``(K, L)``.

    They are the current path; other solutions of the broken frame, tracked forward and
    backward in time; and blends from the current path to each of these, projected onto
    the goals. Costs are 0 where goals are reached.
    """
    jump_row = interval.jump_frame - interval.frames.start
    starts = [interval.poses[jump_row], interval.poses[jump_row - 1]]
    starts += list(
        _random_starts(interval, interval.poses[jump_row], start_count, seed)
    )
    frames = np.full(len(starts), interval.jump_frame)
    solutions, solution_costs = interval.solve_frames(np.array(starts), frames)
    distinct_poses = _distinct_poses(interval.chain, solutions[solution_costs == 0])
    if not len(distinct_poses):
        distinct_poses = solutions[np.argsort(solution_costs, kind="stable")[:1]]
    tracks, costs = track_both_directions(interval, distinct_poses, jump_row)
    paths = [interval.poses[None], tracks]
    all_costs = [interval.costs[None], costs]
    for path, solution_costs in _blend_paths(interval, tracks, jump_row):
        paths.append(path[None])
        all_costs.append(solution_costs[None])
    return np.concatenate(paths), np.concatenate(all_costs)


def branch_tracks(
    interval: Interval, rows: IntArray, start_count: int, seed: int
) -> tuple[FloatArray, FloatArray]:
    """Return candidate paths ``(K, L, C)`` tracked from the given rows, and costs.

    They are the current path and, for each of the rows, its pose, that of the row
    before and the nearest other solutions, each tracked to both ends of the interval.
    """
    paths, all_costs = [interval.poses[None]], [interval.costs[None]]
    for row in rows.tolist():
        current_pose = interval.poses[row]
        starts = [current_pose, interval.poses[max(row - 1, 0)]]
        starts += list(_random_starts(interval, current_pose, start_count, seed + row))
        frames = np.full(len(starts), interval.frames[row])
        solutions, solution_costs = interval.solve_frames(np.array(starts), frames)
        is_best = solution_costs <= solution_costs.min() + EQUAL_COST_TOLERANCE
        poses = _distinct_poses(interval.chain, solutions[is_best])
        steps = np.abs(joint_steps(interval.chain, current_pose, poses))
        order = np.argsort(steps.max(axis=1), kind="stable")
        poses = poses[order[:SOLUTIONS_PER_SAMPLE]]
        tracks, costs = track_both_directions(interval, poses, row, TRACK_ITERATIONS)
        paths.append(tracks)
        all_costs.append(costs)
    return np.concatenate(paths), np.concatenate(all_costs)


def search_long_interval(
    interval: Interval, frame_spacing: int, seed: int
) -> tuple[FloatArray, FloatArray]:
    """Return candidate paths ``(K, L, C)`` through a long interval, and costs.

    They are the current path and solutions from seeded starts every ``frame_spacing``
    frames, each tracked in both directions until it ends or a later layer replaces it.
    """
    frame_count = len(interval.poses)
    path_count = 1 + MAX_LAYERS * SOLUTIONS_PER_SAMPLE
    paths = np.zeros((path_count, *interval.poses.shape))
    costs = np.full((path_count, frame_count), 2 * MISS_COST)
    paths[0], costs[0] = interval.poses, interval.costs
    half_span = MAX_LAYERS * frame_spacing // 2
    for i, row in enumerate(range(0, frame_count, frame_spacing)):
        frames = np.full(SOLUTIONS_PER_SAMPLE, interval.frames[row])
        pose = interval.poses[row]
        starts = list(_random_starts(interval, pose, SOLUTIONS_PER_SAMPLE, seed + i))
        solutions, solution_costs = interval.solve_frames(np.array(starts), frames)
        first_path = 1 + i % MAX_LAYERS * SOLUTIONS_PER_SAMPLE
        layer = slice(first_path, first_path + SOLUTIONS_PER_SAMPLE)
        reach_rows = slice(max(row - half_span, 0), row + half_span)
        paths[layer, reach_rows] = solutions[:, None]
        for solution_index in np.flatnonzero(solution_costs == 0):
            for rows in (
                np.arange(row, min(row + half_span, frame_count)),
                np.arange(row, max(row - half_span, -1), -1),
            ):
                poses, reached_count = interval.track(solutions[solution_index], rows)
                paths[first_path + solution_index, rows[:reached_count]] = poses[
                    :reached_count
                ]
                costs[first_path + solution_index, rows[:reached_count]] = 0.0
    return paths, costs


def _random_starts(
    interval: Interval, centre: FloatArray, pose_count: int, seed: int
) -> Iterator[FloatArray]:
    """Yield start poses of an interval, seeded by its jump; see `random_poses`."""
    return random_poses(interval.chain, centre, pose_count, [seed, interval.jump_frame])


def random_poses(
    chain: Chain, centre: FloatArray, pose_count: int, seed: Sequence[int]
) -> Iterator[FloatArray]:
    """Yield random poses: joints within their limits, others around ``centre``."""
    rng = np.random.default_rng(seed)
    for i in range(pose_count):
        step = rng.normal(size=chain.degrees) * RANDOM_SPREADS[i % len(RANDOM_SPREADS)]
        pose = apply_steps(chain, centre, step)
        for (kind, _, column, driver_kind), node_numbers in zip(
            chain.nodes[:, :4], with_periods(chain), strict=True
        ):
            fraction, (low, high) = rng.uniform(-1, 1), node_numbers[14:16]
            if kind != BALL and not driver_kind and np.isfinite([low, high]).all():
                half_range = min((high - low) / 2, np.pi)
                pose[column] = (low + high) / 2 + fraction * half_range
        yield pose


def _distinct_poses(chain: Chain, poses: FloatArray) -> FloatArray:
    """Return the first pose of each branch: poses near an earlier one are left out."""
    distinct_poses: list[FloatArray] = []
    for pose in poses:
        if distinct_poses:
            steps = np.abs(joint_steps(chain, np.array(distinct_poses), pose))
            if not steps.max(axis=1).min() > SAME_BRANCH_DISTANCE:
                continue
        distinct_poses.append(pose)
    return np.array(distinct_poses).reshape(-1, poses.shape[-1])


def track_both_directions(
    interval: Interval,
    poses: FloatArray,
    start_row: int,
    iterations: int = START_ITERATIONS,
) -> tuple[FloatArray, FloatArray]:
    """Track poses ``(K, C)`` from a row to both ends; return paths and costs."""
    frame_count = len(interval.frames)
    tracks = np.zeros((len(poses), frame_count, poses.shape[1]))
    costs = np.zeros((len(poses), frame_count))
    chain, references = interval.chain, interval.reference_poses
    for direction, end_row in ((1, frame_count), (-1, -1)):
        current_poses = poses
        for row in range(start_row, end_row, direction):
            if row != start_row:
                change = joint_steps(chain, references[row - direction], current_poses)
                current_poses = apply_steps(chain, references[row], change)
            frames = np.full(len(current_poses), interval.frames[row])
            current_poses, costs[:, row] = interval.solve_frames(
                current_poses, frames, iterations
            )
            tracks[:, row] = current_poses
    return tracks, costs


def _blend_paths(
    interval: Interval, tracks: FloatArray, end_row: int
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield paths that blend from the current path to a track before ``end_row``."""
    progress = np.clip(np.arange(len(interval.frames)) / max(end_row, 1), 0.0, 1.0)
    weights = (progress**3 * (10 + progress * (6 * progress - 15)))[:, None]
    for track in tracks:
        steps = joint_steps(interval.chain, interval.poses, track)
        blended_poses = apply_steps(interval.chain, interval.poses, weights * steps)
        yield interval.solve_frames(blended_poses, np.array(interval.frames))


def best_path(
    interval: Interval,
    paths: FloatArray,
    costs: FloatArray,
    *,
    is_end_fixed: bool,
    is_start_free: bool = False,
) -> FloatArray:
    """Return the least-cost route ``(L, C)`` across candidate paths, by Viterbi search.

    It minimises the sum of squared steps and miss costs (A. Viterbi, Error bounds for
    convolutional codes, 1967); steps above ``unpenalized_step`` are penalised. The
    route begins on the first path unless ``is_start_free``, and ends there if
    ``is_end_fixed``.

    ``paths`` ``(K, L, C)``, ``costs`` ``(K, L)``.
    """
    chain = interval.chain
    reference_steps = joint_steps(
        chain, interval.reference_poses[:-1], interval.reference_poses[1:]
    )
    path_indices = _kernels.cheapest_ik_path(
        chain.nodes,
        with_geared_limits(chain),
        paths,
        costs,
        reference_steps,
        interval.unpenalized_step,
        is_start_free,
        is_end_fixed,
    )
    return unwrap_angles(chain, paths[path_indices, np.arange(costs.shape[1])])

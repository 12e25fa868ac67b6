"""Searches unreachable frames individually for the pose nearest to their goals."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import product

import numpy as np

from animtool.core.array_types import ArrayLike, FloatArray, IntArray
from animtool.ik.branches import miss_cost, random_poses, weight_misses
from animtool.ik.chain import BALL, Chain, with_periods
from animtool.ik.goals import Targets, targets_of_frames
from animtool.ik.options import IkMethod, IkOptions
from animtool.ik.problem import Problem
from animtool.ik.result import PER_PROBLEM_ARRAYS, IkResult, IkStatus
from animtool.ik.solving import solve_in_frame

# Number of starts from combinations of limits, and as many random poses; a ninth of
# them for chains with more degrees of freedom than the second number.
MAX_STARTS, MANY_DOFS = 27, 12
# Iterations from each start, and from the best ones; a start whose cost is then this
# many times that of the current pose is dropped.
TRIAL_ITERATIONS, FULL_ITERATIONS, HOPELESS_RATIO = 8, 100, 1.3
# Number of the most promising starts that are solved to convergence.
MAX_REFINED_STARTS = 4


def frames_out_of_reach(result: IkResult, options: IkOptions) -> IntArray:
    """Return the frames of status NEAREST, if options allow a further search."""
    if options.seconds > 0 or options.restarts == 0:
        return np.zeros(0, np.int64)
    return np.flatnonzero([status is IkStatus.NEAREST for status in result.statuses])


def find_nearest_poses(
    problem: Problem,
    result: IkResult,
    targets: Targets,
    options: IkOptions,
    prefer: ArrayLike,
) -> IkResult:
    """Return the nearest pose found for each of B problems with unreachable goals.

    Descent from random starts ends in wide minima, but the pose nearest to unreachable
    targets is usually at limits; therefore combinations of limits are starts, too.

    ``result`` and ``targets`` are of the B problems, ``prefer`` ``(B, Q)``.
    """
    frame_options = replace(options, method=IkMethod.DAMPED, restarts=0)
    frame_options = replace(frame_options, ordered=False, warm=False, near=False)
    preferred_poses = np.asarray(prefer, np.float64)
    trial_options, descent_options = (
        replace(frame_options, iterations=n)
        for n in (TRIAL_ITERATIONS, FULL_ITERATIONS)
    )
    trial_poses: list[FloatArray] = []
    costs: list[FloatArray] = []
    for start in _start_poses(problem, result.coordinates[0], options.seed):
        starts = np.repeat(start[None], len(result.coordinates), axis=0)
        rows = problem.chain.into_rig(starts, result.coordinates)
        trial_result = solve_in_frame(
            problem, rows, targets, trial_options, prefer=preferred_poses
        )
        trial_poses.append(trial_result.coordinates)
        costs.append(miss_costs(trial_result, targets))
    best_result, order = result, np.argsort(costs, axis=0, kind="stable")
    for start_indices in order[:MAX_REFINED_STARTS]:
        best_costs = np.array(costs)[start_indices, np.arange(len(start_indices))]
        current_costs = miss_costs(best_result, targets)
        promising_rows = np.flatnonzero(best_costs < HOPELESS_RATIO * current_costs)
        if len(promising_rows):
            best_starts = start_indices[promising_rows]
            starts = np.array(trial_poses)[best_starts, promising_rows]
            promising_targets = targets_of_frames(targets, promising_rows)
            prefer = preferred_poses[promising_rows]
            trial_result = solve_in_frame(
                problem, starts, promising_targets, descent_options, prefer=prefer
            )
            trial_costs = miss_costs(trial_result, promising_targets)
            improved_rows = np.flatnonzero(trial_costs < current_costs[promising_rows])
            best_result = _replace_rows(
                best_result, trial_result, promising_rows[improved_rows], improved_rows
            )
    return best_result


def with_nearest_poses(
    problem: Problem,
    result: IkResult,
    targets: Targets,
    options: IkOptions,
    prefer: FloatArray,
) -> IkResult:
    """Return a result with unreachable frames at their individually nearest pose."""
    rows = frames_out_of_reach(result, options)
    if not len(rows):
        return result
    missed_targets = targets_of_frames(targets, rows)
    nearer = find_nearest_poses(
        problem, result.select(rows), missed_targets, options, prefer[rows]
    )
    return _replace_rows(result, nearer, rows, np.arange(len(rows)))


def miss_costs(result: IkResult, targets: Targets) -> FloatArray:
    """Return the cost of each solution's weighted misses ``(B,)``; see `miss_cost`."""
    misses = weight_misses(result.problem, result.misses, targets)
    return miss_cost(misses, result.converged)


def _start_poses(
    problem: Problem, start: FloatArray, seed: int
) -> Iterator[FloatArray]:
    """Yield start poses ``(C,)``: combinations of limits, and random ones."""
    chain = problem.chain
    max_starts = MAX_STARTS if problem.degrees <= MANY_DOFS else MAX_STARTS // 9
    pose = chain.from_rig(start[None])[0]
    yield from _joint_limit_poses(chain, pose, max_starts)
    yield from random_poses(chain, pose, max_starts, [seed])


def _joint_limit_poses(
    chain: Chain, start: FloatArray, max_pose_count: int
) -> Iterator[FloatArray]:
    """Yield at most ``max_pose_count`` poses that combine the first joints' limits."""
    limits_of_joints = []
    for (kind, _, column, driver_kind), numbers in zip(
        chain.nodes[:, :4], with_periods(chain), strict=True
    ):
        low, high = numbers[14:16]
        if kind != BALL and not driver_kind and np.isfinite([low, high]).all():
            limits_of_joints.append((int(column), (low, (low + high) / 2, high)))
    combined_ranges = limits_of_joints[: int(np.log(max_pose_count) / np.log(3))]
    for values in product(*(values for _, values in combined_ranges)):
        pose = start.copy()
        pose[[column for column, _ in combined_ranges]] = values
        yield pose


def _replace_rows(
    result: IkResult, replacement: IkResult, rows: IntArray, from_rows: IntArray
) -> IkResult:
    """Return a result whose given rows are replaced by rows of another result."""
    if not len(rows):
        return result
    statuses = list(result.statuses)
    for row, source in zip(rows.tolist(), from_rows.tolist(), strict=True):
        statuses[row] = replacement.statuses[source]
    array_by_field = {}
    for name in PER_PROBLEM_ARRAYS:
        values = getattr(result, name).copy()
        values[rows] = getattr(replacement, name)[from_rows]
        array_by_field[name] = values
    return replace(result, statuses=tuple(statuses), **array_by_field)

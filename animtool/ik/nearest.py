"""Searches unreachable frames individually for the pose nearest to their goals."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, replace
from itertools import product

import numpy as np

from animtool.core.array_types import ArrayLike, FloatArray, IntArray
from animtool.ik.branches import price, random_poses, weighed
from animtool.ik.chain import BALL, Chain, with_periods
from animtool.ik.goals import Targets, rows_of
from animtool.ik.options import IkMethod, IkOptions
from animtool.ik.problem import Problem
from animtool.ik.result import IkResult, IkStatus
from animtool.ik.solving import solve

# Starts: this many combinations of limits, and as many random poses; a ninth of them
# for chains with more degrees of freedom.
MAX_STARTS, MANY_DEGREES = 27, 12
# Iterations from each, and from the best; a start that then costs this many times the
# current pose is dropped.
TRIAL, DESCENT, HOPELESS = 8, 100, 1.3
# Number of the most promising starts that are solved to the end.
FOLLOWED = 4


def frames_out_of_reach(result: IkResult, options: IkOptions) -> IntArray:
    """Return the frames that miss goals and may have nearer poses."""
    if options.seconds > 0 or options.restarts == 0:
        return np.zeros(0, np.int64)
    return np.flatnonzero([status is IkStatus.NEAREST for status in result.statuses])


def nearest(
    problem: Problem,
    result: IkResult,
    targets: Targets,
    options: IkOptions,
    prefer: ArrayLike,
) -> IkResult:
    """Return B unreachable problems, each at the nearest pose found.

    Descent from random starts ends in wide minima, but unreachable targets are usually
    nearest at limits: combinations of limits are starts too.

    ``result`` and ``targets`` are of the B problems, ``prefer`` ``(B, Q)``.
    """
    chosen = replace(
        options,
        ordered=False,
        warm=False,
        restarts=0,
        near=False,
        method=IkMethod.DAMPED,
    )
    wished = np.asarray(prefer, np.float64)
    trial, descent = (replace(chosen, iterations=n) for n in (TRIAL, DESCENT))
    ends: list[FloatArray] = []
    costs: list[FloatArray] = []
    for start in _starts(problem, result.coordinates[0], options.seed):
        starts = np.repeat(start[None], len(result.coordinates), axis=0)
        rows = problem.chain.into_rig(starts, result.coordinates)
        end = solve(problem, rows, targets, trial, prefer=wished)
        ends.append(end.coordinates)
        costs.append(cost_of(end, targets))
    best, order = result, np.argsort(costs, axis=0, kind="stable")
    for choice in order[:FOLLOWED]:
        reached = np.array(costs)[choice, np.arange(len(choice))]
        hopeful = np.flatnonzero(reached < HOPELESS * cost_of(best, targets))
        if len(hopeful):
            starts = np.array(ends)[choice[hopeful], hopeful]
            some = rows_of(targets, hopeful)
            end = solve(problem, starts, some, descent, prefer=wished[hopeful])
            better = cost_of(end, some) < cost_of(best, targets)[hopeful]
            best = _placed(best, end, hopeful[better], np.flatnonzero(better))
    return best


def settled(
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
    some = _picked(result, rows)
    better = nearest(problem, some, rows_of(targets, rows), options, prefer[rows])
    return _placed(result, better, rows, np.arange(len(rows)))


def cost_of(result: IkResult, targets: Targets) -> FloatArray:
    """Return the miss costs of a result ``(B,)``, see `price`."""
    misses = weighed(result.problem, result.misses, targets)
    return price(misses, result.converged)


def _starts(problem: Problem, home: FloatArray, seed: int) -> Iterator[FloatArray]:
    """Yield start poses ``(C,)``: combinations of limits, and random ones."""
    chain = problem.chain
    most = MAX_STARTS if problem.degrees <= MANY_DEGREES else MAX_STARTS // 9
    pose = chain.from_rig(home[None])[0]
    yield from _corners(chain, pose, most)
    yield from random_poses(chain, pose, most, [seed])


def _corners(chain: Chain, home: FloatArray, most: int) -> Iterator[FloatArray]:
    """Yield combinations of the first joint limits, at most ``most``."""
    ranges = []
    for (kind, _, column, follows), numbers in zip(
        chain.nodes[:, :4], with_periods(chain), strict=True
    ):
        low, high = numbers[14:16]
        if kind != BALL and not follows and np.isfinite([low, high]).all():
            ranges.append((int(column), (low, (low + high) / 2, high)))
    chosen = ranges[: int(np.log(most) / np.log(3))]
    for values in product(*(values for _, values in chosen)):
        pose = home.copy()
        pose[[column for column, _ in chosen]] = values
        yield pose


def _placed(
    result: IkResult, other: IkResult, rows: IntArray, from_rows: IntArray
) -> IkResult:
    """Return a result with some rows replaced by those of another."""
    if not len(rows):
        return result
    statuses = list(result.statuses)
    for row, source in zip(rows.tolist(), from_rows.tolist(), strict=True):
        statuses[row] = other.statuses[source]
    arrays = {}
    for name in _arrays():
        values = getattr(result, name).copy()
        values[rows] = getattr(other, name)[from_rows]
        arrays[name] = values
    return replace(result, statuses=tuple(statuses), **arrays)


def _picked(result: IkResult, rows: IntArray) -> IkResult:
    """Return some of the problems of a result."""
    arrays = {name: getattr(result, name)[rows] for name in _arrays()}
    statuses = tuple(result.statuses[row] for row in rows.tolist())
    return replace(result, statuses=statuses, **arrays)


def _arrays() -> list[str]:
    """Return the names of a result's per-problem arrays."""
    others = {"problem", "jumps", "statuses"}
    return [field.name for field in fields(IkResult) if field.name not in others]

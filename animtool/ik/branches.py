"""Alternative solution branches over an interval of a clip, and the best path."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from animtool import _kernels
from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.ik.chain import BALL, Chain, difference, moved, unwound, with_periods
from animtool.ik.goals import Targets, by_unit, rows_of
from animtool.ik.options import IkOptions
from animtool.ik.problem import Problem
from animtool.ik.result import IkResult
from animtool.ik.solving import solve

# Cost of a frame that misses its goals, in squared radians: more than any jump.
MISSED = 1e4
# Weight of goals of the next priority number [1].
PRIORITY_FACTOR = 1e-2
# Poses that cost no more than this much more miss their goals by as much, see `price`.
NO_WORSE = 1e-3
# Poses nearer than this belong to one branch [rad], [fraction of the length].
SAME = 1e-3
# Iterations from any start, and from the neighbouring frame; a branch that needs
# more ends there.
DESCENT, STEPS = 100, 30
# Solutions searched at each sample of a clip, and branches kept in parallel.
STRANDS, LAYERS = 12, 8
# A branch is followed this many frames at a time, as it may end at any of them.
AT_A_TIME = 48
# Standard deviations of random rotations of joints without limits [rad], in turn.
SPREAD = (0.5, 1.5, 3.0)


@dataclass(frozen=True)
class Interval:
    """Consecutive frames for which another branch of solutions is searched."""

    problem: Problem  # goals and joints
    targets: Targets  # of all F frames of the clip
    frames: range  # of the interval; paths diverge at the first
    broken: int  # the frame to reach without a jump
    poses: FloatArray  # the current path, chain coordinates ``(L, C)``
    costs: FloatArray  # of its misses, see `price` ``(L,)``
    # Source motion that the path changes ``(L, C)``; one pose repeated without one.
    reference: FloatArray
    # Largest joint step that is not penalised, for each frame pair ``(L - 1,)``.
    easy: FloatArray
    # Preferred poses of all frames, weighted by ``rest_weight`` ``(F, Q)``.
    wished: FloatArray
    options: IkOptions  # solver options of a frame

    @property
    def chain(self) -> Chain:
        """The kinematic chain of the problem."""
        return self.problem.chain

    def solved(
        self, starts: FloatArray, frames: IntArray, steps: int = DESCENT
    ) -> tuple[FloatArray, FloatArray]:
        """Return poses ``(B, C)`` solved from starts at frames of a clip, and costs."""
        rows = self.problem.chain.into_rig(starts, self._empty_rows(len(starts)))
        chosen = replace(self.options, warm=False, restarts=0, iterations=steps)
        result = self._solve(rows, frames, chosen)
        poses = self.chain.from_rig(result.coordinates)
        misses = weighed(self.problem, result.misses, rows_of(self.targets, frames))
        return poses, price(misses, result.converged)

    def tracked(self, pose: FloatArray, rows: IntArray) -> tuple[FloatArray, int]:
        """Return poses tracked from one pose through rows, and how many reach goals."""
        chosen = replace(self.options, warm=True, restarts=0, iterations=STEPS)
        start = self.problem.chain.into_rig(pose[None], self._empty_rows(1))[0]
        poses = np.zeros((len(rows), len(pose)))
        for first in range(0, len(rows), AT_A_TIME):
            some = slice(first, min(first + AT_A_TIME, len(rows)))
            result = self._solve(start, self.frames.start + rows[some], chosen)
            poses[some] = self.chain.from_rig(result.coordinates)
            lost = np.flatnonzero(~result.converged)
            if len(lost):
                return poses, first + int(lost[0])
            start = result.coordinates[-1]
        return poses, len(rows)

    def _solve(
        self, starts: FloatArray, frames: IntArray, options: IkOptions
    ) -> IkResult:
        targets = rows_of(self.targets, frames)
        wished = self.wished[frames]
        return solve(self.problem, starts, targets, options, prefer=wished)

    def _empty_rows(self, count: int) -> FloatArray:
        return np.zeros((count, self.problem.coordinates))

    def changed(self, poses: FloatArray, row: int) -> FloatArray:
        """Return the difference of poses from a reference row ``(..., D)``."""
        return difference(self.chain, self.reference[row], poses)


def weighed(problem: Problem, misses: FloatArray, targets: Targets) -> FloatArray:
    """Return misses ``(F, E, 4)`` [m], [rad] weighted for a search ``(F, E, 4)`` [1].

    As in the solver, misses are scaled by goal weights, and goals of lower priority
    count little. The largest weight of a frame is normalised to 1; lengths are
    fractions of the problem's length.
    """
    counts = np.array([goal.weights for goal in problem.goals])
    counts = counts * PRIORITY_FACTOR ** problem.chain.goals[:, 3:4]
    if targets.weights is not None:
        counts = counts * np.asarray(targets.weights, np.float64)
    most = counts.max(axis=(-2, -1), keepdims=True)
    counts = np.divide(counts, most, out=np.zeros_like(counts), where=most > 0)
    relative_misses = misses / by_unit(problem.length, 1.0)
    # Misses of weight 0 may be infinite.
    return np.asarray(np.where(counts > 0, relative_misses, 0.0) * counts, np.float64)


def price(misses: FloatArray, reached: BoolArray) -> FloatArray:
    """Return the cost of weighted misses, 0 where goals are reached ``(F,)``."""
    cost = MISSED * (1.0 + (misses**2).sum(axis=(1, 2)))
    return np.where(reached, 0.0, cost)


def forgiving(costs: FloatArray, slack: float) -> FloatArray:
    """Return costs of paths ``(K, L)``, equal for misses near the smallest.

    In each frame, a path whose miss exceeds the smallest by at most ``slack``
    [fraction of the length] costs as little as that one.
    """
    least = costs.min(axis=0)
    limit = np.where(least > 0, MISSED * (1.0 + (missed_by(least) + slack) ** 2), 0.0)
    return np.where(costs <= limit, least, costs)


def missed_by(costs: FloatArray) -> FloatArray:
    """Return the miss that a cost stands for; the inverse of `price`."""
    return np.sqrt(np.maximum(costs / MISSED - 1.0, 0.0))


def branches(
    interval: Interval, count: int, seed: int
) -> tuple[FloatArray, FloatArray]:
    """Return candidate paths through an interval ``(K, L, C)``, and costs ``(K, L)``.

    They are the current path; other solutions of the broken frame, tracked forward and
    backward in time; and blends from the current path to each of these, projected onto
    the goals. Costs are 0 where goals are reached.
    """
    at = interval.broken - interval.frames.start
    starts = [interval.poses[at], interval.poses[at - 1]]
    starts += list(_scattered(interval, interval.poses[at], count, seed))
    frames = np.full(len(starts), interval.broken)
    solutions, cost = interval.solved(np.array(starts), frames)
    kept = _distinct(interval.chain, solutions[cost == 0])
    if not len(kept):
        kept = solutions[np.argsort(cost, kind="stable")[:1]]
    tracks, costs = follow_in_both_directions(interval, kept, at)
    current = interval.poses[None]
    paths = [current, tracks]
    prices = [interval.costs[None], costs]
    for path, cost in _passing(interval, tracks, at):
        paths.append(path[None])
        prices.append(cost[None])
    return np.concatenate(paths), np.concatenate(prices)


def branch_tracks(
    interval: Interval, rows: IntArray, count: int, seed: int
) -> tuple[FloatArray, FloatArray]:
    """Return candidate paths from solutions at some rows ``(K, L, C)``; see `branches`.

    They are the current path and, for each of the rows, its pose, that of the row
    before and the nearest other solutions, each tracked to both ends of the interval.
    """
    paths, prices = [interval.poses[None]], [interval.costs[None]]
    for row in rows.tolist():
        home = interval.poses[row]
        starts = [home, interval.poses[max(row - 1, 0)]]
        starts += list(_scattered(interval, home, count, seed + row))
        frames = np.full(len(starts), interval.frames[row])
        solutions, cost = interval.solved(np.array(starts), frames)
        kept = _distinct(interval.chain, solutions[cost <= cost.min() + NO_WORSE])
        away = np.abs(difference(interval.chain, home, kept)).max(axis=1)
        kept = kept[np.argsort(away, kind="stable")[:STRANDS]]
        tracks, costs = follow_in_both_directions(interval, kept, row, STEPS)
        paths.append(tracks)
        prices.append(costs)
    return np.concatenate(paths), np.concatenate(prices)


def search_branches(
    interval: Interval, spacing: int, seed: int
) -> tuple[FloatArray, FloatArray]:
    """Return candidate paths through a long interval ``(K, L, C)``; see `branches`.

    They are the current path and solutions from seeded starts every ``spacing`` frames,
    each tracked in both directions until it ends or a later layer replaces it.
    """
    length, width = interval.poses.shape
    paths = np.zeros((1 + LAYERS * STRANDS, length, width))
    costs = np.full((len(paths), length), 2 * MISSED)
    paths[0] = interval.poses
    costs[0] = interval.costs
    far = LAYERS * spacing // 2
    for i, at in enumerate(range(0, length, spacing)):
        frames = np.full(STRANDS, interval.frames[at])
        starts = _scattered(interval, interval.poses[at], STRANDS, seed + i)
        solutions, cost = interval.solved(np.array(list(starts)), frames)
        layer = 1 + i % LAYERS * STRANDS
        paths[layer : layer + STRANDS, max(at - far, 0) : at + far] = solutions[:, None]
        for k in np.flatnonzero(cost == 0):
            for direction in (
                slice(at, min(at + far, length)),
                slice(at, at - far, -1),
            ):
                rows = np.arange(length)[_clipped(direction)]
                poses, ok = interval.tracked(solutions[k], rows)
                paths[layer + k, rows[:ok]] = poses[:ok]
                costs[layer + k, rows[:ok]] = 0.0
    return paths, costs


def _clipped(rows: slice) -> slice:
    """Return a slice with a negative stop replaced, so that it reaches index 0."""
    return slice(rows.start, None, rows.step) if rows.stop < 0 else rows


def _scattered(
    interval: Interval, home: FloatArray, count: int, seed: int
) -> Iterator[FloatArray]:
    """Return random poses within the limits, or around a pose without limits."""
    return random_poses(interval.chain, home, count, [seed, interval.broken])


def random_poses(
    chain: Chain, home: FloatArray, count: int, seed: Sequence[int]
) -> Iterator[FloatArray]:
    """Yield random poses within the limits, or around a pose without limits."""
    rng = np.random.default_rng(seed)
    for i in range(count):
        step = rng.normal(size=chain.degrees) * SPREAD[i % len(SPREAD)]
        pose = moved(chain, home, step)
        for (kind, _, column, follows), numbers in zip(
            chain.nodes[:, :4], with_periods(chain), strict=True
        ):
            at, (low, high) = rng.uniform(-1, 1), numbers[14:16]
            if kind != BALL and not follows and np.isfinite([low, high]).all():
                pose[column] = (low + high) / 2 + at * min((high - low) / 2, np.pi)
        yield pose


def _distinct(chain: Chain, poses: FloatArray) -> FloatArray:
    kept: list[FloatArray] = []
    for pose in poses:
        if not kept or (
            np.abs(difference(chain, np.array(kept), pose)).max(axis=1).min() > SAME
        ):
            kept.append(pose)
    return np.array(kept).reshape(-1, poses.shape[-1])


def follow_in_both_directions(
    interval: Interval, poses: FloatArray, at: int, steps: int = DESCENT
) -> tuple[FloatArray, FloatArray]:
    """Return poses ``(K, C)`` of a row tracked to both ends of the interval."""
    length = len(interval.frames)
    tracks = np.zeros((len(poses), length, poses.shape[1]))
    costs = np.zeros((len(poses), length))
    for direction, stop in ((1, length), (-1, -1)):
        now = poses
        for row in range(at, stop, direction):
            if row != at:
                change = interval.changed(now, row - direction)
                now = moved(interval.chain, interval.reference[row], change)
            frames = np.full(len(now), interval.frames[row])
            now, costs[:, row] = interval.solved(now, frames, steps)
            tracks[:, row] = now
    return tracks, costs


def _passing(
    interval: Interval, tracks: FloatArray, at: int
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield blends from the current path to others over the rows before ``at``."""
    progress = np.clip(np.arange(len(interval.frames)) / max(at, 1), 0.0, 1.0)
    eased = (progress**3 * (10 + progress * (6 * progress - 15)))[:, None]
    for track in tracks:
        step = difference(interval.chain, interval.poses, track)
        between = moved(interval.chain, interval.poses, eased * step)
        yield interval.solved(between, np.array(interval.frames))


def best_path(
    interval: Interval,
    paths: FloatArray,
    costs: FloatArray,
    *,
    closed: bool,
    opened: bool = False,
) -> FloatArray:
    """Return the poses ``(L, C)`` of the cheapest route across candidate paths.

    Minimises the sum of squared steps and miss costs (A. Viterbi, Error bounds for
    convolutional codes, 1967); steps above ``easy`` are penalised. The route begins on
    the first path unless ``opened``, and ends there if ``closed``.

    ``paths`` ``(K, L, C)``, ``costs`` ``(K, L)``.
    """
    chain = interval.chain
    drifts = difference(chain, interval.reference[:-1], interval.reference[1:])
    chosen = _kernels.cheapest_ik_path(
        chain.nodes,
        with_periods(chain),
        paths,
        costs,
        drifts,
        interval.easy,
        opened,
        closed,
    )
    return unwound(chain, paths[chosen, np.arange(costs.shape[1])])

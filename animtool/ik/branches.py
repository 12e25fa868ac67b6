"""Other ways through a interval of a clip, and the best path that they make."""

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

# What a frame that misses its goals costs, in squared radians: more than any jump.
MISSED = 1e4
# Weight of goals of the next priority number [1].
GIVES_WAY = 1e-2
# Poses that cost no more than this much more miss their goals by as much, see `price`.
NO_WORSE = 1e-3
# Poses nearer than this are one branch [rad], [share of the length].
SAME = 1e-3
# Steps of a frame from anywhere, and from the one beside it; a branch that needs more
# ends there.
DESCENT, STEPS = 100, 30
# Solutions looked for at each place along a whole clip, and branches side by side.
STRANDS, LAYERS = 12, 8
# A branch is followed so many frames at a time, as it may end in any.
AT_A_TIME = 48
# Random turns of joints that no limits hold [rad], of one seed after the other.
SPREAD = (0.5, 1.5, 3.0)


@dataclass(frozen=True)
class Interval:
    """Consecutive frames, to be passed through some other way."""

    problem: Problem  # what is asked
    targets: Targets  # of all F frames of the clip
    frames: range  # of the interval, the first of which is where paths part
    broken: int  # the frame that is not to be come to by a jump
    poses: FloatArray  # the path as it is, chain coordinates ``(L, C)``
    costs: FloatArray  # of what it misses, see `price` ``(L,)``
    # The motion that the path is a change of ``(L, C)``; one pose repeated where it is
    # none.
    reference: FloatArray
    # How far a joint may go from frame to frame as if it were near ``(L - 1,)``; what
    # is beyond is avoided.
    easy: FloatArray
    # Poses of all frames that the problem's ``rest_weight`` draws to ``(F, Q)``.
    wished: FloatArray
    options: IkOptions  # how frames are solved

    @property
    def chain(self) -> Chain:
        """The joints as the solver takes them."""
        return self.problem.chain

    def solved(
        self, starts: FloatArray, frames: IntArray, steps: int = DESCENT
    ) -> tuple[FloatArray, FloatArray]:
        """Return poses ``(B, C)`` for starts in frames of the clip, and their cost."""
        rows = self.problem.chain.into_rig(starts, self._whole(len(starts)))
        chosen = replace(self.options, warm=False, restarts=0, iterations=steps)
        result = self._solve(rows, frames, chosen)
        poses = self.chain.from_rig(result.coordinates)
        misses = weighed(self.problem, result.misses, rows_of(self.targets, frames))
        return poses, price(misses, result.converged)

    def tracked(self, pose: FloatArray, rows: IntArray) -> tuple[FloatArray, int]:
        """Return poses that follow one through rows, and how many reach their goals."""
        chosen = replace(self.options, warm=True, restarts=0, iterations=STEPS)
        start = self.problem.chain.into_rig(pose[None], self._whole(1))[0]
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

    def _whole(self, count: int) -> FloatArray:
        return np.zeros((count, self.problem.coordinates))

    def changed(self, poses: FloatArray, row: int) -> FloatArray:
        """Return how poses in a row differ from the reference ``(..., D)``."""
        return difference(self.chain, self.reference[row], poses)


def weighed(problem: Problem, misses: FloatArray, targets: Targets) -> FloatArray:
    """Return what misses ``(F, E, 4)`` [m], [rad] count in a search ``(F, E, 4)`` [1].

    As in the solver, goals count by their weights, and those that give way hardly
    against the others; what counts most in a frame counts as it is, in shares of the
    length.
    """
    counts = np.array([goal.weights for goal in problem.goals])
    counts = counts * GIVES_WAY ** problem.chain.goals[:, 3:4]
    if targets.weights is not None:
        counts = counts * np.asarray(targets.weights, np.float64)
    most = counts.max(axis=(-2, -1), keepdims=True)
    counts = np.divide(counts, most, out=np.zeros_like(counts), where=most > 0)
    found = misses / by_unit(problem.length, 1.0)
    # What counts nothing may be infinite.
    return np.asarray(np.where(counts > 0, found, 0.0) * counts, np.float64)


def price(misses: FloatArray, reached: BoolArray) -> FloatArray:
    """Return the cost of misses as `weighed`, 0 where goals are reached ``(F,)``."""
    cost = MISSED * (1.0 + (misses**2).sum(axis=(1, 2)))
    return np.where(reached, 0.0, cost)


def forgiving(costs: FloatArray, slack: float) -> FloatArray:
    """Return costs of paths ``(K, L)`` that miss goals by as little as the best do.

    In each frame, what misses its goals by no more than ``slack`` [share of the length]
    beyond the least costs as little as that.
    """
    least = costs.min(axis=0)
    limit = np.where(least > 0, MISSED * (1.0 + (missed_by(least) + slack) ** 2), 0.0)
    return np.where(costs <= limit, least, costs)


def missed_by(costs: FloatArray) -> FloatArray:
    """Return how far poses of some cost miss their goals, see `price`."""
    return np.sqrt(np.maximum(costs / MISSED - 1.0, 0.0))


def branches(
    interval: Interval, count: int, seed: int
) -> tuple[FloatArray, FloatArray]:
    """Return paths through a interval ``(K, L, C)`` and the cost of their misses.

    The path as it is; what other solutions of the broken frame and of the last come to,
    followed through time both ways; and paths that pass from the first to each of these
    little by little, brought to the goals. Costs are ``(K, L)``, 0 where goals are
    reached.
    """
    at = interval.broken - interval.frames.start
    starts = [interval.poses[at], interval.poses[at - 1]]
    starts += list(_scattered(interval, interval.poses[at], count, seed))
    frames = np.full(len(starts), interval.broken)
    solutions, cost = interval.solved(np.array(starts), frames)
    kept = _distinct(interval.chain, solutions[cost == 0])
    if not len(kept):
        kept = solutions[np.argsort(cost, kind="stable")[:1]]
    tracks, costs = follow_both_ways(interval, kept, at)
    own = interval.poses[None]
    paths = [own, tracks]
    prices = [interval.costs[None], costs]
    for path, cost in _passing(interval, tracks, at):
        paths.append(path[None])
        prices.append(cost[None])
    return np.concatenate(paths), np.concatenate(prices)


def branch_tracks(
    interval: Interval, rows: IntArray, count: int, seed: int
) -> tuple[FloatArray, FloatArray]:
    """Return paths through a whole interval ``(K, L, C)``, as of `branches`.

    The path as it is, and for each of some rows the poses there and beside it and the
    nearest of other solutions, each followed both ways through time to the ends.
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
        tracks, costs = follow_both_ways(interval, kept, row, STEPS)
        paths.append(tracks)
        prices.append(costs)
    return np.concatenate(paths), np.concatenate(prices)


def search_branches(
    interval: Interval, spacing: int, seed: int
) -> tuple[FloatArray, FloatArray]:
    """Return paths through a long interval ``(K, L, C)``, as of `branches`.

    The path as it is, and solutions from seeded starts, looked for every ``spacing``
    frames and each followed both ways through time until it ends, or others that began
    later take its place.
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
            for way in (slice(at, min(at + far, length)), slice(at, at - far, -1)):
                rows = np.arange(length)[_clipped(way)]
                poses, ok = interval.tracked(solutions[k], rows)
                paths[layer + k, rows[:ok]] = poses[:ok]
                costs[layer + k, rows[:ok]] = 0.0
    return paths, costs


def _clipped(way: slice) -> slice:
    """Return a slice that goes down to the first element and not around it."""
    return slice(way.start, None, way.step) if way.stop < 0 else way


def _scattered(
    interval: Interval, home: FloatArray, count: int, seed: int
) -> Iterator[FloatArray]:
    """Return poses anywhere within the limits, or about one where there are none."""
    return random_poses(interval.chain, home, count, [seed, interval.broken])


def random_poses(
    chain: Chain, home: FloatArray, count: int, seed: Sequence[int]
) -> Iterator[FloatArray]:
    """Yield poses anywhere within the limits, or about one where there are none."""
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


def follow_both_ways(
    interval: Interval, poses: FloatArray, at: int, steps: int = DESCENT
) -> tuple[FloatArray, FloatArray]:
    """Return poses ``(K, C)`` of a row followed to both ends of the interval."""
    length = len(interval.frames)
    tracks = np.zeros((len(poses), length, poses.shape[1]))
    costs = np.zeros((len(poses), length))
    for way, stop in ((1, length), (-1, -1)):
        now = poses
        for row in range(at, stop, way):
            if row != at:
                change = interval.changed(now, row - way)
                now = moved(interval.chain, interval.reference[row], change)
            frames = np.full(len(now), interval.frames[row])
            now, costs[:, row] = interval.solved(now, frames, steps)
            tracks[:, row] = now
    return tracks, costs


def _passing(
    interval: Interval, tracks: FloatArray, at: int
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Return paths from the one as it is to others, over the rows before ``at``."""
    share = np.clip(np.arange(len(interval.frames)) / max(at, 1), 0.0, 1.0)
    eased = (share**3 * (10 + share * (6 * share - 15)))[:, None]
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
    """Return the poses ``(L, C)`` of the cheapest way along paths and over to others.

    The sum of squared distances from frame to frame and of the misses is the least (A.
    Viterbi, Error bounds for convolutional codes, 1967), steps that are not easy being
    dear. It begins on the first of the paths, unless ``opened``, and ends there if
    ``closed``.

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

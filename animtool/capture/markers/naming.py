"""Assignment of names to points that explains all their distances best."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import Any

import numpy as np

from animtool.capture.markers.chains import evidence, likelihoods
from animtool.capture.markers.geometry import MarkerDistances
from animtool.core.array_types import BoolArray, FloatArray, IntArray

# Least total evidence for naming a point [nat].
WORTH = 1.0
# Spread of pairs that are named together [m], and partners of each point.
RIGID, PARTNERS = 0.006, 3
# Trials of reassigning names, and their least gain [nat].
TRIALS, GAIN = 40, 0.05
# Markers named for less than this fraction of the longest visible one, and unnamed
# points visible for longer than that, have the names around them reassigned: number of
# restarts, radius [m], random bias [nat], and probability of restarting from scratch.
LACKING, LONG, RESTARTS, RADIUS, BIAS, EMPTY_START = (
    0.5,
    0.3,
    60,
    (0.3, 1.2),
    (0.5, 6.0),
    0.4,
)
# Radius around a doubtful marker [m].
AROUND = 0.3
# Markers this near at rest are exchanged in triples and double pairs [m].
NEAR = 0.28
# Exchanges are tried if names are within this of the best [nat].
WITHIN = 10.0
MAX_CHANGES = 40


class Naming:
    """Names of points, and the evidence of named points for each name.

    Attributes:
        names_of: Marker of each point ``(R,)``; -1 for none.
    """

    def __init__(
        self, moving: MarkerDistances, overlap: FloatArray, rest: FloatArray
    ) -> None:
        """Start without names.

        moving: Distances of the points. overlap: Frames in which pairs are visible
        ``(R, R)``. rest: Distances of the markers ``(M, M)`` [m].
        """
        count, markers = len(overlap), len(rest)
        self.together: BoolArray = overlap > 0
        # A pair's weight is its visible fraction.
        overlap_fraction = overlap / max(1.0, float(overlap.max()))
        self.length = np.diag(overlap_fraction).copy()
        np.fill_diagonal(overlap_fraction, 0.0)
        self.pair_scores = pair_evidence(moving, overlap_fraction, rest)
        # Points never visible together that share a name should be one marker.
        part = np.minimum(self.length[:, None], self.length) * ~self.together
        linked = (part * likelihoods(moving, overlap)).astype(np.float32)
        for name in range(markers):
            self.pair_scores[:, :, name, name] += linked
        self.pairs = _rigid_pairs(moving, overlap_fraction)
        self.moves = exchanges(rest)
        self.names_of = np.full(count, -1)
        self.scores = np.zeros((count, markers))
        self.taken = np.zeros((count, markers), np.int64)

    def copy(self) -> Naming:
        """Return a copy that can be changed independently."""
        other = object.__new__(Naming)
        other.__dict__.update(self.__dict__)
        for name in ("names_of", "scores", "taken"):
            setattr(other, name, getattr(self, name).copy())
        return other

    def total(self) -> float:
        """Return the log-likelihood of all distances given the names [nat]."""
        named = np.flatnonzero(self.names_of >= 0)
        return 0.5 * float(self.scores[named, self.names_of[named]].sum())

    def assign(self, point: int, marker: int) -> None:
        """Name a point; -1 removes its name."""
        before = int(self.names_of[point])
        for name, sign in ((before, -1), (marker, 1)):
            if name >= 0:
                self.scores += sign * self.pair_scores[point, :, name]
                self.taken[self.together[point], name] += sign
        self.names_of[point] = marker

    def grow(self, bias: FloatArray | float = 0.0) -> None:
        """Name points one by one, or in rigid pairs, the clearest first.

        Points visible together are never the same marker.

        bias: Additional evidence for names ``(R, M)`` [nat].
        """
        rows = np.arange(len(self.names_of))
        while True:
            score = np.where(self.taken > 0, -np.inf, self.scores + bias)
            score[self.names_of >= 0] = -np.inf
            pair = self._pair(score)
            marker = score.argmax(axis=1)
            best = score[rows, marker]
            score[rows, marker] = -np.inf
            rival = np.maximum(score.max(axis=1), 0.0)
            clear = np.full(len(rows), -1.0)
            worth = np.isfinite(best) & (best > WORTH * self.length)
            clear[worth] = (best - rival)[worth]
            point = int(clear.argmax())
            if pair and pair[0] > max(0.0, clear[point]):
                self.assign(*pair[1])
                self.assign(*pair[2])
            elif clear[point] > 0.0:
                self.assign(point, int(marker[point]))
            else:
                return

    def _pair(self, score: FloatArray) -> Any:
        """Return the clearest rigid pair: its evidence [nat], and points with names."""
        first, second = self.pairs
        free = (self.names_of[first] < 0) & (self.names_of[second] < 0)
        first, second = first[free], second[free]
        if not len(first):
            return None
        both = score[first][:, :, None] + score[second][:, None, :]
        both = (both + self.pair_scores[first, second]).reshape(len(first), -1)
        rows = np.arange(len(first))
        top = both.argmax(axis=1)
        best = both[rows, top].copy()
        both[rows, top] = -np.inf
        rival = np.maximum(both.max(axis=1), 0.0)
        clear = np.full(len(first), -1.0)
        worth = np.isfinite(best)
        worth[worth] = (best > WORTH * (self.length[first] + self.length[second]))[
            worth
        ]
        clear[worth] = 0.5 * (best - rival)[worth]
        row = int(clear.argmax())
        i, j = divmod(int(top[row]), score.shape[1])
        return float(clear[row]), (int(first[row]), i), (int(second[row]), j)

    def improve(self, most: float = -np.inf) -> None:
        """Rename points, and exchange markers, while that fits distances better.

        most: Exchanges are not tried far below this total [nat].
        """
        for _ in range(MAX_CHANGES):
            changed = self._move()
            if self.total() < most - WITHIN:
                return
            names = self._exchanges()
            if names is None:
                if not changed:
                    return
                continue
            for point in np.flatnonzero(self.names_of >= 0).tolist():
                new = int(names[self.names_of[point]])
                if new != self.names_of[point]:
                    self.assign(point, new)

    def _move(self) -> bool:
        """Give points a better free name; return whether any changed."""
        changed = False
        for point in range(len(self.names_of)):
            now = int(self.names_of[point])
            taken = self.taken[point].copy()
            here = 0.0
            if now >= 0:
                taken[now] -= 1
                here = float(self.scores[point, now])
            score = np.where(taken > 0, -np.inf, self.scores[point])
            other = int(score.argmax())
            least = here + GAIN if now >= 0 else WORTH * self.length[point]
            if other != now and score[other] > least:
                self.assign(point, other)
                changed = True
            elif now >= 0 and here < 0.0:
                self.assign(point, -1)
                changed = True
        return changed

    def _exchanges(self) -> IntArray | None:
        """Return a better permutation of the names ``(M,)``; None if there is none.

        All pairs of markers are tried, and triples and double pairs of near ones.
        """
        named = np.flatnonzero(self.names_of >= 0)
        have, first = np.unique(self.names_of[named], return_index=True)
        count = self.scores.shape[1]
        rows = self.pair_scores[named[first]]
        more = np.setdiff1d(np.arange(len(named)), first)
        for point in named[more].tolist():
            rows[np.searchsorted(have, self.names_of[point])] += self.pair_scores[point]
        pair_scores: FloatArray = np.zeros((count,) * 4, self.pair_scores.dtype)
        pair_scores[np.ix_(have, have)] = rows[:, named[first]]
        for point in named[more].tolist():
            pair_scores[have, self.names_of[point]] += rows[:, point]
        pair_scores[np.arange(count), np.arange(count)] = 0.0
        names = np.arange(count)
        for _ in range(MAX_CHANGES):
            # Evidence of each marker for each name, given the names of all others.
            alone = np.zeros((count, count))
            for other in have.tolist():
                alone += pair_scores[:, other, :, names[other]]
            best, gain = None, GAIN
            for old, new in self.moves:
                value = gain_of(pair_scores, alone, names, old, new)
                top = int(value.argmax()) if len(value) else 0
                if len(value) and value[top] > gain:
                    best, gain = (old[top], new[top]), float(value[top])
            if best is None:
                break
            names[best[0]] = names[best[1]]
        return names if (names != np.arange(count)).any() else None

    def doubt(self, tried: set[tuple[int, int]]) -> tuple[int, int] | None:
        """Return the point, and another marker, with the most evidence for renaming."""
        rows = np.arange(len(self.names_of))
        named = self.names_of >= 0
        now = np.where(named, self.scores[rows, self.names_of], 0.0)
        regret = self.scores - now[:, None]
        regret[rows[named], self.names_of[named]] = -np.inf
        for point, marker in tried:
            regret[point, marker] = -np.inf
        point, marker = divmod(int(regret.argmax()), regret.shape[1])
        return (point, marker) if regret[point, marker] > 0.0 else None

    def eject(self, point: int, marker: int, around: BoolArray) -> None:
        """Name a point, remove conflicting names, and assign those again.

        around: Markers whose names are assigned again too ``(M,)``.
        """
        barred = self.together[point] & (self.names_of == marker)
        barred |= (self.names_of >= 0) & around[self.names_of]
        for other in np.flatnonzero(barred).tolist():
            self.assign(other, -1)
        self.assign(point, marker)
        self.grow()

    def lacking(self) -> IntArray:
        """Return the markers with no or few points.

        All of them, if an unnamed point is visible for long.
        """
        lengths = np.zeros(self.scores.shape[1])
        named = self.names_of >= 0
        np.add.at(lengths, self.names_of[named], self.length[named])
        lacking = np.flatnonzero(lengths < LACKING)
        if not len(lacking) and (self.length[~named] > LONG).any():
            return np.arange(len(lengths))
        return lacking

    def restart(
        self, around: BoolArray, seed: dict[int, int], bias: FloatArray
    ) -> None:
        """Remove names of some markers ``(M,)``, and assign them again from a seed."""
        for point in np.flatnonzero(
            (self.names_of >= 0) & around[self.names_of]
        ).tolist():
            self.assign(point, -1)
        for point, marker in seed.items():
            self.assign(point, marker)
        self.grow(bias)


def searched(best: Naming, rest: FloatArray, seeds: Sequence[dict[int, int]]) -> Naming:
    """Return better names, found by removing some and assigning them again.

    A conflicting name is removed first; if that is not enough, all names around the two
    markers.
    """
    best = _redoubted(best, rest)
    most = best.total()
    # A marker without a point is often confused with another one.
    rng = np.random.default_rng(0)
    for _ in range(RESTARTS):
        lacking = best.lacking()
        if not len(lacking):
            break
        centre = int(rng.choice(lacking))
        around = rest[centre] < rng.uniform(*RADIUS)
        if len(lacking) < len(rest) and rng.random() < 0.5:
            around |= (rest[lacking] < AROUND).any(axis=0)
        offsets = rng.uniform(*BIAS) * best.length[:, None]
        bias = rng.normal(0.0, 1.0, best.scores.shape) * offsets
        other = best.copy()
        # Sometimes restart from scratch with another group.
        seed = (
            seeds[int(rng.integers(len(seeds)))] if rng.random() < EMPTY_START else {}
        )
        other.restart(around | bool(seed), seed, bias)
        other.improve(-np.inf if seed else most)
        total = other.total()
        if total > most + GAIN:
            best = _redoubted(other, rest)
            most = best.total()
    return best


def _redoubted(best: Naming, rest: FloatArray) -> Naming:
    """Return names after trying the most doubtful ones again."""
    best.improve()
    most = best.total()
    tried: set[tuple[int, int]] = set()
    for _ in range(TRIALS):
        move = best.doubt(tried)
        if move is None:
            break
        tried.add(move)
        point, marker = move
        about = rest[marker] < AROUND
        if best.names_of[point] >= 0:
            about = about | (rest[best.names_of[point]] < AROUND)
        for around in (np.zeros(len(rest), bool), about):
            other = best.copy()
            other.eject(point, marker, around)
            other.improve(most)
            total = other.total()
            if total > most + GAIN:
                best, most = other, total
                break
    return best


def pair_evidence(
    moving: MarkerDistances, overlap: FloatArray, rest: FloatArray
) -> FloatArray:
    """Return the evidence of point pairs for name pairs ``(R, R, M, M)`` [nat]."""
    count, markers = len(overlap), len(rest)
    # Single precision: the table is large, and evidence needs no more.
    pair_scores: Any = np.zeros((count, count, markers, markers), np.float32)
    for point in range(count - 1):
        others = slice(point + 1, count)
        table = evidence(
            moving.mean[point, others],
            moving.spread[point, others],
            rest.reshape(1, -1),
        ).reshape(-1, markers, markers)
        table *= overlap[point, others, None, None]
        pair_scores[point, others] = table
        pair_scores[others, point] = table.transpose(0, 2, 1)
    return np.asarray(pair_scores)


def _rigid_pairs(
    moving: MarkerDistances, overlap: FloatArray
) -> tuple[IntArray, IntArray]:
    """Return pairs of points that stay rigid, among the most rigid of each."""
    known = (overlap > 0) & np.isfinite(moving.spread)
    spread = np.where(known, moving.spread, np.inf)
    company = np.argsort(spread, axis=1, kind="stable")[:, :PARTNERS]
    pairs = {
        (min(point, other), max(point, other))
        for point, others in enumerate(company.tolist())
        for other in others
        if spread[point, other] < RIGID
    }
    listed = np.array(sorted(pairs), np.int64).reshape(-1, 2)
    return listed[:, 0], listed[:, 1]


def gain_of(
    pair_scores: FloatArray,
    alone: FloatArray,
    names: IntArray,
    old: IntArray,
    new: IntArray,
) -> FloatArray:
    """Return the gain of exchanging markers' names ``(N,)`` [nat]."""
    was, will = names[old], names[new]
    value = (alone[old, will] - alone[old, was]).sum(axis=1)
    for a, b in combinations(range(old.shape[1]), 2):
        one, two = old[:, a], old[:, b]
        value += pair_scores[one, two, will[:, a], will[:, b]]
        value += pair_scores[one, two, was[:, a], was[:, b]]
        value -= pair_scores[one, two, will[:, a], was[:, b]]
        value -= pair_scores[one, two, was[:, a], will[:, b]]
    return np.asarray(value)


def exchanges(rest: FloatArray) -> list[tuple[IntArray, IntArray]]:
    """Return exchanges: markers ``(N, K)``, and the marker whose name each takes."""
    near = rest < NEAR
    first, second = np.triu_indices(len(rest), 1)
    two = np.stack([first, second], axis=1)
    close = two[near[first, second]]
    one, other = np.triu_indices(len(close), 1)
    four = np.concatenate([close[one], close[other]], axis=1)
    disjoint = (close[one][:, :, None] != close[other][:, None, :]).all(axis=(1, 2))
    four = four[disjoint]
    row, third = np.nonzero(near[close].any(axis=1))
    three = np.concatenate([close[row], third[:, None]], axis=1)
    three = three[(three[:, 2] != three[:, 0]) & (three[:, 2] != three[:, 1])]
    return [
        (two, two[:, ::-1]),
        (three, three[:, [1, 2, 0]]),
        (three, three[:, [2, 0, 1]]),
        (four, four[:, [1, 0, 3, 2]]),
    ]

"""Which runs of a cloud are which markers, to begin with: groups that stay rigid."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from animtool._types import BoolArray, FloatArray, IntArray
from animtool.mocap.markers.evidence import evidence, renamed
from animtool.mocap.markers.geometry import Distances, distances, fitted

# A distance that varies less is one within a segment [m].
RIGID = 0.006
# How far the shape of a group of four may be off, for it to be named first [m].
SEED = 0.003
# How far the distances of such a group may be off, and what is tried where none is so
# near [m]; and how many runs a run is grouped with.
NEAREST, FARTHEST, COMPANY = 0.002, 0.006, 7
MAX_GROUPS = 400
# Groups that naming is begun with, of which the one that explains most is taken.
STARTS = 6
# What a run is named for at least, in all its distances together [nat].
WORTH = 1.0
PASSES = 3


def identify(
    points: FloatArray, shape: FloatArray, rest: FloatArray
) -> IntArray | None:
    """Return which marker each run of a window is ``(R,)``; None where nothing fits."""
    moving = distances(points)
    seen = np.isfinite(points[..., 0]).astype(np.float64)
    overlap = seen.T @ seen
    groups = _fours(moving)
    seeds = _seeds(points, groups, moving, shape, rest, NEAREST)
    if not seeds:
        seeds = _seeds(points, groups, moving, shape, rest, FARTHEST)
    best, most = None, -np.inf
    for seed in _distinct(seeds):
        found = _Naming(moving, overlap, rest)
        found.grow(seed)
        total = found.total()
        if total > most:
            best, most = found, total
    if best is None:
        return None
    for _ in range(PASSES):
        if not best.improve(points):
            break
    return best.given


def _distinct(seeds: list[dict[int, int]]) -> list[dict[int, int]]:
    """Return the first seeds of which none is part of what another says."""
    kept: list[dict[int, int]] = []
    for seed in seeds:
        items = set(seed.items())
        if all(len(items & set(other.items())) < 3 for other in kept):
            kept.append(seed)
        if len(kept) == STARTS:
            break
    return kept


def _seeds(
    points: FloatArray,
    groups: list[tuple[int, ...]],
    moving: Distances,
    shape: FloatArray,
    rest: FloatArray,
    tolerance: float,
) -> list[dict[int, int]]:
    """Return groups of rigid runs with the markers that they may be, best first."""
    found = []
    for group in groups:
        for markers in _matches(group, moving.mean, rest, tolerance):
            off = _misfit(points[:, group], shape[list(markers)])
            if off < SEED:
                found.append((off, dict(zip(group, markers, strict=True))))
    found.sort(key=lambda entry: entry[0])
    return [pairs for _, pairs in found]


def _fours(moving: Distances) -> list[tuple[int, ...]]:
    """Return groups of four runs of which any two are rigid, the most rigid first."""
    spread = np.where(np.isfinite(moving.spread), moving.spread, np.inf)
    np.fill_diagonal(spread, np.inf)
    worst: dict[tuple[int, ...], float] = {}
    for run, row in enumerate(spread):
        company = np.argsort(row, kind="stable")[:COMPANY]
        company = company[row[company] < RIGID]
        for others in combinations(company.tolist(), 3):
            group = tuple(sorted((run, *others)))
            if group not in worst:
                pairs = combinations(group, 2)
                worst[group] = max(float(spread[a, b]) for a, b in pairs)
    order = sorted((value, group) for group, value in worst.items() if value < RIGID)
    return [group for _, group in order[:MAX_GROUPS]]


def _matches(
    group: tuple[int, ...], apart: FloatArray, rest: FloatArray, tolerance: float
) -> list[tuple[int, ...]]:
    """Return the markers whose distances at rest are those of a group of runs."""
    first, second = np.nonzero(np.abs(rest - apart[group[1], group[0]]) < tolerance)
    partial = np.stack([first, second], axis=1)
    partial = partial[first != second]
    for k in range(2, len(group)):
        off = np.abs(rest[partial] - apart[group[k], group[:k]][None, :, None])
        fits = (off < tolerance).all(axis=1)
        fits[np.arange(len(partial))[:, None], partial] = False
        row, marker = np.nonzero(fits)
        partial = np.concatenate([partial[row], marker[:, None]], axis=1)
    return [tuple(markers) for markers in partial.tolist()]


def _misfit(points: FloatArray, shape: FloatArray) -> float:
    """Return how far a shape is off points, mirrored ones included [m]."""
    whole = points[np.isfinite(points).all(axis=(1, 2))][::8]
    if not len(whole):
        return np.inf
    rotation, shift = fitted(whole, shape)
    fit = np.einsum("fij,kj->fki", rotation, shape) + shift[:, None]
    return float(np.sqrt(np.median(((fit - whole) ** 2).sum(axis=-1).mean(axis=1))))


class _Naming:
    """Names of runs, and what the distances of all that have one say of each name.

    Attributes:
        given: Which marker each run is ``(R,)``; -1 for none.
    """

    def __init__(
        self, moving: Distances, overlap: FloatArray, rest: FloatArray
    ) -> None:
        self.moving, self.rest = moving, rest
        self.together: BoolArray = overlap > 0
        # A pair counts by how long it was seen, of what could be.
        self.share = overlap / max(1.0, float(overlap.max()))
        np.fill_diagonal(self.share, 0.0)
        count, markers = len(overlap), len(rest)
        self.given = np.full(count, -1)
        self.said = np.zeros((count, markers))
        self.taken = np.zeros((count, markers), np.int64)

    def total(self) -> float:
        """Return how well names explain all distances [nat]."""
        named = np.flatnonzero(self.given >= 0)
        return float(self.said[named, self.given[named]].sum())

    def put(self, run: int, marker: int) -> None:
        """Give a run a name, or take it with -1."""
        before = int(self.given[run])
        for name, sign in ((before, -1), (marker, 1)):
            if name < 0:
                continue
            says = evidence(self.moving.mean[run], self.moving.spread[run],
                            self.rest[name])  # fmt: skip
            self.said += sign * self.share[run][:, None] * says
            self.taken[self.together[run], name] += sign
        self.given[run] = marker

    def grow(self, seed: dict[int, int]) -> None:
        """Name runs one by one from a few that are known, those that are clearest first.

        Runs that are seen together are not the same marker.
        """
        for run, marker in seed.items():
            self.put(run, marker)
        rows = np.arange(len(self.given))
        while True:
            score = np.where(self.taken > 0, -np.inf, self.said)
            marker = score.argmax(axis=1)
            best = score[rows, marker]
            score[rows, marker] = -np.inf
            rival = np.maximum(score.max(axis=1), 0.0)
            length = self.share.sum(axis=1) / max(1, len(rows))
            clear = np.where(best > WORTH * np.minimum(1.0, length), best - rival, -1.0)
            clear[self.given >= 0] = -1.0
            run = int(clear.argmax())
            if clear[run] <= 0.0:
                return
            self.put(run, int(marker[run]))

    def improve(self, points: FloatArray) -> bool:
        """Give runs other names where all distances then fit better; return if any."""
        changed = False
        for run in np.flatnonzero(self.given >= 0).tolist():
            now = int(self.given[run])
            own = self.taken[run].copy()
            own[now] -= 1
            score = np.where(own > 0, -np.inf, self.said[run])
            other = int(score.argmax())
            if other != now and score[other] > score[now]:
                self.put(run, other)
                changed = True
        new = renamed(_named(points, self.given, len(self.rest)), self.rest)
        if new is not None:
            for run in np.flatnonzero(self.given >= 0).tolist():
                if new[self.given[run]] != self.given[run]:
                    self.put(run, int(new[self.given[run]]))
            changed = True
        return changed


def _named(points: FloatArray, given: IntArray, markers: int) -> FloatArray:
    """Return the positions of runs by their names ``(F, M, 3)``."""
    marked = np.full((len(points), markers, 3), np.nan)
    for run in np.flatnonzero(given >= 0).tolist():
        seen = np.isfinite(points[:, run, 0])
        marked[seen, given[run]] = points[seen, run]
    return marked

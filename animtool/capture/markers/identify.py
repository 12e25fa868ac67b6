"""Which runs of a cloud are which markers, to begin with: groups that stay rigid."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from animtool.capture.markers.chains import chained, merged
from animtool.capture.markers.geometry import Distances, distances, fitted
from animtool.capture.markers.naming import Naming, searched
from animtool.core.array_types import BoolArray, FloatArray, IntArray

# A distance that varies less is one within a segment [m].
RIGID = 0.006
# How far the shape of a group of four may be off, for it to be named first [m].
SEED = 0.003
# How far the distances of such a group may be off, and what is tried where none is so
# near [m]; and how many runs a run is grouped with.
NEAREST, FARTHEST, COMPANY = 0.002, 0.006, 7
MAX_GROUPS = 400
# Groups that naming is begun with, of which the one that explains most is taken.
STARTS, GROUPS = 3, 12
# How often runs are joined to chains: longer ones are known better.
ROUNDS = 2


def identify(
    points: FloatArray, shape: FloatArray, rest: FloatArray
) -> IntArray | None:
    """Return which marker each run of a window is ``(R,)``; None where nothing fits."""
    chain = np.arange(points.shape[1])
    for _ in range(ROUNDS):
        moving = distances(points)
        seen = np.isfinite(points[..., 0]).astype(np.float64)
        again = chained(moving, seen.T @ seen)
        points, chain = merged(points, again), again[chain]
    moving = distances(points)
    seen = np.isfinite(points[..., 0]).astype(np.float64)
    groups = _fours(moving)
    seeds = _seeds(points, groups, moving, shape, rest, NEAREST)
    if not seeds:
        seeds = _seeds(points, groups, moving, shape, rest, FARTHEST)
    begun = Naming(moving, seen.T @ seen, rest)
    best: Naming | None = None
    for seed in [_agreeing(seeds, begun.together), *seeds[:STARTS]]:
        if not seed:
            continue
        naming = begun.copy()
        for point, marker in seed.items():
            naming.put(point, marker)
        naming.grow()
        if best is None or naming.total() > best.total():
            best = naming
    return None if best is None else searched(best, rest, seeds[:GROUPS]).given[chain]


def _agreeing(seeds: list[dict[int, int]], together: BoolArray) -> dict[int, int]:
    """Return the markers of groups that do not contradict each other, best first."""
    given: dict[int, int] = {}
    for seed in seeds:
        if any(given.get(point, marker) != marker for point, marker in seed.items()):
            continue
        both = given | seed
        points, markers = np.array(list(both)), np.array(list(both.values()))
        clash = together[np.ix_(points, points)] & (markers[:, None] == markers)
        np.fill_diagonal(clash, False)
        if not clash.any():
            given = both
    return given


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
        fits: BoolArray = np.asarray((off < tolerance).all(axis=1))
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

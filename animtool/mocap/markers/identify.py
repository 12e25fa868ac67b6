"""Which runs of a cloud are which markers, to begin with: groups that stay rigid."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice

import numpy as np

from animtool._types import BoolArray, FloatArray, IntArray
from animtool.mocap.markers.geometry import Distances, distances, fitted
from animtool.mocap.markers.runs import (
    GHOST,
    SPREADS,
    TOLERANCE,
    WEIGHT_SPREAD,
    WORST,
)

# A distance that varies less is one within a segment [m].
RIGID = 0.006
# How far the shape of a group of four may be off, for it to be named first [m].
SEED = 0.003
# Points apart say less of which marker each is [m].
WEIGHT_FAR = 0.25
# A joint between two markers changes their distance by such a share of it, and [m]; a
# pair that has to bend for its distance counts as much as this off.
PLAY, PLAY_LEAST, ARTICULATED = 0.35, 0.03, 1.5
MAX_GROUPS = 400
# Weights of distances to what is known, all together: fewer name nothing, and more
# than this are no better.
MIN_SHARE, FULL_SHARE = 0.05, 3.0


def identify(
    points: FloatArray, shape: FloatArray, rest: FloatArray
) -> IntArray | None:
    """Return which marker each run of a window is ``(R,)``; None where nothing fits."""
    moving = distances(points)
    seen = np.isfinite(points[..., 0]).astype(np.float64)
    together = seen.T @ seen > 0
    seeds = _seeds(points, moving, shape, rest)
    given = _agreeing(seeds, together)
    return _grown(given, moving, rest, together) if given else None


def _agreeing(
    seeds: list[list[tuple[int, int]]], together: BoolArray
) -> dict[int, int]:
    """Return the markers of groups that do not contradict each other, best first."""
    given: dict[int, int] = {}
    for pairs in seeds:
        merged = dict(pairs)
        known = [(run, given[run]) for run, _ in pairs if run in given]
        if any(merged[run] != marker for run, marker in known):
            continue
        both = given | merged
        runs = np.array(list(both))
        markers = np.array(list(both.values()))
        clash = together[np.ix_(runs, runs)] & (markers[:, None] == markers)
        np.fill_diagonal(clash, False)
        if not clash.any():
            given = both
    return given


def _seeds(
    points: FloatArray, moving: Distances, shape: FloatArray, rest: FloatArray
) -> list[list[tuple[int, int]]]:
    """Return groups of rigid runs with the markers that they may be, best first."""
    rigid = (moving.spread < RIGID) & np.isfinite(moving.mean)
    np.fill_diagonal(rigid, False)
    groups = list(islice(_fours(rigid), MAX_GROUPS))
    found = []
    for group in groups:
        for markers in _matches(group, moving.mean, rest):
            off = _misfit(points[:, group], shape[list(markers)])
            if off < SEED:
                pairs = list(zip(group, markers, strict=True))
                found.append((off, pairs))
    found.sort(key=lambda entry: entry[0])
    return [pairs for _, pairs in found]


def _fours(rigid: BoolArray) -> Iterator[tuple[int, ...]]:
    """Yield four runs of which any two are rigid, in order of their numbers."""
    after = [np.flatnonzero(row[i:]) + i for i, row in enumerate(rigid)]
    for i, others in enumerate(after):
        for j in others.tolist():
            both = after[j][rigid[i, after[j]]]
            for k in both.tolist():
                all_three = after[k][rigid[i, after[k]] & rigid[j, after[k]]]
                for m in all_three.tolist():
                    yield i, j, k, m


def _matches(
    group: tuple[int, ...], apart: FloatArray, rest: FloatArray
) -> list[tuple[int, ...]]:
    """Return the markers whose distances at rest are those of a group of runs."""
    partial: list[tuple[int, ...]] = [(marker,) for marker in range(len(rest))]
    for k in range(1, len(group)):
        longer: list[tuple[int, ...]] = []
        for markers in partial:
            off = np.zeros(len(rest))
            for earlier, marker in enumerate(markers):
                distance = apart[group[k], group[earlier]]
                off = np.maximum(off, np.abs(rest[:, marker] - distance))
            off[list(markers)] = np.inf
            fitting = np.flatnonzero(off < TOLERANCE)
            longer += [(*markers, marker) for marker in fitting.tolist()]
        partial = longer
    return partial


def _misfit(points: FloatArray, shape: FloatArray) -> float:
    """Return how far a shape is off points, mirrored ones included [m]."""
    whole = points[np.isfinite(points).all(axis=(1, 2))][::8]
    if not len(whole):
        return np.inf
    rotation, shift = fitted(whole, shape)
    fit = np.einsum("fij,kj->fki", rotation, shape) + shift[:, None]
    return float(np.sqrt(np.median(((fit - whole) ** 2).sum(axis=-1).mean(axis=1))))


def _grown(
    given: dict[int, int], moving: Distances, rest: FloatArray, together: BoolArray
) -> IntArray:
    """Return markers of all runs that fit, found one by one from a few that are known.

    The run that fits one marker best, and by far, comes first. Runs that are seen
    together are not the same marker.
    """
    count, markers = len(moving.mean), len(rest)
    weight = 1.0 / (1.0 + (moving.spread / WEIGHT_SPREAD) ** 2)
    weight = np.nan_to_num(weight / (1.0 + (moving.mean / WEIGHT_FAR) ** 2))
    allowed = TOLERANCE + SPREADS * moving.spread
    total = np.zeros((count, markers))
    share = np.zeros(count)
    barred = np.zeros((count, markers), bool)
    found = np.full(count, -1)
    waiting = list(given.items())
    while True:
        for run, marker in waiting:
            found[run] = marker
            off = np.nan_to_num(rest[marker][None] - moving.mean[run][:, None])
            loose = ARTICULATED + (off / (PLAY * rest[marker] + PLAY_LEAST)) ** 2
            cost = np.minimum((off / allowed[run][:, None]) ** 2, loose)
            cost = np.minimum(np.nan_to_num(cost), WORST)
            total += weight[run][:, None] * cost
            share += weight[run]
            barred[together[run], marker] = True
        mean = total / np.maximum(share, 1e-9)[:, None]
        mean[barred] = np.inf
        mean[(found >= 0) | (share <= MIN_SHARE)] = np.inf
        order = np.sort(mean, axis=1)
        finite = np.isfinite(order[:, 0])
        rival = np.minimum(order[:, 1], order[:, 0] + WORST, where=finite,
                           out=np.zeros(count))  # fmt: skip
        margin = np.where(finite, rival - np.where(finite, order[:, 0], 0.0), -1.0)
        worth = np.where(
            order[:, 0] < GHOST, margin * np.minimum(share, FULL_SHARE), -1
        )
        run = int(worth.argmax())
        if worth[run] <= 0.0:
            return found
        waiting = [(run, int(mean[run].argmin()))]

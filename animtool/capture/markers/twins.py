"""Markers that distances barely distinguish: told apart by their neighbours."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from animtool.capture.markers.geometry import distances, fitted
from animtool.capture.markers.naming import exchanges, gain_of, pair_evidence
from animtool.core.array_types import FloatArray, IntArray
from animtool.core.record import dataclass

# Exchanges with more evidence against them are ignored [nat].
AGAINST = 6.0
# Neighbours, any two of which define a frame with the exchanged markers.
AROUND = 5
# Two pairs this near are exchanged together [m].
NEAR_DISTANCE = 0.26
# Frames sampled, and the fraction nearest to the trial's pose [1].
SAMPLES, BEST, MIN_SAMPLES = 120, 0.1, 8
# Shapes are off by as much for noise alone [m]; a shape that is off e times more is
# spoken against by so much [nat].
NOISE, SHAPES = 0.001, 10.0
# Least gain of an exchange, and of one in doubt [nat].
MIN_GAIN, DOUBTED = 0.05, -0.8
# Least gain in part of a take [nat].
IN_PART = 2.0
MAX_EXCHANGES = 12


@dataclass(frozen=True, slots=True)
class Exchange:
    """A name exchange that fits a take about as well as the chosen names.

    Attributes:
        markers: Those exchanged.
        score: Evidence for it [nat]; below 0.
    """

    markers: tuple[int, ...]
    score: float


def distinguish_twins(
    positions: FloatArray, shape: FloatArray
) -> tuple[IntArray, list[Exchange], list[tuple[int, int]]]:
    """Return the name of each marker ``(M,)``, and the exchanges that stay in doubt.

    The pairs are those that distances leave open, by their final names.

    Exchanges that distances do not rule out are compared by distances and by shape: the
    error of the rest shape on the points, with any two neighbouring markers, in the
    best frames, rotated but not mirrored.

    positions: By current names ``(F, M, 3)``. shape: At rest ``(M, 3)`` [m].
    """
    rest = np.linalg.norm(shape[:, None] - shape[None], axis=-1)
    visible = np.isfinite(positions[..., 0]).astype(np.float64)
    overlap = visible.T @ visible
    fraction = overlap / max(1.0, float(overlap.max()))
    np.fill_diagonal(fraction, 0.0)
    pair_scores = pair_evidence(distances(positions), fraction, rest)
    moves = _near_only(exchanges(rest), rest)
    names = np.arange(len(shape))
    known: dict[tuple[int, ...], float] = {}
    doubts: list[Exchange] = []
    pairs: list[tuple[int, int]] = []
    for _ in range(MAX_EXCHANGES):
        alone = np.zeros(rest.shape)
        for other, name in enumerate(names.tolist()):
            alone += pair_scores[:, other, :, name]
        best, most = None, MIN_GAIN
        doubts, pairs = [], []
        for old, new in moves:
            gains = gain_of(pair_scores, alone, names, old, new)
            for row in np.flatnonzero(gains > -AGAINST).tolist():
                if old.shape[1] == 2:
                    a, b = names[old[row]].tolist()
                    pairs.append((a, b))
                changed = names.copy()
                changed[old[row]] = names[new[row]]
                score = float(gains[row])
                score += SHAPES * _shape_says(
                    positions, shape, rest, old[row].tolist(), names, changed, known
                )
                if score > most:
                    best, most = changed, score
                elif score > DOUBTED:
                    markers = tuple(sorted(names[old[row]].tolist()))
                    doubts.append(Exchange(markers, min(score, 0.0)))
        if best is None:
            break
        names = best
    return names, doubts, pairs


def exchanged_in(
    positions: FloatArray, shape: FloatArray, pair: tuple[int, int]
) -> bool:
    """Return whether shapes clearly show two markers exchanged in some frames.

    positions: Of these frames, by current names ``(F, M, 3)``.
    """
    names = np.arange(len(shape))
    then = names.copy()
    then[list(pair)] = pair[::-1]
    rest = np.linalg.norm(shape[:, None] - shape[None], axis=-1)
    pair_scores = _shape_says(positions, shape, rest, list(pair), names, then, {})
    return SHAPES * pair_scores > IN_PART


def _near_only(
    moves: list[tuple[IntArray, IntArray]], rest: FloatArray
) -> list[tuple[IntArray, IntArray]]:
    """Return exchanges without those of two unrelated pairs."""
    kept = []
    for old, new in moves:
        near = np.ones(len(old), bool)
        if old.shape[1] == 4:
            between = rest[old[:, :2, None], old[:, None, 2:]]
            near = between.min(axis=(1, 2)) < NEAR_DISTANCE
        kept.append((old[near], new[near]))
    return kept


def _shape_says(
    positions: FloatArray,
    shape: FloatArray,
    rest: FloatArray,
    changed: list[int],
    now: IntArray,
    then: IntArray,
    known: dict[tuple[int, ...], float],
) -> float:
    """Return the shape evidence for other names, a mean over neighbours [nat]."""
    distance = rest[now[changed]][:, now].min(axis=0)
    distance[changed] = np.inf
    nearest = np.argsort(distance, kind="stable")[:AROUND]
    ratios = []
    for pair in combinations(nearest.tolist(), 2):
        group = [*changed, *pair]
        offs = []
        for names in (now, then):
            key = (*group, *names[group].tolist())
            if key not in known:
                known[key] = _off(positions, group, shape[names[group]])
            offs.append(known[key])
        if np.isfinite(offs).all():
            ratios.append(np.log((offs[0] + NOISE) / (offs[1] + NOISE)))
    return float(np.mean(ratios)) if ratios else 0.0


def _off(positions: FloatArray, group: list[int], shape: FloatArray) -> float:
    """Return the error of a shape on points in the frames that fit it best [m]."""
    points = positions[:, group]
    complete = np.flatnonzero(np.isfinite(points).all(axis=(1, 2)))
    if len(complete) < MIN_SAMPLES:
        return np.inf
    points = points[complete[:: max(1, len(complete) // SAMPLES)]]
    rotation, shift = fitted(points, shape)
    fit = np.einsum("fij,kj->fki", rotation, shape) + shift[:, None]
    off = np.sqrt(((fit - points) ** 2).sum(axis=-1).mean(axis=1))
    count = max(1, int(BEST * len(off)))
    return float(np.partition(off, count - 1)[:count].mean())

"""Distinguishes markers with similar distances by the shapes of their neighbours."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from animtool.capture.markers.geometry import marker_distances, mean_square_errors
from animtool.capture.markers.naming import (
    compute_pair_evidence,
    compute_swap_gains,
    find_swaps,
)
from animtool.core.array_types import FloatArray, IntArray
from animtool.core.record import dataclass

# Swaps with more evidence against them are ignored [nat].
MAX_COUNTER_EVIDENCE = 6.0
# Number of neighbours; any two of them define a frame with the swapped markers.
NEIGHBOUR_COUNT = 5
# Two pairs this near each other are swapped together [m].
PAIR_DISTANCE = 0.26
# Number of sampled frames, the fraction of them nearest to the trial's pose [1], and
# their minimum number.
SAMPLED_FRAME_COUNT, BEST_FRAME_FRACTION, MIN_COMPLETE_FRAMES = 120, 0.1, 8
# Shape error from noise alone [m], and evidence against a shape per factor e of its
# error [nat].
SHAPE_NOISE, SHAPE_EVIDENCE = 0.001, 10.0
# Minimum gain of a swap, and of a swap in doubt [nat].
MIN_GAIN, MIN_DOUBT_GAIN = 0.05, -0.8
# Minimum gain in part of a take [nat].
MIN_SPAN_GAIN = 2.0
MAX_SWAP_ROUNDS = 12


@dataclass(frozen=True, slots=True)
class NameSwap:
    """A swap of marker names that fits the take about as well as the chosen names."""

    markers: tuple[int, ...]  # the swapped markers
    score: float  # evidence for the swap [nat]; negative


def distinguish_twins(
    positions: FloatArray, rest_shape: FloatArray
) -> tuple[IntArray, list[NameSwap], list[tuple[int, int]]]:
    """Swap the names of similar markers if distances and shapes fit better.

    Return the new name of each marker ``(M,)``, the swaps that stay in doubt, and
    the pairs that distances cannot distinguish, by final names.

    Swaps that distances do not rule out are compared by distances and by shape: the
    error of the rest shape on the points, with any two neighbouring markers, in the
    best frames, rotated but not mirrored.

    positions: By current names ``(F, M, 3)``. rest_shape: ``(M, 3)`` [m].
    """
    rest_distances = np.linalg.norm(rest_shape[:, None] - rest_shape[None], axis=-1)
    is_visible = np.isfinite(positions[..., 0]).astype(np.float64)
    overlap = is_visible.T @ is_visible
    overlap_fraction = overlap / max(1.0, float(overlap.max()))
    np.fill_diagonal(overlap_fraction, 0.0)
    pair_scores = compute_pair_evidence(
        marker_distances(positions), overlap_fraction, rest_distances
    )
    swaps = _without_unrelated_swaps(find_swaps(rest_distances), rest_distances)
    labels = np.arange(len(rest_shape))
    shape_cache: dict[tuple[int, ...], float] = {}
    doubtful_swaps: list[NameSwap] = []
    doubtful_pairs: list[tuple[int, int]] = []
    for _ in range(MAX_SWAP_ROUNDS):
        single_scores = np.zeros(rest_distances.shape)
        for marker, label in enumerate(labels.tolist()):
            single_scores += pair_scores[:, marker, :, label]
        best_labels, best_gain = None, MIN_GAIN
        doubtful_swaps, doubtful_pairs = [], []
        for old, new in swaps:
            gains = compute_swap_gains(pair_scores, single_scores, labels, old, new)
            for row in np.flatnonzero(gains > -MAX_COUNTER_EVIDENCE).tolist():
                if old.shape[1] == 2:
                    a, b = labels[old[row]].tolist()
                    doubtful_pairs.append((a, b))
                changed_labels = labels.copy()
                changed_labels[old[row]] = labels[new[row]]
                score = float(gains[row])
                score += SHAPE_EVIDENCE * _shape_evidence(
                    positions,
                    rest_shape,
                    rest_distances,
                    old[row].tolist(),
                    labels,
                    changed_labels,
                    shape_cache,
                )
                if score > best_gain:
                    best_labels, best_gain = changed_labels, score
                elif score > MIN_DOUBT_GAIN:
                    markers = tuple(sorted(labels[old[row]].tolist()))
                    doubtful_swaps.append(NameSwap(markers, min(score, 0.0)))
        if best_labels is None:
            break
        labels = best_labels
    return labels, doubtful_swaps, doubtful_pairs


def is_swapped(
    positions: FloatArray, rest_shape: FloatArray, pair: tuple[int, int]
) -> bool:
    """Return whether shapes clearly show two markers swapped in some frames.

    positions: Positions in these frames, by current names ``(F, M, 3)``.
    """
    labels = np.arange(len(rest_shape))
    swapped_labels = labels.copy()
    swapped_labels[list(pair)] = pair[::-1]
    rest_distances = np.linalg.norm(rest_shape[:, None] - rest_shape[None], axis=-1)
    shape_evidence = _shape_evidence(
        positions, rest_shape, rest_distances, list(pair), labels, swapped_labels, {}
    )
    return SHAPE_EVIDENCE * shape_evidence > MIN_SPAN_GAIN


def _without_unrelated_swaps(
    swaps: list[tuple[IntArray, IntArray]], rest_distances: FloatArray
) -> list[tuple[IntArray, IntArray]]:
    """Return swaps without the double ones of pairs that are far from each other."""
    near_swaps = []
    for old, new in swaps:
        is_near = np.ones(len(old), bool)
        if old.shape[1] == 4:
            pair_distances = rest_distances[old[:, :2, None], old[:, None, 2:]]
            is_near = pair_distances.min(axis=(1, 2)) < PAIR_DISTANCE
        near_swaps.append((old[is_near], new[is_near]))
    return near_swaps


def _shape_evidence(
    positions: FloatArray,
    rest_shape: FloatArray,
    rest_distances: FloatArray,
    changed_markers: list[int],
    current_labels: IntArray,
    other_labels: IntArray,
    cache: dict[tuple[int, ...], float],
) -> float:
    """Return the mean log ratio of the shape errors before a swap to those after it."""
    distances = rest_distances[current_labels[changed_markers]][:, current_labels].min(
        axis=0
    )
    distances[changed_markers] = np.inf
    nearest = np.argsort(distances, kind="stable")[:NEIGHBOUR_COUNT]
    ratios = []
    for pair in combinations(nearest.tolist(), 2):
        group = [*changed_markers, *pair]
        errors = []
        for labels in (current_labels, other_labels):
            key = (*group, *labels[group].tolist())
            if key not in cache:
                cache[key] = _shape_error(positions, group, rest_shape[labels[group]])
            errors.append(cache[key])
        if np.isfinite(errors).all():
            ratios.append(np.log((errors[0] + SHAPE_NOISE) / (errors[1] + SHAPE_NOISE)))
    return float(np.mean(ratios)) if ratios else 0.0


def _shape_error(positions: FloatArray, group: list[int], shape: FloatArray) -> float:
    """Return a group's mean rigid fit error in the best-fitting frames [m]."""
    points = positions[:, group]
    frame_indices = np.flatnonzero(np.isfinite(points).all(axis=(1, 2)))
    if len(frame_indices) < MIN_COMPLETE_FRAMES:
        return np.inf
    points = points[frame_indices[:: max(1, len(frame_indices) // SAMPLED_FRAME_COUNT)]]
    shape_errors = np.sqrt(mean_square_errors(points, shape))
    best_count = max(1, int(BEST_FRAME_FRACTION * len(shape_errors)))
    return float(np.partition(shape_errors, best_count - 1)[:best_count].mean())

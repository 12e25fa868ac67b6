"""Assigns names to points by the evidence of all their distances."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import Any

import numpy as np

from animtool.capture.markers.chains import chain_likelihoods, rest_evidence
from animtool.capture.markers.geometry import MarkerDistances
from animtool.core.array_types import BoolArray, FloatArray, IntArray

# Minimum total evidence for naming a point [nat].
MIN_NAME_EVIDENCE = 1.0
# Spread of pairs that are named together [m], and partners of each point.
RIGID_SPREAD, RIGID_PARTNERS = 0.006, 3
# Trials of reassigning names, and their minimum gain [nat].
MAX_RENAME_TRIALS, MIN_EVIDENCE_GAIN = 40, 0.05
# Markers named for less than this fraction of the longest visible marker, and unnamed
# points visible for longer than that fraction, have the names around them reassigned:
# number of restarts, radius [m], random bias [nat], and probability of restarting from
# scratch.
MIN_NAMED_FRACTION, LONG_FRACTION, RESTART_COUNT = 0.5, 0.3, 60
RESTART_RADIUS, RANDOM_BIAS, SCRATCH_PROBABILITY = (0.3, 1.2), (0.5, 6.0), 0.4
# Radius around a doubtful marker [m].
DOUBT_RADIUS = 0.3
# Markers this near at rest are swapped in triples and double pairs [m].
SWAP_DISTANCE = 0.28
# Swaps are tried if the names are within this margin of the best [nat].
SWAP_MARGIN = 10.0
MAX_SWAPS = 40


class PointNaming:
    """An assignment of markers to points, and the evidence for each possible name.

    Attributes:
        point_markers: Marker of each point ``(R,)``; -1 for none.
    """

    def __init__(
        self,
        distances: MarkerDistances,
        overlap: FloatArray,
        rest_distances: FloatArray,
    ) -> None:
        """Start without names.

        distances: Between the points. overlap: Number of frames in which pairs
        are visible ``(R, R)``. rest_distances: Between the markers ``(M, M)`` [m].
        """
        point_count, marker_count = len(overlap), len(rest_distances)
        self.are_concurrent: BoolArray = overlap > 0
        # A pair's weight is its visible fraction.
        overlap_fraction = overlap / max(1.0, float(overlap.max()))
        self.visible_fraction = np.diag(overlap_fraction).copy()
        np.fill_diagonal(overlap_fraction, 0.0)
        self.pair_scores = compute_pair_evidence(
            distances, overlap_fraction, rest_distances
        )
        # Points never visible together that share a name should be one marker.
        pair_weights = np.minimum(self.visible_fraction[:, None], self.visible_fraction)
        pair_weights = pair_weights * ~self.are_concurrent
        chain_evidence = pair_weights * chain_likelihoods(distances, overlap)
        for marker in range(marker_count):
            self.pair_scores[:, :, marker, marker] += chain_evidence.astype(np.float32)
        # Pairs of points that stay rigid, few for each point.
        is_measured = (overlap_fraction > 0) & np.isfinite(distances.spread)
        spread = np.where(is_measured, distances.spread, np.inf)
        rigid_partners = np.argsort(spread, axis=1, kind="stable")[:, :RIGID_PARTNERS]
        rigid_pairs = {
            (min(point, other), max(point, other))
            for point, others in enumerate(rigid_partners.tolist())
            for other in others
            if spread[point, other] < RIGID_SPREAD
        }
        pair_array = np.array(sorted(rigid_pairs), np.int64).reshape(-1, 2)
        self.rigid_pairs = pair_array[:, 0], pair_array[:, 1]
        self.swaps = find_swaps(rest_distances)
        self.point_markers = np.full(point_count, -1)
        self.scores = np.zeros((point_count, marker_count))
        self.blocked_counts = np.zeros((point_count, marker_count), np.int64)

    def copy(self) -> PointNaming:
        """Return an independent copy of the assignment; constant tables are shared."""
        naming = object.__new__(PointNaming)
        naming.__dict__.update(self.__dict__)
        for name in ("point_markers", "scores", "blocked_counts"):
            setattr(naming, name, getattr(self, name).copy())
        return naming

    def total_evidence(self) -> float:
        """Return the evidence of all distances between named points [nat]."""
        points = np.flatnonzero(self.point_markers >= 0)
        return 0.5 * float(self.scores[points, self.point_markers[points]].sum())

    def assign(self, point: int, marker: int) -> None:
        """Assign a marker's name to a point; marker -1 removes the point's name."""
        previous_marker = int(self.point_markers[point])
        for changed_marker, sign in ((previous_marker, -1), (marker, 1)):
            if changed_marker >= 0:
                self.scores += sign * self.pair_scores[point, :, changed_marker]
                self.blocked_counts[self.are_concurrent[point], changed_marker] += sign
        self.point_markers[point] = marker

    def assign_greedily(self, bias: FloatArray | float = 0.0) -> None:
        """Name unnamed points one by one, or in rigid pairs, the clearest first.

        Points visible together are never the same marker.

        bias: Additional evidence for names ``(R, M)`` [nat].
        """
        rows = np.arange(len(self.point_markers))
        while True:
            score = np.where(self.blocked_counts > 0, -np.inf, self.scores + bias)
            score[self.point_markers >= 0] = -np.inf
            pair = self._clearest_pair(score)
            marker = score.argmax(axis=1)
            best_score = score[rows, marker]
            score[rows, marker] = -np.inf
            rival_score = np.maximum(score.max(axis=1), 0.0)
            margin = np.full(len(rows), -1.0)
            min_scores = MIN_NAME_EVIDENCE * self.visible_fraction
            is_eligible = np.isfinite(best_score) & (best_score > min_scores)
            margin[is_eligible] = (best_score - rival_score)[is_eligible]
            point = int(margin.argmax())
            if pair and pair[0] > max(0.0, margin[point]):
                self.assign(*pair[1])
                self.assign(*pair[2])
            elif margin[point] > 0.0:
                self.assign(point, int(marker[point]))
            else:
                return

    def _clearest_pair(self, score: FloatArray) -> Any:
        """Return the clearest rigid pair: evidence margin [nat], points and names."""
        first_points, second_points = self.rigid_pairs
        is_free = (self.point_markers[first_points] < 0) & (
            self.point_markers[second_points] < 0
        )
        first_points, second_points = first_points[is_free], second_points[is_free]
        if not len(first_points):
            return None
        pair_scores = score[first_points][:, :, None] + score[second_points][:, None, :]
        pair_scores = pair_scores + self.pair_scores[first_points, second_points]
        pair_scores = pair_scores.reshape(len(first_points), -1)
        rows = np.arange(len(first_points))
        best_pair = pair_scores.argmax(axis=1)
        best_score = pair_scores[rows, best_pair].copy()
        pair_scores[rows, best_pair] = -np.inf
        rival_score = np.maximum(pair_scores.max(axis=1), 0.0)
        margin = np.full(len(first_points), -1.0)
        is_eligible = np.isfinite(best_score)
        is_eligible[is_eligible] = (
            best_score
            > MIN_NAME_EVIDENCE
            * (
                self.visible_fraction[first_points]
                + self.visible_fraction[second_points]
            )
        )[is_eligible]
        margin[is_eligible] = 0.5 * (best_score - rival_score)[is_eligible]
        row = int(margin.argmax())
        first_marker, second_marker = divmod(int(best_pair[row]), score.shape[1])
        return (
            float(margin[row]),
            (int(first_points[row]), first_marker),
            (int(second_points[row]), second_marker),
        )

    def improve(self, best_total: float = -np.inf) -> None:
        """Rename points and swap markers as long as the likelihood increases.

        best_total: Swaps are not tried far below this total [nat].
        """
        for _ in range(MAX_SWAPS):
            has_changed = self._improve_names()
            if self.total_evidence() < best_total - SWAP_MARGIN:
                return
            new_markers = self._better_permutation()
            if new_markers is None:
                if not has_changed:
                    return
                continue
            for point in np.flatnonzero(self.point_markers >= 0).tolist():
                new_marker = int(new_markers[self.point_markers[point]])
                if new_marker != self.point_markers[point]:
                    self.assign(point, new_marker)

    def _improve_names(self) -> bool:
        """Give points a free name that fits better; return whether any name changed."""
        has_changed = False
        for point in range(len(self.point_markers)):
            current_marker = int(self.point_markers[point])
            blocked_counts = self.blocked_counts[point].copy()
            current_score = 0.0
            if current_marker >= 0:
                blocked_counts[current_marker] -= 1
                current_score = float(self.scores[point, current_marker])
            score = np.where(blocked_counts > 0, -np.inf, self.scores[point])
            best_marker = int(score.argmax())
            if current_marker >= 0:
                min_score = current_score + MIN_EVIDENCE_GAIN
            else:
                min_score = MIN_NAME_EVIDENCE * self.visible_fraction[point]
            if best_marker != current_marker and score[best_marker] > min_score:
                self.assign(point, best_marker)
                has_changed = True
            elif current_marker >= 0 and current_score < 0.0:
                self.assign(point, -1)
                has_changed = True
        return has_changed

    def _better_permutation(self) -> IntArray | None:
        """Return a permutation of names ``(M,)`` with more evidence, or None.

        All pairs of markers are tried, and triples and double pairs of near ones.
        """
        points = np.flatnonzero(self.point_markers >= 0)
        named_markers, first_rows = np.unique(
            self.point_markers[points], return_index=True
        )
        marker_count = self.scores.shape[1]
        marker_scores = self.pair_scores[points[first_rows]]
        later_points = np.setdiff1d(np.arange(len(points)), first_rows)
        for point in points[later_points].tolist():
            marker_scores[
                np.searchsorted(named_markers, self.point_markers[point])
            ] += self.pair_scores[point]
        pair_scores: FloatArray = np.zeros((marker_count,) * 4, self.pair_scores.dtype)
        pair_scores[np.ix_(named_markers, named_markers)] = marker_scores[
            :, points[first_rows]
        ]
        for point in points[later_points].tolist():
            pair_scores[named_markers, self.point_markers[point]] += marker_scores[
                :, point
            ]
        pair_scores[np.arange(marker_count), np.arange(marker_count)] = 0.0
        new_markers = np.arange(marker_count)
        for _ in range(MAX_SWAPS):
            # Evidence of each marker for each name, given the names of all others.
            single_scores = np.zeros((marker_count, marker_count))
            for other in named_markers.tolist():
                single_scores += pair_scores[:, other, :, new_markers[other]]
            best_markers, best_gain = None, MIN_EVIDENCE_GAIN
            for old, new in self.swaps:
                gains = compute_swap_gains(
                    pair_scores, single_scores, new_markers, old, new
                )
                best_row = int(gains.argmax()) if len(gains) else 0
                if len(gains) and gains[best_row] > best_gain:
                    best_markers = old[best_row], new[best_row]
                    best_gain = float(gains[best_row])
            if best_markers is None:
                break
            new_markers[best_markers[0]] = new_markers[best_markers[1]]
        return new_markers if (new_markers != np.arange(marker_count)).any() else None

    def most_doubtful_point(
        self, tried_moves: set[tuple[int, int]]
    ) -> tuple[int, int] | None:
        """Return the point and marker with the most evidence to gain, or None."""
        rows = np.arange(len(self.point_markers))
        is_named = self.point_markers >= 0
        current_scores = np.where(is_named, self.scores[rows, self.point_markers], 0.0)
        rename_gains = self.scores - current_scores[:, None]
        rename_gains[rows[is_named], self.point_markers[is_named]] = -np.inf
        for point, marker in tried_moves:
            rename_gains[point, marker] = -np.inf
        point, marker = divmod(int(rename_gains.argmax()), rename_gains.shape[1])
        return (point, marker) if rename_gains[point, marker] > 0.0 else None

    def force_name(self, point: int, marker: int, is_reassigned: BoolArray) -> None:
        """Name a point, remove conflicting names, and reassign the removed names.

        is_reassigned: Mask of further markers whose names are reassigned ``(M,)``.
        """
        is_conflicting = self.are_concurrent[point] & (self.point_markers == marker)
        is_conflicting |= (self.point_markers >= 0) & is_reassigned[self.point_markers]
        for other in np.flatnonzero(is_conflicting).tolist():
            self.assign(other, -1)
        self.assign(point, marker)
        self.assign_greedily()

    def scarce_markers(self) -> IntArray:
        """Return the markers whose points are missing, or visible for a short time.

        Return all markers if none is scarce but an unnamed point is visible for long.
        """
        durations = np.zeros(self.scores.shape[1])
        is_named = self.point_markers >= 0
        np.add.at(
            durations, self.point_markers[is_named], self.visible_fraction[is_named]
        )
        markers = np.flatnonzero(durations < MIN_NAMED_FRACTION)
        if (
            not len(markers)
            and (self.visible_fraction[~is_named] > LONG_FRACTION).any()
        ):
            return np.arange(len(durations))
        return markers

    def restart(
        self, is_reassigned: BoolArray, seed: dict[int, int], bias: FloatArray
    ) -> None:
        """Remove the names in a mask ``(M,)``, and assign them again from a seed."""
        is_removed = (self.point_markers >= 0) & is_reassigned[self.point_markers]
        for point in np.flatnonzero(is_removed).tolist():
            self.assign(point, -1)
        for point, marker in seed.items():
            self.assign(point, marker)
        self.assign_greedily(bias)


def search_names(
    best_naming: PointNaming,
    rest_distances: FloatArray,
    seeds: Sequence[dict[int, int]],
) -> PointNaming:
    """Search for names with more evidence by removing and reassigning names.

    A conflicting name is removed first; if that is not enough, all names around the two
    markers.
    """
    best_naming = _retry_doubtful(best_naming, rest_distances)
    best_total = best_naming.total_evidence()
    # A marker without a point is often confused with another one.
    rng = np.random.default_rng(0)
    for _ in range(RESTART_COUNT):
        scarce_markers = best_naming.scarce_markers()
        if not len(scarce_markers):
            break
        centre_marker = int(rng.choice(scarce_markers))
        is_near = rest_distances[centre_marker] < rng.uniform(*RESTART_RADIUS)
        if len(scarce_markers) < len(rest_distances) and rng.random() < 0.5:
            is_near |= (rest_distances[scarce_markers] < DOUBT_RADIUS).any(axis=0)
        bias_scale = rng.uniform(*RANDOM_BIAS) * best_naming.visible_fraction[:, None]
        bias = rng.normal(0.0, 1.0, best_naming.scores.shape) * bias_scale
        candidate = best_naming.copy()
        # Sometimes restart from scratch with another group.
        has_seed = rng.random() < SCRATCH_PROBABILITY
        seed = seeds[int(rng.integers(len(seeds)))] if has_seed else {}
        candidate.restart(is_near | bool(seed), seed, bias)
        candidate.improve(-np.inf if seed else best_total)
        candidate_total = candidate.total_evidence()
        if candidate_total > best_total + MIN_EVIDENCE_GAIN:
            best_naming = _retry_doubtful(candidate, rest_distances)
            best_total = best_naming.total_evidence()
    return best_naming


def _retry_doubtful(
    best_naming: PointNaming, rest_distances: FloatArray
) -> PointNaming:
    """Rename the most doubtful points and those around them while evidence grows."""
    best_naming.improve()
    best_total = best_naming.total_evidence()
    tried_moves: set[tuple[int, int]] = set()
    for _ in range(MAX_RENAME_TRIALS):
        move = best_naming.most_doubtful_point(tried_moves)
        if move is None:
            break
        tried_moves.add(move)
        point, marker = move
        is_nearby = rest_distances[marker] < DOUBT_RADIUS
        if best_naming.point_markers[point] >= 0:
            is_nearby |= rest_distances[best_naming.point_markers[point]] < DOUBT_RADIUS
        for is_reassigned in (np.zeros(len(rest_distances), bool), is_nearby):
            candidate = best_naming.copy()
            candidate.force_name(point, marker, is_reassigned)
            candidate.improve(best_total)
            candidate_total = candidate.total_evidence()
            if candidate_total > best_total + MIN_EVIDENCE_GAIN:
                best_naming, best_total = candidate, candidate_total
                break
    return best_naming


def compute_pair_evidence(
    point_distances: MarkerDistances, overlap: FloatArray, rest_distances: FloatArray
) -> FloatArray:
    """Return the evidence that pairs of points are pairs of markers ``(R, R, M, M)``.

    It is weighted by ``overlap``, the fraction of frames with both points [nat].
    """
    point_count, marker_count = len(overlap), len(rest_distances)
    # Single precision: the table is large, and evidence is not more precise.
    table_shape = (point_count, point_count, marker_count, marker_count)
    pair_scores: Any = np.zeros(table_shape, np.float32)
    for point in range(point_count - 1):
        later_points = slice(point + 1, point_count)
        evidence = rest_evidence(
            point_distances.mean[point, later_points],
            point_distances.spread[point, later_points],
            rest_distances.reshape(1, -1),
        ).reshape(-1, marker_count, marker_count)
        evidence *= overlap[point, later_points, None, None]
        pair_scores[point, later_points] = evidence
        pair_scores[later_points, point] = evidence.transpose(0, 2, 1)
    return np.asarray(pair_scores)


def compute_swap_gains(
    pair_scores: FloatArray,
    single_scores: FloatArray,
    labels: IntArray,
    old: IntArray,
    new: IntArray,
) -> FloatArray:
    """Return each swap's gain in evidence ``(N,)`` [nat].

    old: Markers of each swap ``(N, K)``. new: Whose labels they get ``(N, K)``.
    """
    old_labels, new_labels = labels[old], labels[new]
    gains = (single_scores[old, new_labels] - single_scores[old, old_labels]).sum(
        axis=1
    )
    for a, b in combinations(range(old.shape[1]), 2):
        old_pair, new_pair = old[:, a], old[:, b]
        gains += pair_scores[old_pair, new_pair, new_labels[:, a], new_labels[:, b]]
        gains += pair_scores[old_pair, new_pair, old_labels[:, a], old_labels[:, b]]
        gains -= pair_scores[old_pair, new_pair, new_labels[:, a], old_labels[:, b]]
        gains -= pair_scores[old_pair, new_pair, old_labels[:, a], new_labels[:, b]]
    return np.asarray(gains)


def find_swaps(rest_distances: FloatArray) -> list[tuple[IntArray, IntArray]]:
    """Return name swaps to try: markers ``(N, K)``, and their new names."""
    is_near = rest_distances < SWAP_DISTANCE
    first_markers, second_markers = np.triu_indices(len(rest_distances), 1)
    marker_pairs = np.stack([first_markers, second_markers], axis=1)
    close_pairs = marker_pairs[is_near[first_markers, second_markers]]
    first_pair, second_pair = np.triu_indices(len(close_pairs), 1)
    double_pairs = np.concatenate(
        [close_pairs[first_pair], close_pairs[second_pair]], axis=1
    )
    is_disjoint = (
        close_pairs[first_pair][:, :, None] != close_pairs[second_pair][:, None, :]
    ).all(axis=(1, 2))
    double_pairs = double_pairs[is_disjoint]
    pair_rows, third_markers = np.nonzero(is_near[close_pairs].any(axis=1))
    triples = np.concatenate([close_pairs[pair_rows], third_markers[:, None]], axis=1)
    is_distinct = (triples[:, 2:] != triples[:, :2]).all(axis=1)
    triples = triples[is_distinct]
    return [
        (marker_pairs, marker_pairs[:, ::-1]),
        (triples, triples[:, [1, 2, 0]]),
        (triples, triples[:, [2, 0, 1]]),
        (double_pairs, double_pairs[:, [1, 0, 3, 2]]),
    ]

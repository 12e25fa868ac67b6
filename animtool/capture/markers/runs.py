"""Names runs of points by their distances to markers that already have names."""

from __future__ import annotations

import numpy as np

from animtool.capture.markers.geometry import (
    MarkerDistances,
    marker_distances,
    positions_by_column,
)
from animtool.capture.markers.tracklets import Tracklets
from animtool.core.array_types import FloatArray, IntArray

# Tolerance of a distance: noise, and skin over bone [m].
DISTANCE_TOLERANCE = 0.006
# Tolerance of markers on different segments, in standard deviations of their distance.
SPREAD_FACTOR = 1.5
# Largest cost of a pair, so that a single wrong pair does not decide.
MAX_PAIR_COST = 9.0
# Spread of a distance at which its weight is halved [m].
HALF_WEIGHT_SPREAD = 0.02
# Frames sampled of a run.
SAMPLED_FRAME_COUNT = 24
# Mean cost above which a run is not a marker: ghosts exceed 5.5, markers stay below 2.
MAX_MARKER_COST = 4.0
# Minimum margin over the second best name for an early assignment.
MIN_MARGIN = 1.5
# Longest gap for comparing a run with those before and after it [s].
BRIDGE_SECONDS = 0.3
# Iterations of learning distances.
LEARNING_ROUNDS = 2
# Motion of a marker over a gap: noise [m], acceleration [m/s^2] and speed error [m/s];
# and its largest cost.
GAP_NOISE, ACCELERATION, SPEED_ERROR, MAX_GAP_COST = 0.004, 60.0, 0.3, 2.0
# Assumed relative spread of markers never visible together.
UNKNOWN_SPREAD = 0.25


class TrackletLabels:
    """Assignment of a point cloud's runs to markers, improved by distances and motion.

    Attributes:
        run_markers: Marker of each run ``(T,)``; -1 for none.
        marker_positions: Positions of the markers ``(F, M, 3)`` from named runs.
    """

    def __init__(
        self,
        positions: FloatArray,
        tracklets: Tracklets,
        rate: float,
        run_markers: IntArray,
        rest_distances: FloatArray,
    ) -> None:
        """Start from runs and the names that are already known.

        rest_distances: Of the markers in a trial at rest ``(M, M)``; NaN where unknown.
        """
        self.positions, self.tracklets, self.rate = positions, tracklets, rate
        self.rest_distances = rest_distances
        self.run_count = len(tracklets.first)
        self.run_markers = run_markers.copy()
        self.marker_positions = self.marker_paths()

    def marker_paths(self) -> FloatArray:
        """Return each marker's positions from its runs ``(F, M, 3)``, NaN in gaps."""
        ids, marker_count = self.tracklets.ids, len(self.rest_distances)
        return positions_by_column(self.positions, ids, self.run_markers, marker_count)

    def name_runs(self) -> None:
        """Name the remaining runs, the clearest first."""
        for _ in range(LEARNING_ROUNDS):
            self._update_distances()
            self._reject_outliers()
            while self._name_clear_runs(is_forced=False) or self._name_clear_runs(
                is_forced=True
            ):
                pass
        self._update_distances()
        self._reject_outliers()

    def _update_distances(self) -> None:
        """Measure marker distances on the named runs, and mark all costs as stale."""
        self.marker_positions = self.marker_paths()
        take_distances = marker_distances(self.marker_positions)
        self.distances = _merge_known_distances(self.rest_distances, take_distances)
        self.costs = np.full((self.run_count, len(self.rest_distances)), np.inf)
        self.is_stale = np.ones(self.run_count, bool)

    def _reject_outliers(self) -> None:
        """Remove the names of runs that fit another marker, or none, clearly better."""
        for run in np.flatnonzero(self.run_markers >= 0).tolist():
            marker = int(self.run_markers[run])
            begin, end, path = self._run_positions(run)
            costs = self._shape_costs(path, begin, end)
            if costs[marker] > min(MAX_MARKER_COST, costs.min() + MIN_MARGIN):
                self.run_markers[run] = -1
                self.marker_positions[begin:end, marker] = np.nan

    def _name_clear_runs(self, *, is_forced: bool) -> bool:
        """Name unnamed runs with a clear best marker; return whether any was named.

        is_forced: Whether the best marker also counts without a margin to the second.
        """
        for run in np.flatnonzero(self.is_stale & (self.run_markers < 0)).tolist():
            self.costs[run] = self._marker_costs(run)
        self.is_stale[:] = False
        unnamed_runs = np.flatnonzero(self.run_markers < 0)
        if not len(unnamed_runs):
            return False
        smallest_costs = np.partition(self.costs[unnamed_runs], 1, axis=1)
        best_cost, rival_cost = smallest_costs[:, 0], smallest_costs[:, 1]
        is_clear = best_cost < MAX_MARKER_COST
        if not is_forced:
            is_clear &= rival_cost > np.where(is_clear, best_cost, 0.0) + MIN_MARGIN
        named_spans = np.zeros((0, 2), np.int64)
        first, last = self.tracklets.first, self.tracklets.last
        max_gap = int(BRIDGE_SECONDS * self.rate)
        for candidate_index in np.argsort(best_cost, kind="stable").tolist():
            if not is_clear[candidate_index]:
                continue
            run = int(unnamed_runs[candidate_index])
            marker = int(self.costs[run].argmin())
            begins, ends = named_spans[:, 0], named_spans[:, 1]
            is_overlapped = (begins <= last[run]) & (ends >= first[run])
            if is_overlapped.any() if is_forced else not self._is_free(run, marker):
                continue
            self.run_markers[run] = marker
            begin, end, path = self._run_positions(run)
            self.marker_positions[begin:end, marker] = path
            named_spans = np.vstack([named_spans, (begin - max_gap, end + max_gap)])
        for begin, end in named_spans.tolist():
            self.is_stale |= (first <= end) & (last >= begin)
        return len(named_spans) > 0

    def _is_free(self, run: int, marker: int) -> bool:
        """Return whether a marker has no position in the frames of a run."""
        begin, end = int(self.tracklets.first[run]), int(self.tracklets.last[run]) + 1
        return not np.isfinite(self.marker_positions[begin:end, marker, 0]).any()

    def _run_positions(self, run: int) -> tuple[int, int, FloatArray]:
        """Return a run's first frame, end frame and positions ``(L, 3)``."""
        begin, end = int(self.tracklets.first[run]), int(self.tracklets.last[run]) + 1
        return begin, end, self.tracklets.trajectory(self.positions, run)

    def _marker_costs(self, run: int) -> FloatArray:
        """Return each marker's cost for a run ``(M,)``, infinite if it is visible."""
        begin, end, path = self._run_positions(run)
        costs = self._shape_costs(path, begin, end) + self._gap_costs(path, begin, end)
        costs[np.isfinite(self.marker_positions[begin:end, :, 0]).any(axis=0)] = np.inf
        return costs

    def _shape_costs(self, path: FloatArray, begin: int, end: int) -> FloatArray:
        """Return each marker's cost of a run's distances to named markers ``(M,)``."""
        rows = np.linspace(0, end - begin - 1, SAMPLED_FRAME_COUNT).astype(np.int64)
        sampled_rows = np.unique(rows)
        marker_positions = self.marker_positions[begin + sampled_rows]
        offsets = marker_positions - path[sampled_rows][:, None]
        lengths = np.linalg.norm(offsets, axis=-1)  # (S, M)
        # The run itself may already have a name.
        is_known = np.isfinite(lengths) & (lengths > 0.0)
        spread = self.distances.spread
        weight = np.nan_to_num(1.0 / (1.0 + (spread / HALF_WEIGHT_SPREAD) ** 2))
        np.fill_diagonal(weight, 0.0)
        tolerance = DISTANCE_TOLERANCE + SPREAD_FACTOR * spread
        deviation = np.nan_to_num(lengths)[:, None] - self.distances.mean[None]
        deviation = deviation / tolerance[None]
        pair_costs = np.minimum(np.nan_to_num(deviation) ** 2, MAX_PAIR_COST)
        weights = weight[None] * is_known[:, None]
        weight_sum = weights.sum(axis=(0, 2))
        cost_sum = (pair_costs * weights).sum(axis=(0, 2))
        return np.where(weight_sum > 0, cost_sum / np.maximum(weight_sum, 1e-9), np.inf)

    def _gap_costs(self, path: FloatArray, begin: int, end: int) -> FloatArray:
        """Return each marker's cost of the motion across gaps around a run ``(M,)``."""
        max_gap = int(BRIDGE_SECONDS * self.rate)
        positions_before = self.marker_positions[max(begin - max_gap, 0) : begin][::-1]
        positions_after = self.marker_positions[end : end + max_gap]
        costs = np.zeros(len(self.rest_distances))
        for window, point in ((positions_before, path[0]), (positions_after, path[-1])):
            is_visible = np.isfinite(window[..., 0])
            for marker in np.flatnonzero(is_visible.any(axis=0)).tolist():
                gap = int(is_visible[:, marker].argmax())
                position, velocity = window[gap, marker], np.zeros(3)
                if gap + 3 < len(window) and is_visible[gap + 3, marker]:
                    velocity = (position - window[gap + 3, marker]) / 3.0
                distance = np.linalg.norm(point - position - velocity * (gap + 1))
                time = (gap + 1) / self.rate
                tolerance = (
                    GAP_NOISE + 0.5 * ACCELERATION * time**2 + SPEED_ERROR * time
                )
                costs[marker] += (distance / tolerance) ** 2
        return np.minimum(costs, MAX_GAP_COST)


def _merge_known_distances(
    rest_distances: FloatArray, take_distances: MarkerDistances
) -> MarkerDistances:
    """Return a take's distances, with those at rest where the take has none."""
    is_known = np.isfinite(take_distances.mean)
    mean = np.where(is_known, take_distances.mean, rest_distances)
    return MarkerDistances(
        mean, np.where(is_known, take_distances.spread, UNKNOWN_SPREAD * rest_distances)
    )

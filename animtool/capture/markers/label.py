"""Labels unnamed points by a static trial and their motion."""

from __future__ import annotations

from dataclasses import field
from itertools import combinations

import numpy as np

from animtool.capture.markers.chains import chain_runs, merge_chains
from animtool.capture.markers.geometry import (
    MarkerDistances,
    marker_distances,
    mean_square_errors,
    positions_by_column,
)
from animtool.capture.markers.naming import PointNaming, search_names
from animtool.capture.markers.plausible import plausibility_warnings
from animtool.capture.markers.runs import TrackletLabels
from animtool.capture.markers.tracklets import Tracklets, track_points
from animtool.capture.markers.twins import NameSwap, distinguish_twins, is_swapped
from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.clock import span_label
from animtool.core.errors import Fault, OptionError, warning
from animtool.core.record import dataclass
from animtool.motion.markers import Markers

# Initial labelling of runs: groups that stay rigid.

# Distances that vary less are within one segment [m].
MAX_RIGID_SPREAD = 0.006
# Largest shape error of a group of four that may start the naming [m].
MAX_SEED_ERROR = 0.003
# Tolerances for the distances of such a group, the second if the first finds none [m];
# and the number of partners that each run is grouped with.
SEED_TOLERANCE, LOOSE_SEED_TOLERANCE, SEED_PARTNERS = 0.002, 0.006, 7
MAX_RIGID_GROUPS = 400
# Number of starting groups, of which the one with the most evidence is kept.
MAX_SEEDS, MAX_RESTART_SEEDS = 3, 12
# Iterations of joining runs to chains.
CHAIN_ROUNDS = 2


def identify_runs(
    points: FloatArray, rest_shape: FloatArray, rest_distances: FloatArray
) -> IntArray | None:
    """Return the marker of each run of points ``(F, R, 3)``; None if nothing fits."""
    chain_of_run = np.arange(points.shape[1])
    for _ in range(CHAIN_ROUNDS):
        distances = marker_distances(points)
        is_visible = np.isfinite(points[..., 0]).astype(np.float64)
        next_chain = chain_runs(distances, is_visible.T @ is_visible)
        points, chain_of_run = (
            merge_chains(points, next_chain),
            next_chain[chain_of_run],
        )
    distances = marker_distances(points)
    is_visible = np.isfinite(points[..., 0]).astype(np.float64)
    groups = _rigid_groups(distances)
    seeds = _find_seeds(
        points, groups, distances, rest_shape, rest_distances, SEED_TOLERANCE
    )
    if not seeds:
        seeds = _find_seeds(
            points, groups, distances, rest_shape, rest_distances, LOOSE_SEED_TOLERANCE
        )
    initial_naming = PointNaming(distances, is_visible.T @ is_visible, rest_distances)
    merged_seed = _merge_seeds(seeds, initial_naming.are_concurrent)
    namings = []
    for seed in filter(None, [merged_seed, *seeds[:MAX_SEEDS]]):
        naming = initial_naming.copy()
        for point, marker in seed.items():
            naming.assign(point, marker)
        naming.assign_greedily()
        namings.append(naming)
    if not namings:
        return None
    best_naming = max(namings, key=PointNaming.total_evidence)
    naming = search_names(best_naming, rest_distances, seeds[:MAX_RESTART_SEEDS])
    return naming.point_markers[chain_of_run]


def _merge_seeds(
    seeds: list[dict[int, int]], are_concurrent: BoolArray
) -> dict[int, int]:
    """Merge seeds, point → marker, unless they contradict a better one before them."""
    merged_seed: dict[int, int] = {}
    for seed in seeds:
        if any(merged_seed.get(p, m) != m for p, m in seed.items()):
            continue
        extended_seed = merged_seed | seed
        points = np.array(list(extended_seed))
        markers = np.array(list(extended_seed.values()))
        is_clash = are_concurrent[np.ix_(points, points)] & (
            markers[:, None] == markers
        )
        np.fill_diagonal(is_clash, False)
        if not is_clash.any():
            merged_seed = extended_seed
    return merged_seed


def _find_seeds(
    points: FloatArray,
    groups: list[tuple[int, ...]],
    distances: MarkerDistances,
    rest_shape: FloatArray,
    rest_distances: FloatArray,
    tolerance: float,
) -> list[dict[int, int]]:
    """Return rigid groups as point → marker, by the error of their shape at rest."""
    seeds = []
    for group in groups:
        for markers in _match_markers(group, distances.mean, rest_distances, tolerance):
            shape_error = _shape_error(points[:, group], rest_shape[list(markers)])
            if shape_error < MAX_SEED_ERROR:
                seeds.append((shape_error, dict(zip(group, markers, strict=True))))
    seeds.sort(key=lambda entry: entry[0])
    return [pairs for _, pairs in seeds]


def _rigid_groups(distances: MarkerDistances) -> list[tuple[int, ...]]:
    """Return groups of four mutually rigid runs, the most rigid first."""
    spread = np.where(np.isfinite(distances.spread), distances.spread, np.inf)
    np.fill_diagonal(spread, np.inf)
    worst_spread: dict[tuple[int, ...], float] = {}
    for run, row in enumerate(spread):
        nearest_runs = np.argsort(row, kind="stable")[:SEED_PARTNERS]
        nearest_runs = nearest_runs[row[nearest_runs] < MAX_RIGID_SPREAD]
        for partners in combinations(nearest_runs.tolist(), 3):
            group = tuple(sorted((run, *partners)))
            if group not in worst_spread:
                pairs = combinations(group, 2)
                worst_spread[group] = max(float(spread[a, b]) for a, b in pairs)
    rigid_groups = sorted(
        (value, group)
        for group, value in worst_spread.items()
        if value < MAX_RIGID_SPREAD
    )
    return [group for _, group in rigid_groups[:MAX_RIGID_GROUPS]]


def _match_markers(
    group: tuple[int, ...],
    distances: FloatArray,
    rest_distances: FloatArray,
    tolerance: float,
) -> list[tuple[int, ...]]:
    """Return all marker tuples whose rest distances match those of a group of runs."""
    first_markers, second_markers = np.nonzero(
        np.abs(rest_distances - distances[group[1], group[0]]) < tolerance
    )
    partial_matches = np.stack([first_markers, second_markers], axis=1)
    partial_matches = partial_matches[first_markers != second_markers]
    for k in range(2, len(group)):
        group_distances = distances[group[k], group[:k]]
        deviation = np.abs(
            rest_distances[partial_matches] - group_distances[None, :, None]
        )
        is_match: BoolArray = np.asarray((deviation < tolerance).all(axis=1))
        is_match[np.arange(len(partial_matches))[:, None], partial_matches] = False
        match_indices, next_marker = np.nonzero(is_match)
        partial_matches = np.concatenate(
            [partial_matches[match_indices], next_marker[:, None]], axis=1
        )
    return [tuple(markers) for markers in partial_matches.tolist()]


def _shape_error(points: FloatArray, shape: FloatArray) -> float:
    """Return the median root mean square error of a shape's rigid fit to points [m]."""
    complete_points = points[np.isfinite(points).all(axis=(1, 2))][::8]
    if not len(complete_points):
        return np.inf
    return float(np.sqrt(np.median(mean_square_errors(complete_points, shape))))


# Minimum length of the runs that are named first [frame], and of the part of the take
# they come from [s].
MIN_RUN_FRAMES = 30
FIRST_SPAN_SECONDS = 10.0


@dataclass(frozen=True, slots=True)
class AmbiguousNames:
    """Markers whose names could be swapped without contradicting the capture."""

    markers: tuple[str, ...]  # names of the markers
    first: int  # first frame in which all of them are visible, from 0
    last: int  # last such frame
    # Evidence for the swap [nat]: 0 if it equals that for the assigned names,
    # negative if less.
    score: float


@dataclass(frozen=True, slots=True)
class LabelReport:
    """Result of labelling: how many points have names, and which names are doubtful."""

    frames: int  # number of frames
    markers: int  # number of names
    points: int  # visible points over all frames
    labelled: int  # points that got a name
    rejected: int  # points that are not markers
    runs: int  # number of gapless runs
    missing: list[str]  # names without a point in any frame
    coverage: dict[str, float]  # fraction of frames in which each name has a point
    # Markers that neither distances nor shapes distinguish.
    doubts: list[AmbiguousNames]
    notices: list[Fault] = field(default_factory=list)  # warnings

    @property
    def fraction(self) -> float:
        """Fraction of the points that have a name [1]."""
        return self.labelled / max(1, self.points)


def label_points(
    cloud: Markers, static: Markers, static_name: str = "the static trial"
) -> tuple[Markers, LabelReport]:
    """Label a point cloud with the marker names of a static trial.

    Points are joined to runs by their motion. Runs that keep their distance are on one
    segment: groups of them are matched to the trial by distances and handedness. Then
    runs are named one at a time, the clearest first. A run after a gap gets the name
    that fits its distances to the named runs. Points that fit no marker stay unnamed.

    Args:
        cloud: Points in any order, which may change from frame to frame.
        static: The subject's labelled static trial; its frames are averaged.
        static_name: Name of the trial in messages.
    """
    names, rest_shape = _static_template(static)
    rate = float(cloud.clock.rate)
    tracklets = track_points(cloud.positions, rate)
    marker_of_first_run = _name_first_runs(cloud, tracklets, rest_shape)
    if marker_of_first_run is None:
        message = f"no group of points moves like any segment of {static_name}"
        hint = (
            f"does {static_name} show the same subject, with the same markers and unit?"
        )
        raise OptionError(Fault("MKR021", message, hint=hint))
    rest_distances = np.linalg.norm(rest_shape[:, None] - rest_shape[None], axis=-1)
    labels = TrackletLabels(
        cloud.positions, tracklets, rate, marker_of_first_run, rest_distances
    )
    new_marker_of, swaps, pairs = distinguish_twins(labels.marker_paths(), rest_shape)
    is_named = labels.run_markers >= 0
    labels.run_markers = np.where(is_named, new_marker_of[labels.run_markers], -1)
    for pair in pairs:
        _swap_where_better(labels, rest_shape, pair)
    labels.name_runs()
    return _apply_names(cloud, names, tracklets, labels.run_markers, swaps)


def _static_template(static: Markers) -> tuple[tuple[str, ...], FloatArray]:
    """Return names and median positions ``(M, 3)`` of a static trial's markers."""
    visible_columns = np.flatnonzero(static.visible.any(axis=0)).tolist()
    columns = [i for i in visible_columns if not static.names[i].startswith("*")]
    if len(columns) < 4:
        message = f"the trial has {len(columns)} labelled markers; labelling needs 4"
        raise OptionError(Fault("MKR020", message))
    rest_shape = np.nanmedian(static.positions[:, columns], axis=0)
    return tuple(static.names[i] for i in columns), rest_shape


def _apply_names(
    cloud: Markers,
    names: tuple[str, ...],
    tracklets: Tracklets,
    run_markers: IntArray,
    swaps: list[NameSwap],
) -> tuple[Markers, LabelReport]:
    """Return the cloud with a named marker for each name, and the report."""
    frame_count = len(cloud)
    point_indices = np.full((frame_count, len(names)), -1)
    ids = tracklets.ids
    marker_of_point = np.where(ids >= 0, run_markers[ids], -1)
    frame_indices, points = np.nonzero(marker_of_point >= 0)
    point_indices[frame_indices, marker_of_point[frame_indices, points]] = points

    labelled_cloud = cloud.rearrange(point_indices, names)
    fractions = (point_indices >= 0).mean(axis=0)
    point_count, labelled_count = int((ids >= 0).sum()), int((point_indices >= 0).sum())
    coverage = dict(zip(names, fractions.tolist(), strict=True))
    missing_names = [name for name, fraction in coverage.items() if not fraction]
    notices = plausibility_warnings(cloud)
    if missing_names:
        message = f"no points were found for {', '.join(missing_names)}"
        notices.append(warning("MKR110", message))
    doubts = _swap_doubts(labelled_cloud, swaps)
    if doubts:
        notices.append(_doubt_warning(doubts, cloud))
    report = LabelReport(
        frame_count, len(names), point_count, labelled_count,
        point_count - labelled_count, len(tracklets.first), missing_names,
        coverage, doubts, notices,
    )  # fmt: skip
    return labelled_cloud, report


def _swap_doubts(
    labelled_cloud: Markers, swaps: list[NameSwap]
) -> list[AmbiguousNames]:
    """Return doubtful swaps as names, with the first and last frame of all."""
    doubts = []
    for swap in swaps:
        markers = list(swap.markers)
        shared_frames = np.flatnonzero(labelled_cloud.visible[:, markers].all(axis=1))
        if len(shared_frames):
            names = tuple(labelled_cloud.names[marker] for marker in markers)
            score = round(swap.score, 3)
            first, last = shared_frames[[0, -1]].tolist()
            doubts.append(AmbiguousNames(names, first, last, score))
    return doubts


def _doubt_warning(doubts: list[AmbiguousNames], cloud: Markers) -> Fault:
    """Return a warning that lists doubtful names and their frames (MKR116)."""
    doubt_texts = []
    for doubt in doubts:
        first, last = cloud.clock.times[[doubt.first, doubt.last]]
        frames = f"frames {span_label(first, last)}"
        doubt_texts.append(f"{', '.join(doubt.markers)} ({frames})")
    message = "by distances and shapes, these names could be swapped: "
    message += "; ".join(doubt_texts)
    hint = "look at a frame; a trial with a pose nearer to the take would tell them "
    hint += "apart"
    return warning("MKR116", message, hint)


def _name_first_runs(
    cloud: Markers, tracklets: Tracklets, rest_shape: FloatArray
) -> IntArray | None:
    """Name the long runs of the span with most of them ``(T,)``; -1 for the others.

    Return None if no group of runs fits the markers at rest.
    """
    frames, long_tracklets = _find_first_span(
        tracklets, len(cloud), float(cloud.clock.rate)
    )
    rest_distances = np.linalg.norm(rest_shape[:, None] - rest_shape[None], axis=-1)
    column_of_tracklet = np.full(len(tracklets.first) + 1, -1)
    column_of_tracklet[long_tracklets] = np.arange(len(long_tracklets))
    points = positions_by_column(
        cloud.positions[frames],
        tracklets.ids[frames],
        column_of_tracklet,
        len(long_tracklets),
    )
    markers = identify_runs(points, rest_shape, rest_distances)
    if markers is None:
        return None
    run_markers = np.full(len(tracklets.first), -1)
    run_markers[long_tracklets] = markers
    return run_markers


def _find_first_span(
    tracklets: Tracklets, frame_count: int, rate: float
) -> tuple[slice, IntArray]:
    """Return the frames that long runs cover best, and the indices of those runs."""
    first, last = tracklets.first, tracklets.last
    span_length = min(frame_count, max(MIN_RUN_FRAMES, int(FIRST_SPAN_SECONDS * rate)))
    best_start, best_score = 0, -1
    for start in range(0, frame_count - span_length + 1, max(1, span_length // 4)):
        ends = np.minimum(last, start + span_length - 1)
        shared_frames = ends - np.maximum(first, start) + 1
        frame_score = int(shared_frames[shared_frames > MIN_RUN_FRAMES].sum())
        if frame_score > best_score:
            best_start, best_score = start, frame_score
    end = best_start + span_length
    shared_frames = np.minimum(last, end - 1) - np.maximum(first, best_start) + 1
    return slice(best_start, end), np.flatnonzero(
        shared_frames >= min(MIN_RUN_FRAMES, span_length)
    )


def _swap_where_better(
    labels: TrackletLabels, rest_shape: FloatArray, pair: tuple[int, int]
) -> None:
    """Swap two markers' runs where the rest shape then fits better.

    Runs are tested in groups that end at a gap of both markers.
    """
    pair_run_indices = np.flatnonzero(np.isin(labels.run_markers, pair))
    first, last = labels.tracklets.first, labels.tracklets.last
    pair_run_indices = pair_run_indices[
        np.argsort(first[pair_run_indices], kind="stable")
    ]
    ends = np.maximum.accumulate(last[pair_run_indices])
    run_groups = np.split(
        pair_run_indices, np.flatnonzero(first[pair_run_indices][1:] > ends[:-1]) + 1
    )
    if len(run_groups) < 2:
        return
    marker_positions = labels.marker_paths()
    for run_group in run_groups:
        end = int(last[run_group].max()) + 1
        frames = slice(int(first[run_group].min()), end)
        if is_swapped(marker_positions[frames], rest_shape, pair):
            markers = labels.run_markers[run_group]
            labels.run_markers[run_group] = sum(pair) - markers

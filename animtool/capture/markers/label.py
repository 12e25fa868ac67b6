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
from animtool.capture.markers.twins import Exchange, distinguish_twins, is_exchanged
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
SEED_TOLERANCE, LOOSE_SEED_TOLERANCE, PARTNERS = 0.002, 0.006, 7
MAX_GROUPS = 400
# Number of starting groups, of which the one with the most evidence is kept.
MAX_SEEDS, MAX_SEED_GROUPS = 3, 12
# Iterations of joining runs to chains.
CHAIN_ROUNDS = 2


def identify_runs(
    points: FloatArray, shape: FloatArray, rest: FloatArray
) -> IntArray | None:
    """Return the marker of each run of a window ``(R,)``; None if nothing fits."""
    chain = np.arange(points.shape[1])
    for _ in range(CHAIN_ROUNDS):
        distances = marker_distances(points)
        visible = np.isfinite(points[..., 0]).astype(np.float64)
        new_chain = chain_runs(distances, visible.T @ visible)
        points, chain = merge_chains(points, new_chain), new_chain[chain]
    distances = marker_distances(points)
    visible = np.isfinite(points[..., 0]).astype(np.float64)
    groups = _rigid_groups(distances)
    seeds = _find_seeds(points, groups, distances, shape, rest, SEED_TOLERANCE)
    if not seeds:
        seeds = _find_seeds(
            points, groups, distances, shape, rest, LOOSE_SEED_TOLERANCE
        )
    initial_naming = PointNaming(distances, visible.T @ visible, rest)
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
    return search_names(best_naming, rest, seeds[:MAX_SEED_GROUPS]).names_of[chain]


def _merge_seeds(seeds: list[dict[int, int]], together: BoolArray) -> dict[int, int]:
    """Merge the marker names of groups that do not contradict better groups."""
    names: dict[int, int] = {}
    for seed in seeds:
        if any(names.get(point, marker) != marker for point, marker in seed.items()):
            continue
        combined_names = names | seed
        points = np.array(list(combined_names))
        markers = np.array(list(combined_names.values()))
        is_clash = together[np.ix_(points, points)] & (markers[:, None] == markers)
        np.fill_diagonal(is_clash, False)
        if not is_clash.any():
            names = combined_names
    return names


def _find_seeds(
    points: FloatArray,
    groups: list[tuple[int, ...]],
    distances: MarkerDistances,
    shape: FloatArray,
    rest: FloatArray,
    tolerance: float,
) -> list[dict[int, int]]:
    """Return groups of rigid runs with their candidate markers, best first."""
    seeds = []
    for group in groups:
        for markers in _matching_markers(group, distances.mean, rest, tolerance):
            error = _shape_error(points[:, group], shape[list(markers)])
            if error < MAX_SEED_ERROR:
                seeds.append((error, dict(zip(group, markers, strict=True))))
    seeds.sort(key=lambda entry: entry[0])
    return [pairs for _, pairs in seeds]


def _rigid_groups(distances: MarkerDistances) -> list[tuple[int, ...]]:
    """Return groups of four mutually rigid runs, the most rigid first."""
    spread = np.where(np.isfinite(distances.spread), distances.spread, np.inf)
    np.fill_diagonal(spread, np.inf)
    worst_spread: dict[tuple[int, ...], float] = {}
    for run, row in enumerate(spread):
        nearest_runs = np.argsort(row, kind="stable")[:PARTNERS]
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
    return [group for _, group in rigid_groups[:MAX_GROUPS]]


def _matching_markers(
    group: tuple[int, ...], lengths: FloatArray, rest: FloatArray, tolerance: float
) -> list[tuple[int, ...]]:
    """Return all tuples of markers whose rest distances match a group of runs."""
    first, second = np.nonzero(np.abs(rest - lengths[group[1], group[0]]) < tolerance)
    partial_matches = np.stack([first, second], axis=1)
    partial_matches = partial_matches[first != second]
    for k in range(2, len(group)):
        group_lengths = lengths[group[k], group[:k]]
        deviation = np.abs(rest[partial_matches] - group_lengths[None, :, None])
        is_match: BoolArray = np.asarray((deviation < tolerance).all(axis=1))
        is_match[np.arange(len(partial_matches))[:, None], partial_matches] = False
        match_indices, marker = np.nonzero(is_match)
        partial_matches = np.concatenate(
            [partial_matches[match_indices], marker[:, None]], axis=1
        )
    return [tuple(markers) for markers in partial_matches.tolist()]


def _shape_error(points: FloatArray, shape: FloatArray) -> float:
    """Return the rigid fit error of a shape to points, without reflections [m]."""
    complete_frames = points[np.isfinite(points).all(axis=(1, 2))][::8]
    if not len(complete_frames):
        return np.inf
    return float(np.sqrt(np.median(mean_square_errors(complete_frames, shape))))


# Minimum length of the runs that are named first [frame], and of the part of the take
# they come from [s].
MIN_RUN_FRAMES = 30
BASE_SECONDS = 10.0


@dataclass(frozen=True, slots=True)
class Doubt:
    """Markers whose names could be exchanged."""

    markers: tuple[str, ...]  # names of the markers
    first: int  # first frame in which all of them are visible, from 0
    last: int  # last such frame
    # Evidence for the exchange [nat]: 0 if it equals that for the assigned names,
    # negative if less.
    score: float


@dataclass(frozen=True, slots=True)
class LabelReport:
    """Result of labelling: named points, and names that stay in doubt."""

    frames: int  # number of frames
    markers: int  # number of names
    points: int  # visible points over all frames
    labelled: int  # points that got a name
    rejected: int  # points that are not markers
    runs: int  # number of gapless runs
    missing: list[str]  # names without a point in any frame
    coverage: dict[str, float]  # fraction of frames in which each name has a point
    doubts: list[Doubt]  # markers that neither distances nor shapes distinguish
    notices: list[Fault] = field(default_factory=list)  # warnings

    @property
    def fraction(self) -> float:
        """Fraction of the points that have a name [1]."""
        return self.labelled / max(1, self.points)


def label_points(cloud: Markers, static: Markers) -> tuple[Markers, LabelReport]:
    """Label a point cloud with the marker names of a static trial.

    Points are joined to runs by their motion. Runs that keep their distance are on one
    segment: groups of them are matched to the trial by distances and handedness. Then
    runs are named one at a time, the clearest first. A run after a gap gets the name
    that fits its distances to the named runs. Points that fit no marker stay unnamed.

    Args:
        cloud: Points in any order, which may change from frame to frame.
        static: The subject's labelled static trial; its frames are averaged.
    """
    names, rest = _static_template(static)
    rate = float(cloud.clock.rate)
    tracklets = track_points(cloud.positions, rate)
    first_names = _name_first_runs(cloud, tracklets, rest)
    if first_names is None:
        message = "no group of points moves like a segment of the trial"
        hint = "does it show the same subject, with the same markers and unit?"
        raise OptionError(Fault("MKR021", message, hint=hint))
    lengths = np.linalg.norm(rest[:, None] - rest[None], axis=-1)
    tracklet_labels = TrackletLabels(
        cloud.positions, tracklets, rate, first_names, lengths
    )
    names_of, exchanges, pairs = distinguish_twins(tracklet_labels.marker_paths(), rest)
    is_named = tracklet_labels.names_of >= 0
    tracklet_labels.names_of = np.where(
        is_named, names_of[tracklet_labels.names_of], -1
    )
    for pair in pairs:
        _exchange_parts(tracklet_labels, rest, pair)
    tracklet_labels.name_runs()
    return _apply_names(cloud, names, tracklets, tracklet_labels.names_of, exchanges)


def _static_template(static: Markers) -> tuple[tuple[str, ...], FloatArray]:
    """Return names and mean positions ``(M, 3)`` of the markers of a trial at rest."""
    visible_columns = np.flatnonzero(static.visible.any(axis=0)).tolist()
    columns = [i for i in visible_columns if not static.names[i].startswith("*")]
    if len(columns) < 4:
        message = f"the trial has {len(columns)} labelled markers; labelling needs 4"
        raise OptionError(Fault("MKR020", message))
    rest = np.nanmedian(static.positions[:, columns], axis=0)
    return tuple(static.names[i] for i in columns), rest


def _apply_names(
    cloud: Markers,
    names: tuple[str, ...],
    tracklets: Tracklets,
    name_of_run: IntArray,
    exchanges: list[Exchange],
) -> tuple[Markers, LabelReport]:
    """Return the cloud with labelled markers."""
    frames = len(cloud)
    slots = np.full((frames, len(names)), -1)
    ids = tracklets.ids
    marker = np.where(ids >= 0, name_of_run[ids], -1)
    frame, slot = np.nonzero(marker >= 0)
    slots[frame, marker[frame, slot]] = slot

    labelled_cloud = cloud.rearrange(slots, names)
    coverage = (slots >= 0).mean(axis=0)
    point_count, labelled_count = int((ids >= 0).sum()), int((slots >= 0).sum())
    coverage_values = dict(zip(names, coverage.tolist(), strict=True))
    missing = [name for name, fraction in coverage_values.items() if not fraction]
    notices = plausibility_warnings(cloud)
    if missing:
        message = f"no points were found for {', '.join(missing)}"
        notices.append(warning("MKR110", message))
    doubts = _exchange_doubts(labelled_cloud, exchanges)
    if doubts:
        notices.append(_doubt_warning(doubts, cloud))
    report = LabelReport(
        frames, len(names), point_count, labelled_count, point_count - labelled_count,
        len(tracklets.first), missing, coverage_values, doubts, notices,
    )  # fmt: skip
    return labelled_cloud, report


def _exchange_doubts(labelled_cloud: Markers, exchanges: list[Exchange]) -> list[Doubt]:
    """Return the doubtful name exchanges, with the frames that they affect."""
    doubts = []
    for exchange in exchanges:
        markers = list(exchange.markers)
        visible = np.flatnonzero(labelled_cloud.visible[:, markers].all(axis=1))
        if len(visible):
            names = tuple(labelled_cloud.names[marker] for marker in markers)
            score = round(exchange.score, 3)
            doubts.append(Doubt(names, int(visible[0]), int(visible[-1]), score))
    return doubts


def _doubt_warning(doubts: list[Doubt], cloud: Markers) -> Fault:
    """Return a warning that lists the markers whose names could be exchanged."""
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
    cloud: Markers, tracklets: Tracklets, rest_positions: FloatArray
) -> IntArray | None:
    """Return the marker of each long run, -1 for the others; None if nothing fits."""
    frames, runs = _base_frames(tracklets, len(cloud), float(cloud.clock.rate))
    lengths = np.linalg.norm(rest_positions[:, None] - rest_positions[None], axis=-1)
    column_of_run = np.full(len(tracklets.first) + 1, -1)
    column_of_run[runs] = np.arange(len(runs))
    points = positions_by_column(
        cloud.positions[frames], tracklets.ids[frames], column_of_run, len(runs)
    )
    names = identify_runs(points, rest_positions, lengths)
    if names is None:
        return None
    name_of_run = np.full(len(tracklets.first), -1)
    name_of_run[runs] = names
    return name_of_run


def _base_frames(
    tracklets: Tracklets, frames: int, rate: float
) -> tuple[slice, IntArray]:
    """Return the frames with the longest runs, to label first, and these runs."""
    first, last = tracklets.first, tracklets.last
    length = min(frames, max(MIN_RUN_FRAMES, int(BASE_SECONDS * rate)))
    best_start, best_count = 0, -1
    for start in range(0, frames - length + 1, max(1, length // 4)):
        ends = np.minimum(last, start + length - 1)
        shared_frames = ends - np.maximum(first, start) + 1
        score = int(shared_frames[shared_frames > MIN_RUN_FRAMES].sum())
        if score > best_count:
            best_start, best_count = start, score
    end = best_start + length
    shared_frames = np.minimum(last, end - 1) - np.maximum(first, best_start) + 1
    return slice(best_start, end), np.flatnonzero(
        shared_frames >= min(MIN_RUN_FRAMES, length)
    )


def _exchange_parts(
    tracklet_labels: TrackletLabels, rest_positions: FloatArray, pair: tuple[int, int]
) -> None:
    """Exchange two names in those parts of a take in which the shape fits better.

    A part ends at a gap of both markers, where continuity is lost.
    """
    runs = np.flatnonzero(np.isin(tracklet_labels.names_of, pair))
    first, last = tracklet_labels.tracklets.first, tracklet_labels.tracklets.last
    runs = runs[np.argsort(first[runs], kind="stable")]
    ends = np.maximum.accumulate(last[runs])
    parts_of_take = np.split(runs, np.flatnonzero(first[runs][1:] > ends[:-1]) + 1)
    if len(parts_of_take) < 2:
        return
    marker_positions = tracklet_labels.marker_paths()
    for runs_in_part in parts_of_take:
        end = int(last[runs_in_part].max()) + 1
        frames = slice(int(first[runs_in_part].min()), end)
        if is_exchanged(marker_positions[frames], rest_positions, pair):
            names = tracklet_labels.names_of[runs_in_part]
            tracklet_labels.names_of[runs_in_part] = sum(pair) - names

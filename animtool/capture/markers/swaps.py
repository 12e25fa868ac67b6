"""Repair of temporarily swapped marker names."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from animtool.capture.markers.geometry import MarkerDistances, marker_distances
from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.record import dataclass
from animtool.maths.runs import merge_runs, runs
from animtool.motion.markers import Markers

# Minimum frames of a swap; a shorter one is a spike.
MIN_SWAP_FRAMES = 4
# Tolerance of an extrapolated position: noise [m], acceleration of a marker without a
# history [m/s^2], and its speed [m/s]. Otherwise the acceleration is a multiple of the
# marker's median, at least the minimum [m/s^2].
POSITION_NOISE, DEFAULT_ACCELERATION, SPEED_ERROR = 0.003, 100.0, 3.0
MIN_ACCELERATION, ACCELERATION_FACTOR = 20.0, 6.0
# Acceleration of a marker on a throwing hand: markers within reach are candidates
# [m/s^2].
MAX_ACCELERATION = 500.0
# Longest gap over which a marker's position is predicted [s].
BRIDGE_SECONDS = 0.1
# Number of past samples for the velocity.
PAST_SAMPLES = 3
# A jump leads to another marker's position if that is this many times nearer.
MIN_DISTANCE_RATIO = 2.5
# Cost of an arbitrary position, of a change of names, and of a swapped frame:
# without other evidence, the shorter part is the swapped one.
ARBITRARY_COST, NAME_CHANGE_COST, SWAPPED_FRAME_COST = 16.0, 5.0, 0.002
# Distances to other markers are weaker evidence than frame-to-frame motion: the largest
# evidence of a span, and the number of its frames that are sampled.
MAX_SHAPE_GAIN, SHAPE_SAMPLES = 4.0, 24
# Tolerance of a distance: noise and skin motion [m], and a factor on its spread.
DISTANCE_TOLERANCE, SPREAD_FACTOR = 0.006, 1.5
# Minimum log-likelihood gain of a swap.
MIN_SWAP_GAIN = 2.0


@dataclass(frozen=True, slots=True)
class Swap:
    """A span of frames in which two markers had each other's names."""

    markers: tuple[str, str]  # the two, in the order of the file
    first: int  # first frame, from 0
    last: int  # last frame


def repair_swaps(markers: Markers) -> tuple[Markers, list[Swap]]:
    """Undo swaps of marker names, and list them.

    A pair of markers is tested over the full take if one jumps to the other's expected
    position. Of all swaps of their names in spans of frames, the one is kept in
    which both move most smoothly and keep their typical distances to the others.
    """
    swaps: list[Swap] = []
    marker_count = len(markers.names)
    if marker_count < 2 or not markers.visible.any():
        return markers, swaps
    rate = float(markers.clock.rate)
    positions = markers.positions.copy()
    source_column = np.tile(np.arange(marker_count), (len(markers), 1))
    distances: MarkerDistances | None = None
    crossing_by_pair: dict[tuple[int, int], tuple[float, BoolArray]] = {}
    tested_pairs: set[tuple[int, int]] = set()
    while True:
        for a, b in _jump_pairs(positions, rate):
            if (a, b) not in crossing_by_pair and (a, b) not in tested_pairs:
                distances = distances or marker_distances(positions)
                crossing_by_pair[a, b] = _find_crossed_frames(
                    positions, a, b, rate, distances
                )
        # The clearest pair first: among three markers it decides about the others.
        clearest_pair = max(
            crossing_by_pair,
            key=lambda pair: (crossing_by_pair[pair][0], pair),
            default=None,
        )
        if clearest_pair is None or crossing_by_pair[clearest_pair][0] < MIN_SWAP_GAIN:
            break
        pair = list(clearest_pair)
        names = (markers.names[pair[0]], markers.names[pair[1]])
        is_crossed = crossing_by_pair[clearest_pair][1]
        for first, last in _swap_spans(is_crossed, positions[:, pair]):
            swaps.append(Swap(names, first, last))
            span = slice(first, last + 1)
            positions[span, pair] = positions[span, pair[::-1]]
            source_column[span, pair] = source_column[span, pair[::-1]]
        tested_pairs.add(clearest_pair)
        crossing_by_pair = {
            other_pair: crossing
            for other_pair, crossing in crossing_by_pair.items()
            if not set(other_pair) & set(clearest_pair)
        }
    swaps.sort(key=lambda swap: (swap.first, swap.markers))
    if not swaps:
        return markers, swaps
    return markers.rearrange(source_column, markers.names), swaps


def _expected_positions(
    positions: FloatArray, rate: float, acceleration: float = DEFAULT_ACCELERATION
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Extrapolate each marker linearly from its last visible frames ``(F, M, 3)``.

    Also return tolerances [m] and a mask of the frames shortly after those ``(F, M)``.
    """
    frame_count, marker_count, _ = positions.shape
    is_visible = np.isfinite(positions[..., 0])
    frames = np.arange(frame_count)[:, None]
    last_frames = np.maximum.accumulate(np.where(is_visible, frames, -1), axis=0)
    last_frames = np.vstack([np.full((1, marker_count), -1), last_frames[:-1]])
    all_markers = np.arange(marker_count)
    frames_since = frames - last_frames
    is_known = (last_frames >= 0) & (frames_since <= BRIDGE_SECONDS * rate + 1)
    last_position = positions[np.maximum(last_frames, 0), all_markers]
    velocity = np.zeros_like(last_position)
    has_velocity = np.zeros(is_visible.shape, bool)
    for samples_back in range(1, PAST_SAMPLES):
        past_positions = positions[
            np.maximum(last_frames - samples_back, 0), all_markers
        ]
        # The earliest sample of a gapless run gives the velocity.
        is_usable = (
            (last_frames >= samples_back)
            & np.isfinite(past_positions[..., 0])
            & (has_velocity | (samples_back == 1))
        )
        displacements = last_position[is_usable] - past_positions[is_usable]
        velocity[is_usable] = displacements / samples_back
        has_velocity = is_usable if samples_back == 1 else has_velocity
    time = frames_since / rate
    tolerance = POSITION_NOISE + 0.5 * acceleration * time**2
    tolerance += np.where(has_velocity, 0.0, SPEED_ERROR * time)
    return last_position + velocity * frames_since[..., None], tolerance, is_known


def _jump_pairs(positions: FloatArray, rate: float) -> list[tuple[int, int]]:
    """Return pairs of markers where one jumps to the other, by number of jumps."""
    predictions, tolerance, is_known = _expected_positions(positions, rate)
    is_visible = np.isfinite(positions[..., 0])
    deviations = np.linalg.norm(positions - predictions, axis=-1)
    is_continuous = is_visible & is_known & (deviations <= tolerance)
    jump_counts: dict[tuple[int, int], int] = {}
    jump_frames, jump_markers = np.nonzero(is_visible & ~is_continuous)
    points = positions[jump_frames, jump_markers]
    distances = np.linalg.norm(points[:, None] - predictions[jump_frames], axis=-1)
    jump_sizes = np.where(is_known, deviations, np.inf)[jump_frames, jump_markers]
    max_distance = tolerance * (MAX_ACCELERATION / DEFAULT_ACCELERATION)
    is_reached = is_known[jump_frames] & (distances <= max_distance[jump_frames])
    is_reached &= ~is_continuous[jump_frames]
    is_reached &= MIN_DISTANCE_RATIO * distances < jump_sizes[:, None]
    is_reached[np.arange(len(jump_markers)), jump_markers] = False
    for k, target in np.argwhere(is_reached).tolist():
        pair = tuple(sorted((int(jump_markers[k]), target)))
        jump_counts[pair] = jump_counts.get(pair, 0) + 1  # type: ignore[index,arg-type]
    return sorted(jump_counts, key=lambda pair: (-jump_counts[pair], pair))


@dataclass(frozen=True, slots=True)
class _SwapPath:
    """A path of the Viterbi search: when two markers' names changed, and its cost."""

    cost: float  # negative log-likelihood
    state: int  # 1 if the names are swapped at its end, else 0
    changes: tuple[int, ...]  # frames in which the state changes
    past_positions: list[list[Any]]  # last visible frames and positions of both markers


def _find_crossed_frames(
    positions: FloatArray,
    first_marker: int,
    second_marker: int,
    rate: float,
    typical_distances: MarkerDistances,
) -> tuple[float, BoolArray]:
    """Find the frames in which two markers have each other's names ``(F,)``.

    The log-likelihood gain over no swap is returned first.

    Viterbi search: of the paths that end normally and of those that end swapped, the
    best one is kept from frame to frame, with the last visible positions of both
    markers.
    """
    pair_positions = positions[:, [first_marker, second_marker]]
    is_pair_visible = np.isfinite(pair_positions[..., 0])
    acceleration = _typical_acceleration(pair_positions, rate)
    predictions, tolerance, is_known = _expected_positions(
        pair_positions, rate, acceleration
    )
    deviations = np.linalg.norm(pair_positions - predictions, axis=-1)
    is_smooth = ~is_pair_visible | (is_known & (deviations <= tolerance))
    # In frames without events, both keep their names.
    is_unchanged = np.vstack(
        [np.zeros((1, 2), bool), is_pair_visible[1:] == is_pair_visible[:-1]]
    )
    event_frames = np.flatnonzero(~(is_smooth & is_unchanged).all(axis=1)).tolist()
    event_frames = sorted({0, *event_frames})
    event_ends = [*event_frames[1:], len(pair_positions)]
    initial_path = _SwapPath(0.0, 0, (), [[], []])
    paths = [initial_path, _SwapPath(NAME_CHANGE_COST, 1, (0,), [[], []])]
    points, is_visible = pair_positions.tolist(), is_pair_visible.tolist()
    for start, end in zip(event_frames, event_ends, strict=True):
        shape_gain = _shape_gain(
            positions, first_marker, second_marker, start, end, typical_distances
        )
        length = int(is_pair_visible[start:end].any(axis=1).sum())
        costs_by_state = (
            max(0.0, shape_gain),
            max(0.0, -shape_gain) + SWAPPED_FRAME_COST * length,
        )

        def extend(
            path: _SwapPath,
            state: int,
            start: int = start,
            end: int = end,
            costs_by_state: tuple[float, float] = costs_by_state,
        ) -> _SwapPath:
            """Extend a path by a span in a state: 0 own names, 1 swapped names."""
            cost, changes = path.cost + costs_by_state[state], path.changes
            if state != path.state:
                cost, changes = cost + NAME_CHANGE_COST, (*changes, start)
            past_positions = []
            for marker, past in enumerate(path.past_positions):
                column = marker ^ state
                if start and is_visible[start][column]:
                    point = points[start][column]
                    cost += _position_cost(past, start, point, rate, acceleration)
                new_positions = [
                    (frame, points[frame][column])
                    for frame in range(max(start, end - PAST_SAMPLES), end)
                    if is_visible[frame][column]
                ]
                past_positions.append([*past, *new_positions][-PAST_SAMPLES:])
            return _SwapPath(cost, state, changes, past_positions)

        initial_path = extend(initial_path, 0)
        if start == 0:
            paths = [extend(path, path.state) for path in paths]
        else:
            paths = [
                min((extend(path, state) for path in paths), key=lambda path: path.cost)
                for state in (0, 1)
            ]
    best_path = min(paths, key=lambda path: path.cost)
    crossing_state = np.zeros(len(pair_positions), np.int64)
    for change in best_path.changes:
        crossing_state[change:] ^= 1
    return initial_path.cost - best_path.cost, crossing_state.astype(bool)


def _typical_acceleration(pair_positions: FloatArray, rate: float) -> float:
    """Estimate the largest acceleration of two markers from its median [m/s^2]."""
    second_differences = np.linalg.norm(np.diff(pair_positions, 2, axis=0), axis=-1)
    valid_differences = second_differences[np.isfinite(second_differences)]
    if not len(valid_differences):
        return DEFAULT_ACCELERATION
    max_acceleration = ACCELERATION_FACTOR * np.median(valid_differences) * rate**2
    return float(np.clip(max_acceleration, MIN_ACCELERATION, DEFAULT_ACCELERATION))


def _position_cost(
    past: list[Any], frame: int, point: list[float], rate: float, acceleration: float
) -> float:
    """Return the cost of a position after up to `PAST_SAMPLES` earlier positions.

    It is a negative log-likelihood, bounded by that of an arbitrary position.
    """
    if not past:
        return ARBITRARY_COST
    last_frame, last_position = past[-1]
    age = frame - last_frame
    first_frame, first_position = next(
        sample for sample in past if last_frame - sample[0] < PAST_SAMPLES
    )
    frames_between = last_frame - first_frame
    step_ratio = age / frames_between if frames_between else 0.0
    squared_distance: float = sum(
        (p - x - step_ratio * (x - y)) ** 2
        for p, x, y in zip(point, last_position, first_position, strict=True)
    )
    time = age / rate
    tolerance = POSITION_NOISE + 0.5 * acceleration * time**2
    if not frames_between:
        tolerance += SPEED_ERROR * time
    log_volume = 3.0 * math.log(tolerance / POSITION_NOISE)
    cost: float = 0.5 * squared_distance / tolerance**2 + log_volume
    return min(cost, ARBITRARY_COST)


def _shape_gain(
    positions: FloatArray,
    first_marker: int,
    second_marker: int,
    start: int,
    end: int,
    typical_distances: MarkerDistances,
) -> float:
    """Return the log-likelihood gain of a swap from distances to other markers."""
    if end - start < MIN_SWAP_FRAMES:
        return 0.0
    frames = np.unique(np.linspace(start, end - 1, SHAPE_SAMPLES).astype(np.int64))
    others = np.setdiff1d(np.arange(positions.shape[1]), (first_marker, second_marker))
    gains = []
    for marker, partner in (
        (first_marker, second_marker),
        (second_marker, first_marker),
    ):
        offsets = positions[frames][:, others] - positions[frames, marker][:, None]
        frame_distances = np.linalg.norm(offsets, axis=-1)
        costs = []
        for named_marker in (marker, partner):
            spread = typical_distances.spread[named_marker, others]
            mean = typical_distances.mean[named_marker, others]
            deviation = (frame_distances - mean) / (
                DISTANCE_TOLERANCE + SPREAD_FACTOR * spread
            )
            costs.append(np.minimum(deviation**2, 9.0))
        is_known = np.isfinite(costs[0] - costs[1])
        if is_known.any():
            scale = DISTANCE_TOLERANCE + np.minimum(
                typical_distances.spread[marker, others],
                typical_distances.spread[partner, others],
            )
            weight = np.where(is_known, (DISTANCE_TOLERANCE / scale) ** 2, 0.0)
            gain = np.where(is_known, costs[0] - costs[1], 0.0)
            if weight.sum() > 0:
                gains.append(float((weight * gain).sum() / weight.sum()))
    return float(np.clip(MAX_SHAPE_GAIN * sum(gains), -MAX_SHAPE_GAIN, MAX_SHAPE_GAIN))


def _swap_spans(
    is_crossed: BoolArray, pair_positions: FloatArray
) -> list[tuple[int, int]]:
    """Return first and last frames of crossed spans that are long enough.

    A span that begins or ends in a gap of both markers begins or ends in its middle.
    """
    is_visible = np.asarray(np.isfinite(pair_positions[..., 0]).any(axis=1))
    spans = []
    # A few normal frames between swapped ones are a spike.
    for first, end in merge_runs(runs(is_crossed), MIN_SWAP_FRAMES):
        visible_frames = first + np.flatnonzero(is_visible[first:end])
        if len(visible_frames) < MIN_SWAP_FRAMES:
            continue
        frames_before = np.flatnonzero(is_visible[: visible_frames[0]])
        frames_after = np.flatnonzero(is_visible[visible_frames[-1] + 1 :])
        first_frame, last_frame = int(visible_frames[0]), int(visible_frames[-1])
        if len(frames_before) and frames_before[-1] < first_frame - 1:
            first_frame = (int(frames_before[-1]) + first_frame) // 2 + 1
        if len(frames_after):
            last_frame += int(frames_after[0]) // 2
        spans.append((first_frame, last_frame))
    return spans

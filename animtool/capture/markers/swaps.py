"""Repair of temporarily exchanged marker names."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from animtool.capture.markers.geometry import MarkerDistances, marker_distances
from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.record import dataclass
from animtool.maths.runs import merge_runs, runs
from animtool.motion.markers import Markers

# Minimum frames of an exchange; a shorter one is a spike.
MIN_SWAP_FRAMES = 4
# Tolerance of an extrapolated position: noise [m], acceleration of a marker without a
# history [m/s^2], and its speed [m/s]. Otherwise the acceleration is a multiple of the
# marker's median, at least the minimum [m/s^2].
NOISE, DEFAULT_ACCELERATION, SPEED_ERROR = 0.003, 100.0, 3.0
MIN_ACCELERATION, ACCELERATION_FACTOR = 20.0, 6.0
# Acceleration of a marker on a throwing hand: markers within reach are candidates
# [m/s^2].
MAX_ACCELERATION = 500.0
# Longest gap over which a marker's position is predicted [s].
BRIDGE_SECONDS = 0.1
# Number of past samples for the velocity.
PAST_SAMPLES = 3
# A jump leads to another marker's position if that is this many times nearer.
NEARER_RATIO = 2.5
# Cost of an arbitrary position, of a change of names, and of an exchanged frame:
# without other evidence, the shorter part is the exchanged one.
ARBITRARY_COST, CHANGE_COST, FRAME_COST = 16.0, 5.0, 0.002
# Distances to other markers are weaker evidence than frame-to-frame motion: the largest
# evidence of a span, and the number of its frames that are sampled.
MAX_SHAPE_GAIN, SHAPE_SAMPLES = 4.0, 24
# Tolerance of a distance: noise and skin motion [m], and a factor on its spread.
TOLERANCE, SPREAD_FACTOR = 0.006, 1.5
# Minimum log-likelihood gain of an exchange.
MIN_GAIN = 2.0


@dataclass(frozen=True, slots=True)
class Swap:
    """A span of frames in which two markers had each other's names."""

    markers: tuple[str, str]  # the two, in the order of the file
    first: int  # first frame, from 0
    last: int  # last frame


def repair_swaps(markers: Markers) -> tuple[Markers, list[Swap]]:
    """Return markers with exchanged spans repaired, and the swaps.

    A pair of markers is tested over the full take if one jumps to the other's expected
    position. Of all exchanges of their names in spans of frames, the one is kept in
    which both move most smoothly and keep their typical distances to the others.
    """
    swaps: list[Swap] = []
    count = len(markers.names)
    if count < 2 or not markers.visible.any():
        return markers, swaps
    rate = float(markers.clock.rate)
    positions = markers.positions.copy()
    source_column = np.tile(np.arange(count), (len(markers), 1))
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
        if clearest_pair is None or crossing_by_pair[clearest_pair][0] < MIN_GAIN:
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
            other_pair: candidate
            for other_pair, candidate in crossing_by_pair.items()
            if not set(other_pair) & set(clearest_pair)
        }
    swaps.sort(key=lambda swap: (swap.first, swap.markers))
    if not swaps:
        return markers, swaps
    return markers.rearrange(source_column, markers.names), swaps


def _expected_positions(
    positions: FloatArray, rate: float, acceleration: float = DEFAULT_ACCELERATION
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return each marker's expected position, its tolerance [m], and validity.

    The position is extrapolated linearly from the last visible frames.
    """
    frames, count, _ = positions.shape
    visible = np.isfinite(positions[..., 0])
    rows = np.arange(frames)[:, None]
    last_visible = np.maximum.accumulate(np.where(visible, rows, -1), axis=0)
    last_visible = np.vstack([np.full((1, count), -1), last_visible[:-1]])
    all_markers = np.arange(count)
    frames_since = rows - last_visible
    is_known = (last_visible >= 0) & (frames_since <= BRIDGE_SECONDS * rate + 1)
    last_position = positions[np.maximum(last_visible, 0), all_markers]
    velocity = np.zeros_like(last_position)
    has_velocity = np.zeros(visible.shape, bool)
    for samples_back in range(1, PAST_SAMPLES):
        earlier = positions[np.maximum(last_visible - samples_back, 0), all_markers]
        # The earliest sample of a gapless run gives the velocity.
        is_usable = (
            (last_visible >= samples_back)
            & np.isfinite(earlier[..., 0])
            & (has_velocity | (samples_back == 1))
        )
        displacement = last_position[is_usable] - earlier[is_usable]
        velocity[is_usable] = displacement / samples_back
        has_velocity = is_usable if samples_back == 1 else has_velocity
    time = frames_since / rate
    tolerance = NOISE + 0.5 * acceleration * time**2
    tolerance += np.where(has_velocity, 0.0, SPEED_ERROR * time)
    return last_position + velocity * frames_since[..., None], tolerance, is_known


def _jump_pairs(positions: FloatArray, rate: float) -> list[tuple[int, int]]:
    """Return marker pairs of which one jumps to the other, most frequent first."""
    expected, tolerance, is_known = _expected_positions(positions, rate)
    visible = np.isfinite(positions[..., 0])
    deviation = np.linalg.norm(positions - expected, axis=-1)
    is_continuous = visible & is_known & (deviation <= tolerance)
    counts: dict[tuple[int, int], int] = {}
    frame, marker = np.nonzero(visible & ~is_continuous)
    points = positions[frame, marker]
    offsets = np.linalg.norm(points[:, None] - expected[frame], axis=-1)
    deviation_from_expected = np.where(is_known, deviation, np.inf)[frame, marker]
    max_distance = tolerance * (MAX_ACCELERATION / DEFAULT_ACCELERATION)
    is_reached = is_known[frame] & (offsets <= max_distance[frame])
    is_reached &= ~is_continuous[frame]
    is_reached &= NEARER_RATIO * offsets < deviation_from_expected[:, None]
    is_reached[np.arange(len(marker)), marker] = False
    for k, target in np.argwhere(is_reached).tolist():
        pair = tuple(sorted((int(marker[k]), target)))
        counts[pair] = counts.get(pair, 0) + 1  # type: ignore[index,arg-type]
    return sorted(counts, key=lambda pair: (-counts[pair], pair))


@dataclass(frozen=True, slots=True)
class _SwapPath:
    """A sequence of name exchanges between two markers, up to a frame."""

    cost: float  # negative log-likelihood
    is_swapped: int  # 1 if the names are exchanged at its end, else 0
    changes: tuple[int, ...]  # frames in which the state changes
    past_positions: list[list[Any]]  # last visible frames and positions of both markers


def _find_crossed_frames(
    positions: FloatArray, a: int, b: int, rate: float, lengths: MarkerDistances
) -> tuple[float, BoolArray]:
    """Return the frames in which two markers have each other's names ``(F,)``.

    The log-likelihood gain over no exchange is returned first.

    Viterbi search: of the paths that end normally and of those that end exchanged, the
    best one is kept from frame to frame, with the last visible positions of both
    markers.
    """
    pair_positions = positions[:, [a, b]]
    visible = np.isfinite(pair_positions[..., 0])
    acceleration = _typical_acceleration(pair_positions, rate)
    expected, tolerance, is_known = _expected_positions(
        pair_positions, rate, acceleration
    )
    deviation = np.linalg.norm(pair_positions - expected, axis=-1)
    is_smooth = ~visible | (is_known & (deviation <= tolerance))
    # In frames without events, both keep their names.
    is_unchanged = np.vstack([np.zeros((1, 2), bool), visible[1:] == visible[:-1]])
    events = np.flatnonzero(~(is_smooth & is_unchanged).all(axis=1)).tolist()
    events = sorted({0, *events})
    event_ends = [*events[1:], len(pair_positions)]
    initial_path = _SwapPath(0.0, 0, (), [[], []])
    paths = [initial_path, _SwapPath(CHANGE_COST, 1, (0,), [[], []])]
    points, is_visible = pair_positions.tolist(), visible.tolist()
    for start, end in zip(events, event_ends, strict=True):
        shape_gain = _shape_gain(positions, a, b, start, end, lengths)
        length = int(visible[start:end].any(axis=1).sum())
        costs_by_state = (
            max(0.0, shape_gain),
            max(0.0, -shape_gain) + FRAME_COST * length,
        )

        def extend(
            path: _SwapPath,
            state: int,
            start: int = start,
            end: int = end,
            costs_by_state: tuple[float, float] = costs_by_state,
        ) -> _SwapPath:
            """Return a path extended by a span of frames in a state."""
            cost, changes = path.cost + costs_by_state[state], path.changes
            if state != path.is_swapped:
                cost, changes = cost + CHANGE_COST, (*changes, start)
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
            paths = [extend(path, path.is_swapped) for path in paths]
        else:
            paths = [
                min((extend(path, state) for path in paths), key=lambda path: path.cost)
                for state in (0, 1)
            ]
    best_path = min(paths, key=lambda path: path.cost)
    is_crossed = np.zeros(len(pair_positions), np.int64)
    for change in best_path.changes:
        is_crossed[change:] ^= 1
    return initial_path.cost - best_path.cost, is_crossed.astype(bool)


def _typical_acceleration(pair_positions: FloatArray, rate: float) -> float:
    """Estimate the largest acceleration of two markers from its median [m/s^2]."""
    second_differences = np.linalg.norm(np.diff(pair_positions, 2, axis=0), axis=-1)
    finite_differences = second_differences[np.isfinite(second_differences)]
    if not len(finite_differences):
        return DEFAULT_ACCELERATION
    largest = ACCELERATION_FACTOR * np.median(finite_differences) * rate**2
    return float(np.clip(largest, MIN_ACCELERATION, DEFAULT_ACCELERATION))


def _position_cost(
    past: list[Any], frame: int, point: list[float], rate: float, acceleration: float
) -> float:
    """Return the cost of a position, given the previous visible positions.

    It is a negative log-likelihood, bounded by that of an arbitrary position.
    """
    if not past:
        return ARBITRARY_COST
    last_frame, last_position = past[-1]
    age = frame - last_frame
    first_frame, first_position = next(
        entry for entry in past if last_frame - entry[0] < PAST_SAMPLES
    )
    frames_between = last_frame - first_frame
    step_ratio = age / frames_between if frames_between else 0.0
    squared_distance: float = sum(
        (p - x - step_ratio * (x - y)) ** 2
        for p, x, y in zip(point, last_position, first_position, strict=True)
    )
    time = age / rate
    tolerance = NOISE + 0.5 * acceleration * time**2
    if not frames_between:
        tolerance += SPEED_ERROR * time
    log_volume = 3.0 * math.log(tolerance / NOISE)
    cost: float = 0.5 * squared_distance / tolerance**2 + log_volume
    return min(cost, ARBITRARY_COST)


def _shape_gain(
    positions: FloatArray,
    a: int,
    b: int,
    start: int,
    end: int,
    known_lengths: MarkerDistances,
) -> float:
    """Return the log-likelihood gain of an exchange from distances to other markers."""
    if end - start < MIN_SWAP_FRAMES:
        return 0.0
    frames = np.unique(np.linspace(start, end - 1, SHAPE_SAMPLES).astype(np.int64))
    other_markers = np.setdiff1d(np.arange(positions.shape[1]), (a, b))
    gains = []
    for pair, exchanged_pair in ((a, b), (b, a)):
        offsets = positions[frames][:, other_markers] - positions[frames, pair][:, None]
        lengths = np.linalg.norm(offsets, axis=-1)
        costs = []
        for marker in (pair, exchanged_pair):
            spread = known_lengths.spread[marker, other_markers]
            mean = known_lengths.mean[marker, other_markers]
            deviation = (lengths - mean) / (TOLERANCE + SPREAD_FACTOR * spread)
            costs.append(np.minimum(deviation**2, 9.0))
        is_known = np.isfinite(costs[0] - costs[1])
        if is_known.any():
            scale = TOLERANCE + np.minimum(
                known_lengths.spread[pair, other_markers],
                known_lengths.spread[exchanged_pair, other_markers],
            )
            weight = np.where(is_known, (TOLERANCE / scale) ** 2, 0.0)
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
    visible = np.asarray(np.isfinite(pair_positions[..., 0]).any(axis=1))
    spans = []
    # A few normal frames between exchanged ones are a spike.
    for first, end in merge_runs(runs(is_crossed), MIN_SWAP_FRAMES):
        frames = first + np.flatnonzero(visible[first:end])
        if len(frames) < MIN_SWAP_FRAMES:
            continue
        visible_before = np.flatnonzero(visible[: frames[0]])
        visible_after = np.flatnonzero(visible[frames[-1] + 1 :])
        begin, last = int(frames[0]), int(frames[-1])
        if len(visible_before) and visible_before[-1] < begin - 1:
            begin = (int(visible_before[-1]) + begin) // 2 + 1
        if len(visible_after):
            last += int(visible_after[0]) // 2
        spans.append((begin, last))
    return spans

"""Spikes: positions that deviate for a few frames from the motion around them.

References:
    Wahba, G., "Spline Models for Observational Data", SIAM, 1990, chapter 1.
    Atkinson, A. C., "Two graphical displays for outlying and influential observations
    in regression", Biometrika 68(1), 1981.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.motion.markers import Markers

# Longest spike; longer ones are motion [frame].
MAX_SPIKE_FRAMES = 4
# Frames on either side that predict a marker.
SUPPORT_FRAMES = 7
# Degree of the curve, and minimum number of positions for fitting it.
CURVE_DEGREE = 2
MIN_SUPPORT = CURVE_DEGREE + 3
# Roughness of a motion: variance of its third differences relative to that of its
# noise.
ROUGHNESS_LEVELS = tuple(10.0**power for power in range(-4, 3))
# Minimum size of a spike [m], and over the typical deviation.
MIN_SPIKE_SIZE, MIN_SPIKE_RATIO = 0.006, 8.0
# Factor on these thresholds with positions on one side only.
ONE_SIDED_FACTOR = 2.0
# Largest deviation of the frames around from the curve through them, relative to the
# spike.
MAX_SUPPORT_RESIDUAL_RATIO = 0.35
# Penalty per frame of a spike's length.
LENGTH_PENALTY = 60.0
# Half the number of frames for the local fit quality, and the quantile taken: the worst
# frames are spikes and their surroundings.
LOCAL_WINDOW_SPANS, LOCAL_QUANTILE = 24, 0.4
# A spike can hide neighbours, which are found once it is removed.
MAX_SEARCHES = 6


@dataclass(frozen=True, slots=True)
class Spike:
    """A few frames in which a marker deviates from the motion around them."""

    marker: str  # name of the marker
    first: int  # first frame, from 0
    last: int  # last frame
    size: float  # largest deviation in the spike [m]


def find_spikes(markers: Markers) -> list[Spike]:
    """Find the spikes of all markers, sorted by marker and frame.

    A spike is up to four frames long. Its frames deviate strongly from the smooth curve
    through the frames around, also across gaps, while those stay near it. The marker's
    typical motion determines smoothness and threshold.
    """
    spikes = []
    for index, name in enumerate(markers.names):
        path = markers.positions[:, index]
        for first, last, size in _marker_spikes(path):
            spikes.append(Spike(name, first, last, size))
    return spikes


def remove_spikes(markers: Markers, spikes: list[Spike]) -> Markers:
    """Return markers with NaN in the frames of spikes, to be filled as gaps."""
    positions = markers.positions.copy()
    for spike in spikes:
        column = markers.names.index(spike.marker)
        positions[spike.first : spike.last + 1, column] = np.nan
    return replace(markers, positions=positions)


def _marker_spikes(path: FloatArray) -> list[tuple[int, int, float]]:
    """Return first frame, last frame and size of the spikes of a marker ``(F, 3)``."""
    is_known = np.isfinite(path[:, 0])
    if int(is_known.sum()) < 2 * SUPPORT_FRAMES + 1:
        return []
    path = np.where(is_known[:, None], path, 0.0)
    roughness, noise_by_length = _noise_model(path, is_known)
    spikes: list[tuple[int, int, float]] = []
    for _ in range(MAX_SEARCHES):
        new_spikes = _clearest_spikes(path, is_known, roughness, noise_by_length)
        if not new_spikes:
            break
        spikes += new_spikes
        for first, last, _ in new_spikes:
            is_known[first : last + 1] = False
    return sorted(spikes)


def _clearest_spikes(
    path: FloatArray, is_known: BoolArray, roughness: float, noise_by_length: FloatArray
) -> list[tuple[int, int, float]]:
    """Return first frame, last frame and size of spikes that do not overlap."""
    candidates = []
    local_levels: FloatArray | None = None
    for length in range(1, MAX_SPIKE_FRAMES + 1):
        starts, deviation, gain, residuals = _span_deviations(
            path, is_known, length, roughness
        )
        if not len(starts):
            continue
        factor = np.where(
            _is_one_sided(is_known, starts, length), ONE_SIDED_FACTOR, 1.0
        )
        sigma = noise_by_length[length - 1]
        if local_levels is None:
            local_levels = _local_noise(starts, gain / (3.0 * sigma**2), len(path))
        local_scale = local_levels[starts]
        min_strength = (factor * MIN_SPIKE_RATIO) ** 2 * 3.0 * length
        strength = gain / (sigma**2 * local_scale)
        is_spike = (deviation >= factor * MIN_SPIKE_SIZE) & (strength > min_strength)
        is_spike &= residuals < MAX_SUPPORT_RESIDUAL_RATIO**2 * gain / length
        for k in np.flatnonzero(is_spike).tolist():
            score = float(strength[k]) - LENGTH_PENALTY * length
            candidates.append((-score, int(starts[k]), length, float(deviation[k])))
    candidates.sort()
    variance = noise_by_length[0] ** 2
    is_used_frame = np.zeros(len(path), bool)
    spikes = []
    for _, first, length, size in candidates:
        if is_used_frame[first : first + length].any():
            continue
        if not _is_gap_artifact(path, is_known, first, length, roughness, variance):
            is_used_frame[
                max(first - SUPPORT_FRAMES, 0) : first + length + SUPPORT_FRAMES
            ] = True
            spikes.append((first, first + length - 1, size))
    return spikes


def _is_gap_artifact(
    path: FloatArray,
    is_known: BoolArray,
    first: int,
    length: int,
    roughness: float,
    variance: float,
) -> bool:
    """Return whether a span deviates only because of the few frames before a gap."""
    begin, end = max(first - SUPPORT_FRAMES, 0), first + length
    frames_before = begin + np.flatnonzero(is_known[begin:first])
    frames_after = end + np.flatnonzero(is_known[end : end + SUPPORT_FRAMES])
    for frames_on_side in (frames_before, frames_after):
        if not 0 < len(frames_on_side) < length:
            continue
        is_visible_without = is_known[begin : end + SUPPORT_FRAMES].copy()
        is_visible_without[frames_on_side - begin] = False
        starts, deviation, gain, _ = _span_deviations(
            path[begin : end + SUPPORT_FRAMES], is_visible_without, length, roughness
        )
        span_index = np.flatnonzero(starts == first - begin)
        if len(span_index) and (
            deviation[span_index[0]] < MIN_SPIKE_SIZE
            or gain[span_index[0]] < variance * MIN_SPIKE_RATIO**2 * 3.0 * length
        ):
            return True
    return False


def _is_one_sided(is_known: BoolArray, starts: IntArray, length: int) -> BoolArray:
    """Return a mask of the spans with no visible frame near one of their ends."""
    padding = np.zeros(SUPPORT_FRAMES, bool)
    padded_mask = np.concatenate([padding, is_known, padding])
    totals = np.concatenate([[0], np.cumsum(padded_mask)])
    count_before = totals[starts + SUPPORT_FRAMES] - totals[starts]
    end = starts + SUPPORT_FRAMES + length
    count_after = totals[end + SUPPORT_FRAMES] - totals[end]
    return np.asarray((count_before == 0) | (count_after == 0))


def _local_noise(
    starts: IntArray, squared_residuals: FloatArray, frame_count: int
) -> FloatArray:
    """Return each frame's ratio of local to typical noise variance, at least 1."""
    next_spans = np.searchsorted(starts, np.arange(frame_count))
    window_start = np.maximum(next_spans - LOCAL_WINDOW_SPANS, 0)
    window_end = np.minimum(next_spans + LOCAL_WINDOW_SPANS, len(starts))
    padded_residuals = np.concatenate([squared_residuals, [np.inf]])
    window_length = 2 * LOCAL_WINDOW_SPANS
    window_rows = window_start[:, None] + np.arange(window_length)
    is_inside = window_rows < window_end[:, None]
    window_rows = np.where(is_inside, window_rows, len(squared_residuals))
    windows = np.sort(padded_residuals[window_rows], axis=1)
    quantile_index = (LOCAL_QUANTILE * (window_end - window_start)).astype(np.int64)
    levels = windows[
        np.arange(frame_count), np.minimum(quantile_index, window_length - 1)
    ]
    # That quantile of a chi-squared distribution with 3 degrees, over 3, is below 0.63.
    return np.maximum(np.where(np.isfinite(levels), levels / 0.63, 1.0), 1.0)


def _noise_model(path: FloatArray, is_known: BoolArray) -> tuple[float, FloatArray]:
    """Return the roughness of a motion, and the prediction noise by span length [m].

    The roughness is the one that predicts positions best from nearby positions.
    """
    best_level = (np.inf, ROUGHNESS_LEVELS[0])
    for roughness in ROUGHNESS_LEVELS:
        _, deviation, _, _ = _span_deviations(
            path, is_known, 2, roughness, is_complete=True
        )
        if len(deviation):
            best_level = min(best_level, (float(np.median(deviation)), roughness))
    noise = np.zeros(MAX_SPIKE_FRAMES)
    for length in range(1, MAX_SPIKE_FRAMES + 1):
        starts, _, gain, _ = _span_deviations(
            path, is_known, length, best_level[1], is_complete=True
        )
        if not len(starts):
            starts, _, gain, _ = _span_deviations(path, is_known, length, best_level[1])
        if len(starts):
            # The median of a chi-squared distribution with k degrees is about k - 2/3.
            noise[length - 1] = np.sqrt(np.median(gain) / (3 * length - 2 / 3))
    noise = np.maximum.accumulate(noise)
    return best_level[1], np.maximum(noise, 1e-6)


def _span_deviations(
    path: FloatArray,
    is_known: BoolArray,
    length: int,
    roughness: float,
    *,
    is_complete: bool = False,
) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
    """Compare all spans of a length with the smooth curve through nearby frames.

    Return the first frames ``(S,)`` of the spans; the smallest deviation among each
    span's frames [m]; the drop in the fit's sum of squares when the span is left out
    [m^2]; and the mean square of the residuals. is_complete: Whether to omit spans
    with a hidden frame around.
    """
    window_size = length + 2 * SUPPORT_FRAMES
    padded_mask = np.zeros(len(path) + 2 * SUPPORT_FRAMES, bool)
    padded_mask[SUPPORT_FRAMES : SUPPORT_FRAMES + len(path)] = is_known
    windows = np.lib.stride_tricks.sliding_window_view(padded_mask, window_size)
    is_span = windows[:, SUPPORT_FRAMES : SUPPORT_FRAMES + length].all(axis=1)
    is_visible_around = np.concatenate(
        [windows[:, :SUPPORT_FRAMES], windows[:, SUPPORT_FRAMES + length :]], axis=1
    )
    support_count = is_visible_around.sum(axis=1)
    is_span &= support_count >= (2 * SUPPORT_FRAMES if is_complete else MIN_SUPPORT)
    starts = np.flatnonzero(is_span)
    padded_path = np.zeros((len(path) + 2 * SUPPORT_FRAMES, 3))
    padded_path[SUPPORT_FRAMES : SUPPORT_FRAMES + len(path)] = path
    visibility_codes = is_visible_around[starts] @ (1 << np.arange(2 * SUPPORT_FRAMES))
    deviations, gain, residuals = (np.zeros(len(starts)) for _ in range(3))
    for visibility_bits in np.unique(visibility_codes).tolist():
        spans = np.flatnonzero(visibility_codes == visibility_bits)
        offsets, weights, inverse, quadratic_form = _prediction_weights(
            visibility_bits, length, roughness
        )
        support_positions = padded_path[starts[spans][:, None] + offsets]  # (S, K, 3)
        span_starts = starts[spans][:, None] + SUPPORT_FRAMES
        span_positions = padded_path[span_starts + np.arange(length)]
        prediction_error = span_positions - weights @ support_positions
        gain[spans] = (prediction_error * (inverse @ prediction_error)).sum(axis=(1, 2))
        deviations[spans] = np.sqrt((prediction_error**2).sum(axis=2)).min(axis=1)
        products = support_positions * (quadratic_form @ support_positions)
        remaining_squares = products.sum(axis=(1, 2))
        residuals[spans] = remaining_squares / max(1, len(offsets) - CURVE_DEGREE - 1)
    return starts, deviations, gain, residuals


@lru_cache(maxsize=4096)
def _prediction_weights(
    visibility_bits: int, length: int, roughness: float
) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
    """Return the weights with which positions around a span predict its positions.

    visibility_bits: Bit mask of the visible frames around. Returns their indices in the
    window, their weights, the inverse variance of the prediction error, and the
    quadratic form of their residuals.
    """
    span_offsets = np.arange(SUPPORT_FRAMES, SUPPORT_FRAMES + length)
    offsets_around = np.delete(np.arange(2 * SUPPORT_FRAMES + length), span_offsets)
    offsets = offsets_around[
        [bool(visibility_bits >> k & 1) for k in range(2 * SUPPORT_FRAMES)]
    ]
    frames = np.concatenate([offsets, span_offsets]) + 1.0
    # White noise integrated three times: its expected curve is a quintic spline.
    earlier_frame = np.minimum(frames[:, None], frames)
    frame_distance = np.abs(frames[:, None] - frames)
    integrated_covariance = (
        earlier_frame**5 / 20.0
        + earlier_frame**4 * frame_distance / 8.0
        + earlier_frame**3 * frame_distance**2 / 12.0
    )
    kernel = roughness * integrated_covariance + np.eye(len(frames))
    centred_frames = frames - frames.mean()
    polynomial_terms = np.vander(centred_frames / SUPPORT_FRAMES, CURVE_DEGREE + 1)
    support_count = len(offsets)
    inverse = np.linalg.inv(kernel)
    projection = inverse - inverse @ polynomial_terms @ np.linalg.solve(
        polynomial_terms.T @ inverse @ polynomial_terms, polynomial_terms.T @ inverse
    )
    span_block = projection[support_count:, support_count:]
    weights = -np.linalg.solve(span_block, projection[support_count:, :support_count])
    support_block = projection[:support_count, :support_count]
    quadratic_form = support_block - weights.T @ span_block @ weights
    return offsets, weights, span_block, quadratic_form

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
MAX_REST_RATIO = 0.35
# Penalty per frame of a spike's length.
LENGTH_PENALTY = 60.0
# Half the number of frames for the local fit quality, and the quantile taken: the worst
# frames are spikes and their surroundings.
FIT_WINDOW, FIT_QUANTILE = 24, 0.4
# A spike can hide neighbours, which are found once it is removed.
MAX_ROUNDS = 6


@dataclass(frozen=True, slots=True)
class Spike:
    """A marker that deviates for a few frames."""

    marker: str  # name of the marker
    first: int  # first frame, from 0
    last: int  # last frame
    size: float  # largest deviation in the spike [m]


def find_spikes(markers: Markers) -> list[Spike]:
    """Return the spikes of all markers, by marker and frame.

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
    """Return markers with spikes replaced by gaps."""
    positions = markers.positions.copy()
    for spike in spikes:
        column = markers.names.index(spike.marker)
        positions[spike.first : spike.last + 1, column] = np.nan
    return replace(markers, positions=positions)


def _marker_spikes(path: FloatArray) -> list[tuple[int, int, float]]:
    """Return first frame, last frame and size of the spikes of a marker ``(F, 3)``."""
    visible = np.isfinite(path[:, 0])
    if int(visible.sum()) < 2 * SUPPORT_FRAMES + 1:
        return []
    path = np.where(visible[:, None], path, 0.0)
    roughness, noise = _noise_model(path, visible)
    spikes: list[tuple[int, int, float]] = []
    for _ in range(MAX_ROUNDS):
        new_spikes = _clearest_spikes(path, visible, roughness, noise)
        if not new_spikes:
            break
        spikes += new_spikes
        for first, last, _ in new_spikes:
            visible[first : last + 1] = False
    return sorted(spikes)


def _clearest_spikes(
    path: FloatArray, visible: BoolArray, roughness: float, noise: FloatArray
) -> list[tuple[int, int, float]]:
    """Select spikes that do not overlap, the clearest first."""
    candidates = []
    local_level: FloatArray | None = None
    for length in range(1, MAX_SPIKE_FRAMES + 1):
        starts, deviation, gain, residual = _span_deviations(
            path, visible, length, roughness
        )
        if not len(starts):
            continue
        factor = np.where(_is_one_sided(visible, starts, length), ONE_SIDED_FACTOR, 1.0)
        scale = noise[length - 1]
        if local_level is None:
            local_level = _local_level(starts, gain / (3.0 * scale**2), len(path))
        local_scale = local_level[starts]
        min_clearness = (factor * MIN_SPIKE_RATIO) ** 2 * 3.0 * length
        clearness = gain / (scale**2 * local_scale)
        is_spike = (deviation >= factor * MIN_SPIKE_SIZE) & (clearness > min_clearness)
        is_spike &= residual < MAX_REST_RATIO**2 * gain / length
        for k in np.flatnonzero(is_spike).tolist():
            score = float(clearness[k]) - LENGTH_PENALTY * length
            candidates.append((-score, int(starts[k]), length, float(deviation[k])))
    candidates.sort()
    scale = noise[0] ** 2
    is_used_frame = np.zeros(len(path), bool)
    spikes = []
    for _, first, length, size in candidates:
        if is_used_frame[first : first + length].any():
            continue
        if not _is_gap_artifact(path, visible, first, length, roughness, scale):
            is_used_frame[
                max(first - SUPPORT_FRAMES, 0) : first + length + SUPPORT_FRAMES
            ] = True
            spikes.append((first, first + length - 1, size))
    return spikes


def _is_gap_artifact(
    path: FloatArray,
    visible: BoolArray,
    first: int,
    length: int,
    roughness: float,
    scale: float,
) -> bool:
    """Return whether a span deviates only because of the few frames before a gap."""
    begin, end = max(first - SUPPORT_FRAMES, 0), first + length
    frames_before = begin + np.flatnonzero(visible[begin:first])
    frames_after = end + np.flatnonzero(visible[end : end + SUPPORT_FRAMES])
    for frames_on_side in (frames_before, frames_after):
        if not 0 < len(frames_on_side) < length:
            continue
        is_visible_without = visible[begin : end + SUPPORT_FRAMES].copy()
        is_visible_without[frames_on_side - begin] = False
        starts, deviation, gain, _ = _span_deviations(
            path[begin : end + SUPPORT_FRAMES], is_visible_without, length, roughness
        )
        span_index = np.flatnonzero(starts == first - begin)
        if len(span_index) and (
            deviation[span_index[0]] < MIN_SPIKE_SIZE
            or gain[span_index[0]] < scale * MIN_SPIKE_RATIO**2 * 3.0 * length
        ):
            return True
    return False


def _is_one_sided(visible: BoolArray, starts: IntArray, length: int) -> BoolArray:
    """Return a mask of spans without a nearby position before or after the span."""
    padding = np.zeros(SUPPORT_FRAMES, bool)
    padded_mask = np.concatenate([padding, visible, padding])
    sums = np.concatenate([[0], np.cumsum(padded_mask)])
    count_before = sums[starts + SUPPORT_FRAMES] - sums[starts]
    end = starts + SUPPORT_FRAMES + length
    count_after = sums[end + SUPPORT_FRAMES] - sums[end]
    return np.asarray((count_before == 0) | (count_after == 0))


def _local_level(
    starts: IntArray, squared_residuals: FloatArray, frames: int
) -> FloatArray:
    """Return each frame's local noise level over the typical level ``(F,)``."""
    next_span = np.searchsorted(starts, np.arange(frames))
    window_start = np.maximum(next_span - FIT_WINDOW, 0)
    window_end = np.minimum(next_span + FIT_WINDOW, len(starts))
    padded_residuals = np.concatenate([squared_residuals, [np.inf]])
    window_length = 2 * FIT_WINDOW
    window_rows = window_start[:, None] + np.arange(window_length)
    is_inside = window_rows < window_end[:, None]
    window_rows = np.where(is_inside, window_rows, len(squared_residuals))
    windows = np.sort(padded_residuals[window_rows], axis=1)
    quantile_index = (FIT_QUANTILE * (window_end - window_start)).astype(np.int64)
    level = windows[np.arange(frames), np.minimum(quantile_index, window_length - 1)]
    # That quantile of a chi-squared distribution with 3 degrees, over 3, is below 0.63.
    return np.maximum(np.where(np.isfinite(level), level / 0.63, 1.0), 1.0)


def _noise_model(path: FloatArray, visible: BoolArray) -> tuple[float, FloatArray]:
    """Return the roughness of a motion, and the prediction noise by span length [m].

    The roughness is the one that predicts positions best from nearby positions.
    """
    best_level = (np.inf, ROUGHNESS_LEVELS[0])
    for roughness in ROUGHNESS_LEVELS:
        _, deviation, _, _ = _span_deviations(
            path, visible, 2, roughness, complete=True
        )
        if len(deviation):
            best_level = min(best_level, (float(np.median(deviation)), roughness))
    noise = np.zeros(MAX_SPIKE_FRAMES)
    for length in range(1, MAX_SPIKE_FRAMES + 1):
        starts, _, gain, _ = _span_deviations(
            path, visible, length, best_level[1], complete=True
        )
        if not len(starts):
            starts, _, gain, _ = _span_deviations(path, visible, length, best_level[1])
        if len(starts):
            # The median of a chi-squared distribution with k degrees is about k - 2/3.
            noise[length - 1] = np.sqrt(np.median(gain) / (3 * length - 2 / 3))
    noise = np.maximum.accumulate(noise)
    return best_level[1], np.maximum(noise, 1e-6)


def _span_deviations(
    path: FloatArray,
    visible: BoolArray,
    length: int,
    roughness: float,
    *,
    complete: bool = False,
) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
    """Return spans, and their deviations from the smooth curve through nearby frames.

    The first frames ``(S,)`` of the spans; the smallest deviation among each span's
    frames [m]; the drop in the fit's sum of squares when the span is left out [m^2];
    and the mean square of the residuals. complete: Only spans with all frames around
    visible.
    """
    size = length + 2 * SUPPORT_FRAMES
    padded_mask = np.zeros(len(path) + 2 * SUPPORT_FRAMES, bool)
    padded_mask[SUPPORT_FRAMES : SUPPORT_FRAMES + len(path)] = visible
    windows = np.lib.stride_tricks.sliding_window_view(padded_mask, size)
    is_span = windows[:, SUPPORT_FRAMES : SUPPORT_FRAMES + length].all(axis=1)
    is_visible_around = np.concatenate(
        [windows[:, :SUPPORT_FRAMES], windows[:, SUPPORT_FRAMES + length :]], axis=1
    )
    support_count = is_visible_around.sum(axis=1)
    is_span &= support_count >= (2 * SUPPORT_FRAMES if complete else MIN_SUPPORT)
    starts = np.flatnonzero(is_span)
    padded_path = np.zeros((len(path) + 2 * SUPPORT_FRAMES, 3))
    padded_path[SUPPORT_FRAMES : SUPPORT_FRAMES + len(path)] = path
    visibility_codes = is_visible_around[starts] @ (1 << np.arange(2 * SUPPORT_FRAMES))
    deviations, gain, residuals = (np.zeros(len(starts)) for _ in range(3))
    for code in np.unique(visibility_codes).tolist():
        rows = np.flatnonzero(visibility_codes == code)
        offsets, weights, inverse, quadratic_form = _prediction_weights(
            code, length, roughness
        )
        support_positions = padded_path[starts[rows][:, None] + offsets]  # (S, K, 3)
        span_starts = starts[rows][:, None] + SUPPORT_FRAMES
        span_positions = padded_path[span_starts + np.arange(length)]
        prediction_error = span_positions - weights @ support_positions
        gain[rows] = (prediction_error * (inverse @ prediction_error)).sum(axis=(1, 2))
        deviations[rows] = np.sqrt((prediction_error**2).sum(axis=2)).min(axis=1)
        products = support_positions * (quadratic_form @ support_positions)
        remaining_squares = products.sum(axis=(1, 2))
        residuals[rows] = remaining_squares / max(1, len(offsets) - CURVE_DEGREE - 1)
    return starts, deviations, gain, residuals


@lru_cache(maxsize=4096)
def _prediction_weights(
    code: int, length: int, roughness: float
) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
    """Return the weights with which positions around a span predict its positions.

    code: Bit mask of the visible frames around. Returns their indices in the window,
    their weights, the inverse variance of the prediction error, and the quadratic form
    of their residuals.
    """
    span = np.arange(SUPPORT_FRAMES, SUPPORT_FRAMES + length)
    offsets_around = np.delete(np.arange(2 * SUPPORT_FRAMES + length), span)
    offsets = offsets_around[[bool(code >> k & 1) for k in range(2 * SUPPORT_FRAMES)]]
    frames = np.concatenate([offsets, span]) + 1.0
    # White noise integrated three times: its expected curve is a quintic spline.
    earlier_frame = np.minimum(frames[:, None], frames)
    frame_distance = np.abs(frames[:, None] - frames)
    curve = (
        earlier_frame**5 / 20.0
        + earlier_frame**4 * frame_distance / 8.0
        + earlier_frame**3 * frame_distance**2 / 12.0
    )
    kernel = roughness * curve + np.eye(len(frames))
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

"""Spikes: positions that are off for a few frames against the motion around them.

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

# Longer ones are motion [frame].
MAX_LENGTH = 4
# Frames on either side that predict a marker.
AROUND = 7
# Least positions for fitting the curve.
DEGREE = 2
MIN_SUPPORT = DEGREE + 3
# How rough a motion is: variance of its third differences, of that of its noise.
ROUGHNESS = tuple(10.0**power for power in range(-4, 3))
# Least size of a spike [m], and over the typical deviation.
MIN_SPIKE, MIN_SPIKE_RATIO = 0.006, 8.0
# Factor on these with positions on one side only.
ONE_SIDED = 2.0
# How far the frames around may be off the curve through them, of what is a spike.
SMOOTH = 0.35
# Penalty per frame of a spike's length.
PENALTY = 60.0
# Half the frames that say how well a curve fits about a frame, and which share of them
# is better: others are spikes, and what they upset.
FIT_WINDOW, FIT_QUANTILE = 24, 0.4
# A spike can hide neighbours, which are found once it is removed.
ROUNDS = 6


@dataclass(frozen=True, slots=True)
class Spike:
    """A marker that is off for a few frames.

    Attributes:
        marker: Its name.
        first: First frame, from 0.
        last: Last frame.
        size: Its largest deviation [m].
    """

    marker: str
    first: int
    last: int
    size: float


def find_spikes(markers: Markers) -> list[Spike]:
    """Return the spikes of all markers, by marker and frame.

    A spike is up to four frames long. Its frames are far off the smooth curve through
    the frames around, also across gaps, and the others are near it. The marker's
    typical motion determines smoothness and threshold.
    """
    spikes = []
    for index, name in enumerate(markers.names):
        path = markers.positions[:, index]
        for first, last, size in _spikes(path):
            spikes.append(Spike(name, first, last, size))
    return spikes


def remove_spikes(markers: Markers, spikes: list[Spike]) -> Markers:
    """Return markers with spikes replaced by gaps."""
    positions = markers.positions.copy()
    for spike in spikes:
        column = markers.names.index(spike.marker)
        positions[spike.first : spike.last + 1, column] = np.nan
    return replace(markers, positions=positions)


def _spikes(path: FloatArray) -> list[tuple[int, int, float]]:
    """Return first frame, last frame and size of the spikes of a marker ``(F, 3)``."""
    visible = np.isfinite(path[:, 0])
    if int(visible.sum()) < 2 * AROUND + 1:
        return []
    path = np.where(visible[:, None], path, 0.0)
    rough, noise = _model(path, visible)
    spikes: list[tuple[int, int, float]] = []
    for _ in range(ROUNDS):
        new = _round(path, visible, rough, noise)
        if not new:
            break
        spikes += new
        for first, last, _ in new:
            visible[first : last + 1] = False
    return sorted(spikes)


def _round(
    path: FloatArray, visible: BoolArray, rough: float, noise: FloatArray
) -> list[tuple[int, int, float]]:
    """Return separate spikes, the clearest of overlapping ones."""
    candidates = []
    level: FloatArray | None = None
    for length in range(1, MAX_LENGTH + 1):
        starts, off, gain, rest = _deviation(path, visible, length, rough)
        if not len(starts):
            continue
        factor = np.where(_one_sided(visible, starts, length), ONE_SIDED, 1.0)
        scale = noise[length - 1]
        if level is None:
            level = _local_level(starts, gain / (3.0 * scale**2), len(path))
        about = level[starts]
        limit = (factor * MIN_SPIKE_RATIO) ** 2 * 3.0 * length
        clear = gain / (scale**2 * about)
        flags = (off >= factor * MIN_SPIKE) & (clear > limit)
        flags &= rest < SMOOTH**2 * gain / length
        for k in np.flatnonzero(flags).tolist():
            score = float(clear[k]) - PENALTY * length
            candidates.append((-score, int(starts[k]), length, float(off[k])))
    candidates.sort()
    scale = noise[0] ** 2
    taken = np.zeros(len(path), bool)
    spikes = []
    for _, first, length, size in candidates:
        if taken[first : first + length].any():
            continue
        if not _is_upset(path, visible, first, length, rough, scale):
            taken[max(first - AROUND, 0) : first + length + AROUND] = True
            spikes.append((first, first + length - 1, size))
    return spikes


def _is_upset(
    path: FloatArray,
    visible: BoolArray,
    first: int,
    length: int,
    rough: float,
    scale: float,
) -> bool:
    """Return whether a span is off only because of the few frames before a gap."""
    begin, end = max(first - AROUND, 0), first + length
    before = begin + np.flatnonzero(visible[begin:first])
    after = end + np.flatnonzero(visible[end : end + AROUND])
    for side in (before, after):
        if not 0 < len(side) < length:
            continue
        other = visible[begin : end + AROUND].copy()
        other[side - begin] = False
        starts, off, gain, _ = _deviation(
            path[begin : end + AROUND], other, length, rough
        )
        at = np.flatnonzero(starts == first - begin)
        if len(at) and (
            off[at[0]] < MIN_SPIKE
            or gain[at[0]] < scale * MIN_SPIKE_RATIO**2 * 3.0 * length
        ):
            return True
    return False


def _one_sided(visible: BoolArray, starts: IntArray, length: int) -> BoolArray:
    """Return which spans have no nearby position before or after them."""
    padded = np.concatenate([np.zeros(AROUND, bool), visible, np.zeros(AROUND, bool)])
    sums = np.concatenate([[0], np.cumsum(padded)])
    before = sums[starts + AROUND] - sums[starts]
    end = starts + AROUND + length
    after = sums[end + AROUND] - sums[end]
    return np.asarray((before == 0) | (after == 0))


def _local_level(starts: IntArray, square: FloatArray, frames: int) -> FloatArray:
    """Return the local noise level of single frames over the typical one ``(F,)``."""
    level = np.ones(frames)
    order = np.searchsorted(starts, np.arange(frames))
    low = np.maximum(order - FIT_WINDOW, 0)
    high = np.minimum(order + FIT_WINDOW, len(starts))
    padded = np.concatenate([square, [np.inf]])
    width = 2 * FIT_WINDOW
    rows = low[:, None] + np.arange(width)
    rows = np.where(rows < high[:, None], rows, len(square))
    windows = np.sort(padded[rows], axis=1)
    at = (FIT_QUANTILE * (high - low)).astype(np.int64)
    level = windows[np.arange(frames), np.minimum(at, width - 1)]
    # That fraction of a chi-squared of three, over three, is below 0.63.
    return np.maximum(np.where(np.isfinite(level), level / 0.63, 1.0), 1.0)


def _model(path: FloatArray, visible: BoolArray) -> tuple[float, FloatArray]:
    """Return the roughness of a motion, and its noise by span length [m].

    It is the roughness that predicts most positions best from those around.
    """
    best = (np.inf, ROUGHNESS[0])
    for rough in ROUGHNESS:
        _, off, _, _ = _deviation(path, visible, 2, rough, complete=True)
        if len(off):
            best = min(best, (float(np.median(off)), rough))
    noise = np.zeros(MAX_LENGTH)
    for length in range(1, MAX_LENGTH + 1):
        starts, _, gain, _ = _deviation(path, visible, length, best[1], complete=True)
        if not len(starts):
            starts, _, gain, _ = _deviation(path, visible, length, best[1])
        if len(starts):
            # The median of a chi-squared of k is about k - 2/3.
            noise[length - 1] = np.sqrt(np.median(gain) / (3 * length - 2 / 3))
    noise = np.maximum.accumulate(noise)
    return best[1], np.maximum(noise, 1e-6)


def _deviation(
    path: FloatArray,
    visible: BoolArray,
    length: int,
    rough: float,
    *,
    complete: bool = False,
) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
    """Return spans, and their deviation from the curve through frames around.

    They are first frames ``(S,)``, the least deviation of each span's frames [m], the
    drop in the fit's sum of squares from leaving the span out [m^2], and the mean
    square of the rest. complete: Only spans with all frames around visible.
    """
    size = length + 2 * AROUND
    padded = np.zeros(len(path) + 2 * AROUND, bool)
    padded[AROUND : AROUND + len(path)] = visible
    windows = np.lib.stride_tricks.sliding_window_view(padded, size)
    spans = windows[:, AROUND : AROUND + length].all(axis=1)
    around = np.concatenate(
        [windows[:, :AROUND], windows[:, AROUND + length :]], axis=1
    )
    support = around.sum(axis=1)
    spans &= support == 2 * AROUND if complete else support >= MIN_SUPPORT
    starts = np.flatnonzero(spans)
    values = np.zeros((len(path) + 2 * AROUND, 3))
    values[AROUND : AROUND + len(path)] = path
    codes = around[starts] @ (1 << np.arange(2 * AROUND))
    off, gain, rest = (np.zeros(len(starts)) for _ in range(3))
    for code in np.unique(codes).tolist():
        rows = np.flatnonzero(codes == code)
        offsets, weights, inverse, form = _pattern(code, length, rough)
        near = values[starts[rows][:, None] + offsets]  # (S, K, 3)
        inside = values[starts[rows][:, None] + AROUND + np.arange(length)]
        missed = inside - weights @ near
        gain[rows] = (missed * (inverse @ missed)).sum(axis=(1, 2))
        off[rows] = np.sqrt((missed**2).sum(axis=2)).min(axis=1)
        left = (near * (form @ near)).sum(axis=(1, 2))
        rest[rows] = left / max(1, len(offsets) - DEGREE - 1)
    return starts, off, gain, rest


@lru_cache(maxsize=4096)
def _pattern(
    code: int, length: int, rough: float
) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
    """Return how positions around a span predict it.

    code: Bit mask of the visible frames around. The result is their indices in the
    window, their weights, the inverse variance of the prediction error, and the
    quadratic form of the positions' own misfit.
    """
    around = np.array([*range(AROUND), *range(AROUND + length, 2 * AROUND + length)])
    offsets = around[[bool(code >> k & 1) for k in range(2 * AROUND)]]
    frames = np.concatenate([offsets, np.arange(AROUND, AROUND + length)]) + 1.0
    # An integral of white noise, three times: its expected curve is a quintic spline.
    early = np.minimum(frames[:, None], frames)
    late = np.abs(frames[:, None] - frames)
    curve = early**5 / 20.0 + early**4 * late / 8.0 + early**3 * late**2 / 12.0
    kernel = rough * curve + np.eye(len(frames))
    terms = np.vander((frames - frames.mean()) / AROUND, DEGREE + 1)
    known = len(offsets)
    inverse = np.linalg.inv(kernel)
    outer = inverse - inverse @ terms @ np.linalg.solve(
        terms.T @ inverse @ terms, terms.T @ inverse
    )
    block = outer[known:, known:]
    weights = -np.linalg.solve(block, outer[known:, :known])
    form = outer[:known, :known] - weights.T @ block @ weights
    return offsets, weights, block, form

"""Detects pops: steps between frames that the surrounding motion does not predict."""

from __future__ import annotations

import math

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, median

# Smaller deviations from the surrounding motion are not pops [rad].
MIN_POP_ROTATION = math.radians(17.0)
# No real motion rotates a joint this far in one frame [rad].
FLIP_ANGLE = math.radians(120.0)
# Roughness of a pop relative to the surrounding motion: kicks, claps and landings at 24
# to 120 fps reach 6; a 20 degree pop in a smooth walk has 9 or more [1]. The roughness
# of the motion is at least the noise of captures [rad].
MIN_ROUGHNESS_RATIO = 8.0
ROTATION_NOISE = math.radians(1.0)
# Roughness of a pop relative to adjacent steps [1]; fast motion starts and stops over
# several frames.
MIN_NEIGHBOUR_RATIO = 5.5
# Deviation of a translation pop relative to the change of velocity: a bouncing ball
# reverses its velocity in one step, which is not a pop [1].
MIN_CHANGE_RATIO = 2.5
# Fraction of the smallest pop that smooth interpolation must leave unexplained [1].
MIN_UNEXPLAINED_FRACTION = 0.6
# A step belongs to fast motion if the adjacent one has this fraction of its length [1].
SIMILAR_SPEED_RATIO = 0.4
# Window of the surrounding motion: seconds before and after, minimum number of steps.
WINDOW_SECONDS, MIN_STEPS = 0.12, 12
# Steps next to a pop that are excluded from the surrounding motion.
NEIGHBOURHOOD_GAP = 2
# Fewer frames are too few to know typical motion.
MIN_FRAMES = 8


def find_rotation_pops(
    rotations: FloatArray, interval: float, is_cut: BoolArray
) -> tuple[BoolArray, FloatArray]:
    """Return a mask of rotation pops ``(S, N)``, and the deviations [rad].

    Args:
        rotations: Rotation vectors from each frame to the next ``(S, N, 3)`` [rad].
        interval: Time of a step [s].
        is_cut: Mask of cuts, which are ignored ``(S,)``.

    Fewer than 8 frames have no pops.
    """
    if len(rotations) + 1 < MIN_FRAMES or not rotations.shape[1]:
        no_pops = np.zeros(rotations.shape[:2])
        return no_pops.astype(bool), no_pops
    deviations = prediction_errors(rotations, is_cut)
    is_pop = find_outliers(
        rotations, deviations, is_cut, MIN_POP_ROTATION, ROTATION_NOISE, interval
    )
    # If every second step is a flip, none exceeds its surrounding motion.
    is_flip = np.linalg.norm(rotations, axis=2) > FLIP_ANGLE
    is_pop |= is_flip & (deviations > MIN_POP_ROTATION + 2.0 * median(deviations))
    return is_pop, deviations


def find_translation_pops(
    steps: FloatArray,
    interval: float,
    is_cut: BoolArray,
    min_deviation: float,
    noise: float,
) -> tuple[BoolArray, FloatArray]:
    """Return a mask of translation pops ``(S, N)``, and the deviations [m].

    Like `find_rotation_pops`, for steps ``(S, N, 3)`` [m] in the parent's frame.
    ``min_deviation`` is the smallest pop and ``noise`` the noise of the motion [m].
    """
    if len(steps) + 1 < MIN_FRAMES or not steps.shape[1]:
        no_pops = np.zeros(steps.shape[:2])
        return no_pops.astype(bool), no_pops
    deviations = prediction_errors(steps, is_cut)
    is_pop = find_outliers(steps, deviations, is_cut, min_deviation, noise, interval)
    return is_pop & (
        deviations > MIN_CHANGE_RATIO * velocity_changes(steps)
    ), deviations


def find_outliers(
    steps: FloatArray,
    deviations: FloatArray,
    is_cut: BoolArray,
    min_deviation: float,
    noise: float,
    interval: float,
) -> BoolArray:
    """Return a mask ``(S, N)`` of deviations that far exceed those of nearby steps.

    ``steps`` ``(S, N, 3)``, ``deviations`` ``(S, N)``.
    """
    is_candidate = (deviations > min_deviation).any(axis=0)
    is_outlier = np.zeros(deviations.shape, bool)
    if not is_candidate.any():
        return is_outlier
    deviations = deviations[:, is_candidate]
    steps = _without_cuts(steps[:, is_candidate], is_cut)
    # Overflowing steps stay unexplained.
    with np.errstate(over="ignore", invalid="ignore"):
        residuals, near_pop_residuals = _unexplained_deviations(steps, deviations)
        window_steps = max(MIN_STEPS, round(WINDOW_SECONDS / interval))
        mean_residual = mean_around(residuals, window_steps, NEIGHBOURHOOD_GAP)
        typical_residual = noise + mean_residual
    is_outlier[:, is_candidate] = (
        (deviations > min_deviation)
        & (residuals > MIN_UNEXPLAINED_FRACTION * min_deviation)
        & (residuals > MIN_ROUGHNESS_RATIO * typical_residual)
        & (residuals > MIN_NEIGHBOUR_RATIO * adjacent_maximum(near_pop_residuals))
    )
    return is_outlier


def prediction_errors(steps: FloatArray, is_cut: BoolArray) -> FloatArray:
    """Return the deviation of each step from nearby steps ``(S, N)``.

    The prediction is the trimmed mean of the two steps before and the two after, per
    component, so that one bad step does not affect its neighbours.

    ``steps`` ``(S, N, 3)``, ``is_cut`` ``(S,)``.
    """
    if len(steps) < 3:
        return np.zeros(steps.shape[:2])
    steps = _without_cuts(steps, is_cut)
    a, b, c, d = (_shift_steps(steps, offset) for offset in (-2, -1, 1, 2))
    largest = np.maximum(np.maximum(a, b), np.maximum(c, d))
    smallest = np.minimum(np.minimum(a, b), np.minimum(c, d))
    return _lengths(steps - 0.5 * (a + b + c + d - largest - smallest))


def _unexplained_deviations(
    steps: FloatArray, deviations: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return two arrays ``(S, N)`` of deviations that smooth motion cannot explain.

    Each step is predicted by cubics through four steps around it: the nearest ones, or
    without the one before or after, which a bad frame also disturbs; and by lines
    through the two steps before or after, if the nearer one is as fast, as a strike
    accelerates until it ends. The second array applies the lines to all steps: it is
    for steps next to a pop, which lines on their far sides do not contain.
    """
    a, b, c, d, e, f = (_shift_steps(steps, offset) for offset in (-3, -2, -1, 1, 2, 3))
    residuals = deviations
    for cubic_prediction in (
        (4.0 * (c + d) - b - e) / 6.0,
        c - 0.3 * b + 0.5 * e - 0.2 * f,
        d - 0.3 * e + 0.5 * b - 0.2 * a,
    ):
        residuals = np.fmin(residuals, _lengths(steps - cubic_prediction))
    line_residuals = residuals
    squares = np.einsum("snc,snc->sn", steps, steps)
    for nearer, farther in ((c, b), (d, e)):
        line_errors = _lengths(steps - (2.0 * nearer - farther))
        nearer_squares = np.einsum("snc,snc->sn", nearer, nearer)
        is_similar_speed = nearer_squares > SIMILAR_SPEED_RATIO**2 * squares
        smaller_residuals = np.fmin(residuals, line_errors)
        residuals = np.where(is_similar_speed, smaller_residuals, residuals)
        line_residuals = np.fmin(line_residuals, line_errors)
    return residuals, line_residuals


def _shift_steps(steps: FloatArray, offset: int) -> FloatArray:
    """Shift steps by ``offset`` rows, repeating the end rows ``(S, N, 3)``."""
    rows = np.arange(len(steps)) + offset
    return np.asarray(steps[rows.clip(0, len(steps) - 1)])


def _lengths(vectors: FloatArray) -> FloatArray:
    """Return the Euclidean norms of vectors ``(S, N)``."""
    return np.asarray(np.sqrt(np.einsum("snc,snc->sn", vectors, vectors)))


def _without_cuts(steps: FloatArray, is_cut: BoolArray) -> FloatArray:
    """Replace the steps at cuts by the nearest step without a cut."""
    if not is_cut.any() or is_cut.all():
        return steps
    uncut_rows = np.flatnonzero(~is_cut)
    nearest_indices = np.searchsorted(uncut_rows, np.arange(len(steps)))
    nearest_indices = np.minimum(nearest_indices, len(uncut_rows) - 1)
    return np.asarray(steps[uncut_rows[nearest_indices]])


def mean_around(values: FloatArray, half_window: int, gap: int) -> FloatArray:
    """Return the mean of nearby rows ``(S, N)``, excluding the nearest rows.

    ``values`` ``(S, N)``; rows from ``gap`` to ``half_window`` away are averaged.
    """
    row_count = len(values)
    zero_row = np.zeros((1, *values.shape[1:]))
    cumulative_sums = np.concatenate([zero_row, values.cumsum(axis=0)])
    i = np.arange(row_count)
    starts = np.clip(np.stack([i - half_window, i + gap + 1]), 0, row_count)
    ends = np.clip(np.stack([i - gap, i + half_window + 1]), 0, row_count)
    ends = np.maximum(ends, starts)
    sums = (cumulative_sums[ends] - cumulative_sums[starts]).sum(axis=0)
    return np.asarray(sums / np.maximum((ends - starts).sum(axis=0), 1)[:, None])


def adjacent_maximum(values: FloatArray) -> FloatArray:
    """Return the larger value of the two adjacent steps, ignoring a return step.

    A joint that jumps and stays has one bad step; one that returns in the next frame
    has two. Of the ways to skip such a neighbour, the one with the smallest result is
    used.

    ``values`` ``(S, N)``.
    """
    padded_values = np.pad(values, ((2, 2), (0, 0)))
    pairs = _neighbour_pairs(padded_values)
    return np.asarray(np.min([np.maximum(a, b) for a, b in pairs], axis=0))


def velocity_changes(steps: FloatArray) -> FloatArray:
    """Return the velocity change from the step before to the step after ``(S, N)``.

    A bouncing ball continues in another direction, but a root that jumps continues as
    before. Neighbours are skipped as in `adjacent_maximum`.

    ``steps`` ``(S, N, 3)``.
    """
    padded_steps = np.pad(steps, ((2, 2), (0, 0), (0, 0)), mode="edge")
    pairs = _neighbour_pairs(padded_steps)
    return np.asarray(np.min([np.linalg.norm(b - a, axis=2) for a, b in pairs], axis=0))


def _neighbour_pairs(padded_rows: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
    """Return pairs of rows before and after each row, with at most one row skipped.

    ``padded_rows``: padded by two at each end.
    """
    before2, before, after, after2 = (
        padded_rows[:-4],
        padded_rows[1:-3],
        padded_rows[3:-1],
        padded_rows[4:],
    )
    return [(before, after), (before, after2), (before2, after)]

"""Distances between markers of one subject: at rest, and in motion."""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.maths.so3 import nearest_rotations

# Most frames sampled of a long take.
MAX_SAMPLED_FRAMES = 1500
# Minimum frames for a spread.
MIN_PAIR_FRAMES = 12
# Median, and one standard deviation below and above [%].
PERCENTILES = (15.87, 50.0, 84.13)


@dataclass(frozen=True, slots=True)
class MarkerDistances:
    """Typical distance of each pair of M markers, and its variation."""

    mean: FloatArray  # mean of each pair ``(M, M)`` [m]; NaN if never visible
    spread: FloatArray  # standard deviation of each pair ``(M, M)`` [m]


def marker_distances(positions: FloatArray) -> MarkerDistances:
    """Return median and spread of marker distances over sampled frames.

    positions: ``(F, M, 3)`` [m]; NaN where not visible.
    """
    frame_count, marker_count, _ = positions.shape
    step = max(1, frame_count // MAX_SAMPLED_FRAMES)
    sample = positions[::step]
    mean = np.full((marker_count, marker_count), np.nan)
    spread = np.full((marker_count, marker_count), np.nan)
    min_frames = min(MIN_PAIR_FRAMES, len(sample))
    for i in range(marker_count - 1):
        lengths = np.linalg.norm(sample[:, i + 1 :] - sample[:, i : i + 1], axis=-1)
        is_finite = np.isfinite(lengths)
        measured_columns = np.flatnonzero(is_finite.sum(axis=0) >= min_frames)
        if not len(measured_columns):
            continue
        low, median, high = _column_quantiles(lengths[:, measured_columns])
        partners = measured_columns + i + 1
        mean[i, partners] = mean[partners, i] = median
        spread[i, partners] = spread[partners, i] = 0.5 * (high - low)
    return MarkerDistances(mean, spread)


def _column_quantiles(values: FloatArray) -> FloatArray:
    """Return the `PERCENTILES` of each column ``(3, N)``, ignoring NaN."""
    sorted_values = np.sort(values, axis=0)
    last_row = np.isfinite(values).sum(axis=0) - 1
    fractional_row = np.array(PERCENTILES)[:, None] / 100.0 * last_row
    lower_row = fractional_row.astype(np.int64)
    fraction = fractional_row - lower_row
    columns = np.arange(values.shape[1])
    low = sorted_values[lower_row, columns]
    high = sorted_values[np.minimum(lower_row + 1, last_row), columns]
    step = high - low
    return np.asarray(
        np.where(fraction < 0.5, low + step * fraction, high - step * (1.0 - fraction))
    )


def fit_shape(points: FloatArray, shape: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Fit a rigid shape to the points of each frame by the Kabsch algorithm.

    points: ``(F, K, 3)``. shape: ``(K, 3)``. The result is ``(F, 3, 3)`` and ``(F,
    3)``; ``points = rotation · shape + translation``.
    """
    weights = np.full(points.shape[:2], 1.0 / len(shape))
    centre = np.einsum("fk,fki->fi", weights, points)
    shape_centre = weights @ shape
    centred_shape = shape - shape_centre[:, None]
    covariance = np.einsum(
        "fk,fki,fkj->fij", weights, points - centre[:, None], centred_shape
    )
    rotation = nearest_rotations(covariance)
    return rotation, centre - np.einsum("fij,fj->fi", rotation, shape_centre)


def mean_square_errors(points: FloatArray, shape: FloatArray) -> FloatArray:
    """Return each frame's mean square distance of points from a fitted shape [m^2].

    Arguments are those of `fit_shape`.
    """
    rotation, shift = fit_shape(points, shape)
    fitted_points = np.einsum("fij,kj->fki", rotation, shape) + shift[:, None]
    return np.asarray(((fitted_points - points) ** 2).sum(axis=-1).mean(axis=1))


def positions_by_column(
    positions: FloatArray, run_ids: IntArray, column_of_run: IntArray, column_count: int
) -> FloatArray:
    """Sort points into a column for each run's marker ``(F, M, 3)``, NaN if missing.

    positions: ``(F, P, 3)``. run_ids: Run of each point ``(F, P)``, -1 for none.
    column_of_run: ``(T,)``, -1 for none. column_count: ``M``.
    """
    column_of_point = np.where(run_ids >= 0, column_of_run[run_ids], -1)
    ordered_positions = np.full((len(run_ids), column_count, 3), np.nan)
    frames, points = np.nonzero(column_of_point >= 0)
    ordered_positions[frames, column_of_point[frames, points]] = positions[
        frames, points
    ]
    return ordered_positions


# Iterations of fitting all frames to their median; the shape converges in these.
SHAPE_ITERATIONS = 3


def mean_shape(points: FloatArray) -> FloatArray:
    """Return the median shape of rigid points ``(K, 3)``.

    points: ``(F, K, 3)``, all visible.
    """
    shape = np.median(points - points[:, :1], axis=0)
    for _ in range(SHAPE_ITERATIONS):
        rotation, shift = fit_shape(points, shape)
        local_points = np.einsum("fji,fkj->fki", rotation, points - shift[:, None])
        shape = np.median(local_points, axis=0)
    return np.asarray(shape)

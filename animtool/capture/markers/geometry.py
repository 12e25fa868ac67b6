"""Distances between markers of one subject: at rest, and in motion."""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.record import dataclass

# Most frames sampled of a long take.
MAX_FRAMES = 1500
# Minimum frames for a spread.
MIN_FRAMES = 12
# Median, and one standard deviation below and above [%].
PERCENTILES = (15.87, 50.0, 84.13)


@dataclass(frozen=True, slots=True)
class MarkerDistances:
    """Mean and spread of the distances between M markers."""

    mean: FloatArray  # mean of each pair ``(M, M)`` [m]; NaN if never visible
    spread: FloatArray  # how much each varies ``(M, M)`` [m], standard deviation


def marker_distances(positions: FloatArray) -> MarkerDistances:
    """Return marker distances over frames, robust against a few outliers.

    positions: ``(F, M, 3)`` [m]; NaN where not visible.
    """
    frames, count, _ = positions.shape
    step = max(1, frames // MAX_FRAMES)
    sample = positions[::step]
    mean = np.full((count, count), np.nan)
    spread = np.full((count, count), np.nan)
    min_frames = min(MIN_FRAMES, len(sample))
    for i in range(count - 1):
        lengths = np.linalg.norm(sample[:, i + 1 :] - sample[:, i : i + 1], axis=-1)
        is_finite = np.isfinite(lengths)
        columns_with_data = np.flatnonzero(is_finite.sum(axis=0) >= min_frames)
        if not len(columns_with_data):
            continue
        low, median, high = _column_quantiles(lengths[:, columns_with_data])
        columns = columns_with_data + i + 1
        mean[i, columns] = mean[columns, i] = median
        spread[i, columns] = spread[columns, i] = 0.5 * (high - low)
    return MarkerDistances(mean, spread)


def _column_quantiles(values: FloatArray) -> FloatArray:
    """Return the `PERCENTILES` of each column ``(3, N)``, ignoring NaN."""
    sorted_values = np.sort(values, axis=0)
    last_row = np.isfinite(values).sum(axis=0) - 1
    position = np.array(PERCENTILES)[:, None] / 100.0 * last_row
    lower_row = position.astype(np.int64)
    fraction = position - lower_row
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

    References:
        Kabsch, W., "A solution for the best rotation to relate two sets of vectors",
        Acta Crystallographica A32, 1976.
    """
    weights = np.full(points.shape[:2], 1.0 / len(shape))
    centre = np.einsum("fk,fki->fi", weights, points)
    shape_centre = weights @ shape
    centred_shape = shape - shape_centre[:, None]
    covariance = np.einsum(
        "fk,fki,fkj->fij", weights, points - centre[:, None], centred_shape
    )
    left_vectors, _, right_vectors = np.linalg.svd(covariance)
    sign = np.sign(np.linalg.det(left_vectors) * np.linalg.det(right_vectors))
    left_vectors[:, :, 2] *= np.where(sign == 0, 1.0, sign)[:, None]
    rotation = left_vectors @ right_vectors
    return rotation, centre - np.einsum("fij,fj->fi", rotation, shape_centre)


def mean_square_errors(points: FloatArray, shape: FloatArray) -> FloatArray:
    """Return the mean square distance of points from a fitted shape ``(F,)`` [m^2].

    Arguments are those of `fit_shape`.
    """
    rotation, shift = fit_shape(points, shape)
    fitted_points = np.einsum("fij,kj->fki", rotation, shape) + shift[:, None]
    return np.asarray(((fitted_points - points) ** 2).sum(axis=-1).mean(axis=1))


def positions_by_column(
    positions: FloatArray, ids: IntArray, column_of_id: IntArray, count: int
) -> FloatArray:
    """Return positions in ``count`` columns ``(F, count, 3)``, NaN without a point.

    positions: ``(F, P, 3)``. ids: ``(F, P)``, -1 for none. column_of_id: Column of each
    id, -1 for none.
    """
    column = np.where(ids >= 0, column_of_id[ids], -1)
    ordered_positions = np.full((len(ids), count, 3), np.nan)
    frame, slot = np.nonzero(column >= 0)
    ordered_positions[frame, column[frame, slot]] = positions[frame, slot]
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

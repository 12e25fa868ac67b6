"""Distances between markers of one subject: at rest, and in motion."""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.record import dataclass

# Most frames sampled of a long take.
MAX_FRAMES = 1500
# Minimum frames for a spread.
MIN_FRAMES = 12
# Median, and one standard deviation below and above [%].
PERCENTILES = (15.87, 50.0, 84.13)


@dataclass(frozen=True, slots=True)
class MarkerDistances:
    """Mean and spread of the distances between M markers.

    Attributes:
        mean: Mean of each pair ``(M, M)`` [m]; NaN if never visible.
        spread: How much each varies ``(M, M)`` [m], standard deviation.
    """

    mean: FloatArray
    spread: FloatArray


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
        low, middle, high = _column_quantiles(lengths[:, columns_with_data])
        columns = columns_with_data + i + 1
        mean[i, columns] = mean[columns, i] = middle
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


def merge_distances(rest: MarkerDistances, moving: MarkerDistances) -> MarkerDistances:
    """Return the distances in motion, or at rest where none is known in motion."""
    is_known = np.isfinite(moving.mean)
    return MarkerDistances(
        np.where(is_known, moving.mean, rest.mean),
        np.where(is_known, moving.spread, rest.spread),
    )


def fit_shape(
    points: FloatArray, shape: FloatArray, weights: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Fit a rigid shape to the points of each frame by the Kabsch algorithm.

    points: ``(F, K, 3)``. shape: ``(K, 3)``. weights: Of the points ``(F, K)``; None is
    1. The result is ``(F, 3, 3)`` and ``(F, 3)``; ``points = rotation · shape +
    translation``.

    References:
        Kabsch, W., "A solution for the best rotation to relate two sets of vectors",
        Acta Crystallographica A32, 1976.
    """
    if weights is None:
        weights = np.ones(points.shape[:2])
    weights = weights / weights.sum(axis=1, keepdims=True)
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


# Iterations of fitting all frames to their median; the shape converges in these.
SHAPE_ITERATIONS = 3


def mean_shape(points: FloatArray) -> FloatArray:
    """Return the median shape of rigid points ``(K, 3)``.

    points: ``(F, K, 3)``, all visible.
    """
    shape = np.median(points - points[:, :1], axis=0)
    for _ in range(SHAPE_ITERATIONS):
        rotation, shift = fit_shape(points, shape)
        shape = np.median(
            np.einsum("fji,fkj->fki", rotation, points - shift[:, None]), axis=0
        )
    return np.asarray(shape)

"""Reduces keys to those that linear interpolation needs within a tolerance."""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.formats.gltf.clip_keys import SamplerKeys
from animtool.maths import so3


def reduce_keys(keys: SamplerKeys, tolerance: float) -> SamplerKeys:
    """Return keys that reproduce all others within a tolerance.

    Each step adds the sample with the largest error, until none exceeds the tolerance
    (Ramer, 1972; Douglas and Peucker, 1973). For rotations the tolerance is an angle
    [rad].

    >>> line = SamplerKeys(np.arange(5.0), np.arange(5.0)[:, None])
    >>> reduce_keys(line, 1e-3).times.tolist()
    [0.0, 4.0]
    """
    times, values = keys.times, keys.values
    is_key = np.zeros(len(times), np.bool_)
    is_key[[0, -1]] = True
    spans = [(0, len(times) - 1)]
    while spans:
        first, last = spans.pop()
        if last - first < 2:
            continue
        inside = slice(first + 1, last)
        fraction = (times[inside] - times[first]) / (times[last] - times[first])
        errors = _segment_distances(
            values[first], values[last], fraction, values[inside]
        )
        worst_index = int(errors.argmax())
        if errors[worst_index] > tolerance:
            middle = first + 1 + worst_index
            is_key[middle] = True
            spans += [(first, middle), (middle, last)]
    return SamplerKeys(times[is_key], values[is_key])


def _segment_distances(
    start: FloatArray, end: FloatArray, fraction: FloatArray, values: FloatArray
) -> FloatArray:
    """Return the distance of samples from the segment between two samples."""
    if values.shape[1] == 4:
        interpolated = so3.slerp(start[None], end[None], fraction)
        return so3.angle_between(interpolated, values)
    interpolated = start + fraction[:, None] * (end - start)
    return np.asarray(np.abs(values - interpolated).max(axis=1))

"""Key reduction: samples needed for linear interpolation within a tolerance."""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.formats.gltf.clip_keys import Keys
from animtool.maths import so3


def reduce_keys(keys: Keys, tolerance: float) -> Keys:
    """Return keys that reproduce all others within a tolerance.

    Each step adds the sample with the largest error, until none exceeds the tolerance
    (Ramer, 1972; Douglas and Peucker, 1973). For rotations the tolerance is an angle
    [rad].

    >>> line = Keys(np.arange(5.0), np.arange(5.0)[:, None])
    >>> reduce_keys(line, 1e-3).times.tolist()
    [0.0, 4.0]
    """
    times, values = keys.times, keys.values
    is_key = np.zeros(len(times), np.bool_)
    is_key[[0, -1]] = True
    spans = [(0, len(times) - 1)]
    while spans:
        a, b = spans.pop()
        if b - a < 2:
            continue
        inner = slice(a + 1, b)
        fraction = (times[inner] - times[a]) / (times[b] - times[a])
        errors = _segment_distances(values[a], values[b], fraction, values[inner])
        worst = int(errors.argmax())
        if errors[worst] > tolerance:
            middle = a + 1 + worst
            is_key[middle] = True
            spans += [(a, middle), (middle, b)]
    return Keys(times[is_key], values[is_key])


def _segment_distances(
    a: FloatArray, b: FloatArray, fraction: FloatArray, values: FloatArray
) -> FloatArray:
    """Return the distance of samples from the segment between two of them."""
    if values.shape[1] == 4:
        interpolated = so3.slerp(a[None], b[None], fraction)
        return so3.angle_between(interpolated, values)
    straight = a + fraction[:, None] * (b - a)
    return np.asarray(np.abs(values - straight).max(axis=1))

"""Random numbers that depend on a seed and a key alone, not on the order of asking."""

from __future__ import annotations

import numpy as np

from animtool._types import FloatArray, IntArray

# Of splitmix64: S. Vigna, 2015, after G. Steele, D. Lea, C. Flood, "Fast splittable
# pseudorandom number generators", 2014.
_STEP = np.uint64(0x9E3779B97F4A7C15)
_FIRST = np.uint64(0xBF58476D1CE4E5B9)
_SECOND = np.uint64(0x94D049BB133111EB)


def mixed(
    values: np.ndarray[tuple[int, ...], np.dtype[np.uint64]],
) -> np.ndarray[tuple[int, ...], np.dtype[np.uint64]]:
    """Return 64 bits of which each depends on all those given."""
    z = values + _STEP
    z = (z ^ (z >> np.uint64(30))) * _FIRST
    z = (z ^ (z >> np.uint64(27))) * _SECOND
    return np.asarray(z ^ (z >> np.uint64(31)))


def uniforms(seed: int, keys: IntArray, count: int) -> FloatArray:
    """Return numbers in [0, 1) for each key ``(N, count)``.

    >>> bool((uniforms(1, np.arange(9), 2)[7] == uniforms(1, np.array([7]), 2)).all())
    True
    """
    start = mixed(np.array([seed % 2**64], np.uint64))
    rows = mixed(keys.astype(np.uint64) ^ start)
    columns = np.arange(count, dtype=np.uint64) * _STEP
    bits = mixed(rows[:, None] + columns)
    return np.asarray((bits >> np.uint64(11)).astype(np.float64) * 2.0**-53)

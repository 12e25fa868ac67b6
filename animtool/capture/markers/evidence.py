"""What distances between points say of which markers those are."""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import FloatArray

# Of a pair on one segment, distances are as at rest but for noise and skin [m], and
# more where they vary; and how likely a pair is on one that varies by so much [m].
NOISE, SKIN, ONE_SEGMENT, LOOSE = 0.0007, 0.7, 0.5, 0.003
# Other pairs are about as far apart as at rest, by so much of it, and [m].
PLAY, PLAY_LEAST = 0.25, 0.015
# The density of distances of points that have nothing to do with each other [1/m], and
# what no pair is below.
ANY, LEAST = 1.0, 0.05
# Of pairs that are not on one segment, near ones and steady ones say more [m].
FAR, UNSTEADY = 0.25, 0.02


def evidence(mean: FloatArray, spread: FloatArray, rest: FloatArray) -> FloatArray:
    """Return how much distances speak for those at rest ``(..., M)`` [nat].

    The logarithm of how much likelier each distance is for the pair at rest than for
    any two points. 0 where a distance is not known.

    mean, spread: Of observed distances ``(...)`` [m]. rest: ``(M,)`` or ``(..., M)``.
    """
    known = np.isfinite(mean)
    mean = np.where(known, mean, 0.0)[..., None]
    spread = np.where(known, spread, 1.0)[..., None]
    off = mean - rest
    tight = NOISE + SKIN * spread
    one = ONE_SEGMENT / (1.0 + (spread / LOOSE) ** 2)
    rigid = one / (np.pi * tight * (1.0 + (off / tight) ** 2))
    wide = PLAY_LEAST + spread + PLAY * rest
    other = (1.0 - one) / (np.pi * wide * (1.0 + (off / wide) ** 2)) + LEAST
    weight = 1.0 / ((1.0 + (mean / FAR) ** 2) * (1.0 + (spread / UNSTEADY) ** 2))
    said = weight * np.log(other / ANY) + np.log1p(rigid / other)
    return np.asarray(np.where(known[..., None] & np.isfinite(rest), said, 0.0))

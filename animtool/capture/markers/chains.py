"""Runs of the same unlabelled marker before and after it was hidden."""

from __future__ import annotations

import numpy as np

from animtool.capture.markers.geometry import MarkerDistances
from animtool.core.array_types import FloatArray, IntArray

# Evidence of distances between points for their markers.

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
    """Return the log-likelihood of distances being a rest pair's ``(..., M)`` [nat].

    It compares each distance's likelihood for the pair at rest with that for any two
    points. 0 where a distance is unknown.

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


# Runs are joined where distances say so at least this much, and so much more than of
# any other run that is seen along with one of them [nat].
SURE, CLEAR = 3.0, 1.5


def chained(moving: MarkerDistances, overlap: FloatArray) -> IntArray:
    """Return the chain of each run ``(R,)``, numbered from 0.

    Two runs are joined if they keep the same distances to everything visible with both,
    and no concurrent run matches either nearly as well. Runs visible together are never
    one chain.

    moving: Distances of the runs. overlap: Frames in which pairs are visible ``(R,
    R)``.
    """
    count = len(overlap)
    chain = np.arange(count)
    likelihood = likelihoods(moving, overlap)
    together = overlap > 0
    likelihood[together] = -np.inf
    concurrent = together & ~np.eye(count, dtype=bool)
    # Of two runs that are one marker each is the other's best among those that are seen
    # along with one of them.
    order = np.argwhere(likelihood > SURE)
    order = order[order[:, 0] < order[:, 1]]
    scored = []
    for a, b in order.tolist():
        value = likelihood[a, b]
        rivals_b = likelihood[a][concurrent[b]]  # what could be a instead of b
        rivals_a = likelihood[b][concurrent[a]]
        rival = max(rivals_a.max(initial=0.0), rivals_b.max(initial=0.0))
        if value > rival + CLEAR:
            scored.append((value - rival, a, b))
    scored.sort(reverse=True)
    members = {run: [run] for run in range(count)}
    for _, a, b in scored:
        one, two = int(chain[a]), int(chain[b])
        if one == two or together[np.ix_(members[one], members[two])].any():
            continue
        members[one] += members.pop(two)
        chain[members[one]] = one
    return np.unique(chain, return_inverse=True)[1]


def likelihoods(moving: MarkerDistances, overlap: FloatArray) -> FloatArray:
    """Return the log-likelihood that two runs are one marker, from distances [nat]."""
    count = len(overlap)
    likelihood = np.zeros((count, count))
    for run in range(count):
        mean = moving.mean[run]
        # (S, B): of what is seen along, and the other run's distance to it.
        says = evidence(mean, moving.spread[run], moving.mean)
        weight = np.minimum(1.0, np.minimum(overlap[run][:, None], overlap) / 60.0)
        known = np.isfinite(moving.mean) & np.isfinite(mean)[:, None]
        likelihood[run] = (says * weight * known).sum(axis=0)
    return 0.5 * (likelihood + likelihood.T)


def merged(points: FloatArray, chain: IntArray) -> FloatArray:
    """Return chain positions ``(F, C, 3)`` from run positions ``(F, R, 3)``."""
    merged_points = np.full((len(points), int(chain.max()) + 1, 3), np.nan)
    for run, number in enumerate(chain.tolist()):
        visible = np.isfinite(points[:, run, 0])
        merged_points[visible, number] = points[visible, run]
    return merged_points

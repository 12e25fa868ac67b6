"""Runs that are the same marker before and after it was hidden, without names."""

from __future__ import annotations

import numpy as np

from animtool.capture.markers.evidence import evidence
from animtool.capture.markers.geometry import Distances
from animtool.core.array_types import FloatArray, IntArray

# Runs are joined where distances say so at least this much, and so much more than of
# any other run that is seen along with one of them [nat].
SURE, CLEAR = 3.0, 1.5


def chained(moving: Distances, overlap: FloatArray) -> IntArray:
    """Return which chain each run is of ``(R,)``, numbered from 0.

    Two runs are joined where they are as far from all that is seen along with both, and
    no run seen along with one of them is nearly as much so to the other. Runs that are
    seen together are never one chain.

    moving: Distances of the runs. overlap: Frames that pairs are seen in ``(R, R)``.
    """
    count = len(overlap)
    chain = np.arange(count)
    alike = alike_of(moving, overlap)
    together = overlap > 0
    alike[together] = -np.inf
    concurrent = together & ~np.eye(count, dtype=bool)
    # Of two runs that are one marker each is the other's best among those that are seen
    # along with one of them.
    order = np.argwhere(alike > SURE)
    order = order[order[:, 0] < order[:, 1]]
    scored = []
    for a, b in order.tolist():
        value = alike[a, b]
        rivals_b = alike[a][concurrent[b]]  # what could be a instead of b
        rivals_a = alike[b][concurrent[a]]
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


def alike_of(moving: Distances, overlap: FloatArray) -> FloatArray:
    """Return how much all distances say that two runs are one marker [nat]."""
    count = len(overlap)
    alike = np.zeros((count, count))
    for run in range(count):
        mean = moving.mean[run]
        # (S, B): of what is seen along, and the other run's distance to it.
        says = evidence(mean, moving.spread[run], moving.mean)
        weight = np.minimum(1.0, np.minimum(overlap[run][:, None], overlap) / 60.0)
        seen = np.isfinite(moving.mean) & np.isfinite(mean)[:, None]
        alike[run] = (says * weight * seen).sum(axis=0)
    return 0.5 * (alike + alike.T)


def merged(points: FloatArray, chain: IntArray) -> FloatArray:
    """Return the positions of chains ``(F, C, 3)`` by those of runs ``(F, R, 3)``."""
    whole = np.full((len(points), int(chain.max()) + 1, 3), np.nan)
    for run, number in enumerate(chain.tolist()):
        seen = np.isfinite(points[:, run, 0])
        whole[seen, number] = points[seen, run]
    return whole

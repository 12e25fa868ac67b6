"""What distances between points say of which markers those are."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from animtool._types import FloatArray, IntArray
from animtool.mocap.markers.geometry import distances

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
# Markers so near at rest are exchanged in twos and twos, and in threes [m].
NEAR = 0.2
MAX_CHANGES = 40
# What names have to explain more for them to be changed [nat].
GAIN = 0.5


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


def renamed(positions: FloatArray, rest: FloatArray) -> IntArray | None:
    """Return which name each marker should have ``(M,)`` by distances; None as it is.

    Looks at all exchanges of two markers, and at those of near ones in threes and in
    two pairs at once, until none explains the distances better.

    positions: By the names they have ``(F, M, 3)``. rest: Distances ``(M, M)`` [m].
    """
    moving = distances(positions)
    count = len(rest)
    rows, columns = np.triu_indices(count, 1)
    says = np.zeros((count, count, count, count), np.float32)
    table = evidence(moving.mean[rows, columns], moving.spread[rows, columns],
                     rest.reshape(1, -1)).reshape(-1, count, count)  # fmt: skip
    says[rows, columns] = table
    says[columns, rows] = table.transpose(0, 2, 1)
    moves = _moves(rest)
    names = np.arange(count)
    for _ in range(MAX_CHANGES):
        # What each marker by each name would say, with the names of all others.
        alone = says[:, np.arange(count), :, names].sum(axis=0)
        best, gain = None, GAIN
        for old, new in moves:
            value = _gain(says, alone, names, old, new)
            top = int(value.argmax())
            if value[top] > gain:
                best, gain = (old[top], new[top]), float(value[top])
        if best is None:
            break
        old, new = best
        names[old] = names[new]
    return names if (names != np.arange(count)).any() else None


def _gain(
    says: FloatArray, alone: FloatArray, names: IntArray, old: IntArray, new: IntArray
) -> FloatArray:
    """Return what is gained where markers take the names of others ``(N,)`` [nat]."""
    was, will = names[old], names[new]
    value = (alone[old, will] - alone[old, was]).sum(axis=1)
    for a, b in combinations(range(old.shape[1]), 2):
        one, two = old[:, a], old[:, b]
        value += says[one, two, will[:, a], will[:, b]]
        value += says[one, two, was[:, a], was[:, b]]
        value -= says[one, two, will[:, a], was[:, b]]
        value -= says[one, two, was[:, a], will[:, b]]
    return np.asarray(value)


def _moves(rest: FloatArray) -> list[tuple[IntArray, IntArray]]:
    """Return exchanges: the markers ``(N, K)``, and whose name each takes."""
    count = len(rest)
    two = np.array(list(combinations(range(count), 2)))
    near = [(a, b) for a, b in two.tolist() if rest[a, b] < NEAR]
    three = np.array(
        [
            (a, b, c)
            for a, b, c in combinations(range(count), 3)
            if sum(rest[i, j] < NEAR for i, j in ((a, b), (b, c), (a, c))) >= 2
        ]
    ).reshape(-1, 3)
    four = np.array(
        [
            (*one, *other)
            for one, other in combinations(near, 2)
            if not set(one) & set(other)
        ]
    ).reshape(-1, 4)
    return [
        (two, two[:, ::-1]),
        (three, three[:, [1, 2, 0]]),
        (three, three[:, [2, 0, 1]]),
        (four, four[:, [1, 0, 3, 2]]),
    ]

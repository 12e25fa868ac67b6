"""Names of markers that stand for each other: found by the handedness of shapes."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from animtool._types import FloatArray, IntArray
from animtool.mocap.markers.geometry import fitted

# Markers so near may be taken for each other [m].
NEAR = 0.16
# Markers around those in question that give them a frame.
AROUND = 3
# Frames looked at, and those of them that are nearest to the pose of the trial [1].
SAMPLES, BEST = 240, 0.1
MIN_SAMPLES = 8
# An exchange has to bring shapes nearer by this share, and by this much [m].
SHARE, LEAST = 0.8, 0.001


def better_names(positions: FloatArray, shape: FloatArray) -> IntArray | None:
    """Return which name each marker should have ``(M,)``, where some are exchanged.

    Looks at pairs of near markers, and at two pairs at once. The measure is how far the
    shape at rest is off the points in the frames in which it is least so, turned but
    not mirrored.

    positions: ``(F, M, 3)``. shape: ``(M, 3)`` at rest.

    Returns:
        None where no exchange is clearly better.
    """
    apart = np.linalg.norm(shape[:, None] - shape[None], axis=-1)
    pairs = [
        (i, j) for i, j in combinations(range(len(shape)), 2) if apart[i, j] < NEAR
    ]
    moves = [(pair,) for pair in pairs]
    for one, other in combinations(pairs, 2):
        if not set(one) & set(other) and _near(apart, one, other):
            moves.append((one, other))  # type: ignore[arg-type]
    best, gain = None, 0.0
    for move in moves:
        changed = [marker for pair in move for marker in pair]
        group = np.array([*changed, *_around(apart, changed)])
        points = _samples(positions[:, group])
        if points is None:
            continue
        names = np.arange(len(group))
        for k in range(0, len(changed), 2):
            names[k], names[k + 1] = k + 1, k
        now = _off(points, shape[group])
        then = _off(points, shape[group[names]])
        if then < SHARE * now and now - then > max(LEAST, gain):
            gain = now - then
            best = np.arange(len(shape))
            best[group] = group[names]
    return best


def _near(apart: FloatArray, one: tuple[int, int], other: tuple[int, int]) -> bool:
    return bool(apart[np.ix_(one, other)].min() < NEAR)


def _around(apart: FloatArray, markers: list[int]) -> list[int]:
    """Return the markers nearest to some, beside them."""
    distance = apart[markers].min(axis=0)
    distance[markers] = np.inf
    return [int(i) for i in np.argsort(distance, kind="stable")[:AROUND]]


def _samples(points: FloatArray) -> FloatArray | None:
    """Return frames in which all of some markers are seen; None where they are few."""
    whole = np.flatnonzero(np.isfinite(points).all(axis=(1, 2)))
    if len(whole) < MIN_SAMPLES:
        return None
    step = max(1, len(whole) // SAMPLES)
    return np.asarray(points[whole[::step]])


def _off(points: FloatArray, shape: FloatArray) -> float:
    """Return how far a shape is off points in the frames that fit it best [m]."""
    rotation, shift = fitted(points, shape)
    fit = np.einsum("fij,kj->fki", rotation, shape) + shift[:, None]
    off = np.sqrt(((fit - points) ** 2).sum(axis=-1).mean(axis=1))
    count = max(1, int(BEST * len(off)))
    return float(np.partition(off, count - 1)[:count].mean())

"""How far steps from frame to frame differ from what the frames around predict."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from animtool._types import BoolArray, FloatArray


def surprises(steps: FloatArray, cuts: BoolArray) -> FloatArray:
    """Return how far each step is from those around it ``(S, N)``.

    The prediction is the mean of the middle two of the two steps before and the two
    after, by component, so that one bad step does not spoil that of its neighbours.

    Args:
        steps: Vectors ``(S, N, 3)``.
        cuts: Steps that are no motion ``(S,)``; they surprise by 0.
    """
    if len(steps) < 3:
        return np.zeros(steps.shape[:2])
    steps = _without(steps, cuts)
    rows = np.pad(steps, ((2, 2), (0, 0), (0, 0)), mode="edge")
    a, b, c, d = rows[:-4], rows[1:-3], rows[3:-1], rows[4:]
    most = np.maximum(np.maximum(a, b), np.maximum(c, d))
    least = np.minimum(np.minimum(a, b), np.minimum(c, d))
    off = steps - 0.5 * (a + b + c + d - most - least)
    return np.asarray(np.sqrt(np.einsum("snc,snc->sn", off, off)))


def _without(steps: FloatArray, cuts: BoolArray) -> FloatArray:
    """Return steps in which cuts do what the nearest other step does."""
    if not cuts.any() or cuts.all():
        return steps
    kept = np.flatnonzero(~cuts)
    place = np.searchsorted(kept, np.arange(len(steps))).clip(0, len(kept) - 1)
    return np.asarray(steps[kept[place]])


def mean_around(values: FloatArray, reach: int, gap: int) -> FloatArray:
    """Return the mean of the rows within reach, the nearest left out ``(S, N)``.

    Args:
        values: ``(S, N)``.
        reach: How many rows before and after count.
        gap: How many of them on either side do not, beside the row itself.
    """
    count = len(values)
    total = np.concatenate([np.zeros((1, *values.shape[1:])), values.cumsum(axis=0)])
    i = np.arange(count)
    low = np.clip(np.stack([i - reach, i + gap + 1]), 0, count)
    high = np.maximum(np.clip(np.stack([i - gap, i + reach + 1]), 0, count), low)
    sums = (total[high] - total[low]).sum(axis=0)
    return np.asarray(sums / np.maximum((high - low).sum(axis=0), 1)[:, None])


def around(values: FloatArray) -> FloatArray:
    """Return the larger of the values beside a step that may stay or come back.

    A joint that jumps and stays makes one bad step, one that is back in the next
    frame makes two: of the ways to leave such a neighbour out, the one that leaves
    the least counts.

    Args:
        values: Surprises of steps ``(S, N)``.
    """
    rows = np.pad(values, ((2, 2), (0, 0)))
    before2, before, after, after2 = rows[:-4], rows[1:-3], rows[3:-1], rows[4:]
    stays = np.maximum(before, after)
    comes_back = np.maximum(before, after2)
    came_back = np.maximum(before2, after)
    return np.asarray(np.minimum(stays, np.minimum(comes_back, came_back)))


def changes(steps: FloatArray) -> FloatArray:
    """Return how far the steps after each differ from those before ``(S, N)``.

    A ball that bounces goes on another way, and a root that jumps goes on as before.
    As in `around`, of the ways to leave out a neighbour the best one counts.

    Args:
        steps: Vectors ``(S, N, 3)``.
    """
    rows = np.pad(steps, ((2, 2), (0, 0), (0, 0)), mode="edge")
    before2, before, after, after2 = rows[:-4], rows[1:-3], rows[3:-1], rows[4:]
    pairs = ((before, after), (before, after2), (before2, after))
    return np.asarray(
        np.min([np.linalg.norm(late - early, axis=2) for early, late in pairs], axis=0)
    )


def runs(flags: BoolArray) -> Iterator[tuple[int, int]]:
    """Yield the first and last index of each run of true values.

    >>> list(runs(np.array([True, False, True, True])))
    [(0, 0), (2, 3)]
    """
    edges = np.flatnonzero(np.diff(flags.astype(np.int8), prepend=0, append=0))
    for start, end in edges.reshape(-1, 2).tolist():
        yield start, end - 1

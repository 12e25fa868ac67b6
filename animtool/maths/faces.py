"""Polygons: their sides, and their triangles."""

from __future__ import annotations

import numpy as np

from animtool._types import IntArray

__all__ = ["sides", "triangulated"]


def sides(counts: IntArray, indices: IntArray) -> IntArray:
    """Return each corner of polygons with the next of the same ``(C, 2)``.

    Args:
        counts: Corners of each ``(M,)``.
        indices: Corners, one polygon after the other ``(C,)``.

    >>> sides(np.array([3]), np.array([5, 6, 7])).tolist()
    [[5, 6], [6, 7], [7, 5]]
    """
    ends = np.cumsum(counts)
    ahead = np.roll(indices, -1)
    ahead[ends - 1] = indices[ends - counts]
    return np.stack([indices, ahead], axis=1)


def triangulated(counts: IntArray, indices: IntArray) -> IntArray:
    """Return the triangles of polygons, each cut into a fan ``(T, 3)``.

    Args:
        counts: Corners of each ``(M,)``.
        indices: Corners, one polygon after the other.

    >>> triangulated(np.array([4]), np.array([5, 6, 7, 8])).tolist()
    [[5, 6, 7], [5, 7, 8]]
    """
    firsts = np.cumsum(counts) - counts
    fans = np.maximum(counts - 2, 0)
    starts = np.repeat(firsts, fans)
    turn = np.arange(fans.sum()) - np.repeat(np.cumsum(fans) - fans, fans)
    return np.stack(
        [indices[starts], indices[starts + turn + 1], indices[starts + turn + 2]], 1
    )

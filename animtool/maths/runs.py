"""Runs of true values in masks."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from animtool.core.array_types import BoolArray


def runs(mask: BoolArray) -> list[tuple[int, int]]:
    """Return the runs of a mask ``(F,)`` as half-open spans of indices.

    >>> runs(np.array([True, False, True, True]))
    [(0, 1), (2, 4)]
    """
    boundaries = np.flatnonzero(np.diff(mask, prepend=False, append=False)).tolist()
    return list(zip(boundaries[::2], boundaries[1::2], strict=True))


def merge_runs(spans: Iterable[tuple[int, int]], gap: int) -> list[tuple[int, int]]:
    """Merge sorted runs that are separated by less than a gap.

    >>> merge_runs([(0, 1), (2, 4), (9, 10)], 3)
    [(0, 4), (9, 10)]
    """
    merged_runs: list[tuple[int, int]] = []
    for first, end in spans:
        if merged_runs and first - merged_runs[-1][1] < gap:
            merged_runs[-1] = (merged_runs[-1][0], end)
        else:
            merged_runs.append((first, end))
    return merged_runs

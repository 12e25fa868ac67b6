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
    edges = np.flatnonzero(np.diff(mask, prepend=False, append=False)).tolist()
    return list(zip(edges[::2], edges[1::2], strict=True))


def joined(spans: Iterable[tuple[int, int]], gap: int) -> list[tuple[int, int]]:
    """Return sorted runs, with those separated by less than a gap merged.

    >>> joined([(0, 1), (2, 4), (9, 10)], 3)
    [(0, 4), (9, 10)]
    """
    wide: list[tuple[int, int]] = []
    for first, end in spans:
        if wide and first - wide[-1][1] < gap:
            wide[-1] = (wide[-1][0], end)
        else:
            wide.append((first, end))
    return wide

"""Names of markers that were exchanged for a while: found and put right."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from animtool._types import BoolArray, IntArray
from animtool.markers import Markers
from animtool.mocap.markers.runs import RunLabels
from animtool.mocap.markers.tracklets import follow

# Frames that name a run; a change of fewer is a spike.
MIN_SWAP = 4


@dataclass(frozen=True, slots=True)
class Swap:
    """A span of frames in which two markers had each other's names.

    Attributes:
        markers: The two, in the order of the file.
        first: First frame, from 0.
        last: Last frame.
    """

    markers: tuple[str, str]
    first: int
    last: int


def unswapped(markers: Markers) -> tuple[Markers, list[Swap]]:
    """Return markers in which each has its own positions all along, and what was wrong.

    Points are followed over time without their names. A run that has one name most of
    the time is that marker; a run that is not where its marker would be, by the
    distances to the others, is the marker whose place it is at.
    """
    positions, count = markers.positions, len(markers.names)
    if count < 2 or not markers.seen.any():
        return markers, []
    rate = float(markers.clock.rate)
    tracklets = follow(positions, rate)
    runs = len(tracklets.first)
    votes = np.zeros((runs, count), np.int64)
    frame, marker = np.nonzero(tracklets.ids >= 0)
    np.add.at(votes, (tracklets.ids[frame, marker], marker), 1)
    unknown = np.full((count, count), np.nan)
    given = votes.argmax(axis=1)
    work = RunLabels(positions, tracklets, rate, given, unknown)
    work.settle()
    return _renamed(markers, tracklets.ids, work.given)


def _renamed(
    markers: Markers, ids: IntArray, given: IntArray
) -> tuple[Markers, list[Swap]]:
    """Return markers by the names of runs, where those are others for long enough."""
    count = len(markers.names)
    own = np.where(ids >= 0, given[ids], -1)  # whose each position is
    wrong = (own >= 0) & (own != np.arange(count))
    source = np.tile(np.arange(count), (len(markers), 1))
    swaps = []
    for a, b in _pairs(own, wrong):
        crossed = (own[:, a] == b) | (own[:, b] == a)
        straight = (own[:, a] == a) | (own[:, b] == b)
        for first, last in _spans(crossed, straight):
            swaps.append(Swap((markers.names[a], markers.names[b]), first, last))
            source[first : last + 1, [a, b]] = (b, a)
    swaps.sort(key=lambda swap: (swap.first, swap.markers))
    return (_taken(markers, source) if swaps else markers), swaps


def _pairs(own: IntArray, wrong: BoolArray) -> list[tuple[int, int]]:
    frame, named = np.nonzero(wrong)
    pairs = np.stack([own[frame, named], named], axis=1)
    pairs.sort(axis=1)
    return [(int(a), int(b)) for a, b in np.unique(pairs, axis=0).tolist()]


def _spans(crossed: BoolArray, straight: BoolArray) -> list[tuple[int, int]]:
    """Return first and last frames of spans that are crossed, over gaps too."""
    frames = np.flatnonzero(crossed)
    right = np.concatenate([[0], np.cumsum(straight & ~crossed)])
    parts = np.flatnonzero(np.diff(right[frames]) > 0) + 1
    spans = [(int(part[0]), int(part[-1])) for part in np.split(frames, parts)]
    return [(a, b) for a, b in spans if int(crossed[a : b + 1].sum()) >= MIN_SWAP]


def _taken(markers: Markers, source: IntArray) -> Markers:
    """Return markers whose values are those of others ``(F, M)``."""

    def moved(values: Any) -> Any:
        return None if values is None else np.take_along_axis(values, source, 1)

    return replace(
        markers,
        positions=np.take_along_axis(markers.positions, source[..., None], 1),
        cameras=moved(markers.cameras),
        residuals=moved(markers.residuals),
        filled=moved(markers.filled),
    )

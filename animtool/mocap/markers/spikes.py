"""Positions that are off for a few frames: found against the motion around them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from animtool._types import BoolArray, FloatArray
from animtool.markers import Markers

# Longer ones are motion [frame].
MAX_LENGTH = 4
# Frames on either side that say where a marker should be.
AROUND = 3
# What is off by less is noise or motion [m], and so is what is off by so many times
# what the marker's positions usually are.
LEAST, TIMES = 0.004, 8.0
# How far the frames around may be off the curve through them, of what is a spike.
SMOOTH = 0.35
# Beside a gap there are frames on one side only: a spike is so many times larger.
ONE_SIDED = 4.0
# Frames of one side that say where a marker should be.
ALONE = 6


@dataclass(frozen=True, slots=True)
class Spike:
    """A marker that is off for a few frames.

    Attributes:
        marker: Its name.
        first: First frame, from 0.
        last: Last frame.
        size: How far it is off at most [m].
    """

    marker: str
    first: int
    last: int
    size: float


def find_spikes(markers: Markers) -> list[Spike]:
    """Return the spikes of all markers, by marker and frame.

    A spike is up to four frames long. Its frames are far off a cubic through the three
    frames before and the three after, which themselves are near it.
    """
    found = []
    for index, name in enumerate(markers.names):
        path = markers.positions[:, index]
        for first, last, size in _spikes(path):
            found.append(Spike(name, first, last, size))
    return found


def without_spikes(markers: Markers, spikes: list[Spike]) -> Markers:
    """Return markers in which spikes are gaps."""
    positions = markers.positions.copy()
    for spike in spikes:
        column = markers.names.index(spike.marker)
        positions[spike.first : spike.last + 1, column] = np.nan
    return replace(markers, positions=positions)


def _spikes(path: FloatArray) -> list[tuple[int, int, float]]:
    """Return first frame, last frame and size of the spikes of a marker ``(F, 3)``."""
    seen = np.isfinite(path[:, 0])
    if int(seen.sum()) < 2 * AROUND + 1:
        return []
    usual = _usual(path)
    limit = max(LEAST, TIMES * usual)
    candidates = []
    for length in range(1, MAX_LENGTH + 1):
        for sides, factor in (((True, True), 1.0), ((True, False), ONE_SIDED),
                              ((False, True), ONE_SIDED)):  # fmt: skip
            off, around = _deviation(path, seen, length, *sides)
            size = factor * limit
            flags = (off > size) & (around < SMOOTH * off)
            for first in np.flatnonzero(flags).tolist():
                score = off[first] - around[first]
                candidates.append((factor, -score, first, length, float(off[first])))
    candidates.sort()
    taken = np.zeros(len(path), bool)
    found = []
    for _, _, first, length, size in candidates:
        if not taken[first : first + length].any():
            taken[max(first - AROUND, 0) : first + length + AROUND] = True
            found.append((first, first + length - 1, size))
    return sorted(found)


def _usual(path: FloatArray) -> float:
    """Return how far a position usually is off those around it [m]."""
    off, _ = _deviation(path, np.isfinite(path[:, 0]), 1, True, True)
    known = off[off >= 0]
    return float(np.median(known)) if len(known) else 0.0


def _deviation(
    path: FloatArray, seen: BoolArray, length: int, before: bool, after: bool
) -> tuple[FloatArray, FloatArray]:
    """Return by how much each span is off the frames around it, and those themselves.

    The first is the least of the span's frames, -1 where the span or a frame around is
    not seen. With one side, more frames of that are taken and a parabola is fitted.
    """
    frames = len(path)
    off, around = np.full(frames, -1.0), np.zeros(frames)
    reach = AROUND if before and after else ALONE
    steps = [*(range(-reach, 0) if before else ()),
             *(range(length, length + reach) if after else ())]  # fmt: skip
    inside = np.arange(length)
    low, high = min(steps[0], 0), max(steps[-1], length - 1)
    starts = np.arange(-low, frames - high)
    if not len(starts):
        return off, around
    whole = seen[starts[:, None] + np.array([*steps, *inside])].all(axis=1)
    if not (before and after):
        # Only where the other side is a gap or the end.
        edge = starts + length if before else starts - 1
        outside = (edge < 0) | (edge >= frames)
        whole &= outside | ~seen[np.clip(edge, 0, frames - 1)]
    starts = starts[whole]
    degree = 3 if before and after else 2
    powers = np.vander(np.array(steps, np.float64), degree + 1)
    inverse = np.linalg.pinv(powers)
    support = path[starts[:, None] + steps]  # (S, K, 3)
    curve = np.einsum("pk,skc->spc", inverse, support)
    fit = np.einsum("kp,spc->skc", powers, curve)
    expected = np.einsum("kp,spc->skc", np.vander(inside * 1.0, degree + 1), curve)
    missed = np.linalg.norm(path[starts[:, None] + inside] - expected, axis=-1)
    off[starts] = missed.min(axis=1)
    around[starts] = np.linalg.norm(support - fit, axis=-1).max(axis=1)
    return off, around

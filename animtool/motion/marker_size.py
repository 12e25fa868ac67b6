"""Measures the size of a captured subject, and judges it."""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.quantities import length_text

# Sizes of captured subjects, from a hand to a group of people [m].
MIN_SUBJECT_SIZE, MAX_SUBJECT_SIZE = 0.05, 60.0
# Size of a child, and of a person with raised arms [m].
PERSON_SIZE = (0.5, 3.0)
# Ratios of units: m, cm, mm and in.
_UNIT_RATIOS = (10.0, 100.0, 1000.0, 39.37)
UNIT_FACTORS = (*_UNIT_RATIOS, *(1 / factor for factor in _UNIT_RATIOS))
# Frames sampled, and markers that a frame needs.
SAMPLED_FRAME_COUNT, MIN_MARKERS = 100, 4


def subject_size(positions: FloatArray) -> float | None:
    """Return the median diagonal of the markers of a frame [m]; None for too few.

    ``positions`` are ``(F, M, 3)`` [m], NaN for missing ones.
    """
    frame_indices = np.linspace(0, max(len(positions) - 1, 0), SAMPLED_FRAME_COUNT)
    sizes = []
    for frame in positions[np.unique(frame_indices.astype(int))]:
        visible_points = frame[np.isfinite(frame).all(axis=1)]
        if len(visible_points) >= MIN_MARKERS:
            sizes.append(float(np.linalg.norm(np.ptp(visible_points, axis=0))))
    return float(np.median(sizes)) if sizes else None


def is_plausible_size(size: float) -> bool:
    """Return whether a captured subject may have a size [m]."""
    return MIN_SUBJECT_SIZE <= size <= MAX_SUBJECT_SIZE


def is_person_size(size: float) -> bool:
    """Return whether a size is that of a person [m].

    >>> is_person_size(1.8), is_person_size(18.0)
    (True, False)
    """
    return PERSON_SIZE[0] <= size <= PERSON_SIZE[1]


def rescaled_text(size: float) -> str:
    """Return text naming the factor that makes a size [m] a person's; empty if none.

    >>> rescaled_text(0.0018), rescaled_text(1e9)
    ('; 1000 times that (1.8 m) would fit a person', '')
    """
    for factor in UNIT_FACTORS:
        if is_person_size(size * factor):
            times_text = f"{factor:g} times" if factor > 1 else f"1/{1 / factor:g} of"
            size_text = length_text(size * factor)
            return f"; {times_text} that ({size_text}) would fit a person"
    return ""

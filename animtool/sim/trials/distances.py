"""How far two simulations of one thing are apart."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from animtool._types import FloatArray
from animtool.sim.trials.trial import Shot


@dataclass(frozen=True, slots=True)
class Distances:
    """How far points are from where others have them, over all times.

    Attributes:
        largest: [m]
        rms: Root of the mean of squares [m].
        median: Half of them are nearer [m].
        apart: Share of the points that only one of the two has [1].
    """

    largest: float
    rms: float
    median: float
    apart: float = 0.0

    def scaled(self, factor: float) -> Distances:
        """Return them times a factor."""
        return Distances(
            self.largest * factor, self.rms * factor, self.median * factor, self.apart
        )


def distances(truth: Sequence[Shot], found: Sequence[Shot]) -> Distances:
    """Return how far shots are from others of the same times.

    Points are compared by their ids.

    >>> here, there = Shot(np.zeros((2, 3))), Shot(np.array([[0, 0, 3.0], [0, 4, 0]]))
    >>> distances([here], [there]).largest
    4.0
    """
    parts, lone, count = [np.zeros(0)], 0, 0
    for one, other in zip(truth, found, strict=True):
        a, b = one.points, other.points
        if one.ids is not None and other.ids is not None:
            _, i, j = np.intersect1d(
                one.ids, other.ids, assume_unique=True, return_indices=True
            )
            lone += len(a) + len(b) - 2 * len(i)
            count += len(a) + len(b) - len(i)
            a, b = a[i], b[j]
        else:
            count += len(a)
        parts.append(np.linalg.norm(b - a, axis=1))
    every: FloatArray = np.concatenate(parts)
    if not len(every):
        return Distances(0.0, 0.0, 0.0, lone / max(count, 1))
    # Squares of what has blown up are beyond any number.
    with np.errstate(over="ignore"):
        rms = math.sqrt(float(np.mean(every**2)))
    return Distances(float(every.max()), rms, float(np.median(every)), lone / count)


def extent_of(shots: Sequence[Shot]) -> float:
    """Return the diagonal of the box that all points stay in [m]."""
    every = [shot.points for shot in shots if len(shot.points)]
    if not every:
        return 0.0
    low = np.min([points.min(axis=0) for points in every], axis=0)
    high = np.max([points.max(axis=0) for points in every], axis=0)
    return float(np.linalg.norm(high - low))


def order_seen(coarse: float, fine: float) -> float | None:
    """Return the power of the step that errors go with.

    Args:
        coarse: From steps to half of them, how far a motion moves [m].
        fine: From these to half of them again [m].

    None where there is nothing to tell it from.

    >>> order_seen(0.4, 0.1)
    2.0
    """
    if not (coarse > 0 and fine > 0 and math.isfinite(coarse / fine)):
        return None
    return math.log2(coarse / fine)

"""What acts on particles from outside: pins, targets and the air."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from animtool._types import ArrayLike, FloatArray


@dataclass(frozen=True, slots=True)
class Pins:
    """Particles that are held, and where.

    Between two times they go straight; before the first and after the last they stay.

    Attributes:
        particles: Which ``(P,)``.
        positions: At the times ``(K, P, 3)``, or ``(P, 3)`` where they stand still
            [m]; None where they are at the start.
        times: Ascending ``(K,)`` [s]; None where they stand still.
    """

    particles: ArrayLike
    positions: ArrayLike | None = None
    times: ArrayLike | None = None


@dataclass(frozen=True, slots=True)
class Targets:
    """Points that particles are drawn to by springs of no length.

    Attributes:
        particles: Which are drawn ``(A,)``; one may stand twice.
        positions: Of the points at the times ``(K, A, 3)``, or ``(A, 3)`` where they
            stand still [m].
        stiffness: Force over distance, of each or of all [N/m].
        damping: Force over the speed between particle and point, of each or all
            [N s/m].
        times: Ascending ``(K,)`` [s]; None where the points stand still.
    """

    particles: ArrayLike
    positions: ArrayLike
    stiffness: ArrayLike
    damping: ArrayLike = 0.0
    times: ArrayLike | None = None


@dataclass(frozen=True, slots=True)
class Air:
    """Air that moves past the triangles of a body.

    A triangle of area A, through whose normal n air flows at u against it, bears
    ½ density A (drag |u·n| u + lift (u·n) (|u| n - (u·n) u/|u|)), its corners a third
    each.

    Attributes:
        wind: Velocity of the air ``(3,)``, or at the times ``(K, 3)`` [m/s].
        drag: Coefficient along the flow [1].
        lift: Coefficient across it [1].
        density: [kg/m³]
        times: Ascending ``(K,)`` [s]; None where the wind is steady.
    """

    wind: ArrayLike = (0.0, 0.0, 0.0)
    drag: float = 1.0
    lift: float = 0.5
    density: float = 1.2
    times: ArrayLike | None = None


def over_knots(
    paths: Sequence[tuple[FloatArray, FloatArray]],
) -> tuple[FloatArray, list[FloatArray]]:
    """Return paths over the times of all: ``(K,)`` and each ``(K or 1, P, 3)``.

    Args:
        paths: Times ``(K,)`` of each and positions ``(K, P, 3)``; one time is none.

    >>> times, (path,) = over_knots([(np.array([0.0, 1.0]), np.zeros((2, 1, 3)))])
    >>> times.tolist(), path.shape
    ([0.0, 1.0], (2, 1, 3))
    """
    moving = [times for times, _ in paths if len(times) > 1]
    knots = np.unique(np.concatenate(moving)) if moving else np.zeros(1)
    found = []
    for times, path in paths:
        still = len(times) == 1
        same = still or np.array_equal(times, knots)
        found.append(np.ascontiguousarray(path if same else _at(times, path, knots)))
    return knots, found


def _at(times: FloatArray, path: FloatArray, knots: FloatArray) -> FloatArray:
    after = np.clip(np.searchsorted(times, knots, "right"), 1, len(times) - 1)
    begin, end = times[after - 1], times[after]
    share = np.clip((knots - begin) / (end - begin), 0.0, 1.0)[:, None, None]
    moved: FloatArray = path[after - 1] + share * (path[after] - path[after - 1])
    return np.where(share == 1, path[after], moved)

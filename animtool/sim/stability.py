"""The largest steps with which methods stay stable.

All of it for ``x'' + 2 ζ ω x' + ω² x = 0``, in ``s = ω h``. Polynomials are numpy's:
coefficients in ascending order.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import TypeAlias

import numpy as np
from numpy.polynomial import polynomial as poly

from animtool.core.array_types import FloatArray

# Maps angular frequency [rad/s] and damping ratio [1] to a step [s].
Limit: TypeAlias = Callable[[float, float], float]

# Smaller coefficients, relative to the largest, are rounding.
ROUNDING = 1e-14
# Larger damping ratios use the limit for infinite ratios, scaled by 1 / ratio [1].
MAX_DAMPING = 1e6


def unlimited(omega: float, damping_ratio: float) -> float:  # noqa: ARG001
    """Return the limit of unconditionally stable methods."""
    return math.inf


def rate_limit(growth: Sequence[float]) -> Limit:
    """Return the limit of a method with growth polynomial R(h λ) for ``y' = λ y``.

    R is a polynomial that begins 1 + z.

    Limits of the method: of the steps up to the first that is not stable; windows of
    stable steps beyond are left out.

    >>> round(rate_limit([1, 1, 1 / 2, 1 / 6, 1 / 24])(1.0, 0.0), 3)
    2.828
    """
    coefficients = np.asarray(growth, np.float64)

    def limit(omega: float, damping_ratio: float) -> float:
        # λ h of the slower decay is smaller than rounding.
        if damping_ratio >= 1:
            root = math.sqrt(damping_ratio - 1) * math.sqrt(damping_ratio + 1)
            values = {complex(-damping_ratio - root)}
        else:
            root = math.sqrt((1 - damping_ratio) * (1 + damping_ratio))
            values = {complex(-damping_ratio, root), complex(-damping_ratio, -root)}
        limits = (_first_growth(coefficients, value) for value in values)
        return min(limits) / omega

    return limit


def _first_growth(growth: FloatArray, value: complex) -> float:
    size = abs(value)
    along = growth * (value / size) ** np.arange(len(growth))
    square: FloatArray = np.convolve(along, along.conj()).real
    square[0] = 0.0
    return _first_positive(square) / size


def jury_limit(
    trace: Callable[[float], Sequence[float]],
    determinant: Callable[[float], Sequence[float]],
) -> Limit:
    """Return the limit of a method that maps (x, v/ω) by a matrix each step.

    Both of its eigenvalues are in the unit circle where the determinant D is at most 1
    and the trace T at most 1 + D in size (Jury's conditions). Both are polynomials in s
    for each damping ratio.

    >>> limit = jury_limit(lambda ζ: [2, -2 * ζ, -1], lambda ζ: [1, -2 * ζ])
    >>> round(limit(10.0, 0.0), 9)
    0.2
    """

    def limit(omega: float, damping_ratio: float) -> float:
        ratio = min(damping_ratio, MAX_DAMPING)
        t, d = np.array(trace(ratio)), np.array(determinant(ratio))
        above = poly.polysub(d, [1.0])
        beyond = [poly.polysub(side, poly.polyadd(d, [1.0])) for side in (t, -t)]
        least = min(map(_first_positive, [above, *beyond])) / omega
        # The limit is proportional to 1 / ratio there.
        return least * (ratio / damping_ratio) if damping_ratio > ratio else least

    return limit


def _first_positive(polynomial: FloatArray) -> float:
    """Return the smallest argument above 0 at which a polynomial is positive."""
    small = np.abs(polynomial) <= ROUNDING * max(np.abs(polynomial).max(), 1.0)
    kept = np.where(small, 0.0, polynomial)
    (used,) = kept.nonzero()
    if not len(used):
        return math.inf
    kept = kept[used[0] : used[-1] + 1]
    if kept[0] > 0:
        return 0.0
    roots = poly.polyroots(kept)
    real = roots[np.abs(roots.imag) <= 1e-9 * np.abs(roots)].real
    ends = sorted(real[real > 0].tolist())
    for here, there in pairwise([*ends, math.inf]):
        between = here + 1 if math.isinf(there) else (here + there) / 2
        if poly.polyval(between, kept) > 0:
            return float(here)
    return math.inf

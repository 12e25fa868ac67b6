"""Largest stable steps of integration methods.

For the equation ``x'' + 2 ζ ω x' + ω² x = 0``, in ``s = ω h``. Polynomials are arrays
of coefficients in ascending order, as in numpy.
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
MAX_NEGLIGIBLE = 1e-14
# Larger damping ratios use the limit for infinite ratios, scaled by 1 / ratio [1].
MAX_DAMPING = 1e6


def no_limit(omega: float, damping_ratio: float) -> float:  # noqa: ARG001
    """Return an infinite step: the method is unconditionally stable."""
    return math.inf


def rate_limit(stability_polynomial: Sequence[float]) -> Limit:
    """Return the stability limit of a method with stability polynomial R(h λ).

    A step multiplies ``y' = λ y`` by R, a polynomial that begins 1 + z.

    The limit is the smallest unstable step, even if some larger steps are stable.

    >>> round(rate_limit([1, 1, 1 / 2, 1 / 6, 1 / 24])(1.0, 0.0), 3)
    2.828
    """
    coefficients = np.asarray(stability_polynomial, np.float64)

    def limit(omega: float, damping_ratio: float) -> float:
        # λ h of the slower decay is below rounding.
        if damping_ratio >= 1:
            root = math.sqrt(damping_ratio - 1) * math.sqrt(damping_ratio + 1)
            eigenvalues = {complex(-damping_ratio - root)}
        else:
            root = math.sqrt((1 - damping_ratio) * (1 + damping_ratio))
            eigenvalues = {complex(-damping_ratio, y) for y in (root, -root)}
        limits = (_first_unstable_step(coefficients, value) for value in eigenvalues)
        return min(limits) / omega

    return limit


def _first_unstable_step(coefficients: FloatArray, eigenvalue: complex) -> float:
    """Return the smallest positive step at which a mode with this eigenvalue grows."""
    magnitude = abs(eigenvalue)
    scaled_coefficients = coefficients * (eigenvalue / magnitude) ** np.arange(
        len(coefficients)
    )
    squared_excess: FloatArray = np.convolve(
        scaled_coefficients, scaled_coefficients.conj()
    ).real
    squared_excess[0] = 0.0
    return _first_positive(squared_excess) / magnitude


def jury_limit(
    trace: Callable[[float], Sequence[float]],
    determinant: Callable[[float], Sequence[float]],
) -> Limit:
    """Return the stability limit of a method whose step maps (x, v/ω) by a matrix.

    Both eigenvalues are in the unit circle if the determinant D is at most 1 and the
    magnitude of the trace T at most 1 + D (Jury's conditions). For a damping ratio,
    ``trace`` and ``determinant`` return polynomials in s.

    >>> limit = jury_limit(lambda ζ: [2, -2 * ζ, -1], lambda ζ: [1, -2 * ζ])
    >>> round(limit(10.0, 0.0), 9)
    0.2
    """

    def limit(omega: float, damping_ratio: float) -> float:
        ratio = min(damping_ratio, MAX_DAMPING)
        trace_polynomial, determinant_polynomial = (
            np.array(trace(ratio)),
            np.array(determinant(ratio)),
        )
        determinant_excess = poly.polysub(determinant_polynomial, [1.0])
        trace_excess = [
            poly.polysub(signed_trace, poly.polyadd(determinant_polynomial, [1.0]))
            for signed_trace in (trace_polynomial, -trace_polynomial)
        ]
        step = min(map(_first_positive, [determinant_excess, *trace_excess])) / omega
        # The limit is proportional to 1 / ratio there.
        return step * (ratio / damping_ratio) if damping_ratio > ratio else step

    return limit


def _first_positive(polynomial: FloatArray) -> float:
    """Return the smallest x ≥ 0 at which a polynomial becomes positive."""
    is_negligible = np.abs(polynomial) <= MAX_NEGLIGIBLE * max(
        np.abs(polynomial).max(), 1.0
    )
    coefficients = np.where(is_negligible, 0.0, polynomial)
    (nonzero,) = coefficients.nonzero()
    if not len(nonzero):
        return math.inf
    coefficients = coefficients[nonzero[0] : nonzero[-1] + 1]
    if coefficients[0] > 0:
        return 0.0
    roots = poly.polyroots(coefficients)
    real_roots = roots[np.abs(roots.imag) <= 1e-9 * np.abs(roots)].real
    positive_roots = sorted(real_roots[real_roots > 0].tolist())
    for low, high in pairwise([*positive_roots, math.inf]):
        midpoint = low + 1 if math.isinf(high) else (low + high) / 2
        if poly.polyval(midpoint, coefficients) > 0:
            return float(low)
    return math.inf

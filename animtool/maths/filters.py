"""Zero-lag filters of evenly sampled signals, with a cut-off that noise decides.

The filter is the smoother of E. T. Whittaker: the curve that stays near the samples and
whose differences of some order are small. Its gain at frequency f is
``1 / (1 + (sin(pi f / rate) / sin(pi cutoff / rate)) ** (2 order))``, that of a
Butterworth filter run to and fro. It needs no samples beyond the ends, leaves straight
lines as they are, and goes over gaps.
"""

from __future__ import annotations

import math

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.maths import so3

# Differences of this order hold next to nothing but noise: of what moves slower than a
# tenth of the rate, less than a hundred-thousandth of the power.
NOISE_ORDER = 8
# Cut-offs that are tried, as shares of the rate.
MIN_SHARE, MAX_SHARE, TRIED = 0.005, 0.4, 24
# A filter that would leave more of the noise's power than this is left out.
WORTH = 0.8
# Median of the square of one normal number [1].
MEDIAN_SQUARE = 0.454936
# An axis with less than this share of the largest noise's power has none of its own.
HINGE = 0.05
# Median of a square of a normal number, by how many numbers are added [1]
# (Wilson and Hilferty).
_WILSON = 2 / 9


def lowpass(
    values: FloatArray,
    cutoff: float,
    rate: float,
    *,
    order: int = 2,
    known: BoolArray | None = None,
) -> FloatArray:
    """Return signals without what is faster than a cut-off, without lag ``(F, ...)``.

    Args:
        values: ``(F, ...)``.
        cutoff: Frequency at which half of the amplitude is left [Hz].
        rate: Frames a second.
        order: Of the differences that are kept small; higher cuts off sharper.
        known: Which frames hold something ``(F,)``, ``order`` or more of them; others
            follow from these.
    """
    from scipy.linalg import solveh_banded

    count = len(values)
    order = min(order, count - 1)
    if order < 1 or not values.size:
        return values.copy()
    weights = np.ones(count) if known is None else known.astype(np.float64)
    stiffness = (2 * math.sin(math.pi * min(cutoff / rate, 0.5))) ** (-2 * order)
    bands = stiffness * _penalty(count, order)
    bands[0] += weights
    origin = values[:1] if known is None else values[int(np.argmax(known))][None]
    columns = ((values - origin).T * weights).T.reshape(count, -1)
    smooth = solveh_banded(bands, columns, lower=True, check_finite=False)
    return np.asarray(smooth.reshape(values.shape) + origin)


def lowpass_turns(
    turns: FloatArray,
    cutoff: float,
    rate: float,
    *,
    order: int = 2,
    known: BoolArray | None = None,
) -> FloatArray:
    """Return rotations ``(F, ..., 4)``, signs continuous, as `lowpass` does numbers."""
    return so3.normalize(lowpass(turns, cutoff, rate, order=order, known=known))


def _penalty(count: int, order: int) -> FloatArray:
    """Return the sum of squares of differences as a banded matrix, lower form."""
    steps = _differences(order)
    bands = np.zeros((order + 1, count))
    rows = count - order
    for k in range(order + 1):
        for j in range(order + 1 - k):
            bands[k, j : j + rows] += steps[j] * steps[j + k]
    return bands


def _differences(order: int) -> FloatArray:
    steps = [(-1) ** k * math.comb(order, k) for k in range(order + 1)]
    return np.array(steps, np.float64)


def noise_level(values: FloatArray) -> float:
    """Return the standard deviation of the white noise in a signal ``(F, K)``.

    It is that of its fastest part, by a median, so that a few jumps do not count.

    >>> rng = np.random.default_rng(1)
    >>> slow = np.sin(np.arange(2000)[:, None] / 20)
    >>> round(noise_level(slow + 0.01 * rng.standard_normal((2000, 1))), 3)
    0.01
    """
    return math.sqrt(_noise(values, rotation=False)[0])


def noise_of_turns(turns: FloatArray) -> float:
    """Return the standard deviation of the white noise of rotations ``(F, 4)`` [rad].

    It is that about each axis that they shake about: three, or the one of a hinge.
    """
    return 2 * math.sqrt(_noise(turns, rotation=True)[0])


def _noise(values: FloatArray, *, rotation: bool) -> tuple[float, int]:
    """Return the variance of the noise in each direction, and how many it has."""
    order = min(NOISE_ORDER, len(values) - 1)
    if order < 1:
        return 0.0, 1
    fast = np.diff(values, order, axis=0)
    share = math.comb(2 * order, order)
    if not rotation:
        # In a signal that moves in fewer directions than it has, noise has as few.
        width = max(1, int((np.ptp(values, axis=0) > 0).sum()))
        middle_power = width * (1 - _WILSON / width) ** 3
        power = float(np.median((fast * fast).sum(axis=-1))) / middle_power
        return power / share, width
    # Seen from the frame in the middle, noise is about axes alone.
    middle = values[order // 2 : order // 2 + len(fast)]
    fast = so3.multiply(so3.conjugate(middle), fast)[:, :3]
    along = fast @ np.linalg.eigh(fast.T @ fast)[1]
    powers = np.median(along * along, axis=0) / MEDIAN_SQUARE / share
    width = max(1, int((powers > HINGE * powers.max()).sum()))
    return float(powers.sum()) / width, width


def best_cutoff(
    values: FloatArray, rate: float, *, rotation: bool = False
) -> float | None:
    """Return the cut-off that brings a noisy signal nearest to what it was [Hz].

    The expected error of each cut-off is what the filter takes away and what it leaves
    of the noise (C. L. Mallows, Some comments on Cp, 1973); the noise is that of
    `noise_level`. None is a signal that is best left alone.

    Args:
        values: ``(F, K)``.
        rate: Frames a second.
        rotation: Whether they are quaternions.
    """
    variance, width = _noise(values, rotation=rotation)
    noise = variance * width
    if noise == 0 or len(values) <= NOISE_ORDER:
        return None
    shares = np.geomspace(MIN_SHARE, MAX_SHARE, TRIED)
    waves = np.sin(np.pi * np.arange(len(values)) / (2 * len(values)))
    errors = []
    for share in shares.tolist():
        away = values - lowpass(values, share * rate, rate)
        gains = 1 / (1 + (waves / math.sin(math.pi * share)) ** 4)
        taken = float((away * away).sum()) / len(values)
        errors.append(taken + (2 * float(gains.mean()) - 1) * noise)
    best = int(np.argmin(errors))
    return float(shares[best] * rate) if errors[best] < WORTH * noise else None


def put_between(values: FloatArray, times: FloatArray | IntArray) -> FloatArray:
    """Return values ``(N, C)``, missing ones (NaN) put in between; 0 where all are.

    ``times`` ``(N,)`` ascend. Before the first value and after the last these stay.
    """
    made = values.copy()
    for column in made.T:
        there = np.isfinite(column)
        if not there.all():
            found = there.any()
            column[:] = np.interp(times, times[there], column[there]) if found else 0.0
    return made

"""Zero-lag low-pass filters of evenly sampled signals, with automatic cut-off.

The filter is the smoother of E. T. Whittaker: the curve that stays near the samples and
whose differences of some order are small. Its gain at frequency f is
``1 / (1 + (sin(pi f / rate) / sin(pi cutoff / rate)) ** (2 order))``, that of a
Butterworth filter run forward and backward. It needs no padding, preserves straight
lines, and bridges gaps.
"""

from __future__ import annotations

import math

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.maths import so3

# Differences of this order are almost pure noise: they contain less than 1e-5 of the
# power of motion slower than a tenth of the rate.
NOISE_ORDER = 8
# Range and number of cut-offs to try, as fractions of the rate.
MIN_CUTOFF, MAX_CUTOFF, CUTOFF_COUNT = 0.005, 0.4, 24
# A filter that leaves more than this fraction of the noise power is not applied.
MAX_REMAINING_NOISE = 0.8
# Median of the square of a standard normal variable [1].
MEDIAN_SQUARE = 0.454936
# An axis with less than this fraction of the largest noise power has no noise.
NOISY_AXIS_FRACTION = 0.05
# Coefficient of the median of a chi-squared variable [1] (Wilson and Hilferty).
_WILSON_COEFFICIENT = 2 / 9


def lowpass(
    values: FloatArray,
    cutoff: float,
    rate: float,
    *,
    order: int = 2,
    is_valid: BoolArray | None = None,
) -> FloatArray:
    """Return the signals, low-pass filtered without lag ``(F, ...)``.

    Args:
        values: ``(F, ...)``.
        cutoff: Frequency at which half of the amplitude is left [Hz].
        rate: Frames a second.
        order: Order of the penalised differences; higher cuts off sharper.
        is_valid: Mask of valid frames ``(F,)``, at least ``order``; others are
            interpolated.
    """
    from scipy.linalg import solveh_banded

    frame_count = len(values)
    order = min(order, frame_count - 1)
    if order < 1 or not values.size:
        return values.copy()
    weights = np.ones(frame_count) if is_valid is None else is_valid.astype(np.float64)
    stiffness = (2 * math.sin(math.pi * min(cutoff / rate, 0.5))) ** (-2 * order)
    bands = stiffness * _penalty(frame_count, order)
    bands[0] += weights
    origin = values[:1] if is_valid is None else values[int(np.argmax(is_valid))][None]
    columns = ((values - origin).T * weights).T.reshape(frame_count, -1)
    filtered_columns = solveh_banded(bands, columns, lower=True, check_finite=False)
    return np.asarray(filtered_columns.reshape(values.shape) + origin)


def lowpass_rotations(
    rotations: FloatArray,
    cutoff: float,
    rate: float,
    *,
    order: int = 2,
    is_valid: BoolArray | None = None,
) -> FloatArray:
    """Return low-pass filtered rotations ``(F, ..., 4)`` of continuous sign."""
    return so3.normalize(
        lowpass(rotations, cutoff, rate, order=order, is_valid=is_valid)
    )


def _penalty(frame_count: int, order: int) -> FloatArray:
    """Return the penalty matrix of finite differences in lower banded form."""
    coefficients = _difference_coefficients(order)
    bands = np.zeros((order + 1, frame_count))
    row_count = frame_count - order
    for k in range(order + 1):
        for j in range(order + 1 - k):
            bands[k, j : j + row_count] += coefficients[j] * coefficients[j + k]
    return bands


def _difference_coefficients(order: int) -> FloatArray:
    """Return the finite-difference coefficients of the given order ``(order + 1,)``."""
    coefficients = [(-1) ** k * math.comb(order, k) for k in range(order + 1)]
    return np.array(coefficients, np.float64)


def noise_level(values: FloatArray) -> float:
    """Return the standard deviation of the white noise in a signal ``(F, K)``.

    It is estimated as a median of the highest frequencies, so that a few jumps do not
    affect it.

    >>> rng = np.random.default_rng(1)
    >>> slow = np.sin(np.arange(2000)[:, None] / 20)
    >>> round(noise_level(slow + 0.01 * rng.standard_normal((2000, 1))), 3)
    0.01
    """
    return math.sqrt(_noise_variance(values, is_rotation=False)[0])


def rotation_noise(rotations: FloatArray) -> float:
    """Return the standard deviation of the white noise of rotations ``(F, 4)`` [rad].

    It is the deviation about each noisy axis: three axes, or one for a hinge.
    """
    return 2 * math.sqrt(_noise_variance(rotations, is_rotation=True)[0])


def _noise_variance(values: FloatArray, *, is_rotation: bool) -> tuple[float, int]:
    """Return the noise variance per noisy direction, and the number of directions."""
    difference_order = min(NOISE_ORDER, len(values) - 1)
    if difference_order < 1:
        return 0.0, 1
    differences = np.diff(values, difference_order, axis=0)
    variance_gain = math.comb(2 * difference_order, difference_order)
    if not is_rotation:
        # Static components have no noise.
        direction_count = max(1, int((np.ptp(values, axis=0) > 0).sum()))
        median_power_factor = (
            direction_count * (1 - _WILSON_COEFFICIENT / direction_count) ** 3
        )
        median_power = float(np.median((differences * differences).sum(axis=-1)))
        return median_power / median_power_factor / variance_gain, direction_count
    # Relative to the middle frame, noise is a rotation vector.
    inner_frames = values[
        difference_order // 2 : difference_order // 2 + len(differences)
    ]
    differences = so3.multiply(so3.conjugate(inner_frames), differences)[:, :3]
    components = differences @ np.linalg.eigh(differences.T @ differences)[1]
    powers = np.median(components * components, axis=0) / MEDIAN_SQUARE / variance_gain
    direction_count = max(1, int((powers > NOISY_AXIS_FRACTION * powers.max()).sum()))
    return float(powers.sum()) / direction_count, direction_count


def find_best_cutoff(
    values: FloatArray, rate: float, *, is_rotation: bool = False
) -> float | None:
    """Return the cut-off with the least expected error of a noisy signal [Hz].

    The expected error of a cut-off is the signal it removes plus the noise it keeps (C.
    L. Mallows, Some comments on Cp, 1973), with the noise of `noise_level`. It is None
    if the signal is best left unfiltered.

    Args:
        values: ``(F, K)``.
        rate: Frames a second.
        is_rotation: Whether the values are quaternions.
    """
    variance, direction_count = _noise_variance(values, is_rotation=is_rotation)
    noise_power = variance * direction_count
    if noise_power == 0 or len(values) <= NOISE_ORDER:
        return None
    cutoff_fractions = np.geomspace(MIN_CUTOFF, MAX_CUTOFF, CUTOFF_COUNT)
    frequencies = np.sin(np.pi * np.arange(len(values)) / (2 * len(values)))
    expected_errors = []
    for fraction in cutoff_fractions.tolist():
        residual = values - lowpass(values, fraction * rate, rate)
        gains = 1 / (1 + (frequencies / math.sin(math.pi * fraction)) ** 4)
        removed_power = float((residual * residual).sum()) / len(values)
        expected_errors.append(
            removed_power + (2 * float(gains.mean()) - 1) * noise_power
        )
    best_index = int(np.argmin(expected_errors))
    if expected_errors[best_index] < MAX_REMAINING_NOISE * noise_power:
        return float(cutoff_fractions[best_index] * rate)
    return None


def fill_gaps(values: FloatArray, times: FloatArray | IntArray) -> FloatArray:
    """Return values ``(N, C)`` with NaN interpolated; columns of only NaN become 0.

    ``times`` ``(N,)`` ascend. The first and last values are held to the ends.
    """
    filled_values = values.copy()
    for column in filled_values.T:
        is_valid = np.isfinite(column)
        if not is_valid.any():
            column[:] = 0.0
        elif not is_valid.all():
            column[:] = np.interp(times, times[is_valid], column[is_valid])
    return filled_values

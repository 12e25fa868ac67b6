"""Computes the slopes of keys with automatic and TCB tangents.

References: Autodesk, *FBX SDK documentation*, `FbxAnimCurveDef` (tangent modes);
Kochanek and Bartels, *Interpolating splines with local tension, continuity, and bias
control*, 1984; Fritsch and Carlson, *Monotone piecewise cubic interpolation*, 1980.
"""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray

# Key flags: interpolation of the segment, and how tangents are computed.
STEPPED, STRAIGHT, CURVED = 0x2, 0x4, 0x8
AUTO, TCB, USER, NEXT_VALUE = 0x100, 0x200, 0x400, 0x100
CLAMPED, TIME_INDEPENDENT, PROGRESSIVE = 0x1000, 0x2000, 0x4000
# Tolerance of equal slopes before and after a key [1/s].
SLOPE_TOLERANCE = 1e-4
# With a larger bias, automatic tangents get steeper by the square of the excess.
MAX_LINEAR_BIAS, BIAS_GAIN = 5.0, 40.0


def compute_key_slopes(
    seconds: FloatArray,
    values: FloatArray,
    flags: IntArray,
    key_data: FloatArray,
    weights: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return the slopes after each key, and before the next one ``(K,)`` [1/s].

    Args:
        seconds: Times of the keys, ascending ``(K,)``.
        values: Values of the keys ``(K,)``.
        flags: Flags of the keys ``(K,)``.
        key_data: Three numbers per key in the file ``(K, 3)``: slope out, slope into
            the next and, for TCB tangents, tension, continuity and bias.
        weights: Weights of the handles out of each key and into the next ``(K, 2)``.
    """
    is_cubic = (flags & STEPPED == 0) & (flags & CURVED != 0)
    is_tcb = is_cubic & (flags & TCB != 0)
    is_auto = is_cubic & ~is_tcb & (flags & USER == 0)
    durations = np.diff(seconds)
    # Slopes between keys; 0 between keys of equal time.
    chords = np.diff(values) / np.where(durations > 0, durations, np.inf)
    out_slopes, in_slopes = key_data[:, 0].copy(), key_data[:, 1].copy()
    is_straight = (flags & (STEPPED | CURVED)) == 0
    straight_slopes = np.append(chords, 0.0)[is_straight]
    out_slopes[is_straight] = in_slopes[is_straight] = straight_slopes
    out_slopes[flags & STEPPED != 0] = in_slopes[flags & STEPPED != 0] = 0.0
    in_slopes[is_tcb] = 0.0
    slopes_before = np.concatenate([[0.0], in_slopes[:-1]])
    slopes = slopes_before, out_slopes
    if is_auto.any():
        _set_auto_slopes(is_auto, slopes, seconds, values, flags, weights, chords)
    if is_tcb.any():
        _set_tcb_slopes(is_tcb, slopes, chords, key_data)
    # The last key has no segment after it.
    return out_slopes, np.append(slopes_before[1:], in_slopes[-1:])


def _set_auto_slopes(
    is_auto: BoolArray,
    slopes: tuple[FloatArray, FloatArray],
    seconds: FloatArray,
    values: FloatArray,
    flags: IntArray,
    weights: FloatArray,
    chords: FloatArray,
) -> None:
    """Set the slopes before and after keys with automatic tangents, in place.

    The file states a bias towards a neighbour instead of a slope for these keys.
    """
    slopes_before, out_slopes = slopes
    if len(seconds) < 2:
        slopes_before[is_auto] = out_slopes[is_auto] = 0.0
        return
    for k, chord in ((0, chords[0]), (-1, chords[-1])):
        if is_auto[k]:
            bias = float(out_slopes[k] if k == 0 else -slopes_before[k])
            end_slope = _end_slope(int(flags[k]), float(chord), bias)
            slopes_before[k] = out_slopes[k] = end_slope
    inner_indices = np.flatnonzero(is_auto[1:-1]) + 1
    if not len(inner_indices):
        return
    slope_sums = slopes_before[inner_indices] + out_slopes[inner_indices]
    is_broken = np.abs(slope_sums) > SLOPE_TOLERANCE
    bias_out = out_slopes[inner_indices].copy()
    bias_in = np.where(is_broken, -slopes_before[inner_indices], bias_out)
    inner_slopes = [
        _inner_slopes(inner_indices, seconds, values, flags, weights, chords, bias)
        for bias in (bias_in, bias_out)
    ]
    slopes_before[inner_indices], out_slopes[inner_indices] = inner_slopes


def _end_slope(key_flags: int, chord: float, bias: float) -> float:
    if key_flags & PROGRESSIVE or (key_flags & CLAMPED and chord == 0.0):
        return 0.0
    excess = abs(bias) / 100.0 - MAX_LINEAR_BIAS
    if not key_flags & TIME_INDEPENDENT and excess > 0.0:
        chord += excess * excess * BIAS_GAIN * (1.0 if bias > 0 else -1.0)
    return chord


def _inner_slopes(
    key_indices: IntArray,
    seconds: FloatArray,
    values: FloatArray,
    flags: IntArray,
    weights: FloatArray,
    chords: FloatArray,
    bias: FloatArray,
) -> FloatArray:
    """Return the slopes of automatic keys that have neighbours on both sides [1/s]."""
    key_flags, chord_before, chord_after = (
        flags[key_indices],
        chords[key_indices - 1],
        chords[key_indices],
    )
    time_before, time_after = (
        seconds[key_indices] - seconds[key_indices - 1],
        seconds[key_indices + 1] - seconds[key_indices],
    )
    duration = np.where(time_before + time_after > 0, time_before + time_after, np.inf)
    slope = (values[key_indices + 1] - values[key_indices - 1]) / duration
    fraction = time_before / duration
    smooth_slope = 0.5 * slope + 0.5 * (
        chord_before * (1.0 - fraction) + chord_after * fraction
    )
    bias_amount = np.abs(bias) / 100.0
    biased_slope = np.where(bias > 0, chord_after, chord_before)
    offset = biased_slope - smooth_slope
    slopes = np.where(
        bias_amount > 1e-4,
        smooth_slope * (1.0 - bias_amount) + biased_slope * bias_amount,
        smooth_slope,
    )
    excess = np.maximum(bias_amount - MAX_LINEAR_BIAS, 0.0)
    sign = np.where(np.where(np.abs(offset) > 1e-5, offset, bias) > 0, 1.0, -1.0)
    slopes = slopes + excess * excess * BIAS_GAIN * sign
    slope = np.where(key_flags & TIME_INDEPENDENT != 0, slope, slopes)
    # Slopes are limited so that handles stay within the values of their segment.
    direction = np.where(slope >= 0, 1.0, -1.0)
    max_slope = np.full(len(key_indices), np.inf)
    for chord, weight in (
        (chord_before, weights[key_indices - 1, 1]),
        (chord_after, weights[key_indices, 0]),
    ):
        chord_limit = direction * chord / np.where(weight > 0, weight, np.inf)
        max_slope = np.minimum(max_slope, np.maximum(chord_limit, 0.0))
    max_slope = np.where(key_flags & PROGRESSIVE != 0, max_slope, np.inf)
    slope = direction * np.minimum(direction * slope, max_slope)
    is_extremum = (values[key_indices] == values[key_indices - 1]) | (
        values[key_indices] == values[key_indices + 1]
    )
    return np.asarray(np.where((key_flags & CLAMPED != 0) & is_extremum, 0.0, slope))


def _set_tcb_slopes(
    is_tcb: BoolArray,
    slopes: tuple[FloatArray, FloatArray],
    chords: FloatArray,
    key_data: FloatArray,
) -> None:
    """Set the slopes at keys from tension, continuity and bias, in place."""
    slopes_before, out_slopes = slopes
    tension, continuity, bias = key_data[is_tcb].T
    chord_before = np.concatenate([[0.0], chords])[is_tcb]
    chord_after = np.concatenate([chords, [0.0]])[is_tcb]
    key_indices = np.flatnonzero(is_tcb)
    is_end = (key_indices == 0) | (key_indices == len(is_tcb) - 1)
    gain = np.where(is_end, 1.0, 0.5) * (1.0 - tension)
    plus_bias, minus_bias = 1.0 + bias, 1.0 - bias
    slopes_before[is_tcb] = gain * (
        plus_bias * (1 - continuity) * chord_before
        + minus_bias * (1 + continuity) * chord_after
    )
    out_slopes[is_tcb] = gain * (
        plus_bias * (1 + continuity) * chord_before
        + minus_bias * (1 - continuity) * chord_after
    )

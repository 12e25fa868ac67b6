"""Slopes of automatic and TCB tangents.

References: Autodesk, *FBX SDK documentation*, `FbxAnimCurveDef` (tangent modes);
Kochanek and Bartels, *Interpolating splines with local tension, continuity, and bias
control*, 1984; Fritsch and Carlson, *Monotone piecewise cubic interpolation*, 1980.
"""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray

# Flags of keys: how a segment goes on, and how its tangents are made.
STEPPED, STRAIGHT, CURVED = 0x2, 0x4, 0x8
AUTO, TCB, USER, NEXT_VALUE = 0x100, 0x200, 0x400, 0x100
CLAMPED, TIME_INDEPENDENT, PROGRESSIVE = 0x1000, 0x2000, 0x4000
# Slopes into and out of a key that differ by less are one [1/s].
SAME_SLOPE = 1e-4
# Biases of automatic tangents beyond add to the slope, by their square.
FULL_BIAS, BIAS_GAIN = 5.0, 40.0


def key_slopes(
    seconds: FloatArray,
    values: FloatArray,
    flags: IntArray,
    stated: FloatArray,
    weights: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return slopes leaving and entering keys ``(K,)`` [1/s].

    Args:
        seconds: Times of the keys, ascending ``(K,)``.
        values: Theirs ``(K,)``.
        flags: Theirs ``(K,)``.
        stated: What the file has of each: slope out, slope into the next and, of
            tangents by tension, continuity and bias, these ``(K, 3)``.
        weights: Of the handles out of each key and into the next ``(K, 2)``.
    """
    cubic = (flags & STEPPED == 0) & (flags & CURVED != 0)
    tcb = cubic & (flags & TCB != 0)
    auto = cubic & ~tcb & (flags & USER == 0)
    chords = _chords(seconds, values)
    right, left = stated[:, 0].copy(), stated[:, 1].copy()
    straight = (flags & (STEPPED | CURVED)) == 0
    right[straight] = left[straight] = np.append(chords, 0.0)[straight]
    right[flags & STEPPED != 0] = left[flags & STEPPED != 0] = 0.0
    left[tcb] = 0.0
    into = np.concatenate([[0.0], left[:-1]])
    if auto.any():
        _set_auto(seconds, values, flags, weights, chords, (auto, into, right))
    if tcb.any():
        _set_tcb(chords, stated, (tcb, into, right))
    # Those of the last key go nowhere.
    return right, np.append(into[1:], left[-1:])


def _chords(seconds: FloatArray, values: FloatArray) -> FloatArray:
    """Return chord slopes between keys; 0 between keys of equal time."""
    steps = np.diff(seconds)
    return np.asarray(np.diff(values) / np.where(steps > 0, steps, np.inf))


def _set_auto(
    seconds: FloatArray,
    values: FloatArray,
    flags: IntArray,
    weights: FloatArray,
    chords: FloatArray,
    slopes: tuple[BoolArray, FloatArray, FloatArray],
) -> None:
    """Set the slopes of automatic keys.

    What the file states of such a key is its bias towards a neighbour, not a slope.
    """
    auto, into, right = slopes
    if len(seconds) < 2:
        into[auto] = right[auto] = 0.0
        return
    for k, chord in ((0, chords[0]), (-1, chords[-1])):
        if auto[k]:
            bias = float(right[k] if k == 0 else -into[k])
            into[k] = right[k] = _end_slope(int(flags[k]), float(chord), bias)
    inner = np.flatnonzero(auto[1:-1]) + 1
    if not len(inner):
        return
    broken = np.abs(into[inner] + right[inner]) > SAME_SLOPE
    after = right[inner].copy()
    before = np.where(broken, -into[inner], after)
    both = [
        _inner_slopes(inner, seconds, values, flags, weights, chords, bias)
        for bias in (before, after)
    ]
    into[inner], right[inner] = both


def _end_slope(flags: int, chord: float, bias: float) -> float:
    if flags & PROGRESSIVE or (flags & CLAMPED and chord == 0.0):
        return 0.0
    over = abs(bias) / 100.0 - FULL_BIAS
    if not flags & TIME_INDEPENDENT and over > 0.0:
        chord += over * over * BIAS_GAIN * (1.0 if bias > 0 else -1.0)
    return chord


def _inner_slopes(
    k: IntArray,
    seconds: FloatArray,
    values: FloatArray,
    flags: IntArray,
    weights: FloatArray,
    chords: FloatArray,
    bias: FloatArray,
) -> FloatArray:
    """Return slopes of automatic keys that have both neighbours."""
    key_flags, low, high = flags[k], chords[k - 1], chords[k]
    before, after = seconds[k] - seconds[k - 1], seconds[k + 1] - seconds[k]
    span = np.where(before + after > 0, before + after, np.inf)
    slope = (values[k + 1] - values[k - 1]) / span
    part = before / span
    blend = 0.5 * slope + 0.5 * (low * (1.0 - part) + high * part)
    amount = np.abs(bias) / 100.0
    target = np.where(bias > 0, high, low)
    off = target - blend
    biased = np.where(amount > 1e-4, blend * (1.0 - amount) + target * amount, blend)
    over = np.maximum(amount - FULL_BIAS, 0.0)
    sign = np.where(np.where(np.abs(off) > 1e-5, off, bias) > 0, 1.0, -1.0)
    biased = biased + over * over * BIAS_GAIN * sign
    slope = np.where(key_flags & TIME_INDEPENDENT != 0, slope, biased)
    # No steeper than keeps a handle within the values of its segment.
    direction = np.where(slope >= 0, 1.0, -1.0)
    most = np.full(len(k), np.inf)
    for chord, weight in ((low, weights[k - 1, 1]), (high, weights[k, 0])):
        limit = direction * chord / np.where(weight > 0, weight, np.inf)
        most = np.minimum(most, np.maximum(limit, 0.0))
    most = np.where(key_flags & PROGRESSIVE != 0, most, np.inf)
    slope = direction * np.minimum(direction * slope, most)
    flat = (values[k] == values[k - 1]) | (values[k] == values[k + 1])
    return np.asarray(np.where((key_flags & CLAMPED != 0) & flat, 0.0, slope))


def _set_tcb(
    chords: FloatArray,
    stated: FloatArray,
    slopes: tuple[BoolArray, FloatArray, FloatArray],
) -> None:
    """Set the slopes of keys from tension, continuity and bias."""
    tcb, into, right = slopes
    tension, continuity, bias = stated[tcb].T
    low = np.concatenate([[0.0], chords])[tcb]
    high = np.concatenate([chords, [0.0]])[tcb]
    at = np.flatnonzero(tcb)
    ends = (at == 0) | (at == len(tcb) - 1)
    gain = np.where(ends, 1.0, 0.5) * (1.0 - tension)
    one, other = 1.0 + bias, 1.0 - bias
    into[tcb] = gain * (one * (1 - continuity) * low + other * (1 + continuity) * high)
    right[tcb] = gain * (one * (1 + continuity) * low + other * (1 - continuity) * high)

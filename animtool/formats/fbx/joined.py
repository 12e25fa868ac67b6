"""Curves of a property's components merged to keys of all components."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.formats.fbx.curves import (
    CONSTANT,
    CUBIC,
    NEXT,
    ONE_THIRD,
    FbxCurve,
    FbxExtrapolation,
)
from animtool.formats.fbx.layers import PropertyTrack
from animtool.formats.fbx.settings import TICKS_PER_SECOND
from animtool.maths.curves import Extrapolation, Interp

# Handle weights closer than this are equal.
WEIGHT_TOLERANCE = 1e-9
_EXTRAPOLATIONS = {
    "C": Extrapolation.HOLD,
    "K": Extrapolation.LINEAR,
    "R": Extrapolation.CYCLE,
    "A": Extrapolation.CYCLE_OFFSET,
    "M": Extrapolation.OSCILLATE,
}


@dataclass(frozen=True, slots=True, eq=False)
class JoinedKeys:
    """Keys of a property of D components.

    Attributes:
        ticks: Times ``(K,)``.
        values: ``(K, D)``.
        interps: Interpolation of the segment after each key, K entries.
        ins: Handles before the keys, as offsets: time [s], then values ``(K, 1 + D)``.
        outs: Handles after the keys, likewise.
        pre: Extrapolation before the first key.
        post: Extrapolation after the last key.
    """

    ticks: IntArray
    values: FloatArray
    interps: tuple[Interp, ...]
    ins: FloatArray
    outs: FloatArray
    pre: Extrapolation
    post: Extrapolation


def join_keys(track: PropertyTrack, base: FloatArray) -> JoinedKeys | None:
    """Return keys of all components of a property; None if not exact.

    A key of one component splits the segments of the others without changing values.

    ``base`` is the value without animation ``(D,)``.
    """
    if len(track.layers) != 1 or not track.layers[0].is_first:
        return None
    curves = track.layers[0].curves
    keyed_curves = [curve_ for curve_ in curves if curve_ is not None]
    extrapolation = _common_extrapolation(keyed_curves)
    if not keyed_curves or extrapolation is None:
        return None
    ticks = np.unique(np.concatenate([curve_.times for curve_ in keyed_curves]))
    segmented_curves = [
        _split_curve(curve_, ticks) for curve_ in curves if curve_ is not None
    ]
    interps = _segment_interpolations(segmented_curves, len(ticks) - 1)
    weights = _common_weights(segmented_curves)
    if interps is None or weights is None:
        return None
    seconds = np.diff(ticks) / TICKS_PER_SECOND
    count, width = len(ticks), len(curves)
    ins, outs = np.zeros((count, 1 + width)), np.zeros((count, 1 + width))
    outs[:-1, 0], ins[1:, 0] = weights[:, 0] * seconds, -weights[:, 1] * seconds
    curve_iterator = iter(segmented_curves)
    for component, curve in enumerate(curves):
        if curve is not None:
            curve_ = next(curve_iterator)
            outs[:-1, 1 + component] = curve_.out_slopes * outs[:-1, 0]
            ins[1:, 1 + component] = curve_.in_slopes * ins[1:, 0]
    values = track.at(base, ticks)
    return JoinedKeys(
        ticks, values, (*interps, Interp.LINEAR), ins, outs, *extrapolation
    )


def _common_extrapolation(
    curves: Sequence[FbxCurve],
) -> tuple[Extrapolation, Extrapolation] | None:
    """Return the common extrapolation of curves; None if they differ."""
    extrapolations = []
    for side in ("pre", "post"):
        side_extrapolations = {
            _extrapolation(curve_, getattr(curve_, side)) for curve_ in curves
        }
        if len(side_extrapolations) != 1 or None in side_extrapolations:
            return None
        extrapolations += [
            curve_ for curve_ in side_extrapolations if curve_ is not None
        ]
    if extrapolations and set(extrapolations) != {Extrapolation.HOLD}:
        times = curves[0].times
        if any(not np.array_equal(times, curve_.times) for curve_ in curves):
            return None
    # At a jump between repeats, a clip has the other of the two values.
    jumps = any(curve_.values[0] != curve_.values[-1] for curve_ in curves)
    if not extrapolations or (jumps and Extrapolation.CYCLE in extrapolations):
        return None
    return extrapolations[0], extrapolations[1]


def _extrapolation(curve: FbxCurve, outside: FbxExtrapolation) -> Extrapolation | None:
    if len(curve.times) == 1 or (outside.count == 0 and outside.mode != "K"):
        return Extrapolation.HOLD
    if outside.count > 0 and outside.mode in "RAM":
        return None
    return _EXTRAPOLATIONS[outside.mode]


@dataclass(frozen=True, slots=True, eq=False)
class _SegmentedCurve:
    """A curve split into N segments, whose N + 1 times include all keys."""

    is_cubic: BoolArray  # ``(N,)``
    is_stepped: BoolArray
    is_flat: BoolArray  # constant up to and including the end
    is_split: BoolArray  # whether it is only a part of a segment of the curve
    weights: FloatArray  # ``(N, 2)``
    out_slopes: FloatArray  # slopes [1/s]
    in_slopes: FloatArray


def _split_curve(curve: FbxCurve, ticks: IntArray) -> _SegmentedCurve:
    starts, ends = ticks[:-1], ticks[1:]
    k = np.searchsorted(curve.times, starts, "right") - 1
    in_range = (k >= 0) & (k < len(curve.times) - 1)
    k = np.clip(k, 0, max(len(curve.times) - 2, 0))
    zeros = np.zeros(len(starts))
    if len(curve.times) < 2:
        all_true, all_false = np.ones(len(starts), bool), np.zeros(len(starts), bool)
        return _SegmentedCurve(
            all_false,
            all_false,
            all_true,
            all_false,
            np.full((len(k), 2), ONE_THIRD),
            zeros,
            zeros,
        )
    key_ticks, next_ticks = curve.times[k], curve.times[k + 1]
    modes = curve.modes[k]
    is_cubic = in_range & (modes == CUBIC)
    is_stepped = in_range & ((modes == CONSTANT) | (modes == NEXT))
    is_split = in_range & ((starts != key_ticks) | (ends != next_ticks))
    span = (next_ticks - key_ticks) / TICKS_PER_SECOND
    value_change = curve.values[k + 1] - curve.values[k]
    level = (value_change == 0) & (
        ~is_cubic | ((curve.out_slopes[k] == 0) & (curve.in_slopes[k] == 0))
    )
    slope = value_change / span
    ends_of = [
        np.where(
            is_cubic,
            _slope_at(curve, k, (at - key_ticks) / TICKS_PER_SECOND / span, span),
            slope,
        )
        for at in (starts, ends)
    ]
    out_slopes, in_slopes = (
        np.where(in_range & ~is_stepped, slopes, 0.0) for slopes in ends_of
    )
    # Complete segments keep the slopes of the keys, whatever their weights.
    is_complete = is_cubic & ~is_split
    out_slopes = np.where(is_complete, curve.out_slopes[k], out_slopes)
    in_slopes = np.where(is_complete, curve.in_slopes[k], in_slopes)
    # The value of a NEXT segment applies from its start.
    holds_next = is_stepped & (modes == NEXT) & ~level
    if holds_next.any():
        is_stepped, level = is_stepped & ~holds_next, level & ~holds_next
        return _SegmentedCurve(
            is_cubic | holds_next,
            is_stepped,
            level,
            is_split | holds_next,
            _nan_weights(k),
            out_slopes,
            in_slopes,
        )
    weights = np.where(is_cubic[:, None], curve.weights[k], ONE_THIRD)
    return _SegmentedCurve(
        is_cubic,
        is_stepped,
        level | ~in_range,
        is_split,
        weights,
        out_slopes,
        in_slopes,
    )


def _nan_weights(k: IntArray) -> FloatArray:
    """Return NaN weights, for curves without weighted keys."""
    return np.full((len(k), 2), np.nan)


def _slope_at(
    curve: FbxCurve, k: IntArray, fraction: FloatArray, span: FloatArray
) -> FloatArray:
    """Return slopes within segments whose handles are at thirds [1/s]."""
    out_slopes, in_slopes = curve.out_slopes[k], curve.in_slopes[k]
    chord = (curve.values[k + 1] - curve.values[k]) / span
    middle = 3.0 * chord - out_slopes - in_slopes
    v = 1.0 - fraction
    return np.asarray(
        v * v * out_slopes + 2 * fraction * v * middle + fraction * fraction * in_slopes
    )


def _segment_interpolations(
    curves: Sequence[_SegmentedCurve], count: int
) -> list[Interp] | None:
    """Return the interpolation of each segment; None if components differ."""
    is_cubic = np.logical_or.reduce(
        [curve_.is_cubic & ~curve_.is_flat for curve_ in curves]
    )
    is_moving = np.logical_or.reduce(
        [~curve_.is_flat & ~curve_.is_stepped for curve_ in curves]
    )
    is_stepped = np.logical_or.reduce(
        [curve_.is_stepped & ~curve_.is_flat for curve_ in curves]
    )
    if (is_stepped & is_moving).any():
        return None
    # A step of a split segment is at the end of the curve's own segment.
    split_step_masks = [
        curve_.is_stepped & curve_.is_split & ~curve_.is_flat for curve_ in curves
    ]
    if len(curves) > 1 and np.logical_or.reduce(split_step_masks).any():
        return None
    choices = np.where(is_cubic, 2, np.where(is_stepped, 1, 0))
    interpolations = (Interp.LINEAR, Interp.STEP, Interp.BEZIER)
    return [interpolations[choice] for choice in choices.tolist()][:count]


def _common_weights(curves: Sequence[_SegmentedCurve]) -> FloatArray | None:
    """Return the tangent weights common to all components; else None."""
    weights = np.full(curves[0].weights.shape, ONE_THIRD)
    is_fixed = np.zeros(len(weights), bool)
    for curve_ in curves:
        is_cubic = curve_.is_cubic & ~curve_.is_flat
        is_third = np.abs(curve_.weights - ONE_THIRD).max(axis=1) <= WEIGHT_TOLERANCE
        if not (is_third | ~curve_.is_split | ~is_cubic).all():
            return None
        differs = np.abs(curve_.weights - weights).max(axis=1) > WEIGHT_TOLERANCE
        if (is_fixed & is_cubic & differs).any():
            return None
        weights = np.where(is_cubic[:, None], curve_.weights, weights)
        is_fixed |= is_cubic
    return None if np.isnan(weights).any() else weights

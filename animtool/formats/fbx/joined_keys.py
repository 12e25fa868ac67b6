"""Joins the curves of a property's components to keys that have all components."""

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

# Tolerance of equal handle weights.
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
    """The K keys of a property of D components, each with all components."""

    ticks: IntArray  # times ``(K,)``
    values: FloatArray  # ``(K, D)``
    # Interpolation of the segment after each key, K entries.
    interps: tuple[Interp, ...]
    # Handles before the keys, as offsets: time [s], then values ``(K, 1 + D)``.
    in_handles: FloatArray
    out_handles: FloatArray  # handles after the keys, likewise
    pre: Extrapolation  # extrapolation before the first key
    post: Extrapolation  # extrapolation after the last key


def join_keys(track: PropertyTrack, default_values: FloatArray) -> JoinedKeys | None:
    """Return keys of all components of a property; None if they would be inexact.

    A key of one component splits the segments of the others without changing values.

    ``default_values`` are the values without animation ``(D,)``.
    """
    if len(track.layers) != 1 or not track.layers[0].is_first:
        return None
    curves = track.layers[0].curves
    keyed_curves = [curve for curve in curves if curve is not None]
    extrapolation = _common_extrapolation(keyed_curves)
    if not keyed_curves or extrapolation is None:
        return None
    ticks = np.unique(np.concatenate([curve.times for curve in keyed_curves]))
    segmented_curves = [_split_curve(curve, ticks) for curve in keyed_curves]
    interps = _segment_interpolations(segmented_curves, len(ticks) - 1)
    weights = _common_weights(segmented_curves)
    if interps is None or weights is None:
        return None
    seconds = np.diff(ticks) / TICKS_PER_SECOND
    key_count, component_count = len(ticks), len(curves)
    in_handles = np.zeros((key_count, 1 + component_count))
    out_handles = np.zeros((key_count, 1 + component_count))
    out_handles[:-1, 0], in_handles[1:, 0] = (
        weights[:, 0] * seconds,
        -weights[:, 1] * seconds,
    )
    columns = [1 + i for i, curve in enumerate(curves) if curve is not None]
    for column, segmented_curve in zip(columns, segmented_curves, strict=True):
        out_handles[:-1, column] = segmented_curve.out_slopes * out_handles[:-1, 0]
        in_handles[1:, column] = segmented_curve.in_slopes * in_handles[1:, 0]
    values, interps = track.evaluate(default_values, ticks), [*interps, Interp.LINEAR]
    return JoinedKeys(
        ticks, values, tuple(interps), in_handles, out_handles, *extrapolation
    )


def _common_extrapolation(
    curves: Sequence[FbxCurve],
) -> tuple[Extrapolation, Extrapolation] | None:
    """Return the common extrapolation of curves; None if they differ."""
    convert_extrapolation = _convert_extrapolation
    extrapolation_pairs = {
        (convert_extrapolation(c, c.pre), convert_extrapolation(c, c.post))
        for c in curves
    }
    if len(extrapolation_pairs) != 1:
        return None
    ((pre, post),) = extrapolation_pairs
    if pre is None or post is None:
        return None
    if {pre, post} != {Extrapolation.HOLD}:
        times = curves[0].times
        if any(not np.array_equal(times, curve.times) for curve in curves):
            return None
    # At a discontinuity between repeats, a clip and FBX have different values.
    has_discontinuity = any(curve.values[0] != curve.values[-1] for curve in curves)
    if has_discontinuity and Extrapolation.CYCLE in {pre, post}:
        return None
    return pre, post


def _convert_extrapolation(
    curve: FbxCurve, extrapolation: FbxExtrapolation
) -> Extrapolation | None:
    is_constant = extrapolation.count == 0 and extrapolation.mode != "K"
    if is_constant or len(curve.times) == 1:
        return Extrapolation.HOLD
    if extrapolation.count > 0 and extrapolation.mode in "RAM":
        return None
    return _EXTRAPOLATIONS[extrapolation.mode]


@dataclass(frozen=True, slots=True, eq=False)
class _SegmentedCurve:
    """A curve split into N segments between N + 1 times that include all keys."""

    is_cubic: BoolArray  # ``(N,)``
    is_stepped: BoolArray
    is_flat: BoolArray  # constant up to and including the end
    is_split: BoolArray  # whether it is only one part of a segment of the curve
    weights: FloatArray  # ``(N, 2)``
    out_slopes: FloatArray  # slopes [1/s]
    in_slopes: FloatArray


def _split_curve(curve: FbxCurve, ticks: IntArray) -> _SegmentedCurve:
    start_ticks, end_ticks = ticks[:-1], ticks[1:]
    key_indices = np.searchsorted(curve.times, start_ticks, "right") - 1
    is_in_range = (key_indices >= 0) & (key_indices < len(curve.times) - 1)
    key_indices = np.clip(key_indices, 0, max(len(curve.times) - 2, 0))
    if len(curve.times) < 2:
        slopes, no_flags = np.zeros(len(start_ticks)), np.zeros(len(start_ticks), bool)
        weights = np.full((len(start_ticks), 2), ONE_THIRD)
        return _SegmentedCurve(
            no_flags, no_flags, ~no_flags, no_flags, weights, slopes, slopes
        )
    key_ticks, next_ticks = curve.times[key_indices], curve.times[key_indices + 1]
    modes = curve.modes[key_indices]
    is_cubic = is_in_range & (modes == CUBIC)
    is_stepped = is_in_range & ((modes == CONSTANT) | (modes == NEXT))
    is_split = is_in_range & ((start_ticks != key_ticks) | (end_ticks != next_ticks))
    durations = (next_ticks - key_ticks) / TICKS_PER_SECOND
    value_change = curve.values[key_indices + 1] - curve.values[key_indices]
    has_slope = (curve.out_slopes[key_indices] != 0) | (
        curve.in_slopes[key_indices] != 0
    )
    is_flat = (value_change == 0) & ~(is_cubic & has_slope)
    end_slopes = []
    for times in (start_ticks, end_ticks):
        fraction = (times - key_ticks) / TICKS_PER_SECOND / durations
        cubic_slopes = _evaluate_slope(curve, key_indices, fraction, durations)
        slopes = np.where(is_cubic, cubic_slopes, value_change / durations)
        end_slopes.append(np.where(is_in_range & ~is_stepped, slopes, 0.0))
    out_slopes, in_slopes = end_slopes
    # Complete segments keep the slopes of the keys, whatever their weights.
    is_unsplit_cubic = is_cubic & ~is_split
    out_slopes = np.where(is_unsplit_cubic, curve.out_slopes[key_indices], out_slopes)
    in_slopes = np.where(is_unsplit_cubic, curve.in_slopes[key_indices], in_slopes)
    weights = np.where(is_cubic[:, None], curve.weights[key_indices], ONE_THIRD)
    # The value of a NEXT segment applies from its start; NaN weights mark that it
    # cannot be joined.
    is_next_step = is_stepped & (modes == NEXT) & ~is_flat
    weights[is_next_step] = np.nan
    return _SegmentedCurve(
        is_cubic | is_next_step,
        is_stepped & ~is_next_step,
        is_flat | ~is_in_range,
        is_split | is_next_step,
        weights,
        out_slopes,
        in_slopes,
    )


def _evaluate_slope(
    curve: FbxCurve, key_indices: IntArray, fraction: FloatArray, durations: FloatArray
) -> FloatArray:
    """Return the derivative of cubic segments with handle weights of a third [1/s]."""
    out_slopes, in_slopes = curve.out_slopes[key_indices], curve.in_slopes[key_indices]
    chords = (curve.values[key_indices + 1] - curve.values[key_indices]) / durations
    middle_slope = 3.0 * chords - out_slopes - in_slopes
    v = 1.0 - fraction
    return np.asarray(
        v * v * out_slopes
        + 2 * fraction * v * middle_slope
        + fraction * fraction * in_slopes
    )


def _segment_interpolations(
    curves: Sequence[_SegmentedCurve], segment_count: int
) -> list[Interp] | None:
    """Return the interpolation of each segment; None if it differs by component."""
    is_cubic = np.logical_or.reduce([c.is_cubic & ~c.is_flat for c in curves])
    is_moving = np.logical_or.reduce([~c.is_flat & ~c.is_stepped for c in curves])
    is_stepped = np.logical_or.reduce([c.is_stepped & ~c.is_flat for c in curves])
    if (is_stepped & is_moving).any():
        return None
    # A stepped segment changes its value only at the end of the unsplit segment.
    split_step_masks = [c.is_stepped & c.is_split & ~c.is_flat for c in curves]
    if len(curves) > 1 and np.logical_or.reduce(split_step_masks).any():
        return None
    interpolation_codes = np.where(is_cubic, 2, np.where(is_stepped, 1, 0))
    interpolations = (Interp.LINEAR, Interp.STEP, Interp.BEZIER)
    return [interpolations[code] for code in interpolation_codes.tolist()][
        :segment_count
    ]


def _common_weights(curves: Sequence[_SegmentedCurve]) -> FloatArray | None:
    """Return the handle weights of each segment; None if they differ by component."""
    weights = np.full(curves[0].weights.shape, ONE_THIRD)
    has_weights = np.zeros(len(weights), bool)
    for curve in curves:
        is_cubic = curve.is_cubic & ~curve.is_flat
        has_third_weights = (
            np.abs(curve.weights - ONE_THIRD).max(axis=1) <= WEIGHT_TOLERANCE
        )
        if not (has_third_weights | ~curve.is_split | ~is_cubic).all():
            return None
        is_different = np.abs(curve.weights - weights).max(axis=1) > WEIGHT_TOLERANCE
        if (has_weights & is_cubic & is_different).any():
            return None
        weights = np.where(is_cubic[:, None], curve.weights, weights)
        has_weights |= is_cubic
    return None if np.isnan(weights).any() else weights

"""Curves of a property's components joined to keys of all components."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.formats.fbx.curves import CONSTANT, CUBIC, NEXT, THIRD, FbxCurve, Outside
from animtool.formats.fbx.layers import PropertyTrack
from animtool.formats.fbx.settings import TICKS
from animtool.maths.curves import Extrapolation, Interp

# Weights of handles that differ by less are one.
SAME_WEIGHT = 1e-9
_OUTSIDE = {
    "C": Extrapolation.HOLD,
    "K": Extrapolation.LINEAR,
    "R": Extrapolation.CYCLE,
    "A": Extrapolation.CYCLE_OFFSET,
    "M": Extrapolation.OSCILLATE,
}


@dataclass(frozen=True, slots=True, eq=False)
class JoinedKeys:
    """Keys of a property of D parts.

    Attributes:
        ticks: Times ``(K,)``.
        values: ``(K, D)``.
        interps: Of the segment after each key, K long.
        ins: Handles before the keys, as offsets: time [s], then values ``(K, 1 + D)``.
        outs: Handles after the keys, likewise.
        pre: Before the first key.
        post: After the last.
    """

    ticks: IntArray
    values: FloatArray
    interps: tuple[Interp, ...]
    ins: FloatArray
    outs: FloatArray
    pre: Extrapolation
    post: Extrapolation


def joined_keys(track: PropertyTrack, base: FloatArray) -> JoinedKeys | None:
    """Return keys of all components of a property; None if not exact.

    Keys of one part alone split the segments of the others, which changes no value.

    base: What it is without animation ``(D,)``.
    """
    if len(track.layers) != 1 or not track.layers[0].is_first:
        return None
    curves = track.layers[0].curves
    keyed = [one for one in curves if one is not None]
    outside = _outside(keyed)
    if not keyed or outside is None:
        return None
    ticks = np.unique(np.concatenate([one.times for one in keyed]))
    parts = [_part(one, ticks) for one in curves if one is not None]
    kinds = _kinds(parts, len(ticks) - 1)
    weights = _weights(parts)
    if kinds is None or weights is None:
        return None
    seconds = np.diff(ticks) / TICKS
    count, width = len(ticks), len(curves)
    ins, outs = np.zeros((count, 1 + width)), np.zeros((count, 1 + width))
    outs[:-1, 0], ins[1:, 0] = weights[:, 0] * seconds, -weights[:, 1] * seconds
    remaining = iter(parts)
    for part, curve in enumerate(curves):
        if curve is not None:
            one = next(remaining)
            outs[:-1, 1 + part] = one.right * outs[:-1, 0]
            ins[1:, 1 + part] = one.left * ins[1:, 0]
    values = track.at(base, ticks)
    return JoinedKeys(ticks, values, (*kinds, Interp.LINEAR), ins, outs, *outside)


def _outside(
    curves: Sequence[FbxCurve],
) -> tuple[Extrapolation, Extrapolation] | None:
    """Return the common extrapolation of curves; None if they differ."""
    sides = []
    for side in ("pre", "post"):
        kinds = {_extrapolation(one, getattr(one, side)) for one in curves}
        if len(kinds) != 1 or None in kinds:
            return None
        sides += [one for one in kinds if one is not None]
    if sides and set(sides) != {Extrapolation.HOLD}:
        first = curves[0].times
        if any(not np.array_equal(first, one.times) for one in curves):
            return None
    # Where a repeat jumps a clip has the other one of the two values.
    jumps = any(one.values[0] != one.values[-1] for one in curves)
    if not sides or (jumps and Extrapolation.CYCLE in sides):
        return None
    return sides[0], sides[1]


def _extrapolation(curve: FbxCurve, outside: Outside) -> Extrapolation | None:
    if len(curve.times) == 1 or (outside.count == 0 and outside.mode != "K"):
        return Extrapolation.HOLD
    if outside.count > 0 and outside.mode in "RAM":
        return None
    return _OUTSIDE[outside.mode]


@dataclass(frozen=True, slots=True, eq=False)
class _SegmentedCurve:
    """A curve over the segments between N + 1 times that hold all of its keys."""

    curved: BoolArray  # ``(N,)``
    stepped: BoolArray
    flat: BoolArray  # one value in the segment and at its end
    split: BoolArray  # whether a segment is a part of one of the curve's
    weights: FloatArray  # ``(N, 2)``
    right: FloatArray  # slopes [1/s]
    left: FloatArray


def _part(curve: FbxCurve, ticks: IntArray) -> _SegmentedCurve:
    starts, ends = ticks[:-1], ticks[1:]
    k = np.searchsorted(curve.times, starts, "right") - 1
    inside = (k >= 0) & (k < len(curve.times) - 1)
    k = np.clip(k, 0, max(len(curve.times) - 2, 0))
    nothing = np.zeros(len(starts))
    if len(curve.times) < 2:
        yes, no = np.ones(len(starts), bool), np.zeros(len(starts), bool)
        return _SegmentedCurve(
            no, no, yes, no, np.full((len(k), 2), THIRD), nothing, nothing
        )
    low, high = curve.times[k], curve.times[k + 1]
    modes = curve.modes[k]
    curved = inside & (modes == CUBIC)
    stepped = inside & ((modes == CONSTANT) | (modes == NEXT))
    split = inside & ((starts != low) | (ends != high))
    span = (high - low) / TICKS
    rise = curve.values[k + 1] - curve.values[k]
    level = (rise == 0) & (~curved | ((curve.right[k] == 0) & (curve.left[k] == 0)))
    slope = rise / span
    ends_of = [
        np.where(curved, _slope_at(curve, k, (at - low) / TICKS / span, span), slope)
        for at in (starts, ends)
    ]
    right, left = (np.where(inside & ~stepped, one, 0.0) for one in ends_of)
    # Of whole segments the slopes are those of the keys, whatever the weights.
    unsplit = curved & ~split
    right = np.where(unsplit, curve.right[k], right)
    left = np.where(unsplit, curve.left[k], left)
    # A value that holds up to the next key, and is that of it only then.
    late = stepped & (modes == NEXT) & ~level
    if late.any():
        stepped, level = stepped & ~late, level & ~late
        return _SegmentedCurve(
            curved | late, stepped, level, split | late, _never(k), right, left
        )
    weights = np.where(curved[:, None], curve.weights[k], THIRD)
    return _SegmentedCurve(
        curved, stepped, level | ~inside, split, weights, right, left
    )


def _never(k: IntArray) -> FloatArray:
    """Return weights that no keys have, as NaN."""
    return np.full((len(k), 2), np.nan)


def _slope_at(
    curve: FbxCurve, k: IntArray, fraction: FloatArray, span: FloatArray
) -> FloatArray:
    """Return slopes within segments whose handles are at thirds [1/s]."""
    right, left = curve.right[k], curve.left[k]
    chord = (curve.values[k + 1] - curve.values[k]) / span
    middle = 3.0 * chord - right - left
    v = 1.0 - fraction
    return np.asarray(
        v * v * right + 2 * fraction * v * middle + fraction * fraction * left
    )


def _kinds(parts: Sequence[_SegmentedCurve], count: int) -> list[Interp] | None:
    """Return the interpolation of each segment; None if components differ."""
    curved = np.logical_or.reduce([one.curved & ~one.flat for one in parts])
    moving = np.logical_or.reduce([~one.flat & ~one.stepped for one in parts])
    stepped = np.logical_or.reduce([one.stepped & ~one.flat for one in parts])
    if (stepped & moving).any():
        return None
    # A step within a segment comes at the end of the curve's own.
    steps = [one.stepped & one.split & ~one.flat for one in parts]
    if len(parts) > 1 and np.logical_or.reduce(steps).any():
        return None
    kinds = np.where(curved, 2, np.where(stepped, 1, 0))
    interpolations = (Interp.LINEAR, Interp.STEP, Interp.BEZIER)
    return [interpolations[kind] for kind in kinds.tolist()][:count]


def _weights(parts: Sequence[_SegmentedCurve]) -> FloatArray | None:
    """Return the tangent weights common to all components; else None."""
    weights = np.full(parts[0].weights.shape, THIRD)
    fixed = np.zeros(len(weights), bool)
    for one in parts:
        curved = one.curved & ~one.flat
        thirds = np.abs(one.weights - THIRD).max(axis=1) <= SAME_WEIGHT
        if not (thirds | ~one.split | ~curved).all():
            return None
        off = np.abs(one.weights - weights).max(axis=1) > SAME_WEIGHT
        if (fixed & curved & off).any():
            return None
        weights = np.where(curved[:, None], one.weights, weights)
        fixed |= curved
    return None if np.isnan(weights).any() else weights

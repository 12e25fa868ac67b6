"""Scalar key curves: segments between keys, and extrapolation."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from enum import IntEnum, StrEnum
from typing import TypeVar, cast

import numpy as np

from animtool import _kernels
from animtool.core.array_types import (
    ArrayLike,
    FloatArray,
    IntArray,
    as_floats,
    output_array,
)
from animtool.core.record import dataclass
from animtool.maths.tangents import KeySlopes, Tangent


class Interp(StrEnum):
    """Interpolation of a channel from a key to the next."""

    STEP = "step"
    LINEAR = "linear"
    BEZIER = "bezier"
    CATMULL_ROM = "catmull_rom"
    TCB = "tcb"
    HERMITE = "hermite"
    SLERP = "slerp"
    SQUAD = "squad"
    SPLINE = "spline"


class Extrapolation(StrEnum):
    """Extrapolation of a curve before its first or after its last key."""

    HOLD = "hold"
    LINEAR = "linear"
    CYCLE = "cycle"
    CYCLE_OFFSET = "cycle_offset"
    OSCILLATE = "oscillate"


@dataclass(frozen=True, slots=True)
class FoldedTimes:
    """Times folded into the range of the keys, with the remainders."""

    times: FloatArray  # within the range ``(F,)``
    # Time before (negative) or after the range for linear extrapolation; else 0
    # ``(F,)``.
    overshoot: FloatArray
    # Cycles before (negative) or after the range, if each adds the curve's rise; else 0
    # ``(F,)``.
    cycles: FloatArray


def fold_times(
    times: FloatArray,
    start: float,
    end: float,
    pre: Extrapolation = Extrapolation.HOLD,
    post: Extrapolation = Extrapolation.HOLD,
) -> FoldedTimes:
    """Fold times into the range from ``start`` to ``end``.

    A time at an integer number of cycles belongs to the cycle nearer to the range:
    after the range it gets the last key's value, before it the first key's. In a range
    of length 0, the value is held.

    >>> fold_times(np.array([-1.0, 4.0, 5.0]), 0.0, 4.0, post=Extrapolation.CYCLE).times
    array([0., 4., 1.])
    """
    clamped_times = np.clip(times, start, end)
    overshoot, cycles = np.zeros(times.shape), np.zeros(times.shape)
    period = end - start
    for is_before, extrapolation, range_end in ((True, pre, start), (False, post, end)):
        is_outside = times < start if is_before else times > end
        if extrapolation is Extrapolation.HOLD or not is_outside.any():
            continue
        distance = np.abs(times[is_outside] - range_end)
        if extrapolation is Extrapolation.LINEAR:
            overshoot[is_outside] = -distance if is_before else distance
        elif period > 0:
            cycles_away = np.ceil(distance / period)
            remainder = cycles_away * period - distance  # to the far edge of that cycle
            is_mirrored = cycles_away % 2 == 1
            is_mirrored &= extrapolation is Extrapolation.OSCILLATE
            is_reversed = is_mirrored ^ is_before
            from_start = np.where(is_reversed, remainder, period - remainder)
            clamped_times[is_outside] = np.clip(start + from_start, start, end)
            if extrapolation is Extrapolation.CYCLE_OFFSET:
                cycles[is_outside] = -cycles_away if is_before else cycles_away
    return FoldedTimes(clamped_times, overshoot, cycles)


class SegmentKind(IntEnum):
    """Interpolation of a segment between two keys."""

    HOLD = 0
    LINEAR = 1
    CUBIC = 2
    BEZIER = 3


@dataclass(frozen=True, slots=True)
class Curves:
    """C scalar curves with K keys in total.

    The segment after a key has the control values v, v + out dv, v' + in' dv', v'.
    A CUBIC segment is the cubic of these over time that runs evenly from key to key
    (its handles lie at thirds, whatever ``dt`` says); a BEZIER segment is the curve
    of the control points in time and value, solved for the time.
    """

    # Index of each curve's first key, and K at the end ``(C + 1,)``.
    first_keys: IntArray
    times: FloatArray  # key times, strictly ascending within a curve ``(K,)``
    values: FloatArray  # key values ``(K,)``
    # `SegmentKind` of the segment after each key ``(K,)``; ignored for a curve's last
    # key.
    kinds: IntArray
    in_handles: FloatArray  # handle before each key, as offset (dt ≤ 0, dv) ``(K, 2)``
    out_handles: FloatArray  # handle after each key, as offset (dt ≥ 0, dv) ``(K, 2)``
    # Extrapolation of each curve before its first key, C long.
    pre: tuple[Extrapolation, ...]
    post: tuple[Extrapolation, ...]  # extrapolation after its last key, C long

    def retimed(self, start: float, ratio: float, new_start: float) -> Curves:
        """Return the curves with time t mapped to ``new_start + (t - start) · ratio``.

        >>> zero = np.zeros((2, 1))
        >>> cubic_curves(np.array([0.0, 2.0]), zero, zero, zero).retimed(
        ...     0.0, 0.5, 1001.0
        ... ).times.tolist()
        [1001.0, 1002.0]
        """
        handle_scale = np.array([ratio, 1.0])
        times = new_start + (self.times - start) * ratio
        in_handles, out_handles = (
            self.in_handles * handle_scale,
            self.out_handles * handle_scale,
        )
        return replace(
            self, times=times, in_handles=in_handles, out_handles=out_handles
        )


_SEGMENT_KINDS = {Interp.STEP: SegmentKind.HOLD, Interp.LINEAR: SegmentKind.LINEAR}


def key_handles(
    slopes: KeySlopes,
    interps: Sequence[Interp],
    tangents: Sequence[tuple[Tangent, Tangent]],
    free_ins: FloatArray,
    free_outs: FloatArray,
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return handles ``(K, 1 + D)`` before and after the keys, and segment kinds.

    Args:
        slopes: Key slopes by tangent rule.
        interps: Interpolation of the segment after each key, K long.
        tangents: Before and after each key, K long.
        free_ins: Handles before the keys, where tangents are free ``(K, 1 + D)``.
        free_outs: Handles after the keys, likewise.
    """
    key_count, component_count = slopes.values.shape
    in_handles = np.zeros((key_count, 1 + component_count))
    out_handles = np.zeros((key_count, 1 + component_count))
    kinds = np.full(key_count, int(SegmentKind.HOLD), np.int64)
    if key_count == 1:
        return in_handles, out_handles, kinds
    thirds = np.diff(slopes.times) / 3
    for interp, segments in _indices_by_value(interps[:-1]):
        if interp in _SEGMENT_KINDS:
            kinds[segments] = _SEGMENT_KINDS[interp]
            continue
        kinds[segments] = SegmentKind.CUBIC
        segment_thirds = thirds[segments]
        out_handles[segments, 0], in_handles[segments + 1, 0] = (
            segment_thirds,
            -segment_thirds,
        )
        if interp is Interp.CATMULL_ROM:
            out_handles[segments, 1:], in_handles[segments + 1, 1:] = (
                slopes.catmull_rom_handles(segments, segment_thirds[:, None])
            )
            continue
        for side, handles, free_handles in (
            (1, out_handles, free_outs),
            (0, in_handles, free_ins),
        ):
            side_keys = segments + 1 - side
            signed_thirds = segment_thirds if side else -segment_thirds
            if interp is Interp.TCB:
                slope = slopes.tcb[side][side_keys]
                handles[side_keys, 1:] = slope * signed_thirds[:, None]
                continue
            for tangent, selection in _indices_by_tangent(tangents, side_keys, side):
                keys, tangent_segments = side_keys[selection], segments[selection]
                length = signed_thirds[selection]
                if tangent is Tangent.FREE and interp is not Interp.HERMITE:
                    handles[keys] = free_handles[keys]
                    is_bezier = free_handles[keys, 0] != length
                    kinds[tangent_segments[is_bezier]] = SegmentKind.BEZIER
                    continue
                if tangent is Tangent.FREE:
                    slope = _free_slopes(free_handles[keys])
                else:
                    slope = slopes.by_rule(tangent, keys, tangent_segments)
                handles[keys, 0], handles[keys, 1:] = length, slope * length[:, None]
    return in_handles, out_handles, kinds


_Value = TypeVar("_Value")


def _indices_by_value(values: Sequence[_Value]) -> Iterator[tuple[_Value, IntArray]]:
    """Yield the distinct values of a sequence, each with its indices."""
    if values.count(values[0]) == len(values):
        yield values[0], np.arange(len(values))
        return
    for value in dict.fromkeys(values):
        matches = [other_value == value for other_value in values]
        yield value, np.flatnonzero(matches)


def _indices_by_tangent(
    tangents: Sequence[tuple[Tangent, Tangent]], keys: IntArray, side: int
) -> Iterator[tuple[Tangent, IntArray]]:
    """Yield each distinct tangent on a side of keys, with the indices of its keys."""
    if tangents.count(tangents[0]) == len(tangents):
        yield tangents[0][side], np.arange(len(keys))
    else:
        yield from _indices_by_value([tangents[key][side] for key in keys.tolist()])


def _free_slopes(handles: FloatArray) -> FloatArray:
    """Return the slopes of handles ``(N, 1 + D)``; 0 for handles of zero duration."""
    times = handles[:, :1]
    slopes = handles[:, 1:] / np.where(times != 0, times, 1.0)
    return np.where(times != 0, slopes, 0.0)


def cubic_curves(
    times: FloatArray,
    values: FloatArray,
    in_handles: FloatArray,
    out_handles: FloatArray,
) -> Curves:
    """Return D curves of CUBIC segments that share K key times, held at their ends.

    Args:
        times: Strictly ascending ``(K,)``.
        values: ``(K, D)``.
        in_handles: Value offsets of the handles before the keys ``(K, D)``.
        out_handles: Value offsets of the handles after the keys ``(K, D)``.

    >>> zero = np.zeros((2, 1))
    >>> ease = cubic_curves(np.array([0.0, 2.0]), np.array([[0.0], [1.0]]), zero, zero)
    >>> evaluate(ease, [1.0]).tolist()
    [[0.5]]
    """
    key_count, component_count = values.shape

    def handles(offsets: FloatArray) -> FloatArray:
        """Return handles with the given value offsets and time offsets of 0."""
        return np.stack(
            [np.zeros(key_count * component_count), offsets.T.ravel()], axis=-1
        )

    return Curves(
        np.arange(component_count + 1) * key_count,
        np.tile(np.asarray(times, np.float64), component_count),
        np.ascontiguousarray(values.T.ravel()),
        np.full(key_count * component_count, int(SegmentKind.CUBIC), np.int64),
        handles(in_handles),
        handles(out_handles),
        (Extrapolation.HOLD,) * component_count,
        (Extrapolation.HOLD,) * component_count,
    )


def evaluate(
    curves: Curves, times: ArrayLike, *, out: FloatArray | None = None
) -> FloatArray:
    """Return every curve's values ``(C, F)`` at times ``(F,)``.

    Times may be in any order. Ascending ones are the quickest, and so are neighbouring
    curves with equal key times.
    ``out`` ``(C, F)`` is filled and returned instead of a new array.

    At a key the value is the key's own, exactly. Each segment is solved from its
    nearer key, so the error is about 2e-15 of the values and handles, even with
    handles of length 0. The exception is a curve that is vertical inside a segment
    (both handles as long as the segment): there, rounding the time changes the value.

    A BEZIER handle longer than its segment is shortened to it with the same slope,
    independent of the other handle, so that time never runs backwards.

    >>> ease = Curves(
    ...     first_keys=np.array([0, 2]),
    ...     times=np.array([0.0, 3.0]),
    ...     values=np.array([0.0, 1.0]),
    ...     kinds=np.array([SegmentKind.BEZIER, SegmentKind.HOLD]),
    ...     in_handles=np.array([[0.0, 0.0], [-1.0, 0.0]]),
    ...     out_handles=np.array([[1.0, 0.0], [0.0, 0.0]]),
    ...     pre=(Extrapolation.HOLD,),
    ...     post=(Extrapolation.OSCILLATE,),
    ... )
    >>> evaluate(ease, [-1.0, 0.0, 1.5, 3.0, 6.0]).tolist()
    [[0.0, 0.0, 0.5, 1.0, 0.0]]
    """
    _check_curves(curves)
    times = as_floats(times, ("F",), "times")
    if not np.isfinite(times).all():
        raise ValueError("times must be finite")
    if out is not None:
        output_array(out, (len(curves.pre), len(times)))
    extrapolated_curves = _extrapolated_curves(curves, times)
    if not len(extrapolated_curves):
        return _values_in_range(curves, times[None], out)
    start_keys, end_keys = _end_keys(curves)
    times_by_curve = np.tile(times, (len(curves.pre), 1))
    overshoot, cycles = np.zeros(times_by_curve.shape), np.zeros(times_by_curve.shape)
    for c in extrapolated_curves:
        start, end = (
            float(curves.times[start_keys[c]]),
            float(curves.times[end_keys[c]]),
        )
        folded_times = fold_times(times, start, end, curves.pre[c], curves.post[c])
        times_by_curve[c] = folded_times.times
        overshoot[c] = folded_times.overshoot
        cycles[c] = folded_times.cycles
    slopes = end_slopes(curves)
    rises = curves.values[end_keys] - curves.values[start_keys]
    values = _values_in_range(curves, times_by_curve, out)
    values += overshoot * np.where(overshoot < 0, slopes[:, :1], slopes[:, 1:])
    values += cycles * rises[:, None]
    return values


def end_slopes(curves: Curves) -> FloatArray:
    """Return the slopes ``(C, 2)`` at each curve's first and last key.

    LINEAR extrapolation uses them: 0 for a single key and next to a HOLD segment, else
    the slope of the first or last segment at that key. For a BEZIER handle without
    length in time, the slope of the line between the two keys is used.

    >>> line = Curves(
    ...     first_keys=np.array([0, 2]),
    ...     times=np.array([0.0, 2.0]),
    ...     values=np.array([0.0, 1.0]),
    ...     kinds=np.array([SegmentKind.LINEAR, SegmentKind.HOLD]),
    ...     in_handles=np.zeros((2, 2)),
    ...     out_handles=np.zeros((2, 2)),
    ...     pre=(Extrapolation.LINEAR,),
    ...     post=(Extrapolation.LINEAR,),
    ... )
    >>> end_slopes(line).tolist()
    [[0.5, 0.5]]
    """
    start_keys, end_keys = _end_keys(curves)
    is_single_key = start_keys == end_keys
    second_keys = np.where(is_single_key, start_keys, start_keys + 1)
    second_last_keys = np.where(is_single_key, end_keys, end_keys - 1)
    first_slopes = _segment_slopes(
        curves, start_keys, second_keys, curves.out_handles[start_keys]
    )
    last_slopes = _segment_slopes(
        curves, second_last_keys, end_keys, -curves.in_handles[end_keys]
    )
    return np.stack([first_slopes, last_slopes], axis=-1)


def _segment_slopes(
    curves: Curves, keys: IntArray, next_keys: IntArray, handles: FloatArray
) -> FloatArray:
    """Return the slope of each segment at the end where its handle is ``(C,)``."""
    segment_spans = curves.times[next_keys] - curves.times[keys]
    kinds = curves.kinds[keys]
    segment_spans = np.where(
        (segment_spans > 0) & (kinds != SegmentKind.HOLD), segment_spans, np.inf
    )
    secants = (curves.values[next_keys] - curves.values[keys]) / segment_spans
    dt, dv = handles.T
    has_length = (kinds == SegmentKind.BEZIER) & (dt > 0)
    slopes = np.where(has_length, dv / np.where(dt > 0, dt, 1.0), secants)
    slopes = np.where(kinds == SegmentKind.CUBIC, 3.0 * dv / segment_spans, slopes)
    return np.where(kinds == SegmentKind.HOLD, 0.0, slopes)


def _end_keys(curves: Curves) -> tuple[IntArray, IntArray]:
    """Return the first and last key of each curve, each ``(C,)``."""
    return curves.first_keys[:-1], curves.first_keys[1:] - 1


def _extrapolated_curves(curves: Curves, times: FloatArray) -> IntArray:
    """Return the indices of curves that are extrapolated other than by holding."""
    if not len(times):
        return np.zeros(0, np.int64)
    start_keys, end_keys = _end_keys(curves)
    has_pre = np.array([mode is not Extrapolation.HOLD for mode in curves.pre], bool)
    has_post = np.array([mode is not Extrapolation.HOLD for mode in curves.post], bool)
    is_before = has_pre & (times.min() < curves.times[start_keys])
    is_after = has_post & (times.max() > curves.times[end_keys])
    return np.flatnonzero(is_before | is_after)


def _values_in_range(
    curves: Curves, times: FloatArray, out: FloatArray | None
) -> FloatArray:
    """Return values ``(C, F)`` at times ``(1, F)`` or ``(C, F)``, held beyond keys."""
    values = _kernels.evaluate_curves(
        curves.first_keys,
        curves.times,
        curves.values,
        curves.kinds,
        np.ascontiguousarray(curves.in_handles),
        np.ascontiguousarray(curves.out_handles),
        times,
        out,
    )
    return cast("FloatArray", values if out is None else out)


def _check_curves(curves: Curves) -> None:
    """Raise if the arrays of curves have inconsistent sizes."""
    first_keys, key_count = curves.first_keys, len(curves.times)
    if (
        first_keys.ndim != 1
        or not len(first_keys)
        or first_keys[0] != 0
        or first_keys[-1] != key_count
    ):
        raise ValueError("first_keys must run from 0 to the number of keys")
    if (np.diff(first_keys) < 1).any():
        raise ValueError("every curve needs a key")
    if not len(curves.pre) == len(curves.post) == len(first_keys) - 1:
        raise ValueError("pre and post must name one extrapolation per curve")
    shapes: dict[str, tuple[int, ...]]
    shapes = dict.fromkeys(("times", "values", "kinds"), (key_count,))
    shapes |= dict.fromkeys(("ins", "outs"), (key_count, 2))
    handles = {"ins": curves.in_handles, "outs": curves.out_handles}
    for name, shape in shapes.items():
        array = handles[name] if name in handles else getattr(curves, name)
        if array.shape != shape:
            raise ValueError(f"{name} must have shape {shape}, not {array.shape}")

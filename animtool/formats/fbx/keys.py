"""Curves of FBX 7000 and newer, and the checks of every curve."""

from __future__ import annotations

from typing import Any

import numpy as np

from animtool.core.array_types import IntArray
from animtool.formats.fbx.curves import (
    CONSTANT,
    CUBIC,
    LINEAR,
    MAX_KEYS,
    MAX_TICKS,
    NEXT,
    ONE_THIRD,
    FbxCurve,
    FbxExtrapolation,
)
from animtool.formats.fbx.elements import Element, floats, integers, number
from animtool.formats.fbx.settings import TICKS_PER_SECOND, in_ticks
from animtool.formats.fbx.tangents import CURVED, NEXT_VALUE, STEPPED, TCB, key_slopes
from animtool.formats.file_notices import FileNotices

# Unit of stored handle weights: 4 decimals, two of which fill 32 bits.
WEIGHT_STEP = 1e-4


def curve_of_object(
    element: Element, notes: FileNotices, *, new_ticks: bool = False
) -> FbxCurve | None:
    """Return the curve of an AnimationCurve object (FBX 7000 and newer).

    ``new_ticks`` is whether its times count 141,120,000 ticks per second.
    """
    times = integers(element, "KeyTime", notes)
    if times is None or not len(times):
        return None
    if new_ticks:
        times = in_ticks(times)
    count = len(times)
    values = floats(element, "KeyValueFloat", notes, count)
    flags = integers(element, "KeyAttrFlags", notes)
    data = element.find("KeyAttrDataFloat")
    counts = integers(element, "KeyAttrRefCount", notes)
    check_times(times, element, notes)
    if values is None or flags is None or counts is None or data is None:
        return notes.fail("FBX006", element.where, "a curve lacks an array of its keys")
    raw = _attribute_bits(data, notes)
    lengths_match = len(flags) == len(counts) and raw.size == 4 * len(flags)
    lengths_match = lengths_match and bool(
        (counts >= 0).all() and (counts <= count).all()
    )
    if not lengths_match or int(counts.sum()) != count:
        message = f"the attributes of {count} keys do not fit them"
        notes.fail("FBX006", element.where, message)
    flags = np.repeat(flags, counts)
    rows = np.repeat(raw.reshape(-1, 4), counts, axis=0)
    is_stepped = flags & STEPPED != 0
    cubic = ~is_stepped & (flags & CURVED != 0)
    tcb = cubic & (flags & TCB != 0)
    key_data = rows[:, :3].copy().view(np.float32).astype(np.float64)
    # The third number is the bias of TCB tangents, or two packed weights of others.
    if (
        not np.isfinite(key_data[cubic, :2]).all()
        or not np.isfinite(key_data[tcb]).all()
    ):
        notes.fail("FBX006", element.where, "a slope of a key is not finite")
    packed_weights = rows[:, 2].astype(np.int64) & 0xFFFFFFFF
    weights = np.full((count, 2), ONE_THIRD)
    for side, (flag, numbers) in enumerate(
        ((0x1000000, packed_weights & 0xFFFF), (0x2000000, packed_weights >> 16))
    ):
        is_weighted = cubic & ~tcb & (flags & flag != 0)
        weights[is_weighted, side] = np.minimum(numbers[is_weighted] * WEIGHT_STEP, 1.0)
    modes = np.where(cubic, CUBIC, np.where(is_stepped, CONSTANT, LINEAR))
    modes[is_stepped & (flags & NEXT_VALUE != 0)] = NEXT
    out_slopes, in_slopes = key_slopes(
        times / TICKS_PER_SECOND, values, flags, key_data, weights
    )
    return validate_curve(
        FbxCurve(times, values, modes, out_slopes, in_slopes, weights), element, notes
    )


def _attribute_bits(data: Element, notes: FileNotices) -> Any:
    """Return key attributes as float32 bits; text files write integers."""
    values = data.values[0] if len(data.values) == 1 else np.array(data.values)
    array = np.asarray(values)
    if array.dtype.kind == "f":
        with np.errstate(all="ignore"):
            return array.astype(np.float32).view(np.int32)
    if array.dtype.kind != "i" or (np.abs(array) >= 2**32).any():
        notes.fail("FBX006", data.where, "the attributes of keys must be numbers")
    return array.astype(np.int64).astype(np.uint32).view(np.int32)


def validate_curve(curve: FbxCurve, element: Element, notes: FileNotices) -> FbxCurve:
    """Return a curve with its extrapolation; raise for invalid numbers."""
    times = curve.times
    check_times(times, element, notes)
    for slopes in (curve.out_slopes, curve.in_slopes):
        if not np.isfinite(slopes).all():
            notes.fail("FBX006", element.where, "a slope of a key is not finite")
    pre, post = (
        _fbx_extrapolation(element, f"{name}-Extrapolation", notes)
        for name in _EXTRAPOLATION_ENDS
    )
    out_slopes, in_slopes = curve.out_slopes, curve.in_slopes
    if not (curve.modes == CUBIC).any() and "K" not in {pre.mode, post.mode}:
        # Slopes of linear segments are not used.
        out_slopes = in_slopes = np.zeros(len(times))
    return FbxCurve(
        times,
        curve.values,
        _shared_row(curve.modes),
        _shared_row(out_slopes),
        _shared_row(in_slopes),
        _shared_row(curve.weights),
        pre,
        post,
    )


def _shared_row(rows: Any) -> Any:
    """Return an array of equal rows as a view of one row."""
    if len(rows) > 1 and (rows == rows[:1]).all():
        return np.broadcast_to(rows[0].copy(), rows.shape)
    return rows


def check_times(times: IntArray, element: Element, notes: FileNotices) -> None:
    """Raise for key times that descend or are out of range."""
    if len(times) > MAX_KEYS:
        notes.fail("FBX013", element.where, f"{len(times)} keys in one curve")
    # The smallest integer has no negative counterpart.
    if (times > MAX_TICKS).any() or (times < -MAX_TICKS).any():
        notes.fail("FBX006", element.where, "the time of a key is out of range")
    if (np.diff(times) < 0).any():
        notes.fail("FBX006", element.where, "the times of keys must not descend")


_EXTRAPOLATION_ENDS = ("Pre", "Post")


def _fbx_extrapolation(
    element: Element, name: str, notes: FileNotices
) -> FbxExtrapolation:
    block = element.find(name)
    kind = None if block is None else block.find("Type")
    if block is None or kind is None or not kind.values:
        return FbxExtrapolation()
    mode = kind.values[0]
    if isinstance(mode, int) and 0 <= mode < 256:
        mode = chr(mode)
    if mode not in tuple("CRAMK"):
        message = f"{name} {mode!r} is not known"
        notes.fail("FBX006", kind.where, message)
    repeats = block.find("Repetition")
    count = -1.0 if repeats is None else number(repeats, 0, notes)
    return FbxExtrapolation(str(mode), int(max(-1.0, min(count, 1e9))))

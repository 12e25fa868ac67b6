"""Reads curves of FBX 7000 and newer, and validates all curves."""

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
from animtool.formats.fbx.elements import (
    Element,
    read_floats,
    read_integers,
    read_number,
)
from animtool.formats.fbx.settings import TICKS_PER_SECOND, convert_new_ticks
from animtool.formats.fbx.tangents import (
    CURVED,
    NEXT_VALUE,
    STEPPED,
    TCB,
    compute_key_slopes,
)
from animtool.formats.file_diagnostics import FileDiagnostics

# Unit of stored handle weights; two of them are packed into 32 bits.
WEIGHT_UNIT = 1e-4


def read_curve(
    element: Element, diagnostics: FileDiagnostics, *, has_new_ticks: bool = False
) -> FbxCurve | None:
    """Return the curve of an AnimationCurve object (FBX 7000 and newer).

    ``has_new_ticks`` says whether there are 141,120,000 ticks per second.
    """
    times = read_integers(element, "KeyTime", diagnostics)
    if times is None or not len(times):
        return None
    if has_new_ticks:
        times = convert_new_ticks(times)
    key_count = len(times)
    values = read_floats(element, "KeyValueFloat", diagnostics, key_count)
    key_flags = read_integers(element, "KeyAttrFlags", diagnostics)
    attribute_data = element.find("KeyAttrDataFloat")
    reference_counts = read_integers(element, "KeyAttrRefCount", diagnostics)
    check_times(times, element, diagnostics)
    if (
        values is None
        or key_flags is None
        or not attribute_data
        or reference_counts is None
    ):
        return diagnostics.fail(
            "FBX006", element.location, "a curve lacks an array of its keys"
        )
    attribute_bits = _attribute_bits(attribute_data, diagnostics)
    is_valid_count = (reference_counts >= 0) & (reference_counts <= key_count)
    if not (
        len(key_flags) == len(reference_counts)
        and attribute_bits.size == 4 * len(key_flags)
        and is_valid_count.all()
        and int(reference_counts.sum()) == key_count
    ):
        message = f"the attributes of {key_count} keys do not fit them"
        diagnostics.fail("FBX006", element.location, message)
    key_flags = np.repeat(key_flags, reference_counts)
    key_attributes = np.repeat(attribute_bits.reshape(-1, 4), reference_counts, axis=0)
    is_stepped = key_flags & STEPPED != 0
    is_cubic = ~is_stepped & (key_flags & CURVED != 0)
    is_tcb = is_cubic & (key_flags & TCB != 0)
    key_data = key_attributes[:, :3].copy().view(np.float32).astype(np.float64)
    # The third number is the bias of TCB tangents; for others, two packed weights.
    is_finite = np.isfinite(key_data)
    if not is_finite[is_cubic, :2].all() or not is_finite[is_tcb].all():
        diagnostics.fail("FBX006", element.location, "a slope of a key is not finite")
    packed_weights = key_attributes[:, 2].astype(np.int64) & 0xFFFFFFFF
    weights = np.full((key_count, 2), ONE_THIRD)
    for column, (weight_flag, stored_weights) in enumerate(
        ((0x1000000, packed_weights & 0xFFFF), (0x2000000, packed_weights >> 16))
    ):
        is_weighted = is_cubic & ~is_tcb & (key_flags & weight_flag != 0)
        weight_values = stored_weights[is_weighted] * WEIGHT_UNIT
        weights[is_weighted, column] = np.minimum(weight_values, 1.0)
    modes = np.where(is_cubic, CUBIC, np.where(is_stepped, CONSTANT, LINEAR))
    modes[is_stepped & (key_flags & NEXT_VALUE != 0)] = NEXT
    out_slopes, in_slopes = compute_key_slopes(
        times / TICKS_PER_SECOND, values, key_flags, key_data, weights
    )
    curve = FbxCurve(times, values, modes, out_slopes, in_slopes, weights)
    return validate_curve(curve, element, diagnostics)


def _attribute_bits(element: Element, diagnostics: FileDiagnostics) -> Any:
    """Return key attributes as float32 bits; text files store them as integers."""
    values = element.values[0] if len(element.values) == 1 else np.array(element.values)
    array = np.asarray(values)
    if array.dtype.kind == "f":
        with np.errstate(all="ignore"):
            return array.astype(np.float32).view(np.int32)
    if array.dtype.kind != "i" or (np.abs(array) >= 2**32).any():
        diagnostics.fail(
            "FBX006", element.location, "the attributes of keys must be numbers"
        )
    return array.astype(np.int64).astype(np.uint32).view(np.int32)


def validate_curve(
    curve: FbxCurve, element: Element, diagnostics: FileDiagnostics
) -> FbxCurve:
    """Return a curve with extrapolation and compacted rows (FBX006 if invalid)."""
    times = curve.times
    check_times(times, element, diagnostics)
    for slopes in (curve.out_slopes, curve.in_slopes):
        if not np.isfinite(slopes).all():
            diagnostics.fail(
                "FBX006", element.location, "a slope of a key is not finite"
            )
    pre = _read_extrapolation(element, "Pre-Extrapolation", diagnostics)
    post = _read_extrapolation(element, "Post-Extrapolation", diagnostics)
    out_slopes, in_slopes = curve.out_slopes, curve.in_slopes
    if not (curve.modes == CUBIC).any() and "K" not in {pre.mode, post.mode}:
        # Slopes of linear segments are not used.
        out_slopes = in_slopes = np.zeros(len(times))
    return FbxCurve(
        times,
        curve.values,
        _compact_rows(curve.modes),
        _compact_rows(out_slopes),
        _compact_rows(in_slopes),
        _compact_rows(curve.weights),
        pre,
        post,
    )


def _compact_rows(rows: Any) -> Any:
    """Return a view of one row if all rows are equal, to save memory."""
    if len(rows) > 1 and (rows == rows[:1]).all():
        return np.broadcast_to(rows[0].copy(), rows.shape)
    return rows


def check_times(
    times: IntArray, element: Element, diagnostics: FileDiagnostics
) -> None:
    """Raise if key times descend or are out of range."""
    if len(times) > MAX_KEYS:
        diagnostics.fail("FBX013", element.location, f"{len(times)} keys in one curve")
    # The smallest integer has no negative counterpart.
    if (times > MAX_TICKS).any() or (times < -MAX_TICKS).any():
        diagnostics.fail(
            "FBX006", element.location, "the time of a key is out of range"
        )
    if (np.diff(times) < 0).any():
        diagnostics.fail(
            "FBX006", element.location, "the times of keys must not descend"
        )


def _read_extrapolation(
    curve_element: Element, name: str, diagnostics: FileDiagnostics
) -> FbxExtrapolation:
    element = curve_element.find(name)
    type_element = None if element is None else element.find("Type")
    if element is None or type_element is None or not type_element.values:
        return FbxExtrapolation()
    mode = type_element.values[0]
    if isinstance(mode, int) and 0 <= mode < 256:
        mode = chr(mode)
    if mode not in tuple("CRAMK"):
        message = f"{name} {mode!r} is not known"
        diagnostics.fail("FBX006", type_element.location, message)
    repetition = element.find("Repetition")
    count = -1.0 if repetition is None else read_number(repetition, 0, diagnostics)
    return FbxExtrapolation(str(mode), int(max(-1.0, min(count, 1e9))))

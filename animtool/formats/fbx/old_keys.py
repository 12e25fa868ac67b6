"""Reads curves of FBX before 7000, whose keys are a list of numbers and letters."""

from __future__ import annotations

from typing import Any

import numpy as np

from animtool.core.errors import listed
from animtool.formats.fbx.curves import (
    CONSTANT,
    CUBIC,
    LINEAR,
    MAX_TICKS,
    NEXT,
    ONE_THIRD,
    FbxCurve,
)
from animtool.formats.fbx.elements import Element
from animtool.formats.fbx.keys import check_times, validate_curve
from animtool.formats.fbx.settings import TICKS_PER_SECOND
from animtool.formats.fbx.tangents import (
    CURVED,
    NEXT_VALUE,
    PROGRESSIVE,
    STEPPED,
    STRAIGHT,
    TIME_INDEPENDENT,
    USER,
    compute_key_slopes,
)
from animtool.formats.file_diagnostics import FileDiagnostics

# Key layouts by KeyVer: that of 6100, the first whose constant keys state which value
# applies, and one without tangent weights.
WEIGHTED_LAYOUT, STEP_LETTER_LAYOUT, UNWEIGHTED_LAYOUT = 4005, 4004, 4003
# Layout in 5000 files whose channels state none.
DEFAULT_5000_LAYOUT = 4004


def read_channel_curve(
    element: Element, diagnostics: FileDiagnostics, default_layout: int
) -> FbxCurve | None:
    """Return the curve of a channel of a take (before FBX 7000).

    ``default_layout`` is the key layout if the channel states none.
    """
    key_element = element.find("Key")
    if key_element is None or not key_element.values:
        return None
    version = element.find("KeyVer")
    key_version = None if version is None or not version.values else version.values[0]
    key_layout = key_version if isinstance(key_version, int) else default_layout
    cursor, key_rows = _KeyCursor(key_element, diagnostics, key_layout), []
    while cursor.has_more():
        key_rows.append(_read_key(cursor))
    if cursor.approximated_kinds:
        message = (
            f"tangents of kind {listed(sorted(map(repr, cursor.approximated_kinds)))} "
            "are read as automatic ones, between the keys"
        )
        hint = "bake the curves before exporting, or export FBX 2011 or later"
        diagnostics.warn("FBX120", element.location, message, hint)
    columns = list(zip(*key_rows, strict=True))
    times, values = np.array(columns[0], np.int64), np.array(columns[1])
    flags = np.array(columns[2], np.int64)
    slopes = np.stack((*columns[3:5], columns[4]), axis=1)
    weights = np.stack(columns[5:7], axis=1)
    check_times(times, element, diagnostics)
    out_slopes, in_slopes = compute_key_slopes(
        times / TICKS_PER_SECOND, values, flags, slopes, weights
    )
    step_modes = np.where(flags & NEXT_VALUE != 0, NEXT, CONSTANT)
    modes = np.where(flags & STEPPED != 0, step_modes, LINEAR)
    modes[flags & CURVED != 0] = CUBIC
    curve = FbxCurve(times, values, modes, out_slopes, in_slopes, weights)
    return validate_curve(curve, element, diagnostics)


class _KeyCursor:
    """Reads the numbers and letters that state the keys of a channel, in order."""

    def __init__(
        self, element: Element, diagnostics: FileDiagnostics, key_layout: int
    ) -> None:
        values = element.values
        is_array = len(values) == 1 and isinstance(values[0], np.ndarray)
        self.values = values[0].tolist() if is_array else values
        self.element, self.diagnostics, self.offset = element, diagnostics, 0
        self.key_layout = key_layout
        self.approximated_kinds: set[str] = set()

    def has_more(self) -> bool:
        return self.offset < len(self.values)

    def next_value(self) -> Any:
        if not self.has_more():
            self.fail("the last key of a channel is cut off")
        self.offset += 1
        return self.values[self.offset - 1]

    def next_number(self) -> float:
        value = self.next_value()
        if not isinstance(value, int | float) or not abs(value) < 1e300:
            self.fail(f"{value!r} is not a number of a key")
        return float(value)

    def next_time(self) -> int:
        value = self.next_value()
        if not isinstance(value, int) or abs(value) > MAX_TICKS:
            self.fail(f"{value!r} is not a time of a key")
        return int(value)

    def next_letter(self) -> str:
        value = self.next_value()
        if isinstance(value, int) and 0 <= value < 256:
            value = chr(value)
        return value if isinstance(value, str) else self.fail(f"{value!r} in a key")

    def fail(self, message: str) -> Any:
        return self.diagnostics.fail("FBX006", self.element.location, message)


def _read_key(cursor: _KeyCursor) -> tuple[int, float, int, float, float, float, float]:
    """Return time [tick], value, flags, two slopes and two weights of the next key."""
    time, value, mode = cursor.next_time(), cursor.next_number(), cursor.next_letter()
    if mode == "L":
        return time, value, STRAIGHT, 0.0, 0.0, ONE_THIRD, ONE_THIRD
    if mode == "C":
        step_letter = (
            cursor.next_letter() if cursor.key_layout >= STEP_LETTER_LAYOUT else ""
        )
        flags = STEPPED | (NEXT_VALUE if step_letter == "n" else 0)
        return time, value, flags, 0.0, 0.0, ONE_THIRD, ONE_THIRD
    if mode != "U":
        cursor.fail(f"interpolation {mode!r} of a key is not read")
    flags, out_slope, in_slope, weight_list_count = _read_tangent(cursor)
    weights = [ONE_THIRD, ONE_THIRD]
    for _ in range(weight_list_count):
        _read_weights(cursor, weights)
    return time, value, flags, out_slope, in_slope, weights[0], weights[1]


# Undocumented tangent kinds: number of values, and number of weight lists in older
# layouts and in that of 6100.
_UNDOCUMENTED_TANGENTS = {
    "p": (2, 1, 2),
    "q": (2, 1, 2),
    "t": (3, 0, 0),
    "d": (1, 1, 1),
}


def _read_tangent(cursor: _KeyCursor) -> tuple[int, float, float, int]:
    """Return flags and slopes of a cubic key, and the number of its weight lists."""
    tangent_kind = cursor.next_letter()
    if tangent_kind in {"s", "b"}:
        out_slope, in_slope = cursor.next_number(), cursor.next_number()
        weight_list_count = 0 if cursor.key_layout == UNWEIGHTED_LAYOUT else 1
        return CURVED | USER, out_slope, in_slope, weight_list_count
    auto_flags = CURVED | PROGRESSIVE | TIME_INDEPENDENT
    is_6100 = cursor.key_layout >= WEIGHTED_LAYOUT
    if tangent_kind == "a":
        return auto_flags, 0.0, 0.0, 1 if is_6100 else 0
    if tangent_kind not in _UNDOCUMENTED_TANGENTS:
        cursor.fail(f"tangents {tangent_kind!r} of a key are not read")
    number_count, older_list_count, list_count = _UNDOCUMENTED_TANGENTS[tangent_kind]
    for _ in range(number_count):
        cursor.next_number()
    cursor.approximated_kinds.add(tangent_kind)
    return auto_flags, 0.0, 0.0, list_count if is_6100 else older_list_count


def _read_weights(cursor: _KeyCursor, weights: list[float]) -> None:
    weight_kind = cursor.next_letter()
    if weight_kind not in {"a", "r", "l", "n", "c"}:
        cursor.fail(f"weights {weight_kind!r} of a key are not read")
    for column in {"a": (0, 1), "r": (0,), "l": (1,)}.get(weight_kind, ()):
        weights[column] = min(max(cursor.next_number(), 0.0), 1.0)

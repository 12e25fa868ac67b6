"""Refuse values that USD cannot store as finite numbers.

Attributes are float16, float32 or float64. A number beyond the range of its type would
silently become infinite in the file, so each is checked before it is written.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

from animtool import _kernels
from animtool.core.array_types import Float32Array, FloatArray
from animtool.core.errors import Fault, OutputError
from animtool.core.record import dataclass

# Largest finite number by type code, the last letter of USD's type names.
_TYPE_LIMITS = {
    type_code: float(np.finfo(dtype).max)
    for type_code, dtype in (("h", np.float16), ("f", np.float32), ("d", np.float64))
}
_TYPE_NAMES = {"h": "float16", "f": "float32", "d": "float64"}
_SCALAR_TYPE_CODES = {"GfHalf": "h", "float": "f", "double": "d", "GfTimeCode": "d"}
# Bit masks of float16: all but the sign, and the largest finite number.
_HALF_MAGNITUDE, _HALF_LIMIT = np.uint16(0x7FFF), 0x7BFF
# Half the distance between the largest float32 and the next smaller one: rounding
# within the range changes a coordinate by no more than this.
_MAX_ROUNDING_ERROR = 2.0**103


@dataclass(frozen=True, slots=True)
class ValueLabels:
    """Labels of an attribute's values, for messages."""

    attribute: str  # name or path of the attribute
    noun: str = ""  # owner of each value, such as ``joint``
    names: Sequence[str] = ()  # names of the owners, if they have any

    def label(self, index: Sequence[int]) -> str:
        """Return the label of one value, by its array index."""
        if not index or not self.noun:
            return self.noun or "a value"
        owner_index = index[0]
        name = (
            repr(self.names[owner_index])
            if owner_index < len(self.names)
            else str(owner_index)
        )
        return f"{self.noun} {name}"


@cache
def float_type_code(type_name: Any) -> str:
    """Return the type code (h, f or d) of a value type; empty if not a float."""
    name = str(type_name.scalarType.cppTypeName)
    if name in _SCALAR_TYPE_CODES:
        return _SCALAR_TYPE_CODES[name]
    return name[-1] if name.startswith("Gf") and name[-1] in _TYPE_LIMITS else ""


def narrow_floats(
    values: FloatArray,
    type_code: str,
    labels: ValueLabels,
    time_codes: FloatArray | None = None,
) -> npt.NDArray[Any]:
    """Return values as float16 (``h``) or float32 (``f``).

    ``values`` are ``(F, N, …)`` at time codes ``(F,)``, or ``(N, …)`` without them.
    """
    dtype = np.float16 if type_code == "h" else np.float32
    with np.errstate(over="ignore"):
        narrowed_values = values.astype(dtype)
    if narrowed_values.size and not _is_in_range(
        narrowed_values, _TYPE_LIMITS[type_code]
    ):
        _refuse_non_finite(values, narrowed_values, type_code, labels, time_codes)
    return narrowed_values


def round_to_float32(
    points: FloatArray,
    meters_per_unit: float,
    labels: ValueLabels,
    time_codes: FloatArray,
) -> tuple[Float32Array, float, int, int]:
    """Return points as float32, the largest rounding error, and its frame and vertex.

    ``points`` are ``(F, V, 3)``, time codes ``(F,)``.
    """
    rounded_points, error, frame, vertex = _kernels.round_points(
        points, meters_per_unit
    )
    # The error of an out-of-range value exceeds any rounding error, so this test
    # suffices.
    if not error < _MAX_ROUNDING_ERROR * meters_per_unit:
        with np.errstate(all="ignore"):
            unit_points = points / meters_per_unit
            float32_points = unit_points.astype(np.float32)
        _refuse_non_finite(unit_points, float32_points, "f", labels, time_codes)
    return rounded_points, error, frame, vertex


def rounded_outwards(bounds: FloatArray) -> Float32Array:
    """Return bounds ``(2, 3)`` as float32, rounded so that no point is outside."""
    infinities = np.array([[-np.inf], [np.inf]], np.float32)
    return np.asarray(np.nextafter(bounds.astype(np.float32), infinities), np.float32)


def check_rows(
    rows: npt.NDArray[Any], type_code: str, labels: ValueLabels, time_codes: FloatArray
) -> None:
    """Raise `OutputError` if an attribute's type cannot store a value (USD170).

    ``rows`` are ``(F, …)``, time codes ``(F,)``.
    """
    if not np.isfinite(time_codes).all():
        raise _value_error(labels, "a time code is not finite")
    if rows.size and not _is_in_range(rows, _TYPE_LIMITS[type_code]):
        _refuse_non_finite(rows, rows, type_code, labels, time_codes)


def check_value(
    value: Any, type_code: str, labels: ValueLabels, time_code: float | None = None
) -> None:
    """Raise `OutputError` if an attribute's type cannot store a value (USD170).

    ``time_code`` None is the default.
    """
    floats = float_array(value)
    if (
        floats is None
        or not floats.size
        or _is_in_range(floats, _TYPE_LIMITS[type_code])
    ):
        return
    time_codes = None if time_code is None else np.array([time_code])
    rows = floats if time_code is None else floats[None]
    _refuse_non_finite(rows, rows, type_code, labels, time_codes)


def check_finite_metadata(value: object, name: str) -> None:
    """Raise `OutputError` if metadata contains a non-finite number (USD170)."""
    if isinstance(value, Mapping):
        for key, item in value.items():
            check_finite_metadata(item, f"{name}:{key}")
    elif isinstance(value, float):
        check_value(value, "d", ValueLabels(name))


def float_array(value: Any) -> npt.NDArray[Any] | None:
    """Return the floating-point numbers of a value as an array, or None."""
    if hasattr(value, "imaginary"):
        value = [*value.imaginary, value.real]
    elif hasattr(value, "GetValue"):
        value = value.GetValue()
    array = np.asarray(value)
    return array if array.dtype.kind == "f" else None


def all_rows_equal(rows: npt.NDArray[Any], row: npt.NDArray[Any]) -> bool:
    """Return whether finite rows ``(F, …)`` all equal a row ``(…)``."""
    # Comparing as integers is eight times faster than float16, but misses signed zeros.
    if rows.dtype == np.float16:
        bits, row_bits = rows.view(np.uint16), row.view(np.uint16)
        if (bits == row_bits).all():
            return True
    return bool((rows == row).all())


def _is_in_range(values: npt.NDArray[Any], limit: float) -> bool:
    if values.dtype == np.float16:
        return bool((values.view(np.uint16) & _HALF_MAGNITUDE).max() <= _HALF_LIMIT)
    # min and max propagate NaN, which fails both comparisons.
    return bool(-limit <= values.min() and values.max() <= limit)


def _refuse_non_finite(
    values: npt.NDArray[Any],
    narrowed_values: npt.NDArray[Any],
    type_code: str,
    labels: ValueLabels,
    time_codes: FloatArray | None,
) -> None:
    """Raise an error for the first value that would not be finite in the file."""
    limit = _TYPE_LIMITS[type_code]
    indices = np.argwhere(~(np.abs(narrowed_values) <= limit))
    if not len(indices):
        return
    index = tuple(indices[0].tolist())
    value = float(values[index])
    element_index = index if time_codes is None else index[1:]
    at_frame = "" if time_codes is None else f" at frame {time_codes[index[0]]:.10g}"
    range_text = f"{_TYPE_NAMES[type_code]} can hold finite numbers up to {limit:.6g}"
    raise _value_error(
        labels, f"{labels.label(element_index)}{at_frame} is {value:.6g}; {range_text}"
    )


def _value_error(labels: ValueLabels, message: str) -> OutputError:
    hint = "nothing is written: check the numbers and units of the source"
    return OutputError(Fault("USD170", message, hint=hint, where=labels.attribute))

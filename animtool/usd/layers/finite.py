"""Guards USD output: values that USD cannot hold as finite numbers are refused.

Attributes are float16, float32 or float64. A number beyond the range of its type
becomes infinite in the file without a word, so each is checked before it is written.
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

# Largest finite number of each type, by the letter that ends names of USD's types.
_LIMITS = {
    letter: float(np.finfo(dtype).max)
    for letter, dtype in (("h", np.float16), ("f", np.float32), ("d", np.float64))
}
_NAMES = {"h": "float16", "f": "float32", "d": "float64"}
_SCALARS = {"GfHalf": "h", "float": "f", "double": "d", "GfTimeCode": "d"}
# Half of the distance of the largest float32 from the one below: what is within the
# range is rounded by no more than this along an axis.
_MAX_ROUNDED = 2.0**103


@dataclass(frozen=True, slots=True)
class Labels:
    """Names of an attribute's values, for messages."""

    attribute: str  # its name or path
    of: str = ""  # what has the value, such as ``joint``
    names: Sequence[str] = ()  # of those, where they have names

    def at(self, index: Sequence[int]) -> str:
        """Return the name of one value."""
        if not index or not self.of:
            return self.of or "a value"
        first = index[0]
        name = repr(self.names[first]) if first < len(self.names) else str(first)
        return f"{self.of} {name}"


@cache
def largest(type_name: Any) -> str:
    """Return the float kind of one of ``Sdf.ValueTypeNames``: h, f, d; else empty."""
    name = str(type_name.scalarType.cppTypeName)
    if name in _SCALARS:
        return _SCALARS[name]
    return name[-1] if name.startswith("Gf") and name[-1] in _LIMITS else ""


def narrowed(
    values: FloatArray,
    letter: str,
    labels: Labels,
    codes: FloatArray | None = None,
) -> npt.NDArray[Any]:
    """Return values as float16 (``h``) or float32 (``f``).

    values: ``(F, N, …)``, or ``(N, …)`` without codes; codes: time codes ``(F,)``.
    """
    dtype = np.float16 if letter == "h" else np.float32
    with np.errstate(over="ignore"):
        narrow = values.astype(dtype)
    if narrow.size and not _within(narrow, _LIMITS[letter]):
        _refuse(values, narrow, letter, labels, codes)
    return narrow


def rounded(
    points: FloatArray, unit: float, labels: Labels, codes: FloatArray
) -> tuple[Float32Array, float, int, int]:
    """Return points as `_kernels.round_points` does.

    points: ``(F, V, 3)``; codes: time codes ``(F,)``.
    """
    rounded_points, error, frame, vertex = _kernels.round_points(points, unit)
    # Beyond the range the error is larger than any rounding, so nothing more is read.
    if not error < _MAX_ROUNDED * unit:
        with np.errstate(all="ignore"):
            scaled = points / unit
            narrow = scaled.astype(np.float32)
        _refuse(scaled, narrow, "f", labels, codes)
    return rounded_points, error, frame, vertex


def check_rows(
    rows: npt.NDArray[Any], letter: str, labels: Labels, codes: FloatArray
) -> None:
    """Raise `OutputError` where an attribute's type does not hold a value (USD170).

    rows: ``(F, …)``; codes: time codes ``(F,)``.
    """
    if not np.isfinite(codes).all():
        raise _error(labels, "a time code is not finite")
    if rows.size and not _within(rows, _LIMITS[letter]):
        _refuse(rows, rows, letter, labels, codes)


def check_value(
    value: Any, letter: str, labels: Labels, code: float | None = None
) -> None:
    """Raise `OutputError` where an attribute's type does not hold a value (USD170).

    code: time code; None is the default.
    """
    numbers = floats_of(value)
    if numbers is None or not numbers.size or _within(numbers, _LIMITS[letter]):
        return
    codes = None if code is None else np.array([code])
    rows = numbers if code is None else numbers[None]
    _refuse(rows, rows, letter, labels, codes)


def check_data(value: object, name: str) -> None:
    """Raise `OutputError` where metadata hold a number that is not finite (USD170)."""
    if isinstance(value, Mapping):
        for key, item in value.items():
            check_data(item, f"{name}:{key}")
    elif isinstance(value, float):
        check_value(value, "d", Labels(name))


def floats_of(value: Any) -> npt.NDArray[Any] | None:
    """Return the floats of a value; None if it has none."""
    if hasattr(value, "imaginary"):
        value = [*value.imaginary, value.real]
    elif hasattr(value, "GetValue"):
        value = value.GetValue()
    array = np.asarray(value)
    return array if array.dtype.kind == "f" else None


def _within(values: npt.NDArray[Any], limit: float) -> bool:
    # NaN comes through both, and through neither comparison.
    return bool(-limit <= values.min() and values.max() <= limit)


def _refuse(
    values: npt.NDArray[Any],
    narrow: npt.NDArray[Any],
    letter: str,
    labels: Labels,
    codes: FloatArray | None,
) -> None:
    """Raise an error that names the first value not finite in the file, if any."""
    limit = _LIMITS[letter]
    bad = np.argwhere(~(np.abs(narrow) <= limit))
    if not len(bad):
        return
    index = tuple(bad[0].tolist())
    value = float(values[index])
    rest = index if codes is None else index[1:]
    when = "" if codes is None else f" at frame {codes[index[0]]:.10g}"
    allowed = f"{_NAMES[letter]} can hold finite numbers up to {limit:.6g}"
    raise _error(labels, f"{labels.at(rest)}{when} is {value:.6g}; {allowed}")


def _error(labels: Labels, message: str) -> OutputError:
    hint = "nothing is written: check the numbers and units of the source"
    return OutputError(Fault("USD170", message, hint=hint, where=labels.attribute))

"""Values of attributes, whatever their type in the file is."""

from __future__ import annotations

from collections.abc import Sized
from typing import Any

import numpy as np
from pxr import Usd

from animtool._types import FloatArray, IntArray


def array_value(attr: Any, time: Any = None) -> Any:
    """Return an attribute's array; an empty one where it has none, or no array.

    Without a time, that is the default, else the first sample.
    """
    value = attr.Get() if time is None else attr.Get(time)
    if value is None and time is None:
        value = attr.Get(Usd.TimeCode.EarliestTime())
    return array_of(value)


def array_of(value: Any) -> Any:
    """Return a value that is an array; an empty one where it is none."""
    return value if isinstance(value, Sized) and not isinstance(value, str) else ()


def numbers(attr: Any, width: int, time: Any = None) -> FloatArray:
    """Return an attribute's rows ``(N, width)``; none where it has another type."""
    return numbers_of(array_value(attr, time), width)


def numbers_of(value: Any, width: int) -> FloatArray:
    """Return the rows of an array ``(N, width)``; none where it has another type."""
    value = array_of(value)
    found = np.array(value)
    if found.dtype.kind not in "fiu" or found.size != len(value) * width:
        return np.zeros((0, width))
    return found.astype(np.float64).reshape(-1, width)


def integers(attr: Any, time: Any = None) -> IntArray:
    """Return an attribute's integers ``(N,)``; none where it has another type."""
    found = np.array(array_value(attr, time))
    if found.dtype.kind not in "iu" or found.ndim != 1:
        return np.zeros(0, np.int64)
    return found.astype(np.int64)


def stored_data(prim: Any) -> dict[str, Any]:
    """Return what ``animtool`` in a prim's customData holds, if it is a dictionary."""
    data = prim.GetCustomDataByKey("animtool")
    return data if isinstance(data, dict) else {}

"""Columnar storage of keys that have only time and value."""

from __future__ import annotations

from collections.abc import Callable
from itertools import chain
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.record import dataclass
from animtool.documents.fields import MAX_NUMBER

_NUMBERS = {int, float}
_PLAIN_KEYS = {"t", "v"}


@dataclass(frozen=True, slots=True, eq=False)
class PlainKeys:
    """K keys of D components without interpolation settings."""

    times: FloatArray  # key times ``(K,)`` [frames]
    values: FloatArray  # key values ``(K, D)``, in the units of the file
    name: str = ""  # reference to their array; empty for key lists

    def __len__(self) -> int:
        """Return the number of keys."""
        return len(self.times)

    @staticmethod
    def from_entries(entries: Any) -> PlainKeys | None:
        """Return keys as columns; None if one is invalid or has more than `t` and `v`.

        >>> keys = PlainKeys.from_entries([{"t": 1, "v": [0.5, 2]}])
        >>> keys.values.tolist()
        [[0.5, 2.0]]
        >>> PlainKeys.from_entries([{"t": 1, "v": 0.5, "out": "flat"}]) is None
        True
        """
        if entries.__class__ is not list or not entries:
            return None
        if not all(e.__class__ is dict and e.keys() == _PLAIN_KEYS for e in entries):
            return None
        times = [entry["t"] for entry in entries]
        values = [entry["v"] for entry in entries]
        component_count = 1
        if all(value.__class__ is list for value in values):
            component_count = len(values[0])
            if not component_count or any(len(v) != component_count for v in values):
                return None
            values = list(chain.from_iterable(values))
        if not {number.__class__ for number in (*times, *values)} <= _NUMBERS:
            return None
        try:
            value_rows = np.array(values, np.float64).reshape(-1, component_count)
            return PlainKeys.from_arrays(np.array(times, np.float64), value_rows)
        except OverflowError:
            return None

    @staticmethod
    def from_arrays(times: FloatArray, values: FloatArray) -> PlainKeys | None:
        """Return keys from arrays; None if a number exceeds the file limits."""
        is_valid = (np.abs(times) <= MAX_NUMBER).all()
        is_valid &= (np.abs(values) <= MAX_NUMBER).all()
        return PlainKeys(times, values) if is_valid else None

    def entries(self) -> list[dict[str, Any]]:
        """Return the keys as mappings, as in a file."""
        values = self.values[:, 0] if self.values.shape[1] == 1 else self.values
        time_value_pairs = zip(self.times.tolist(), values.tolist(), strict=True)
        return [{"t": time, "v": value} for time, value in time_value_pairs]


def plain_keys_or_check(entries: Any, check: Callable[[Any], Any]) -> Any:
    """Return keys of only time and value as columns, else the result of ``check``."""
    keys = PlainKeys.from_entries(entries)
    return check(entries) if keys is None else keys

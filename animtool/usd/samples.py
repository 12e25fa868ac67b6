"""Samples of an attribute over time, a default alone while nothing changes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from animtool._types import FloatArray
from animtool.maths import so3
from animtool.usd.finite import Labels, check_rows, check_value, largest
from animtool.usd.layers import attribute


class Samples:
    """An attribute's samples; a default only, while the values do not change.

    The frames before the first change share one array, as copies of it would. Signs of
    quaternions ``(F, …, 4)`` continue from frame to frame and from block to block:
    every rotation over time is written here.

    sampled: whether they changed, or are sampled all the same.
    """

    def __init__(
        self,
        spec: Any,
        name: str,
        type_name: Any,
        make: Callable[[Any], Any],
        *,
        interpolation: str = "",
        quaternions: bool = False,
        of: str = "",
        names: Sequence[str] = (),
    ) -> None:
        self._attribute = attribute(spec, name, type_name, interpolation=interpolation)
        self._path = self._attribute.path
        self._set = spec.layer.SetTimeSample
        self._make = make
        self._letter = largest(type_name)
        self._labels = Labels(str(self._path), of, names)
        self._first: npt.NDArray[Any] | None = None
        self._quaternions = quaternions
        self._last: npt.NDArray[Any] | None = None
        self._held: list[FloatArray] = []
        self.sampled = False

    def add(self, codes: FloatArray, rows: npt.NDArray[Any]) -> None:
        """Add frames of values ``(F, …)``."""
        rows = np.ascontiguousarray(self._continued(rows))
        if self._letter:
            check_rows(rows, self._letter, self._labels, codes)
        if self._first is None:
            self._first = rows[0].copy()
        if not self.sampled:
            if (rows == self._first).all():
                self._held.append(codes)
                return
            self.release()
        put, path, make = self._set, self._path, self._make
        for code, row in zip(codes.tolist(), rows, strict=True):
            put(path, code, make(row))

    def _continued(self, rows: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Return rows, quaternions with signs that continue those added before."""
        if not self._quaternions or not rows.size:
            return rows
        last = rows[0] if self._last is None else self._last
        rows = so3.align_signs(rows, last).astype(rows.dtype)
        self._last = rows[-1]
        return rows

    def release(self) -> None:
        """Sample from the first frame on, whether anything changes or not."""
        if self.sampled:
            return
        self.sampled = True
        value = self._make(self._first)
        for codes in self._held:
            for code in codes.tolist():
                self._set(self._path, code, value)
        self._held.clear()

    def rest(self) -> None:
        """Author the first value as the default too, where there are samples.

        Readers that ask at no time find it.
        """
        if self.sampled and self._first is not None:
            self._attribute.default = self._make(self._first)

    def finish(self, otherwise: npt.NDArray[Any]) -> None:
        """Author the default of values that never changed, or never came."""
        if not self.sampled:
            first = otherwise if self._first is None else self._first
            value = self._make(first)
            if self._letter:
                check_value(value, self._letter, self._labels)
            self._attribute.default = value

"""What writes one prim of what is simulated, frame by frame."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar

import numpy as np

from animtool._types import Float32Array, FloatArray
from animtool.usd.finite import Labels, check_value, largest, rounded
from animtool.usd.point_cache import CachedMesh


class PrimWriter(ABC):
    """Writes a prim: once what it is, then each frame of it.

    Attributes:
        report: What was written so far.
        of: What each value of an array is of, for messages.

    Args:
        path: Of the prim.
        meters_per_unit: Unit of the layer [m].
    """

    of: ClassVar[str] = "point"

    def __init__(self, path: str, meters_per_unit: float) -> None:
        self.report = CachedMesh(path)
        self.unit = meters_per_unit
        self._last: dict[str, Any] = {}
        self._letters: dict[str, str] = {}

    @abstractmethod
    def begin(self, layer: Any, row: Any) -> None:
        """Write the prim, with attributes and what no frame changes.

        Args:
            layer: Where to.
            row: The first frame.
        """

    @abstractmethod
    def add(self, layer: Any, code: float, row: Any) -> None:
        """Write a frame.

        Args:
            layer: It has the prim.
            code: Time code.
            row: What there is then.
        """

    def put(self, layer: Any, code: float, name: str, value: Any) -> None:
        """Write the value of an attribute at a time code; the first is its default.

        Raises:
            OutputError: USD holds it as no finite number (USD170).
        """
        path = f"{self.report.path}.{name}"
        if name not in self._last:
            spec = layer.GetAttributeAtPath(path)
            self._letters[name] = largest(spec.typeName)
            spec.default = value
        if letter := self._letters[name]:
            check_value(value, letter, Labels(path, self.of), code)
        self._last[name] = value
        layer.SetTimeSample(path, code, value)

    def rounded(
        self, name: str, values: FloatArray, code: float
    ) -> tuple[Float32Array, float, int, int]:
        """Return the values of a frame as `animtool.usd.finite.rounded` does.

        Args:
            name: Of their attribute.
            values: ``(N, 3)`` [m], or [m/s].
            code: Time code.
        """
        labels = Labels(f"{self.report.path}.{name}", self.of)
        return rounded(values[None], self.unit, labels, np.array([code]))

    def repeat(self, layer: Any, code: float) -> None:
        """Write the last frame into another layer too, which is not counted."""
        for name, value in self._last.items():
            self.put(layer, code, name, value)

    def count(self, code: float, error: float, vertex: int, size: int) -> None:
        """Count a frame.

        Args:
            code: Time code.
            error: Largest distance that rounding moved a point [m].
            vertex: That point.
            size: Of its values in memory [byte].
        """
        report = self.report
        report.samples += 1
        report.bytes += size
        if error > report.error:
            report.error, report.error_code, report.error_vertex = error, code, vertex

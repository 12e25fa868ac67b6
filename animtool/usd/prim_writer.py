"""What writes one prim of what is simulated, frame by frame."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

from animtool.usd.point_cache import CachedMesh

__all__ = ["PrimWriter"]


class PrimWriter(ABC):
    """Writes a prim: once what it is, then each frame of it.

    Attributes:
        report: What was written so far.

    Args:
        path: Of the prim.
        meters_per_unit: Unit of the layer [m].
    """

    def __init__(self, path: str, meters_per_unit: float) -> None:
        self.report = CachedMesh(path)
        self.unit = meters_per_unit
        self._last: dict[str, Any] = {}

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
        """Write the value of an attribute at a time code; the first is its default."""
        path = f"{self.report.path}.{name}"
        if name not in self._last:
            layer.GetAttributeAtPath(path).default = value
        self._last[name] = value
        layer.SetTimeSample(path, code, value)

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

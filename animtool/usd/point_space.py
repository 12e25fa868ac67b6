"""The space that cached points are in."""

from __future__ import annotations

from dataclasses import dataclass

from animtool._types import FloatArray


@dataclass(frozen=True, slots=True)
class PointSpace:
    """Where the points of a mesh are written.

    Attributes:
        placement: Mesh from skeleton space, in the layer's unit ``(4, 4)``; None where
            these are the same.
        margin: How far what is drawn reaches beyond the points, in the layer's unit:
            half the width of curves.
    """

    placement: FloatArray | None = None
    margin: float = 0.0

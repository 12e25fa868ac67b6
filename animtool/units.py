"""Length units and up axes of files, and the way between them and metres."""

from __future__ import annotations

import math
from enum import StrEnum

__all__ = ["LengthUnit", "UpAxis", "unit_name", "up_from_up"]


class LengthUnit(StrEnum):
    """A unit that a file may be declared to be in."""

    M = "m"
    CM = "cm"
    MM = "mm"
    IN = "in"

    @property
    def meters(self) -> float:
        """Length of one unit [m]."""
        return {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}[self.value]


class UpAxis(StrEnum):
    """The axis that points away from the ground."""

    Y = "Y"
    Z = "Z"


def unit_name(meters: float) -> str:
    """Return what a unit of this length is called.

    >>> unit_name(0.01), unit_name(0.3048)
    ('cm', '0.3048 m')
    """
    for unit in LengthUnit:
        # Stage metadata is often a float32 widened to a double.
        if math.isclose(unit.meters, meters, rel_tol=1e-6):
            return unit.value
    return f"{meters:g} m"


def up_from_up(
    target: UpAxis, source: UpAxis
) -> tuple[float, float, float, float] | None:
    """Return the rotation (x, y, z, w) that stands a source-up world target-up.

    A quarter turn about X; None where both are the same.

    >>> up_from_up(UpAxis.Y, UpAxis.Y) is None
    True
    """
    if target is source:
        return None
    half = math.sqrt(0.5)
    return (half if target is UpAxis.Z else -half, 0.0, 0.0, half)

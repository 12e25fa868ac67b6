"""Length units and up axes of files, and their conversion."""

from __future__ import annotations

import itertools
import math
import re
from enum import StrEnum


class LengthUnit(StrEnum):
    """A length unit that a file may declare."""

    M = "m"
    CM = "cm"
    MM = "mm"
    IN = "in"

    @property
    def meters(self) -> float:
        """Length of one unit [m]."""
        return {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}[self.value]


class UpAxis(StrEnum):
    """The axis that points up in a file: Y or Z."""

    Y = "Y"
    Z = "Z"

    @property
    def vector(self) -> tuple[float, float, float]:
        """Unit vector of the up axis."""
        return (0.0, 0.0, 1.0) if self is UpAxis.Z else (0.0, 1.0, 0.0)


def likely_unit(
    size: float, unit: LengthUnit, typical_size: float
) -> tuple[LengthUnit, float]:
    """Return the unit in which a size is closest to a typical one, and that size [m].

    ``size`` [m] was read with its numbers in ``unit``; it must not be 0.

    >>> likely_unit(2000.0, LengthUnit.M, 1.0)
    (<LengthUnit.MM: 'mm'>, 2.0)
    """
    sizes = {other: size * other.meters / unit.meters for other in LengthUnit}
    likely = min(sizes, key=lambda other: abs(math.log(sizes[other] / typical_size)))
    return likely, sizes[likely]


def confused_units(ratio: float) -> tuple[LengthUnit, LengthUnit]:
    """Return the true unit and the wrongly assumed unit that best explain a size ratio.

    ``ratio`` is the size in the assumed unit over the true size.

    >>> [unit.value for unit in confused_units(857.0)]
    ['mm', 'm']
    """
    return min(
        itertools.permutations(LengthUnit, 2),
        key=lambda pair: abs(math.log(ratio * pair[0].meters / pair[1].meters)),
    )


def unit_name(meters: float) -> str:
    """Return the name of the unit that has a length [m], or the length itself.

    >>> unit_name(0.01), unit_name(0.3048)
    ('cm', '0.3048 m')
    """
    for unit in LengthUnit:
        # Stage metadata is often a float32 widened to a double.
        if math.isclose(unit.meters, meters, rel_tol=1e-6):
            return unit.value
    return f"{meters:g} m"


_LENGTH_PATTERN = re.compile(r"([0-9.eE+-]+)\s*(m|cm|mm|in)?")


def parse_length(text: str) -> float:
    """Return a positive length [m] such as ``0.5mm``.

    >>> parse_length("0.5mm")
    0.0005
    """
    match = _LENGTH_PATTERN.fullmatch(text.strip())
    try:
        value = float(match[1]) if match else math.nan
    except ValueError:
        value = math.nan
    if match is None or not math.isfinite(value):
        raise ValueError(f"{text!r} is not a length such as 0.5mm")
    if value <= 0:
        raise ValueError(f"{text!r} is not a length above 0, such as 0.5mm")
    if match[2] is None:
        raise ValueError(f"{text!r} has no unit: write {match[1]}mm or {match[1]}m")
    return value * LengthUnit(match[2]).meters


def up_from_up(
    target: UpAxis, source: UpAxis
) -> tuple[float, float, float, float] | None:
    """Return the rotation (x, y, z, w) from one up axis to another.

    A rotation of 90 degrees about X; None if both axes are equal.

    >>> up_from_up(UpAxis.Y, UpAxis.Y) is None
    True
    """
    if target is source:
        return None
    sine = math.sqrt(0.5)
    return (sine if target is UpAxis.Z else -sine, 0.0, 0.0, sine)

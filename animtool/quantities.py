"""Lengths, durations and sizes as reports print them: plain numbers with units."""

from __future__ import annotations

import math

# Least number that a unit is used for, the unit, and its name.
_LENGTHS = (
    (1.0, 1.0, "m"),
    (1e-6, 1e-3, "mm"),
    (1e-9, 1e-6, "µm"),
    (0.0, 1e-9, "nm"),
)
# Shorter lengths are what rounding in float64 leaves [m].
LEAST_LENGTH = 1e-12
# Smaller angles are what rounding in float64 leaves [deg].
LEAST_ANGLE = 1e-6
_DURATIONS = ((1.0, 1.0, "s"), (1e-3, 1e-3, "ms"), (0.0, 1e-6, "µs"))
_SIZES = ((1e9, 1e9, "GB"), (1e6, 1e6, "MB"), (1e3, 1e3, "kB"), (0.0, 1.0, "B"))


def plain(value: float, digits: int = 3) -> str:
    """Return a number of so many significant digits, without an exponent.

    >>> plain(1614.2), plain(0.000267), plain(26.2), plain(0.0)
    ('1610', '0.000267', '26.2', '0')
    """
    if not math.isfinite(value):
        return f"{value:g}"
    text = f"{value:.{digits}g}"
    if "e" not in text:
        return text
    rounded, exponent = float(text), int(text.partition("e")[2])
    decimals = max(0, digits - 1 - exponent)
    text = f"{rounded:.{decimals}f}"
    return text.rstrip("0").rstrip(".") if decimals else text


def length_text(meters: float, digits: int = 3) -> str:
    """Return a length in metres, or in millimetres or less where it is shorter.

    >>> length_text(26.2), length_text(0.00012), length_text(4.1e-8), length_text(0)
    ('26.2 m', '0.12 mm', '0.041 µm', '0 mm')
    """
    if 0 < abs(meters) < LEAST_LENGTH:
        return "below 0.001 nm"
    return _text(meters, _LENGTHS, "mm", digits)


def angle_text(degrees: float, digits: int = 3) -> str:
    """Return an angle in degrees.

    >>> angle_text(26.25, 4), angle_text(0.000267), angle_text(8.8e-13), angle_text(0)
    ('26.25°', '0.000267°', 'below 0.000001°', '0°')
    """
    if 0 < abs(degrees) < LEAST_ANGLE:
        return f"below {plain(LEAST_ANGLE)}°"
    return f"{plain(degrees, digits)}°"


def duration_text(seconds: float, digits: int = 3) -> str:
    """Return a duration in seconds, milliseconds or microseconds.

    >>> duration_text(1.61e-3), duration_text(72.4), duration_text(3e-5)
    ('1.61 ms', '72.4 s', '30 µs')
    """
    return _text(seconds, _DURATIONS, "s", digits)


def size_text(size: float, digits: int = 3) -> str:
    """Return a size in bytes, kB, MB or GB.

    >>> size_text(5160), size_text(20)
    ('5.16 kB', '20 B')
    """
    return _text(size, _SIZES, "B", digits)


def _text(
    value: float,
    units: tuple[tuple[float, float, str], ...],
    zero: str,
    digits: int,
) -> str:
    if not value:
        return f"0 {zero}"
    _, unit, name = next(entry for entry in units if abs(value) >= entry[0])
    return f"{plain(value / unit, digits)} {name}"

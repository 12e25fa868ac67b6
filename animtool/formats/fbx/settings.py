"""Reads FBX global settings: axes, unit and frame rate."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import excerpt
from animtool.core.rates import parse_rate
from animtool.core.record import dataclass
from animtool.core.units import UpAxis
from animtool.formats.fbx.elements import Element
from animtool.formats.fbx.objects import FbxFile, read_scalar

# Ticks per second; files with another tick are converted by `convert_new_ticks`.
TICKS_PER_SECOND = 46_186_158_000
# Ticks per second of files whose TCDefinition is 0, which FBX 2019.5 introduced.
_NEW_TICKS_PER_SECOND = 141_120_000
# Values of TCDefinition: 127 is `TICKS_PER_SECOND`.
_NEW_TICK_DEFINITION, _OLD_TICK_DEFINITION = 0, 127
# Frame rate by TimeMode, as numbered in `FbxTime::EMode`.
_RATES = {
    0: Fraction(30),
    1: Fraction(120),
    2: Fraction(100),
    3: Fraction(60),
    4: Fraction(50),
    5: Fraction(48),
    6: Fraction(30),
    7: Fraction(30),
    8: Fraction(30000, 1001),
    9: Fraction(30000, 1001),
    10: Fraction(25),
    11: Fraction(24),
    12: Fraction(1000),
    13: Fraction(24000, 1001),
    15: Fraction(96),
    16: Fraction(72),
    17: Fraction(60000, 1001),
    18: Fraction(120000, 1001),
}
CUSTOM_TIME_MODE = 14


@dataclass(frozen=True, slots=True, eq=False)
class FbxSettings:
    """Length unit, axes and time mode of a file."""

    meters: float  # size of the file's length unit [m]
    up: UpAxis  # up axis after the roots are rotated by `basis`
    basis: FloatArray  # rotation of the roots ``(3, 3)``
    fps: Fraction  # frames per second


def read_settings(file: FbxFile, up: UpAxis | None) -> FbxSettings:
    """Return the global settings of a file.

    ``up`` is the up axis of the file; None is the stated axis.
    """
    diagnostics, settings = file.diagnostics, file.settings
    unit_factor = read_scalar(settings, "UnitScaleFactor", 1.0, diagnostics)
    if not 1e-9 <= unit_factor <= 1e12:
        message = f"UnitScaleFactor is {unit_factor:g}, and must be positive"
        diagnostics.fail("FBX005", settings.element.location, message)
    up_and_basis = (up, np.eye(3)) if up is not None else _read_axes(file)
    return FbxSettings(unit_factor / 100.0, *up_and_basis, _read_rate(file))


def has_new_ticks(file: FbxFile) -> bool:
    """Return whether a file counts 141,120,000 ticks per second."""
    header = file.root.find("FBXHeaderExtension")
    flags_element = None if header is None else header.find("OtherFlags")
    element = None if flags_element is None else flags_element.find("TCDefinition")
    if element is None or not element.values:
        return False
    tick_definition = element.values[0]
    if tick_definition not in {_NEW_TICK_DEFINITION, _OLD_TICK_DEFINITION}:
        message = f"unknown TCDefinition {excerpt(str(tick_definition))}: using "
        message += str(_OLD_TICK_DEFINITION)
        file.diagnostics.warn("FBX106", element.location, message)
    return bool(tick_definition == _NEW_TICK_DEFINITION)


def convert_new_ticks(times: IntArray) -> IntArray:
    """Convert times with 141,120,000 ticks per second to `TICKS_PER_SECOND`, rounded.

    Extreme times are clamped, so that they stay out of the valid range.

    >>> ticks = convert_new_ticks(np.array([-141_120_000, 5_880_000]))
    >>> (ticks / TICKS_PER_SECOND).tolist()
    [-1.0, 0.041666666666666664]
    """
    ratio = Fraction(TICKS_PER_SECOND, _NEW_TICKS_PER_SECOND)
    limit = 2**62 // (ratio.numerator // ratio.denominator + 1)
    quotient, remainder = np.divmod(np.clip(times, -limit, limit), ratio.denominator)
    rounding = ratio.denominator // 2
    fraction_ticks = (remainder * ratio.numerator + rounding) // ratio.denominator
    return np.asarray(quotient * ratio.numerator + fraction_ticks, np.int64)


def _read_axes(file: FbxFile) -> tuple[UpAxis, FloatArray]:
    """Return the up axis, and the rotation from file axes to it.

    Files with Y or Z up keep their axes if they face the common direction; others are
    rotated to Y up, facing Z.
    """
    axis_rows = []
    for name, axis in (("CoordAxis", 0), ("UpAxis", 1), ("FrontAxis", 2)):
        index = int(read_scalar(file.settings, name, axis, file.diagnostics))
        sign = read_scalar(file.settings, f"{name}Sign", 1.0, file.diagnostics)
        if index not in {0, 1, 2}:
            message = f"{name} is {index}, and must be 0, 1 or 2"
            file.diagnostics.fail("FBX007", file.settings.element.location, message)
        axis_rows.append(np.eye(3)[index] * (-1.0 if sign < 0 else 1.0))
    basis = np.array(axis_rows)
    if np.linalg.det(basis) < 0.5:
        message = "the axes of the file are left-handed, or two are the same"
        file.diagnostics.fail("FBX007", file.settings.element.location, message)
    if (basis == [[1, 0, 0], [0, 0, 1], [0, -1, 0]]).all():
        return UpAxis.Z, np.eye(3)
    return UpAxis.Y, basis


def _read_rate(file: FbxFile) -> Fraction:
    time_mode = int(read_scalar(file.settings, "TimeMode", 0.0, file.diagnostics))
    if time_mode == CUSTOM_TIME_MODE:
        rate = read_scalar(file.settings, "CustomFrameRate", 24.0, file.diagnostics)
        if not 0.01 <= rate <= 100_000:
            message = f"CustomFrameRate is {rate:g}, and must be positive"
            file.diagnostics.fail("FBX005", file.settings.element.location, message)
        return parse_rate(f"{rate:.9g}")
    if "TimeMode" not in file.settings.properties:
        return _read_old_rate(file)
    if time_mode not in _RATES:
        message = f"unknown time mode {time_mode}: using {_RATES[0]} frames per second"
        file.diagnostics.warn("FBX106", file.settings.element.location, message)
    return _RATES.get(time_mode, _RATES[0])


def _read_old_rate(file: FbxFile) -> Fraction:
    """Return the rate stated by files before 7000."""
    element: Element | None = file.root
    for name in ("Version5", "Settings", "FrameRate"):
        element = None if element is None else element.find(name)
    try:
        rate = parse_rate(str(element.values[0])) if element and element.values else 0
    except (ValueError, ArithmeticError):
        rate = 0
    return Fraction(rate if Fraction(1, 100) <= rate <= 100_000 else 24)

"""FBX global settings: axes, unit and frame rate."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.rates import parse_rate
from animtool.core.record import dataclass
from animtool.core.units import UpAxis
from animtool.formats.fbx.elements import Element
from animtool.formats.fbx.objects import FbxFile, scalar

# Ticks per second.
TICKS = 46_186_158_000
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
CUSTOM = 14


@dataclass(frozen=True, slots=True, eq=False)
class FbxSettings:
    """Length unit, axes and time mode of a file.

    Attributes:
        meters: Size of its unit [m].
        up: Up axis after the roots are rotated by `basis`.
        basis: Rotation of the roots ``(3, 3)``.
        fps: Frames per second.
    """

    meters: float
    up: UpAxis
    basis: FloatArray
    fps: Fraction


def read_settings(file: FbxFile, up: UpAxis | None = None) -> FbxSettings:
    """Return the global settings of a file.

    ``up`` is the up axis of the file; None is the stated axis.

    Raises:
        FormatError: Its axes are left-handed or invalid (FBX007), or unit or rate are
            not positive numbers (FBX005).
    """
    notes, settings = file.notes, file.settings
    factor = scalar(settings, "UnitScaleFactor", 1.0, notes)
    if not 1e-9 <= factor <= 1e12:
        message = f"UnitScaleFactor is {factor:g}, and must be positive"
        notes.fail("FBX005", settings.element.where, message)
    up_and_basis = (up, np.eye(3)) if up is not None else _axes(file)
    return FbxSettings(factor / 100.0, *up_and_basis, _rate(file))


def _axes(file: FbxFile) -> tuple[UpAxis, FloatArray]:
    """Return the up axis, and the rotation from file axes to it.

    Files with Y or Z up keep their axes if they face the common direction; others are
    rotated to Y up, facing Z.
    """
    rows = []
    for name, axis in (("CoordAxis", 0), ("UpAxis", 1), ("FrontAxis", 2)):
        index = int(scalar(file.settings, name, axis, file.notes))
        sign = scalar(file.settings, f"{name}Sign", 1.0, file.notes)
        if index not in {0, 1, 2}:
            message = f"{name} is {index}, and must be 0, 1 or 2"
            file.notes.fail("FBX007", file.settings.element.where, message)
        rows.append(np.eye(3)[index] * (-1.0 if sign < 0 else 1.0))
    basis = np.array(rows)
    if np.linalg.det(basis) < 0.5:
        message = "the axes of the file are left-handed, or two are the same"
        file.notes.fail("FBX007", file.settings.element.where, message)
    if (basis == [[1, 0, 0], [0, 0, 1], [0, -1, 0]]).all():
        return UpAxis.Z, np.eye(3)
    return UpAxis.Y, basis


def _rate(file: FbxFile) -> Fraction:
    mode = int(scalar(file.settings, "TimeMode", 0.0, file.notes))
    if mode == CUSTOM:
        rate = scalar(file.settings, "CustomFrameRate", 24.0, file.notes)
        if not 0.01 <= rate <= 100_000:
            message = f"CustomFrameRate is {rate:g}, and must be positive"
            file.notes.fail("FBX005", file.settings.element.where, message)
        return parse_rate(f"{rate:.9g}")
    if "TimeMode" not in file.settings.properties:
        return _old_rate(file)
    if mode not in _RATES:
        message = f"unknown time mode {mode}: using 24 frames per second"
        file.notes.warn("FBX106", file.settings.element.where, message)
    return _RATES.get(mode, _RATES[0])


def _old_rate(file: FbxFile) -> Fraction:
    """Return the rate stated by files before 7000."""
    element: Element | None = file.root
    for name in ("Version5", "Settings", "FrameRate"):
        element = None if element is None else element.find(name)
    try:
        rate = (
            parse_rate(str(element.values[0])) if element and element.values else None
        )
    except (ValueError, ArithmeticError):
        rate = None
    if rate is None or not Fraction(1, 100) <= rate <= 100_000:
        return Fraction(24)
    return rate

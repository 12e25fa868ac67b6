"""Warnings about tolerances of a comparison that hide every difference."""

from __future__ import annotations

import math

from animtool.core.arguments import argument
from animtool.core.errors import Fault, warning
from animtool.core.quantities import length_text, percent_hint

# Default tolerances, which cause no warning [m], [deg], [1].
LENGTH_TOLERANCE, ANGLE_TOLERANCE, WEIGHT_TOLERANCE = 1e-5, 1e-3, 1e-5
# Tolerances above this fraction of the compared size cause a warning.
MAX_TOLERANCE_FRACTION = 0.25
# Largest difference of rotations [deg], and of usual weights [1].
MAX_ROTATION, MAX_TYPICAL_WEIGHT = 180.0, 1.0


def length_warnings(tolerance: float, largest: float, size: float) -> list[Fault]:
    """Warn if a tolerance is a large fraction of the compared size (CLI107).

    Args:
        tolerance: Distance to ignore [m]; infinity ignores all on purpose.
        largest: Largest difference [m].
        size: Size of the compared takes or points [m].
    """
    if not max(MAX_TOLERANCE_FRACTION * size, LENGTH_TOLERANCE) <= tolerance < math.inf:
        return []
    if not LENGTH_TOLERANCE < largest <= tolerance:
        return []
    setting = f"{argument('tolerance')} {length_text(tolerance)}"
    reason = f"all that is compared measures {length_text(size)}"
    hint = f"a number alone is in metres: for millimetres write {tolerance:g}mm"
    return [_hiding_warning(setting, length_text(largest), reason, hint)]


def _hiding_warning(setting: str, largest: str, reason: str, hint: str) -> Fault:
    """Return a warning about a tolerance that hides every difference (CLI107)."""
    message = (
        f"{setting} hides every difference: the largest is {largest}, and {reason}"
    )
    return warning("CLI107", message, hint)


def angle_warnings(tolerance: float, largest: float) -> list[Fault]:
    """Warn if no rotation can exceed a tolerance [deg] (CLI107)."""
    if not (MAX_ROTATION <= tolerance < math.inf and largest > ANGLE_TOLERANCE):
        return []
    setting = f"{argument('angle_tolerance')} {tolerance:g}"
    hint = "use a smaller angle, or inf to ignore rotations"
    reason = "no rotation differs by more than 180°"
    return [_hiding_warning(setting, f"{largest:.3g}°", reason, hint)]


def weight_warnings(tolerance: float, largest: float) -> list[Fault]:
    """Warn if a tolerance hides every difference of weights (CLI107)."""
    if not MAX_TYPICAL_WEIGHT <= tolerance < math.inf:
        return []
    if not WEIGHT_TOLERANCE < largest <= tolerance:
        return []
    setting = f"{argument('weight_tolerance')} {tolerance:g}"
    hint = f"{percent_hint(tolerance)}, or inf to ignore weights"
    return [_hiding_warning(setting, f"{largest:.3g}", "weights are from 0 to 1", hint)]

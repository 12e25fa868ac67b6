"""Warnings about system angles in radians, and quaternions that are not normalized."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from animtool.documents.document import Document, Location
from animtool.rig.suspicions import (
    FULL_REVOLUTION,
    QUARTER_ROUNDING,
    TIGHT_LIMIT,
    are_multiples,
    warn_of_quaternion_length,
)
from animtool.scene.systems.suspicious_times import stated_keys

# Keys of quaternions.
ROTATION_KEYS = {"rotate", "inertia_axes", "rotation"}


def warn_of_radians(
    document: Document, at: Location, values: Mapping[str, Any]
) -> None:
    """Warn of limits, cones and fields of view that seem to be in radians (SIM200).

    Args:
        document: The scene.
        at: Location of the system.
        values: Its stated keys, in degrees.
    """
    for location, key, angle in _cones(at, values):
        message = f"{key} {angle:g} is a cone of {angle:g}°"
        hint = f"for {angle:g} rad write {math.degrees(angle):.3g}"
        document.warn("SIM200", location, message, hint)
    for i, joint in enumerate(values.get("joints") or ()):
        for key in ("limits", "swing", "twist") if isinstance(joint, Mapping) else ():
            numbers = joint.get(key)
            if key == "limits" and joint.get("type") != "pin":
                continue
            angles = numbers if isinstance(numbers, list) else [numbers or 0.0]
            if _look_like_radians(angles):
                location = (*at, "joints", i, key)
                message = f"{key} {_text(numbers, 1.0)} look like radians, but angles "
                message += f"are in degrees: the largest is {max(map(abs, angles)):g}°"
                hint = f"write {_text(numbers, math.degrees(1.0))}, or declare "
                hint += "'units: {angle: rad}' in the scene"
                document.warn("SIM200", location, message, hint)
                return


def warn_of_rotations(
    document: Document, at: Location, values: Mapping[str, Any]
) -> None:
    """Warn once if a quaternion is not of unit length (RIG110)."""
    for location, key, value in stated_keys(at, values):
        if key in ROTATION_KEYS and _is_quaternion(value):
            warn_of_quaternion_length(document, location, value)
        for i, row in enumerate(value if key == "turns" else ()):
            if isinstance(row, list) and _is_quaternion(row[1:]):
                warn_of_quaternion_length(document, (*location, i), row[1:])


def _is_quaternion(value: object) -> bool:
    return (
        isinstance(value, list)
        and len(value) == 4
        and all(isinstance(number, int | float) for number in value)
    )


def _cones(
    at: Location, values: Mapping[str, Any]
) -> Iterator[tuple[Location, str, float]]:
    """Yield cone angles that are plausible in radians, with location and key."""
    for key in ("emitters", "species"):
        for i, entry in enumerate(values.get(key) or ()):
            spread, vision = entry.get("spread"), entry.get("vision") or {}
            # Few integers are radians.
            if isinstance(spread, float) and 0 < spread <= math.pi and spread % 1:
                yield (*at, key, i, "spread"), "spread", spread
            angle = vision.get("angle")
            if isinstance(angle, int | float) and 0 < angle <= math.tau:
                yield (*at, key, i, "vision", "angle"), "vision.angle", angle


def _look_like_radians(angles: Sequence[float]) -> bool:
    largest = max(map(abs, angles))
    quarter = math.pi / 2
    quarters = [round(angle / quarter) * quarter for angle in angles]
    is_multiple = are_multiples(angles).any() or any(
        multiple and abs(angle - multiple) < QUARTER_ROUNDING
        for angle, multiple in zip(angles, quarters, strict=True)
    )
    return TIGHT_LIMIT <= largest <= FULL_REVOLUTION and bool(is_multiple)


def _text(numbers: float | Sequence[float], factor: float) -> str:
    if isinstance(numbers, int | float):
        return f"{numbers * factor:.3g}"
    return f"[{', '.join(f'{number * factor:.3g}' for number in numbers)}]"

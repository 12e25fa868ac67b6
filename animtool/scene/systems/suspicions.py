"""Warnings about systems whose numbers look like another unit."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from animtool.core.quantities import frames_hint, length_text
from animtool.documents.document import Document, Location
from animtool.scene.systems.suspicious_forces import MAX_GRAVITY

# Greater thickness of cloth is implausible [m].
MAX_THICKNESS = 0.5
# Only rubber stretches to twice its length [1].
MAX_STRETCH = 1.0
# Critical damping is 1; a percentage of it is rarely below 4 [1].
MAX_RATIO = 3.0
# A rope is hardly longer, unless it is a cable: a cord of 5 mm weighs as much [m],
# [kg/m].
MAX_ROPE, CABLE = 20.0, 0.02
# Longer than any rope [m], and heavier than a chain of 5 cm [kg/m].
MAX_LENGTH, MAX_LINE = 200.0, 50.0
# Cloth heavier than a sheet of rubber of 2 cm [kg/m²].
MAX_SHEET = 25.0
# Denser than the densest metal, 22 600 [kg/m³].
MAX_DENSITY = 30000.0
# Lighter than foam, so grams per cm³ are meant [kg/m³].
MIN_DENSITY = 10.0
# Rubber on rubber has 1.5, and gears mesh [1].
MAX_FRICTION = 5.0
GRAMS = 1000.0
# Keys of durations, and a whole number of seconds that may be one of frames [s].
DURATION_KEYS = {"preroll", "emitters"}
MIN_LONG = 20.0


def warn_of_durations(
    document: Document,
    at: Location,
    values: Mapping[str, Any],
    rate: float,
    length: float,
) -> None:
    """Warn of durations that seem to be in frames, and cones in radians (SIM200).

    Args:
        document: The scene.
        at: Location of the system.
        values: Its stated keys among `DURATION_KEYS`.
        rate: Frames per second of the scene.
        length: Time from its first to its last frame; 0 if unknown [s].
    """
    durations = [((*at, "preroll"), "preroll", values.get("preroll"))]
    for i, emitter in enumerate(values.get("emitters") or ()):
        location = (*at, "emitters", i)
        durations += [((*location, "lifetime"), "lifetime", emitter.get("lifetime"))]
        _warn_of_cone(document, (*location, "spread"), emitter.get("spread"))
    for location, key, seconds in durations:
        if not isinstance(seconds, int | float) or seconds < max(MIN_LONG, length):
            continue
        if hint := frames_hint(seconds, rate):
            message = f"{key} {seconds:g} is {seconds:g} s"
            message += f", and the scene has {length:.3g} s" if length else ""
            document.warn("SIM200", location, message, hint)


def _warn_of_cone(document: Document, at: Location, spread: object) -> None:
    """Warn of a cone whose angle is a fraction in the range of radians."""
    if isinstance(spread, float) and 0 < spread <= math.pi and spread % 1:
        message = f"spread {spread:g} is a cone of {spread:g}°"
        hint = f"for {spread:g} rad write {math.degrees(spread):.3g}"
        document.warn("SIM200", at, message, hint)


def warn_of_sizes(document: Document, at: Location, values: Mapping[str, Any]) -> None:
    """Warn of lengths, masses, densities and accelerations in other units (SIM200)."""
    _warn_of_ratio(document, at, values)
    _warn_of_forces(document, at, values)
    for i, body in enumerate(values.get("bodies") or ()):
        _warn_of_body(document, (*at, "bodies", i), body)
    is_rope = values.get("start") and values.get("end")
    if is_rope and _warn_of_rope(document, at, values):
        return  # all its lengths are in another unit
    if values.get("across") and values.get("up"):
        _warn_of_sheet(document, at, values)
    contact = values.get("self_contact")
    if isinstance(contact, Mapping):
        _warn_of_length(document, (*at, "self_contact"), "thickness", contact)
    _warn_of_length(document, at, "thickness", values)
    _warn_of_length(document, at, "radius", values)
    stretch = values.get("stretch")
    if isinstance(stretch, int | float) and stretch >= MAX_STRETCH:
        message = f"stretch {stretch:g} allows springs {1 + stretch:g} times as long"
        hint = f"for {stretch:g}% write {stretch / 100:g}"
        document.warn("SIM200", (*at, "stretch"), message, hint)


def _warn_of_length(
    document: Document, at: Location, key: str, values: Mapping[str, Any]
) -> None:
    for length in _metres(values.get(key)):
        message = f"{key} {length:g} makes the surface {length_text(2 * length)} thick"
        if key == "thickness":
            message = f"thickness {length:g} is {length_text(length)}, in metres"
        hint = f"for {length:g} mm write {length / 1000:g}"
        document.warn("SIM200", (*at, key), message, hint)


def _metres(value: object) -> Iterator[float]:
    """Yield a length without a unit, if it is implausible [m]."""
    if isinstance(value, int | float) and value >= MAX_THICKNESS:
        yield float(value)


def _warn_of_ratio(document: Document, at: Location, values: Mapping[str, Any]) -> None:
    families = {k: v for k, v in (values.get("springs") or {}).items() if v}
    for key, family in {"": values, **families}.items():
        ratio = family.get("ratio")
        if isinstance(ratio, int | float) and ratio > MAX_RATIO:
            message = f"ratio {ratio:g} is {ratio:g} times critical damping"
            hint = f"for {ratio:g}% write {ratio / 100:g}"
            inner = ("springs", key) if key else ()
            document.warn("SIM200", (*at, *inner, "ratio"), message, hint)
            return


def _warn_of_forces(
    document: Document, at: Location, values: Mapping[str, Any]
) -> None:
    """Warn of the gravity of a pass that pulls up or is in cm/s²."""
    gravity = values.get("gravity")
    if isinstance(gravity, int | float) and not 0 <= gravity <= MAX_GRAVITY:
        message = f"gravity {gravity:g} is {gravity:g} m/s²"
        hint = f"for {gravity:g} cm/s² write {gravity / 100:g}"
        if gravity < 0:
            message = f"gravity {gravity:g} pulls up"
            hint = f"it is a magnitude: write {-gravity:g}"
        document.warn("SIM200", (*at, "gravity"), message, hint)


def _warn_of_rope(document: Document, at: Location, values: Mapping[str, Any]) -> bool:
    """Warn of a rope that is too long, or too heavy; return whether it is too long."""
    length, mass = math.dist(values["start"], values["end"]), values.get("mass") or 0.0
    if not length > 0:
        return False
    if length > MAX_LENGTH or (length > MAX_ROPE and mass < CABLE * length):
        message = f"the rope is {length_text(length)} long"
        message += f" and weighs {mass:g} kg" if length <= MAX_LENGTH else ""
        hint = "lengths are in metres; for centimetres write "
        hint += "'units: {length: cm}' in the scene"
        document.warn("SIM200", (*at, "to"), message, hint)
        return True
    if mass > MAX_LINE * length:
        _warn_of_grams(document, at, mass, f"the rope is {length_text(length)} long")
    return False


def _warn_of_sheet(document: Document, at: Location, values: Mapping[str, Any]) -> None:
    """Warn of cloth that is too heavy for its area."""
    area = math.hypot(*values["across"]) * math.hypot(*values["up"])
    mass = values.get("mass") or 0.0
    if area > 0 and mass > MAX_SHEET * area:
        mass_text = f"the cloth has {area:.3g} m², {mass / area:.3g} kg/m²"
        _warn_of_grams(document, at, mass, mass_text)


def _warn_of_body(document: Document, at: Location, body: Mapping[str, Any]) -> None:
    """Warn of a body's density in g/cm³, mass in grams and friction in percent."""
    density, friction = body.get("density"), body.get("friction")
    if isinstance(density, int | float) and 0 < density < MIN_DENSITY:
        message = f"density {density:g} is {density:g} kg/m³, lighter than foam"
        hint = f"for {density:g} g/cm³ write {density * GRAMS:g}"
        document.warn("SIM200", (*at, "density"), message, hint)
    if isinstance(friction, int | float) and friction > MAX_FRICTION:
        message = f"friction {friction:g} is {friction:g} times the normal force"
        hint = f"for {friction:g}% write {friction / 100:g}"
        document.warn("SIM200", (*at, "friction"), message, hint)
    volume, mass = shape_volume(body.get("shape") or {}), body.get("mass")
    if mass and volume > 0 and mass > MAX_DENSITY * volume:
        density_text = f"its density is {mass / volume:.3g} kg/m³"
        _warn_of_grams(document, at, mass, density_text)


def _warn_of_grams(
    document: Document, at: Location, mass: float, mass_text: str
) -> None:
    message = f"mass {mass:g} is {mass:g} kg; {mass_text}"
    hint = f"for {mass:g} g write {mass / GRAMS:g}"
    document.warn("SIM200", (*at, "mass"), message, hint)


def shape_volume(shape: Mapping[str, Any]) -> float:
    """Return the volume of a box, sphere or capsule; 0 for others [m³]."""
    for name, values in shape.items():
        sizes = values if isinstance(values, Mapping) else {}
        radius = sizes.get("radius") or 0.0
        length = sizes.get("length") or 0.0
        if name == "box" and isinstance(sizes.get("size"), list):
            return float(math.prod(sizes["size"]))
        if name in {"sphere", "capsule"} and isinstance(radius, int | float):
            return math.pi * radius**2 * (4 / 3 * radius + length)
    return 0.0

"""Warnings about numbers of systems that look like another unit, such as radians.

Quaternions that are not normalized are reported too.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from animtool.core.quantities import length_text, percent_hint, plain_number
from animtool.documents.document import Document, Location
from animtool.rig.suspicions import (
    FULL_REVOLUTION,
    QUARTER_ROUNDING,
    TIGHT_LIMIT,
    are_multiples,
    warn_of_quaternion,
    warn_of_quaternion_length,
)
from animtool.scene.systems.suspicious_forces import MAX_GRAVITY
from animtool.scene.systems.suspicious_times import stated_keys

# Greater thickness of cloth is implausible [m].
MAX_CLOTH_THICKNESS = 0.5
# Only rubber stretches to twice its length [1].
MAX_CLOTH_STRETCH = 1.0
# Critical damping is 1; a percentage of it is rarely below 4 [1].
MAX_DAMPING_RATIO = 3.0
# A longer rope is implausible [m], unless it weighs as much as a 5 mm cord [kg/m].
MAX_CORD_LENGTH, MIN_CABLE_LINE_MASS = 20.0, 0.02
# Longer than any rope [m], and heavier than a chain of 5 cm [kg/m].
MAX_ROPE_LENGTH, MAX_LINE_MASS = 200.0, 50.0
# Cloth heavier than a sheet of rubber of 2 cm [kg/m²].
MAX_AREA_MASS = 25.0
# Denser than the densest metal, 22 600 [kg/m³].
MAX_DENSITY = 30000.0
# Lighter than foam, so grams per cm³ are meant [kg/m³].
MIN_DENSITY = 10.0
# Rubber on rubber has 1.5, and gears mesh [1].
MAX_FRICTION = 5.0
GRAMS_PER_KILOGRAM = 1000.0
# Shoulders of an elephant, and a tall giraffe with room to spare [m].
MAX_AGENT_RADIUS, MAX_AGENT_HEIGHT = 3.0, 10.0
# Of people, in metres and metres per second.
PERSON_HEIGHTS, PERSON_RADII, PERSON_SPEEDS = (0.9, 2.3), (0.12, 0.5), (0.3, 4.0)
# Ions have whole numbers of e, atoms of molecules hundredths; coulombs are below 1e-17.
ELEMENTARY_CHARGE, MAX_COULOMBS = 1.602176634e-19, 1e-12
# Pitch has 2e5, but hardly flows; lava has up to 10, and water 1e-6 [m²/s].
MAX_VISCOSITY, WATER_VISCOSITY = 100.0, 1e-6
# Densities of liquids, which may be in the wrong key [kg/m³].
LIQUID_DENSITIES = 500.0, 20000.0
# A scene in centimetres or less has metres if a rope is shorter [m], and heavier than
# a steel chain of its length [kg/m].
MIN_ROPE_LENGTH, CHAIN_LINE_MASS = 0.15, 5.0


def warn_of_suspect_units(
    document: Document, location: Location, values: Mapping[str, Any], unit: float = 1.0
) -> None:
    """Warn of lengths, masses, densities and accelerations in other units (SIM200).

    ``values`` are the keys of a system or pass, in metres; ``unit`` is the length unit
    of the scene [m].
    """
    if unit < 1 and _warn_of_metres(document, location, values):
        return  # all its lengths are in another unit
    _warn_of_density_and_viscosity(document, location, values)
    _warn_of_ratio(document, location, values)
    _warn_of_gravity(document, location, values)
    for i, body in enumerate(values.get("bodies") or ()):
        _warn_of_body(document, (*location, "bodies", i), body)
    is_rope = values.get("start") and values.get("end")
    if is_rope and _warn_of_rope(document, location, values):
        return  # all its lengths are in another unit
    if values.get("across") and values.get("up"):
        _warn_of_sheet(document, location, values)
    contact = values.get("self_contact")
    if isinstance(contact, Mapping):
        _warn_of_length(document, (*location, "self_contact"), "thickness", contact)
    _warn_of_length(document, location, "thickness", values)
    _warn_of_length(document, location, "radius", values)
    stretch = values.get("stretch")
    if isinstance(stretch, int | float) and stretch >= MAX_CLOTH_STRETCH:
        message = f"stretch {stretch:g} allows springs {1 + stretch:g} times as long"
        hint = percent_hint(stretch)
        document.warn("SIM200", (*location, "stretch"), message, hint)


def _warn_of_length(
    document: Document, location: Location, key: str, values: Mapping[str, Any]
) -> None:
    """Warn of a thickness or radius that seems to be in millimetres (SIM200)."""
    length = values.get(key)
    # Lengths with a unit are texts.
    if not isinstance(length, int | float) or length < MAX_CLOTH_THICKNESS:
        return
    message = f"{key} {length:g} is a thickness of {length_text(2 * length)}"
    if key == "thickness":
        message = f"thickness {length:g} is {length_text(length)}, in metres"
    hint = f"for {length:g} mm write {length / 1000:g}, for {length:g} cm "
    hint += f"{length / 100:g}"
    document.warn("SIM200", (*location, key), message, hint)


def _warn_of_density_and_viscosity(
    document: Document, location: Location, values: Mapping[str, Any]
) -> None:
    """Warn of a density in g/cm³, and of a viscosity in mm²/s or equal to a density."""
    density, viscosity = values.get("density"), values.get("viscosity")
    if isinstance(density, int | float) and 0 < density < MIN_DENSITY:
        message = f"density {density:g} is {density:g} kg/m³, lighter than foam"
        hint = f"for {density:g} g/cm³ write {density * GRAMS_PER_KILOGRAM:g}"
        document.warn("SIM200", (*location, "density"), message, hint)
    if isinstance(viscosity, int | float) and viscosity >= MAX_VISCOSITY:
        ratio = f"{plain_number(viscosity / WATER_VISCOSITY)} times that of water"
        message = f"viscosity {viscosity:g} is {viscosity:g} m²/s, {ratio}"
        hint = f"for {viscosity:g} mm²/s write {viscosity * WATER_VISCOSITY:g}"
        if LIQUID_DENSITIES[0] <= viscosity <= LIQUID_DENSITIES[1]:
            hint += f"; a density is 'density: {viscosity:g}'"
        document.warn("SIM200", (*location, "viscosity"), message, hint)


def _warn_of_metres(
    document: Document, location: Location, values: Mapping[str, Any]
) -> bool:
    """Warn of a rope or cloth sized in metres if the scene uses a smaller unit."""
    mass = values.get("mass") or 0.0
    if values.get("start") and values.get("end"):
        length = math.dist(values["start"], values["end"])
        is_heavy = 0 < length < MIN_ROPE_LENGTH and mass > CHAIN_LINE_MASS * length
        key, message = "to", f"the rope is {length_text(length)} long"
    elif values.get("across") and values.get("up"):
        sides = math.hypot(*values["across"]), math.hypot(*values["up"])
        area = math.prod(sides)
        is_heavy = 0 < max(sides) < MIN_ROPE_LENGTH and mass > MAX_AREA_MASS * area
        key, message = "across", f"the cloth has sides of {length_text(sides[0])} and "
        message += length_text(sides[1])
    else:
        return False
    if is_heavy:
        message += f" and weighs {mass:g} kg"
        hint = "the scene declares a smaller units.length; if the numbers are metres, "
        hint += "remove it"
        document.warn("SIM200", (*location, key), message, hint)
    return bool(is_heavy)


def _warn_of_ratio(
    document: Document, location: Location, values: Mapping[str, Any]
) -> None:
    """Warn of a damping ratio that seems to be in percent (SIM200)."""
    settings_by_key = {"": values, **(values.get("springs") or {})}
    for key, settings in settings_by_key.items():
        ratio = (settings or {}).get("ratio")
        if isinstance(ratio, int | float) and ratio > MAX_DAMPING_RATIO:
            message = f"ratio {ratio:g} is {ratio:g} times critical damping"
            inner_path = ("springs", key, "ratio") if key else ("ratio",)
            document.warn(
                "SIM200", (*location, *inner_path), message, percent_hint(ratio)
            )
            return


def _warn_of_gravity(
    document: Document, location: Location, values: Mapping[str, Any]
) -> None:
    """Warn if the gravity of a pass points up or is in cm/s² (SIM200)."""
    gravity = values.get("gravity")
    if isinstance(gravity, int | float) and not 0 <= gravity <= MAX_GRAVITY:
        message = f"gravity {gravity:g} is {gravity:g} m/s²"
        hint = f"for {gravity:g} cm/s² write {gravity / 100:g}"
        if gravity < 0:
            message = f"gravity {gravity:g} pulls up"
            hint = f"it is a magnitude: write {-gravity:g}"
        document.warn("SIM200", (*location, "gravity"), message, hint)


def _warn_of_rope(
    document: Document, location: Location, values: Mapping[str, Any]
) -> bool:
    """Warn about a rope that is too long or too heavy; return whether it is long."""
    length, mass = math.dist(values["start"], values["end"]), values.get("mass") or 0.0
    if not length > 0:
        return False
    is_light = mass < MIN_CABLE_LINE_MASS * length
    if length > MAX_ROPE_LENGTH or (length > MAX_CORD_LENGTH and is_light):
        message = f"the rope is {length_text(length)} long"
        message += f" and weighs {mass:g} kg" if length <= MAX_ROPE_LENGTH else ""
        hint = "lengths are in metres; for centimetres write "
        hint += "'units: {length: cm}' in the scene"
        document.warn("SIM200", (*location, "to"), message, hint)
        return True
    if mass > MAX_LINE_MASS * length:
        size_text = f"the rope is {length_text(length)} long"
        _warn_of_grams(document, location, mass, size_text)
    return False


def _warn_of_sheet(
    document: Document, location: Location, values: Mapping[str, Any]
) -> None:
    """Warn about cloth that is too heavy for its area (SIM200)."""
    area = math.hypot(*values["across"]) * math.hypot(*values["up"])
    mass = values.get("mass") or 0.0
    if area > 0 and mass > MAX_AREA_MASS * area:
        mass_text = f"the cloth has {area:.3g} m², {plain_number(mass / area)} kg/m²"
        _warn_of_grams(document, location, mass, mass_text)


def _warn_of_body(
    document: Document, location: Location, body: Mapping[str, Any]
) -> None:
    """Warn about a body's density in g/cm³, mass in grams or friction in percent."""
    friction = body.get("friction")
    _warn_of_density_and_viscosity(document, location, body)
    if isinstance(friction, int | float) and friction > MAX_FRICTION:
        message = f"friction {friction:g} is {friction:g} times the normal force"
        hint = percent_hint(friction)
        document.warn("SIM200", (*location, "friction"), message, hint)
    volume, mass = shape_volume(body.get("shape") or {}), body.get("mass")
    if mass and volume > 0 and mass > MAX_DENSITY * volume:
        density_text = f"its density is {plain_number(mass / volume)} kg/m³"
        _warn_of_grams(document, location, mass, density_text)


def warn_of_agents_and_atoms(
    document: Document, location: Location, values: Mapping[str, Any], unit: float = 1.0
) -> None:
    """Warn of agents in centimetres or metres and of charges in coulombs (SIM200).

    ``values`` are in metres; ``unit`` is the length unit of the scene [m].
    """
    for i, population in enumerate(values.get("populations") or ()):
        population_location = (*location, "populations", i)
        _warn_of_agent_size(document, population_location, population)
        if unit < 1:
            _warn_of_agent_metres(document, population_location, population, unit)
    for i, species in enumerate(values.get("species") or ()):
        _warn_of_charge(document, (*location, "species", i), species)


def _warn_of_agent_size(
    document: Document, location: Location, population: Mapping[str, Any]
) -> None:
    """Warn of agents whose size seems to be in centimetres (SIM200)."""
    for key, largest in ("radius", MAX_AGENT_RADIUS), ("height", MAX_AGENT_HEIGHT):
        length = population.get(key)
        if isinstance(length, int | float) and length > largest:
            message = f"{key} {length:g} is {length:g} m, larger than any person or "
            message += "animal"
            hint = f"for {length:g} cm write {length / 100:g}"
            document.warn("SIM200", (*location, key), message, hint)
            return


def _warn_of_agent_metres(
    document: Document, location: Location, population: Mapping[str, Any], unit: float
) -> None:
    """Warn of people in metres in a scene with a smaller unit (SIM200)."""
    speed = population.get("speed") or {}
    numbers = {
        ("height",): (population.get("height"), PERSON_HEIGHTS),
        ("radius",): (population.get("radius"), PERSON_RADII),
        ("speed", "mean"): (speed.get("mean"), PERSON_SPEEDS),
    }
    wrong_numbers = {}
    for keys, (value, (low, high)) in numbers.items():
        if not isinstance(value, int | float) or low <= value <= high:
            continue
        if not low <= value / unit <= high:
            return  # a small animal
        wrong_numbers[keys] = value / unit
    for keys, number in wrong_numbers.items():
        key = ".".join(keys)
        speed_text = " a second" if keys[0] == "speed" else ""
        message = f"{key} {number:g} is {length_text(number * unit)}{speed_text}, as "
        message += "the scene declares a smaller units.length"
        hint = f"for {number:g} m{'/s' if speed_text else ''} write "
        hint += plain_number(number / unit)
        document.warn("SIM200", (*location, *keys), message, hint)
        return


def _warn_of_charge(
    document: Document, location: Location, species: Mapping[str, Any]
) -> None:
    """Warn of a charge that seems to be in coulombs (SIM200)."""
    charge = species.get("charge")
    if isinstance(charge, int | float) and 0 < abs(charge) < MAX_COULOMBS:
        message = f"charge {charge:g} has no effect: charges are in e, the elementary "
        message += "charge"
        count = round(charge / ELEMENTARY_CHARGE, 3)
        hint = f"for {charge:g} C write {plain_number(count)}"
        document.warn("SIM200", (*location, "charge"), message, hint)


def _warn_of_grams(
    document: Document, location: Location, mass: float, mass_text: str
) -> None:
    """Warn of a mass that seems to be in grams (SIM200)."""
    message = f"mass {mass:g} is {mass:g} kg; {mass_text}"
    hint = f"for {mass:g} g write {mass / GRAMS_PER_KILOGRAM:g}"
    document.warn("SIM200", (*location, "mass"), message, hint)


def shape_volume(shape: Mapping[str, Any]) -> float:
    """Return the volume of a box, sphere or capsule [m³]; 0 for any other shape."""
    for name, values in shape.items():
        sizes = values if isinstance(values, Mapping) else {}
        radius = sizes.get("radius") or 0.0
        length = sizes.get("length") or 0.0
        if name == "box" and isinstance(sizes.get("size"), list):
            return float(math.prod(sizes["size"]))
        if name in {"sphere", "capsule"} and isinstance(radius, int | float):
            return math.pi * radius**2 * (4 / 3 * radius + length)
    return 0.0


# Keys of quaternions.
ROTATION_KEYS = {"rotate", "inertia_axes", "rotation"}


def warn_of_radians(
    document: Document, location: Location, values: Mapping[str, Any]
) -> None:
    """Warn of limits, cones and fields of view that seem to be in radians (SIM200).

    ``values`` are the stated keys of the system at a location, in degrees.
    """
    for key_location, key, angle in _cones(location, values):
        message = f"{key} {angle:g} is a cone of {angle:g}°"
        hint = f"for {angle:g} rad write {math.degrees(angle):.3g}"
        document.warn("SIM200", key_location, message, hint)
    for i, joint in enumerate(values.get("joints") or ()):
        for key in ("limits", "swing", "twist") if isinstance(joint, Mapping) else ():
            numbers = joint.get(key)
            if key == "limits" and joint.get("type") != "pin":
                continue
            angles = numbers if isinstance(numbers, list) else [numbers or 0.0]
            if _look_like_radians(angles):
                key_location = (*location, "joints", i, key)
                message = f"{key} {_numbers_text(numbers, 1.0)} look like radians, but "
                message += (
                    f"angles are in degrees: the largest is {max(map(abs, angles)):g}°"
                )
                hint = f"write {_numbers_text(numbers, math.degrees(1.0))}, or declare "
                hint += "'units: {angle: rad}' in the scene"
                document.warn("SIM200", key_location, message, hint)
                return


def warn_of_rotations(
    document: Document, location: Location, values: Mapping[str, Any]
) -> None:
    """Warn of a quaternion that is not of unit length (RIG110), or has w last (SIM200).

    Each is reported once.
    """
    has_w_last = False
    for key_location, key, value in stated_keys(location, values):
        if key in ROTATION_KEYS and _is_quaternion(value):
            warn_of_quaternion_length(document, key_location, value)
            if value == [0, 0, 0, 1] and not has_w_last:
                has_w_last = True
                warn_of_quaternion(document, "SIM200", key_location)
        for i, row in enumerate(value if key == "turns" else ()):
            if isinstance(row, list) and _is_quaternion(row[1:]):
                warn_of_quaternion_length(document, (*key_location, i), row[1:])


def _is_quaternion(value: object) -> bool:
    return (
        isinstance(value, list)
        and len(value) == 4
        and all(isinstance(number, int | float) for number in value)
    )


def _cones(
    location: Location, values: Mapping[str, Any]
) -> Iterator[tuple[Location, str, float]]:
    """Yield cone angles that are plausible in radians, with location and key."""
    for key in ("emitters", "species"):
        for i, entry in enumerate(values.get(key) or ()):
            spread, vision = entry.get("spread"), entry.get("vision") or {}
            # Few integers are radians.
            if isinstance(spread, float) and 0 < spread <= math.pi and spread % 1:
                yield (*location, key, i, "spread"), "spread", spread
            angle = vision.get("angle")
            if isinstance(angle, int | float) and 0 < angle <= math.tau:
                yield (*location, key, i, "vision", "angle"), "vision.angle", angle


def _look_like_radians(angles: Sequence[float]) -> bool:
    """Return whether angles [deg] look like radians: simple fractions of pi."""
    largest, is_multiple = max(map(abs, angles)), bool(are_multiples(angles).any())
    for angle in angles:
        multiple = round(angle / (math.pi / 2)) * (math.pi / 2)
        is_multiple |= multiple != 0 and abs(angle - multiple) < QUARTER_ROUNDING
    return TIGHT_LIMIT <= largest <= FULL_REVOLUTION and is_multiple


def _numbers_text(numbers: float | Sequence[float], factor: float) -> str:
    """Return numbers times a factor as text."""
    if isinstance(numbers, int | float):
        return f"{numbers * factor:.3g}"
    return f"[{', '.join(f'{number * factor:.3g}' for number in numbers)}]"

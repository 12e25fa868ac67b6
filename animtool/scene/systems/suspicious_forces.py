"""Warnings about forces and speeds of systems that look like another unit or axis."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from animtool.documents.document import Document, Location

# Ten times that of Earth; the Sun's is 274 [m/s²].
MAX_GRAVITY = 100.0
EARTH, EARTH_TOLERANCE = 9.81, 0.03
# Smaller gravity in any direction may drift things on purpose [m/s²].
MIN_PULL = 1.0
# Cosine to an axis of a vector along it.
ALONG = 0.99
# Faster than any storm, and than what is thrown or flies by itself [m/s].
MAX_WIND = MAX_SPEED = 200.0
# A bullet is smaller, and faster [m³], [m/s].
BULLET, MAX_BULLET = 1e-4, 3000.0
# Faster than any sprinter [m/s].
MAX_WALK = 15.0
# A hundred times the pull of Earth [m/s²].
MAX_ACCELERATION = 1000.0
# Keys that these warnings look at, and the default mass of a particle [kg].
FORCE_KEYS = {"gravity", "wind", "forces", "emitters", "fills", "bodies", "species"}
FORCE_KEYS |= {"populations"}
PARTICLE_MASS = 1e-3

_Values = Mapping[str, Any]


def warn_of_forces(
    document: Document,
    at: Location,
    values: _Values,
    unit: float = 1.0,
    volume: Callable[[_Values], float] = lambda _: math.inf,
) -> None:
    """Warn of gravity, wind and speeds in another unit, or along another axis (SIM200).

    Args:
        document: The scene.
        at: Location of the system or pass.
        values: Its stated keys, in metres.
        unit: Metres in a length of 1 of the scene [m].
        volume: Function that returns the volume of a shape [m³].
    """
    for location, gravity in _gravities(at, values):
        problem = _of_gravity(gravity, unit)
        if problem:
            document.warn("SIM200", location, *problem)
            break
    for location, wind in _winds(at, values):
        speed = math.hypot(*wind)
        if speed > MAX_WIND:
            message = f"a wind of {speed:g} m/s is faster than any storm"
            document.warn("SIM200", location, message, _unit_hint(speed, unit))
            break
    for location, speed, limit, fastest in _speeds(at, values, volume):
        if speed > limit:
            message = f"a speed of {speed:g} m/s is faster than {fastest}"
            document.warn("SIM200", location, message, _unit_hint(speed, unit))
            break
    _warn_of_push(document, at, values)


def _unit_hint(speed: float, unit: float) -> str:
    if unit != 1.0:
        return f"write {speed / unit / 100:g} if it is 100 times too fast"
    return (
        f"for {speed:g} cm/s write {speed / 100:g}, or declare 'units: {{length: cm}}' "
        "in the scene"
    )


def _of_gravity(gravity: Sequence[float], unit: float) -> tuple[str, str] | None:
    """Return a message and hint about the gravity of a system [m/s²]."""
    size = math.hypot(*gravity)
    shown = ", ".join(f"{value / unit:g}" for value in gravity)
    down = f"[0, {-size / unit:g}, 0]"
    if gravity[2] <= -ALONG * size and size >= MIN_PULL:
        message = f"gravity [{shown}] pulls along -Z, but systems have Y up"
        hint = f"write {down}; in an output with Z up, systems are rotated"
        return message, hint
    if size > MAX_GRAVITY:
        message = f"gravity [{shown}] is {size:g} m/s², {size / EARTH:.3g} times that "
        return f"{message}of Earth", f"Earth's is {EARTH / unit:g}"
    is_earth = abs(size / EARTH - 1) <= EARTH_TOLERANCE
    if is_earth and gravity[1] >= ALONG * size:
        return f"gravity [{shown}] pulls up", f"write {down}"
    if unit < 1 and abs(size / unit / EARTH - 1) <= EARTH_TOLERANCE:
        message = f"gravity [{shown}] is {size:g} m/s² in the unit of the scene"
        return message, f"for Earth's write {EARTH / unit:g}, or leave the key out"
    return None


def _vector(value: object) -> list[float] | None:
    """Return a vector of numbers; None for anything else."""
    if not isinstance(value, list | tuple) or len(value) != 3:
        return None
    numbers = [number for number in value if isinstance(number, int | float)]
    return numbers if len(numbers) == 3 else None


def _forces(at: Location, values: _Values) -> Iterator[tuple[Location, str, _Values]]:
    for i, force in enumerate(values.get("forces") or ()):
        for name, options in force.items():
            yield (*at, "forces", i, name), name, options or {}


def _gravities(
    at: Location, values: _Values
) -> Iterator[tuple[Location, Sequence[float]]]:
    gravity = _vector(values.get("gravity"))
    if gravity is not None:
        yield (*at, "gravity"), gravity
    for location, name, options in _forces(at, values):
        acceleration = _vector(options.get("acceleration"))
        if name == "gravity" and acceleration is not None:
            yield (*location, "acceleration"), acceleration


def _winds(at: Location, values: _Values) -> Iterator[tuple[Location, Sequence[float]]]:
    wind = values.get("wind")
    velocity = _vector(wind)
    if velocity is not None:
        yield (*at, "wind"), velocity
    if isinstance(wind, Mapping):
        velocity = _vector(wind.get("velocity"))
        if velocity is not None:
            yield (*at, "wind", "velocity"), velocity
        for i, row in enumerate(wind.get("gusts") or ()):
            yield (*at, "wind", "gusts", i), row[1:]
    for location, name, options in _forces(at, values):
        velocity = _vector(options.get("velocity"))
        if name == "wind" and velocity is not None:
            yield (*location, "velocity"), velocity


def _speeds(
    at: Location, values: _Values, volume: Callable[[_Values], float]
) -> Iterator[tuple[Location, float, float, str]]:
    """Yield the location of each speed, the speed, its limit, and what reaches it."""
    flying = "anything that is thrown or flies"
    for i, emitter in enumerate(values.get("emitters") or ()):
        # Charges move in fields, as fast as those make them.
        if isinstance(emitter.get("speed"), int | float) and not emitter.get("charge"):
            yield (
                (*at, "emitters", i, "speed"),
                abs(emitter["speed"]),
                MAX_SPEED,
                flying,
            )
    for i, fill in enumerate(values.get("fills") or ()):
        velocity = _vector(fill.get("velocity"))
        if velocity is not None:
            location = (*at, "fills", i, "velocity")
            yield location, math.hypot(*velocity), MAX_SPEED, flying
    for i, body in enumerate(values.get("bodies") or ()):
        velocity = _vector(body.get("velocity"))
        if velocity is not None:
            is_bullet = volume(body.get("shape") or {}) <= BULLET
            limit = MAX_BULLET if is_bullet else MAX_SPEED
            yield (*at, "bodies", i, "velocity"), math.hypot(*velocity), limit, flying
    for key, limit, fastest in (
        ("species", MAX_SPEED, flying),
        ("populations", MAX_WALK, "any runner"),
    ):
        for i, group in enumerate(values.get(key) or ()):
            for name, speed in (group.get("speed") or {}).items():
                if name in {"cruise", "least", "most", "mean"} and speed is not None:
                    yield (*at, key, i, "speed", name), speed, limit, fastest


def _warn_of_push(document: Document, at: Location, values: _Values) -> None:
    """Warn of forces that accelerate particles beyond reason (SIM200)."""
    emitters = values.get("emitters") or ()
    masses = [emitter.get("mass") or PARTICLE_MASS for emitter in emitters]
    for location, name, options in _forces(at, values):
        push, strength = _vector(options.get("push")), options.get("strength")
        if name == "uniform" and push is not None and masses:
            acceleration = math.hypot(*push) / max(masses)
            if acceleration > MAX_ACCELERATION:
                message = (
                    f"a push of {math.hypot(*push):g} N accelerates particles of "
                    f"{max(masses):g} kg by {acceleration:g} m/s²"
                )
                hint = "use `gravity` for an acceleration, or set the particles' mass"
                document.warn("SIM200", (*location, "push"), message, hint)
                return
        if not isinstance(strength, int | float):
            continue
        if name == "turbulence" and strength > MAX_GRAVITY:
            ratio = strength / EARTH
            message = (
                f"turbulence of {strength:g} m/s² is {ratio:.3g} times Earth's pull"
            )
            hint = "its strength is an acceleration in metres per second squared"
            document.warn("SIM200", (*location, "strength"), message, hint)
            return

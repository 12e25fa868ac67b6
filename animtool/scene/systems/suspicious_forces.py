"""Warnings about forces and speeds of systems that look like another unit or axis."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.quantities import length_text, plain_number
from animtool.documents.document import Document, Location

# Ten times that of Earth; the Sun's is 274 [m/s²].
MAX_GRAVITY = 100.0
EARTH_GRAVITY, EARTH_TOLERANCE = 9.81, 0.03
# Smaller gravity may be in any direction on purpose [m/s²].
MIN_GRAVITY = 1.0
# Cosine to an axis of a vector along it.
ALIGNED_COSINE = 0.99
# Faster than any hurricane, and than anything thrown or flying [m/s].
MAX_WIND_SPEED, MAX_FLYING_SPEED = 100.0, 200.0
# A bullet is smaller, and faster [m³], [m/s].
MAX_BULLET_VOLUME, MAX_BULLET_SPEED = 1e-4, 3000.0
# A bird flies as fast as a swift [m/s], and sees what it passes in this time [s].
MAX_FLIGHT_SPEED, MIN_SIGHT_TIME = 30.0, 1 / 12
VISION_RADIUS = 2.0
# Faster than any sprinter [m/s].
MAX_RUN_SPEED = 15.0
# Kilometres per hour in a metre per second.
KMH_PER_MPS = 3.6
# A hundred times the pull of Earth [m/s²].
MAX_FORCE_ACCELERATION = 1000.0
# The default mass of a particle [kg].
PARTICLE_MASS = 1e-3
# Gravity that moves bodies by less of their distances than a pixel of a picture does
# nothing [1], in this time or in the range if it is longer [s].
MIN_RELATIVE_MOVE, MIN_GRAVITY_SECONDS = 1e-3, 10.0
# The constant of nature [m³/(kg s²)], and the tolerance for it [1].
NEWTON_CONSTANT, CONSTANT_TOLERANCE = 6.674e-11, 0.01
# Bodies whose accelerations are computed.
MAX_COMPARED_BODIES = 200

_EntryValues = Mapping[str, Any]


def warn_of_forces(
    document: Document,
    entry_path: Location,
    values: _EntryValues,
    unit: float = 1.0,
    volume: Callable[[_EntryValues], float] = lambda _: math.inf,
) -> None:
    """Warn about gravity, wind and speeds in another unit or axis (SIM200).

    ``values`` are the stated keys of a system or pass, in metres; ``unit`` is the
    length unit of the scene [m]; ``volume`` returns the volume of a shape [m³].
    """
    for location, gravity in _gravities(entry_path, values):
        problem = _gravity_problem(gravity, unit)
        if problem:
            document.warn("SIM200", location, *problem)
            break
    for location, wind in _winds(entry_path, values):
        speed = math.hypot(*wind)
        if speed > MAX_WIND_SPEED:
            message = f"a wind of {speed:g} m/s is faster than any hurricane"
            hint = _unit_hint(speed, unit)
            if unit == 1.0 and speed <= MAX_FLYING_SPEED * KMH_PER_MPS:
                hint = f"for {speed:g} km/h write {speed / KMH_PER_MPS:.3g}; {hint}"
            document.warn("SIM200", location, message, hint)
            break
    for location, speed, limit, comparison in _speeds(entry_path, values, volume):
        if speed > limit:
            message = f"a speed of {speed:g} m/s is faster than {comparison}"
            document.warn("SIM200", location, message, _unit_hint(speed, unit))
            break
    _warn_of_cruise(document, entry_path, values)
    _warn_of_large_forces(document, entry_path, values)


def _warn_of_cruise(
    document: Document, entry_path: Location, values: _EntryValues
) -> None:
    """Warn of members of a flock that fly faster than they see (SIM200)."""
    for i, species in enumerate(values.get("species") or ()):
        cruise = (species.get("speed") or {}).get("cruise")
        radius = (species.get("vision") or {}).get("radius") or VISION_RADIUS
        if (
            not isinstance(cruise, int | float)
            or not MAX_FLIGHT_SPEED < cruise <= MAX_FLYING_SPEED
        ):
            continue
        if cruise * MIN_SIGHT_TIME > radius:
            message = (
                f"speed.cruise {cruise:g} m/s is {cruise * KMH_PER_MPS:.3g} km/h, "
            )
            message += f"and members see {length_text(radius)}, {radius / cruise:.2g} s"
            hint = f"for {cruise:g} km/h write {cruise / KMH_PER_MPS:.3g}, or a larger "
            hint += "vision.radius"
            location = (*entry_path, "species", i, "speed", "cruise")
            document.warn("SIM200", location, message, hint)
            return


def _unit_hint(speed: float, unit: float) -> str:
    if unit != 1.0:
        return f"write {speed / unit / 100:g} if it is 100 times too fast"
    hint = f"for {speed:g} cm/s write {speed / 100:g}, or declare "
    return f"{hint}'units: {{length: cm}}' in the scene"


def _gravity_problem(gravity: Sequence[float], unit: float) -> tuple[str, str] | None:
    """Return a message and hint about the gravity of a system [m/s²]."""
    magnitude = math.hypot(*gravity)
    gravity_text = ", ".join(f"{value / unit:g}" for value in gravity)
    down = f"[0, {-magnitude / unit:g}, 0]"
    if gravity[2] <= -ALIGNED_COSINE * magnitude and magnitude >= MIN_GRAVITY:
        message = f"gravity [{gravity_text}] pulls along -Z, but systems have Y up"
        hint = f"write {down}; in an output with Z up, systems are rotated"
        return message, hint
    if magnitude > MAX_GRAVITY:
        ratio = plain_number(magnitude / EARTH_GRAVITY)
        message = (
            f"gravity [{gravity_text}] is {magnitude:g} m/s², {ratio} times that of "
        )
        message += "Earth"
        scaled_text = ", ".join(f"{value / unit / 100:g}" for value in gravity)
        hint = f"for {magnitude:g} cm/s² write [{scaled_text}]"
        return message, hint if unit == 1 else f"Earth's is {EARTH_GRAVITY / unit:g}"
    is_earth = abs(magnitude / EARTH_GRAVITY - 1) <= EARTH_TOLERANCE
    if is_earth and gravity[1] >= ALIGNED_COSINE * magnitude:
        return f"gravity [{gravity_text}] pulls up", f"write {down}"
    if unit < 1 and abs(magnitude / unit / EARTH_GRAVITY - 1) <= EARTH_TOLERANCE:
        message = (
            f"gravity [{gravity_text}] is {magnitude:g} m/s² in the unit of the scene"
        )
        hint = f"for Earth's write {EARTH_GRAVITY / unit:g}, or leave the key out"
        return message, hint
    return None


def _vector(value: object) -> list[float] | None:
    """Return a value as a vector of numbers; None if it is not one."""
    if not isinstance(value, list | tuple) or len(value) != 3:
        return None
    numbers = [number for number in value if isinstance(number, int | float)]
    return numbers if len(numbers) == 3 else None


def _forces(
    location: Location, values: _EntryValues
) -> Iterator[tuple[Location, str, _EntryValues]]:
    """Yield the location, name and options of each force."""
    for i, force in enumerate(values.get("forces") or ()):
        for name, options in force.items():
            yield (*location, "forces", i, name), name, options or {}


def _force_vectors(
    entry_path: Location, values: _EntryValues, name: str, option: str
) -> Iterator[tuple[Location, Sequence[float]]]:
    """Yield a vector of each force of a name, with its location."""
    for location, force_name, options in _forces(entry_path, values):
        vector = _vector(options.get(option))
        if force_name == name and vector is not None:
            yield (*location, option), vector


def _gravities(
    entry_path: Location, values: _EntryValues
) -> Iterator[tuple[Location, Sequence[float]]]:
    """Yield the vector of each gravity, with its location."""
    gravity = _vector(values.get("gravity"))
    if gravity is not None:
        yield (*entry_path, "gravity"), gravity
    yield from _force_vectors(entry_path, values, "gravity", "acceleration")


def _winds(
    entry_path: Location, values: _EntryValues
) -> Iterator[tuple[Location, Sequence[float]]]:
    """Yield the vector of each wind, with its location."""
    wind = values.get("wind")
    if (velocity := _vector(wind)) is not None:
        yield (*entry_path, "wind"), velocity
    if isinstance(wind, Mapping):
        if (velocity := _vector(wind.get("velocity"))) is not None:
            yield (*entry_path, "wind", "velocity"), velocity
        for i, row in enumerate(wind.get("gusts") or ()):
            yield (*entry_path, "wind", "gusts", i), row[1:]
    yield from _force_vectors(entry_path, values, "wind", "velocity")


def _speeds(
    entry_path: Location, values: _EntryValues, volume: Callable[[_EntryValues], float]
) -> Iterator[tuple[Location, float, float, str]]:
    """Yield each speed with its location, its maximum, and what the maximum is for."""
    flying_bodies = "anything that is thrown or flies"
    for i, emitter in enumerate(values.get("emitters") or ()):
        # Charges move in fields, as fast as those make them.
        if isinstance(emitter.get("speed"), int | float) and not emitter.get("charge"):
            location = (*entry_path, "emitters", i, "speed")
            yield location, abs(emitter["speed"]), MAX_FLYING_SPEED, flying_bodies
    for i, fill in enumerate(values.get("fills") or ()):
        velocity = _vector(fill.get("velocity"))
        if velocity is not None:
            location = (*entry_path, "fills", i, "velocity")
            yield location, math.hypot(*velocity), MAX_FLYING_SPEED, flying_bodies
    for i, body in enumerate(values.get("bodies") or ()):
        velocity = _vector(body.get("velocity"))
        if velocity is not None:
            is_bullet = volume(body.get("shape") or {}) <= MAX_BULLET_VOLUME
            limit = MAX_BULLET_SPEED if is_bullet else MAX_FLYING_SPEED
            location = (*entry_path, "bodies", i, "velocity")
            yield location, math.hypot(*velocity), limit, flying_bodies
    for key, limit, comparison in (
        ("species", MAX_FLYING_SPEED, flying_bodies),
        ("populations", MAX_RUN_SPEED, "any runner"),
    ):
        for i, group in enumerate(values.get(key) or ()):
            for name, speed in (group.get("speed") or {}).items():
                if name in {"cruise", "least", "most", "mean"} and speed is not None:
                    yield (*entry_path, key, i, "speed", name), speed, limit, comparison


def _warn_of_large_forces(
    document: Document, entry_path: Location, values: _EntryValues
) -> None:
    """Warn about forces that accelerate particles implausibly fast (SIM200)."""
    emitters = values.get("emitters") or ()
    masses = [emitter.get("mass") or PARTICLE_MASS for emitter in emitters]
    for location, name, options in _forces(entry_path, values):
        push, strength = _vector(options.get("push")), options.get("strength")
        if name == "uniform" and push is not None and masses:
            magnitude, mass = math.hypot(*push), max(masses)
            if magnitude / mass > MAX_FORCE_ACCELERATION:
                message = (
                    f"a push of {magnitude:g} N accelerates particles of {mass:g} kg "
                )
                message += f"by {magnitude / mass:g} m/s²"
                hint = "use `gravity` for an acceleration, or set the particles' mass"
                document.warn("SIM200", (*location, "push"), message, hint)
                return
        if not isinstance(strength, int | float):
            continue
        if name == "turbulence" and strength > MAX_GRAVITY:
            ratio = plain_number(strength / EARTH_GRAVITY)
            message = f"turbulence of {strength:g} m/s² is {ratio} times Earth's pull"
            hint = "its strength is an acceleration in metres per second squared"
            document.warn("SIM200", (*location, "strength"), message, hint)
            return


def warn_of_weak_gravity(
    document: Document,
    location: Location,
    spec: Any,
    entry_data: Mapping[str, Any],
    seconds: float,
) -> None:
    """Warn of an N-body system whose mutual gravity has no visible effect (SIM200).

    The lengths of its spec are in metres. ``entry_data`` has its parsed entries by key,
    and ``seconds`` is the time from the first to the last frame [s].
    """
    constant = float(spec.gravity_constant)
    mass, distance, acceleration = _strongest_gravity(spec, entry_data)
    if not constant * acceleration * distance > 0:
        return  # nothing attracts, or arrays that are refused are not finite
    seconds = max(seconds, MIN_GRAVITY_SECONDS)
    displacement = constant * acceleration * seconds**2 / 2
    if displacement >= MIN_RELATIVE_MOVE * distance:
        return
    message = f"with a constant of {constant:.3g}, masses of {plain_number(mass)} kg "
    message += f"in all and distances of {length_text(distance)}, gravity moves bodies "
    message += f"by at most {length_text(displacement)} in {seconds:.3g} s"
    # Bodies then move by their distance in about a second.
    suggested_constant = float(f"{2 * distance / acceleration:.0e}")
    hint = f"raise it, such as to gravity_constant: {suggested_constant:g}"
    if math.isclose(constant, NEWTON_CONSTANT, rel_tol=CONSTANT_TOLERANCE):
        hint = f"{constant:.3g} is that of nature, for kg, m and s; for these numbers "
        hint += f"write gravity_constant: {suggested_constant:g}"
    is_stated = "gravity_constant" in spec.model_fields_set
    key_location = (*location, "gravity_constant") if is_stated else location
    document.warn("SIM200", key_location, message, hint)


def _strongest_gravity(
    spec: Any, entry_data: Mapping[str, Any]
) -> tuple[float, float, float]:
    """Return the total mass, and the distance and acceleration of the largest effect.

    The acceleration is per unit of the gravitational constant [kg/m²].
    """
    extremes = []
    points, masses = [np.zeros((0, 3))], [np.zeros(0)]
    for body, entry_arrays in zip(
        spec.bodies, entry_data.get("bodies") or (), strict=False
    ):
        body_points = np.asarray((entry_arrays or {}).get("points", ()), np.float64)
        if body_points.shape[1:] != (3,):
            continue  # refused when the system is built
        body_masses = np.full(len(body_points), float(body.mass))
        stated_masses = (entry_arrays or {}).get("masses")
        if stated_masses is not None and np.shape(stated_masses) == body_masses.shape:
            body_masses = np.asarray(stated_masses, np.float64)
        points.append(body_points)
        masses.append(body_masses)
    for galaxy in spec.galaxies:
        points.append(np.array([galaxy.at], np.float64))
        mass = sum(part.mass for part in galaxy.components)
        max_radius = max((part.radius for part in galaxy.components), default=0.0)
        masses.append(np.array([mass]))
        extremes += [(max_radius, mass / max_radius**2)] if max_radius else []
    for attractor in spec.attractors:
        points.append(np.array([attractor.at], np.float64))
        masses.append(np.array([attractor.mass]))
    all_points, all_masses = np.concatenate(points), np.concatenate(masses)
    extent = float(np.linalg.norm(np.ptp(all_points, axis=0))) if len(all_points) else 0
    if extent:
        accelerations = _accelerations(all_points, all_masses, float(spec.softening))
        extremes.append((extent, float(accelerations.max())))
    total_mass = float(all_masses.sum())
    distance, acceleration = max(
        extremes, key=lambda extreme: extreme[1] / extreme[0], default=(0.0, 0.0)
    )
    return total_mass, float(distance), float(acceleration)


def _accelerations(
    points: FloatArray, masses: FloatArray, softening: float
) -> FloatArray:
    """Return accelerations of some of N points, per unit of the constant."""
    stride = max(1, len(points) // MAX_COMPARED_BODIES)
    offsets = points[None] - points[::stride, None]
    squares = (offsets**2).sum(axis=2) + max(softening, 1e-9) ** 2
    accelerations = (masses / squares**1.5)[..., None] * offsets
    return np.asarray(np.linalg.norm(accelerations.sum(axis=1), axis=1))

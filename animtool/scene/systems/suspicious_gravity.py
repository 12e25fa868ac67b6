"""Warnings about N-body systems whose gravity is too weak to be visible."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.quantities import length_text, plain_number
from animtool.documents.document import Document, Location

# Gravity that moves bodies by less of their distances than a pixel of a picture does
# nothing [1], in this time or in the range if it is longer [s].
MIN_RELATIVE_MOVE, MIN_SECONDS = 1e-3, 10.0
# The constant of nature [m³/(kg s²)], and the tolerance for it [1].
NEWTON_CONSTANT, CONSTANT_TOLERANCE = 6.674e-11, 0.01
# Bodies whose accelerations are computed.
MAX_BODIES = 200


def warn_of_weak_gravity(
    document: Document,
    location: Location,
    spec: Any,
    parts: Mapping[str, Any],
    seconds: float,
) -> None:
    """Warn of an N-body system whose mutual gravity has no visible effect (SIM200).

    The lengths of its spec are in metres; ``parts`` are its parsed entries, by key, and
    ``seconds`` is the time from the first to the last frame [s].
    """
    constant = float(spec.gravity_constant)
    mass, distance, acceleration = _strongest_gravity(spec, parts)
    if not constant * acceleration * distance > 0:
        return  # nothing attracts, or arrays that are refused are not finite
    seconds = max(seconds, MIN_SECONDS)
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
    spec: Any, parts: Mapping[str, Any]
) -> tuple[float, float, float]:
    """Return the total mass, and the distance and acceleration of the largest effect.

    The acceleration is per unit of the gravitational constant [kg/m²].
    """
    extremes = []
    points, masses = [np.zeros((0, 3))], [np.zeros(0)]
    for body, entry_arrays in zip(spec.bodies, parts.get("bodies") or (), strict=False):
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
        radius = max((part.radius for part in galaxy.components), default=0.0)
        masses.append(np.array([mass]))
        extremes += [(radius, mass / radius**2)] if radius else []
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
    stride = max(1, len(points) // MAX_BODIES)
    offsets = points[None] - points[::stride, None]
    squares = (offsets**2).sum(axis=2) + max(softening, 1e-9) ** 2
    accelerations = (masses / squares**1.5)[..., None] * offsets
    return np.asarray(np.linalg.norm(accelerations.sum(axis=1), axis=1))

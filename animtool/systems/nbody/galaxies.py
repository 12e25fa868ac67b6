"""Galaxies in equilibrium, and two on an orbit.

Discs are exponential, with a vertical sech² profile, spheroids have the profile of
Hernquist or Plummer. Circular velocities are those of all that a galaxy has; velocities
are drawn from local Gaussians whose moments solve the equations of Jeans.

References:
    K. C. Freeman, On the disks of spiral and S0 galaxies, Astrophysical Journal 160,
    1970 (rotation curves). L. Hernquist, N-body realizations of compound galaxies,
    Astrophysical Journal Supplement 86, 1993 (dispersions). A. Toomre, On the
    gravitational stability of a disk of stars, Astrophysical Journal 139, 1964.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.maths import so3
from animtool.systems.framework import matter
from animtool.systems.framework.matter import PointMasses, unit_quaternion
from animtool.systems.nbody.spec import (
    DiscModel,
    EncounterModel,
    GalaxyModel,
    NbodyModel,
    SpheroidModel,
)
from animtool.systems.particles.emitter import uniforms

# Radii at which profiles are tabulated.
RADII = 4096
# Largest speed over the escape velocity.
BOUND = 0.95
# Toomre's constant for stars.
TOOMRE = 3.36
# Largest radial dispersion over the circular velocity.
WARMEST = 0.7


class MassProfile:
    """Mass profile of a galaxy, at radii ``(R,)`` [m]."""

    def __init__(self, galaxy: GalaxyModel, constant: float, softening: float) -> None:
        self.galaxy, self.constant = galaxy, constant
        far = max((p.radius * p.cutoff for p in galaxy.parts), default=1.0)
        near = min((p.radius for p in galaxy.parts), default=1.0)
        self.r = np.geomspace(max(1e-4 * near, 1e-250), 4 * far, RADII)
        within = np.full(RADII, galaxy.nucleus)
        for one in (galaxy.bulge, galaxy.halo):
            if one is not None:
                within = within + enclosed(one, self.r)
        around = within
        # Softened bodies attract as Plummer spheres.
        soft = (self.r**2 / (self.r**2 + softening**2)) ** 1.5
        speeds = constant * within / self.r * soft
        if galaxy.disc is not None:
            around = within + enclosed(galaxy.disc, self.r)
            speeds = speeds + constant * disc_speeds(galaxy.disc, self.r) * soft
        self.circular = np.sqrt(speeds)  # [m/s]
        self.pull = constant * around / self.r**2 * soft  # [m/s²]
        beyond = constant * around[-1] / self.r[-1]
        # Escape velocities [m/s].
        self.escape = np.sqrt(2 * (_from_outside(self.pull, self.r) + beyond))

    def dispersion(self, part: SpheroidModel) -> FloatArray:
        """Return the velocity dispersion of a spheroid ``(R,)`` [m/s]."""
        density = np.gradient(enclosed(part, self.r), self.r) / self.r**2
        density = np.maximum(density, 0.0)
        pressure = _from_outside(density * self.pull, self.r)
        least = density.max() * 1e-12
        squares = pressure / np.maximum(density, least)
        return np.sqrt(np.where(density > least, squares, 0.0))


def _from_outside(values: FloatArray, r: FloatArray) -> FloatArray:
    """Return integrals from each radius to the last one (trapezoidal rule)."""
    steps = (values[1:] + values[:-1]) / 2 * np.diff(r)
    return np.append(np.cumsum(steps[::-1])[::-1], 0.0)


# Fraction of an infinite profile's mass within radii, in scale radii.
_WITHIN: dict[str, Callable[[Any], Any]] = {
    "exponential": lambda x: 1 - (1 + x) * np.exp(-x),
    "hernquist": lambda x: (x / (1 + x)) ** 2,
    "plummer": lambda x: x**3 / (1 + x**2) ** 1.5,
}


def enclosed(part: SpheroidModel | DiscModel, r: FloatArray) -> FloatArray:
    """Return the mass of a spheroid or a disc within radii [kg]."""
    within = _WITHIN[getattr(part, "profile", "exponential")]
    inside = np.minimum(r / part.radius, part.cutoff)
    return np.asarray(part.mass * within(inside) / within(part.cutoff))


def disc_speeds(disc: DiscModel, r: FloatArray) -> FloatArray:
    """Return squared circular velocities in a disc, over the constant [kg/m]."""
    from scipy.special import i0e, i1e, k0e, k1e

    y = np.minimum(r / (2 * disc.radius), 300.0)
    bessel = i0e(y) * k0e(y) - i1e(y) * k1e(y)
    surface = disc_surface(disc, 0.0)
    return np.asarray(4 * np.pi * surface * disc.radius * y**2 * bessel)


def disc_surface(disc: DiscModel, r: FloatArray | float) -> FloatArray:
    """Return surface densities of a disc [kg/m²]."""
    enclosed_fraction = _WITHIN["exponential"](disc.cutoff)
    central = disc.mass / (2 * np.pi * disc.radius**2 * enclosed_fraction)
    return np.asarray(central * np.exp(-r / disc.radius))


def built_galaxies(spec: NbodyModel) -> list[PointMasses]:
    """Return the bodies of each galaxy of a spec, at its start."""
    constant, softening = spec.gravity_constant, spec.softening
    built = [build_galaxy(one, constant, softening) for one in spec.galaxies]
    starts = [(np.array(one.at), np.array(one.velocity)) for one in spec.galaxies]
    if spec.encounter is not None:
        starts = on_orbit(spec.encounter, [g.masses.sum() for g in built], constant)
    placed = []
    for galaxy, bodies, (at, v) in zip(spec.galaxies, built, starts, strict=True):
        placing = matter.UnitFrame(at, unit_quaternion(galaxy.rotate))
        velocities = placing.velocities_out(bodies.velocities) + v
        placed.append(
            PointMasses(placing.outwards(bodies.points), velocities, bodies.masses)
        )
    return placed


def build_galaxy(galaxy: GalaxyModel, constant: float, softening: float) -> PointMasses:
    """Return a galaxy's bodies about its centre, the halo last."""
    profile = MassProfile(galaxy, constant, softening)
    parts = []
    if galaxy.nucleus:
        none = np.zeros((1, 3))
        parts.append(PointMasses(none, none, np.array([galaxy.nucleus])))
    if galaxy.disc is not None:
        parts.append(_disc(galaxy.disc, profile, galaxy.seed))
    for number, part in enumerate((galaxy.bulge, galaxy.halo)):
        if part is not None:
            parts.append(_spheroid(part, profile, galaxy.seed + 1000 * (number + 1)))
    joined = PointMasses.concatenate(parts)
    # Its centre of mass is at the position and velocity of the file.
    weights = joined.masses / joined.masses.sum()
    x, v = (each + -weights @ each for each in (joined.points, joined.velocities))
    return PointMasses(x, v, joined.masses)


def _spheroid(part: SpheroidModel, profile: MassProfile, seed: int) -> PointMasses:
    u = uniforms(seed, np.arange(part.count), 6)
    r = np.interp(u[:, 0] * part.mass, enclosed(part, profile.r), profile.r)
    sigma = np.interp(r, profile.r, profile.dispersion(part))
    most = BOUND * np.interp(r, profile.r, profile.escape)
    velocities = sigma[:, None] * matter.normals(u[:, 3:6])
    speeds = np.linalg.norm(velocities, axis=1)
    velocities *= np.minimum(most / np.maximum(speeds, 1e-300), 1.0)[:, None]
    masses = np.full(part.count, part.mass / part.count)
    return PointMasses(r[:, None] * matter.directions(u[:, 1:3]), velocities, masses)


def _disc(disc: DiscModel, profile: MassProfile, seed: int) -> PointMasses:
    u = uniforms(seed, np.arange(disc.count), 6)
    r = np.interp(u[:, 0] * disc.mass, enclosed(disc, profile.r), profile.r)
    angles = 2 * np.pi * u[:, 1]
    height = disc.thickness * disc.radius
    up = height * np.arctanh(np.clip(2 * u[:, 2] - 1, -0.999, 0.999))
    tables = disc_velocities(disc, profile)
    radial, around, upward, mean = (np.interp(r, profile.r, one) for one in tables)
    normal = matter.normals(u[:, 3:6])
    out, along = radial * normal[:, 0], mean + around * normal[:, 1]
    cos, sin = np.cos(angles), np.sin(angles)
    # Right-handed about y: from z to x.
    points = np.stack([r * sin, up, r * cos], axis=1)
    x, z = out * sin + along * cos, out * cos - along * sin
    velocities = np.stack([x, upward * normal[:, 2], z], axis=1)
    return PointMasses(points, velocities, np.full(disc.count, disc.mass / disc.count))


def disc_velocities(
    disc: DiscModel, profile: MassProfile
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return radial, azimuthal and vertical dispersions, and mean rotation ``(R,)``."""
    r, circular = profile.r, profile.circular
    turning = circular / r
    squares = np.gradient(turning**2, r) * r + 4 * turning**2
    epicycle = np.sqrt(np.maximum(squares, 1e-300))
    surface = disc_surface(disc, r)
    radial = disc.stability * TOOMRE * profile.constant * surface / epicycle
    radial = np.minimum(radial, WARMEST * circular)
    ratio = epicycle / np.maximum(2 * turning, 1e-300)
    drift = radial**2 * (1 - ratio**2 - 2 * r / disc.radius)
    mean = np.sqrt(np.maximum(circular**2 + drift, 0.0))
    height = disc.thickness * disc.radius
    upward = np.sqrt(np.pi * profile.constant * surface * height)
    return radial, radial * ratio, upward if disc.stability else 0 * upward, mean


def on_orbit(
    orbit: EncounterModel, masses: Sequence[float], constant: float
) -> list[tuple[FloatArray, FloatArray]]:
    """Return start positions and velocities of two galaxies on an orbit."""
    total = sum(masses)
    e, r = orbit.eccentricity, orbit.separation
    width = orbit.pericentre * (1 + e)
    cosine = np.clip((width / r - 1) / e, -1.0, 1.0) if e > 0 else 1.0
    # Before the pericentre: the true anomaly is negative.
    anomaly = -np.arccos(cosine)
    speed = np.sqrt(constant * total / width)
    separation = r * np.array([np.sin(anomaly), 0.0, np.cos(anomaly)])
    velocity = speed * np.array([e + np.cos(anomaly), 0.0, -np.sin(anomaly)])
    tilt = unit_quaternion(orbit.rotate)
    separation, velocity = so3.rotate(tilt, separation), so3.rotate(tilt, velocity)
    shares = -masses[1] / total, masses[0] / total
    return [
        (np.array(orbit.at) + fraction * separation, fraction * velocity)
        for fraction in shares
    ]

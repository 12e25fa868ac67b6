"""Galaxies in equilibrium, and encounters of two galaxies on an orbit.

Discs are exponential with a vertical sech² profile; spheroids have the profile of
Hernquist or Plummer. Circular velocities are those of all components; velocities are
sampled from local Gaussians whose moments solve the Jeans equations.

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
from animtool.systems.particles.emitter import uniform_samples

# Number of radii at which profiles are tabulated.
RADIUS_COUNT = 4096
# Largest speed relative to the escape velocity.
MAX_SPEED_RATIO = 0.95
# Toomre's constant for stars.
TOOMRE_CONSTANT = 3.36
# Largest radial dispersion relative to the circular velocity.
MAX_DISPERSION_RATIO = 0.7


class MassProfile:
    """Circular and escape velocities of a galaxy at radii ``(R,)`` [m]."""

    def __init__(self, galaxy: GalaxyModel, constant: float, softening: float) -> None:
        self.galaxy, self.constant = galaxy, constant
        max_radius = max((p.radius * p.cutoff for p in galaxy.components), default=1.0)
        min_radius = min((p.radius for p in galaxy.components), default=1.0)
        self.r = np.geomspace(
            max(1e-4 * min_radius, 1e-250), 4 * max_radius, RADIUS_COUNT
        )
        mass_inside = np.full(RADIUS_COUNT, galaxy.nucleus)
        for spheroid in (galaxy.bulge, galaxy.halo):
            if spheroid is not None:
                mass_inside = mass_inside + enclosed_mass(spheroid, self.r)
        total_mass = mass_inside
        # Softened bodies attract as Plummer spheres.
        softening_factor = (self.r**2 / (self.r**2 + softening**2)) ** 1.5
        squared_speeds = constant * mass_inside / self.r * softening_factor
        if galaxy.disc is not None:
            total_mass = mass_inside + enclosed_mass(galaxy.disc, self.r)
            squared_disc_velocities = constant * squared_disc_speeds(
                galaxy.disc, self.r
            )
            squared_speeds = squared_speeds + squared_disc_velocities * softening_factor
        self.circular_velocities = np.sqrt(squared_speeds)  # [m/s]
        # [m/s²]
        self.accelerations = constant * total_mass / self.r**2 * softening_factor
        outer_potential = constant * total_mass[-1] / self.r[-1]
        # Escape velocities [m/s].
        potentials = _integral_to_end(self.accelerations, self.r) + outer_potential
        self.escape_velocities = np.sqrt(2 * potentials)

    def velocity_dispersion(self, spheroid: SpheroidModel) -> FloatArray:
        """Return the velocity dispersion of a spheroid ``(R,)`` [m/s]."""
        density = np.gradient(enclosed_mass(spheroid, self.r), self.r) / self.r**2
        density = np.maximum(density, 0.0)
        pressure = _integral_to_end(density * self.accelerations, self.r)
        min_density = density.max() * 1e-12
        squared_dispersions = pressure / np.maximum(density, min_density)
        return np.sqrt(np.where(density > min_density, squared_dispersions, 0.0))


def _integral_to_end(values: FloatArray, r: FloatArray) -> FloatArray:
    """Return the integrals from each radius to the last, by the trapezoidal rule."""
    steps = (values[1:] + values[:-1]) / 2 * np.diff(r)
    return np.append(np.cumsum(steps[::-1])[::-1], 0.0)


# Mass fraction of an infinite profile within radii, in scale radii.
_MASS_FRACTIONS: dict[str, Callable[[Any], Any]] = {
    "exponential": lambda x: 1 - (1 + x) * np.exp(-x),
    "hernquist": lambda x: (x / (1 + x)) ** 2,
    "plummer": lambda x: x**3 / (1 + x**2) ** 1.5,
}


def enclosed_mass(component: SpheroidModel | DiscModel, r: FloatArray) -> FloatArray:
    """Return the enclosed mass of a spheroid or disc at radii [kg]."""
    mass_fraction = _MASS_FRACTIONS[getattr(component, "profile", "exponential")]
    scaled_radii = np.minimum(r / component.radius, component.cutoff)
    fractions = mass_fraction(scaled_radii)
    return np.asarray(component.mass * fractions / mass_fraction(component.cutoff))


def squared_disc_speeds(disc: DiscModel, r: FloatArray) -> FloatArray:
    """Return squared circular velocities of a disc over G [kg/m]."""
    from scipy.special import i0e, i1e, k0e, k1e

    y = np.minimum(r / (2 * disc.radius), 300.0)
    bessel = i0e(y) * k0e(y) - i1e(y) * k1e(y)
    central_density = surface_density(disc, 0.0)
    return np.asarray(4 * np.pi * central_density * disc.radius * y**2 * bessel)


def surface_density(disc: DiscModel, r: FloatArray | float) -> FloatArray:
    """Return surface densities of a disc at radii [kg/m²]."""
    enclosed_fraction = _MASS_FRACTIONS["exponential"](disc.cutoff)
    central_density = disc.mass / (2 * np.pi * disc.radius**2 * enclosed_fraction)
    return np.asarray(central_density * np.exp(-r / disc.radius))


def build_galaxies(spec: NbodyModel) -> list[PointMasses]:
    """Return the bodies of each galaxy of a spec at the start positions."""
    constant, softening = spec.gravity_constant, spec.softening
    galaxies = [build_galaxy(galaxy, constant, softening) for galaxy in spec.galaxies]
    initial_motions = [
        (np.array(galaxy.at), np.array(galaxy.velocity)) for galaxy in spec.galaxies
    ]
    if spec.encounter is not None:
        masses = [galaxy.masses.sum() for galaxy in galaxies]
        initial_motions = orbit_motions(spec.encounter, masses, constant)
    placed_galaxies = []
    for model, bodies, (centre, v) in zip(
        spec.galaxies, galaxies, initial_motions, strict=True
    ):
        galaxy_frame = matter.UnitFrame(centre, unit_quaternion(model.rotate))
        points = galaxy_frame.to_scene(bodies.points)
        velocities = galaxy_frame.velocities_to_scene(bodies.velocities) + v
        placed_galaxies.append(PointMasses(points, velocities, bodies.masses))
    return placed_galaxies


def build_galaxy(galaxy: GalaxyModel, constant: float, softening: float) -> PointMasses:
    """Return the bodies of a galaxy about its centre; those of the halo are last."""
    profile = MassProfile(galaxy, constant, softening)
    components = []
    if galaxy.nucleus:
        origin = np.zeros((1, 3))
        components.append(PointMasses(origin, origin, np.array([galaxy.nucleus])))
    if galaxy.disc is not None:
        components.append(_build_disc(galaxy.disc, profile, galaxy.seed))
    for component_index, spheroid in enumerate((galaxy.bulge, galaxy.halo)):
        if spheroid is not None:
            seed = galaxy.seed + 1000 * (component_index + 1)
            components.append(_build_spheroid(spheroid, profile, seed))
    bodies = PointMasses.concatenate(components)
    # Its centre of mass is at the position and velocity of the file.
    weights = bodies.masses / bodies.masses.sum()
    x, v = (values + -weights @ values for values in (bodies.points, bodies.velocities))
    return PointMasses(x, v, bodies.masses)


def _build_spheroid(
    spheroid: SpheroidModel, profile: MassProfile, seed: int
) -> PointMasses:
    """Return the bodies of a spheroid about its centre."""
    u = uniform_samples(seed, np.arange(spheroid.count), 6)
    masses_inside = enclosed_mass(spheroid, profile.r)
    r = np.interp(u[:, 0] * spheroid.mass, masses_inside, profile.r)
    dispersions = np.interp(r, profile.r, profile.velocity_dispersion(spheroid))
    max_speeds = MAX_SPEED_RATIO * np.interp(r, profile.r, profile.escape_velocities)
    velocities = dispersions[:, None] * matter.normal_samples(u[:, 3:6])
    speeds = np.linalg.norm(velocities, axis=1)
    velocities *= np.minimum(max_speeds / np.maximum(speeds, 1e-300), 1.0)[:, None]
    masses = np.full(spheroid.count, spheroid.mass / spheroid.count)
    points = r[:, None] * matter.random_directions(u[:, 1:3])
    return PointMasses(points, velocities, masses)


def _build_disc(disc: DiscModel, profile: MassProfile, seed: int) -> PointMasses:
    """Return the bodies of a disc about its centre."""
    u = uniform_samples(seed, np.arange(disc.count), 6)
    r = np.interp(u[:, 0] * disc.mass, enclosed_mass(disc, profile.r), profile.r)
    angles = 2 * np.pi * u[:, 1]
    scale_height = disc.thickness * disc.radius
    heights = scale_height * np.arctanh(np.clip(2 * u[:, 2] - 1, -0.999, 0.999))
    velocity_tables = disc_velocities(disc, profile)
    radial, azimuthal, vertical_dispersion, mean_rotation = (
        np.interp(r, profile.r, table) for table in velocity_tables
    )
    normal = matter.normal_samples(u[:, 3:6])
    radial_velocities = radial * normal[:, 0]
    azimuthal_velocities = mean_rotation + azimuthal * normal[:, 1]
    cos, sin = np.cos(angles), np.sin(angles)
    # Right-handed about y: from z to x.
    points = np.stack([r * sin, heights, r * cos], axis=1)
    x = radial_velocities * sin + azimuthal_velocities * cos
    z = radial_velocities * cos - azimuthal_velocities * sin
    velocities = np.stack([x, vertical_dispersion * normal[:, 2], z], axis=1)
    return PointMasses(points, velocities, np.full(disc.count, disc.mass / disc.count))


def disc_velocities(
    disc: DiscModel, profile: MassProfile
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return radial, azimuthal and vertical velocity dispersions, and mean rotation.

    All four are at the radii of the profile ``(R,)`` [m/s].
    """
    r, circular = profile.r, profile.circular_velocities
    angular_velocity = circular / r
    squared_frequency = (
        np.gradient(angular_velocity**2, r) * r + 4 * angular_velocity**2
    )
    epicyclic_frequency = np.sqrt(np.maximum(squared_frequency, 1e-300))
    surface_densities = surface_density(disc, r)
    toomre_factor = disc.stability * TOOMRE_CONSTANT * profile.constant
    radial_dispersion = toomre_factor * surface_densities / epicyclic_frequency
    radial_dispersion = np.minimum(radial_dispersion, MAX_DISPERSION_RATIO * circular)
    dispersion_ratio = epicyclic_frequency / np.maximum(2 * angular_velocity, 1e-300)
    squared_drift = radial_dispersion**2 * (
        1 - dispersion_ratio**2 - 2 * r / disc.radius
    )
    mean_rotation = np.sqrt(np.maximum(circular**2 + squared_drift, 0.0))
    height = disc.thickness * disc.radius
    vertical_dispersion = np.sqrt(np.pi * profile.constant * surface_densities * height)
    vertical_dispersion = (
        vertical_dispersion if disc.stability else 0 * vertical_dispersion
    )
    return (
        radial_dispersion,
        radial_dispersion * dispersion_ratio,
        vertical_dispersion,
        mean_rotation,
    )


def orbit_motions(
    orbit: EncounterModel, masses: Sequence[float], constant: float
) -> list[tuple[FloatArray, FloatArray]]:
    """Return start positions and velocities of two galaxies on an orbit."""
    total_mass = sum(masses)
    e, r = orbit.eccentricity, orbit.separation
    semi_latus_rectum = orbit.pericentre * (1 + e)
    cosine = np.clip((semi_latus_rectum / r - 1) / e, -1.0, 1.0) if e > 0 else 1.0
    # Before the pericentre: the true anomaly is negative.
    anomaly = -np.arccos(cosine)
    speed = np.sqrt(constant * total_mass / semi_latus_rectum)
    separation = r * np.array([np.sin(anomaly), 0.0, np.cos(anomaly)])
    velocity = speed * np.array([e + np.cos(anomaly), 0.0, -np.sin(anomaly)])
    orbit_rotation = unit_quaternion(orbit.rotate)
    separation = so3.rotate(orbit_rotation, separation)
    velocity = so3.rotate(orbit_rotation, velocity)
    mass_fractions = -masses[1] / total_mass, masses[0] / total_mass
    return [
        (np.array(orbit.at) + fraction * separation, fraction * velocity)
        for fraction in mass_fractions
    ]

"""Gravity, constant and central forces, springs and propulsion."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.options import Range
from animtool.core.record import dataclass
from animtool.systems.particles.forces.base import (
    AnyVector,
    Finite,
    Force,
    NonNegative,
    Time,
    Vector,
    unit_vectors,
)
from animtool.systems.particles.state import ParticleState

# Slower particles count as stopped by a brake [m/s].
MIN_BRAKED_SPEED = 1e-9


@dataclass(frozen=True)
class Gravity(Force):
    """Uniform acceleration, such as gravity."""

    acceleration: Vector = (0.0, -9.81, 0.0)  # [m/s²]

    is_variable = False

    def force(
        self, t: Time, x: FloatArray, v: FloatArray, particles: ParticleState
    ) -> FloatArray:
        """Return forces ``(N, 3)`` [N]."""
        return np.outer(particles.masses, self.acceleration)

    def potential(self, x: FloatArray, particles: ParticleState) -> FloatArray:
        """Return potential energies ``(N,)`` [J]."""
        return np.asarray(-particles.masses * (x @ np.asarray(self.acceleration)))


@dataclass(frozen=True)
class Uniform(Force):
    """Uniform force on each particle, whatever its mass."""

    push: Vector = (0.0, 0.0, 0.0)  # [N]

    is_variable = False

    def force(
        self, t: Time, x: FloatArray, v: FloatArray, particles: ParticleState
    ) -> FloatArray:
        """Return forces ``(N, 3)`` [N]."""
        return np.tile(np.asarray(self.push, np.float64), (len(x), 1))

    def potential(self, x: FloatArray, particles: ParticleState) -> FloatArray:
        """Return potential energies ``(N,)`` [J]."""
        return -(x @ np.asarray(self.push, np.float64))


@dataclass(frozen=True)
class Central(Force):
    """Acceleration towards a centre."""

    centre: Vector = (0.0, 0.0, 0.0)  # [m]
    strength: Finite = 1.0  # acceleration at one metre [m/s²]; negative repels
    power: Finite = -2.0  # exponent of the distance: -2 for gravity and charges
    softening: NonNegative = 0.01  # softening length [m]

    def force(
        self, t: Time, x: FloatArray, v: FloatArray, particles: ParticleState
    ) -> FloatArray:
        """Return forces ``(N, 3)`` [N]."""
        offsets = np.asarray(self.centre) - x
        distance = self._distance(x)[:, None]
        unit_force = particles.masses[:, None] * offsets * self.strength
        return np.asarray(unit_force * distance ** (self.power - 1))

    def _distance(self, x: FloatArray) -> FloatArray:
        """Return the softened distances from the centre ``(N,)`` [m]."""
        offsets = x - np.asarray(self.centre)
        return np.asarray(np.sqrt((offsets * offsets).sum(axis=1) + self.softening**2))

    def potential(self, x: FloatArray, particles: ParticleState) -> FloatArray:
        """Return potential energies ``(N,)`` [J]."""
        distance = self._distance(x)
        if self.power == -1:
            return np.asarray(particles.masses * self.strength * np.log(distance))
        powers = distance ** (self.power + 1) / (self.power + 1)
        return np.asarray(particles.masses * self.strength * powers)

    def faults(self) -> list[tuple[str, str]]:
        """Return the names of invalid options, each with a message."""
        faults = super().faults()
        if self.power < 1 and not self.softening > 0:
            faults.append(("softening", "must be above 0 if the power is below 1"))
        return faults


@dataclass(frozen=True)
class Spring(Force):
    """A spring to a point, or to each particle's birth position."""

    anchor: AnyVector = None  # the point [m]; None for each particle's birth position
    k: NonNegative = 1.0  # stiffness [N/m]
    rest: NonNegative = 0.0  # rest length [m]
    kd: NonNegative = 0.0  # damping along the spring [kg/s]

    def force(
        self, t: Time, x: FloatArray, v: FloatArray, particles: ParticleState
    ) -> FloatArray:
        """Return forces ``(N, 3)`` [N]."""
        offsets = x - self._anchors(particles)
        if self.rest == 0 and self.kd == 0:
            return -self.k * offsets
        directions, length = unit_vectors(offsets)
        elongation_rate = (v * directions).sum(axis=1)[:, None]
        tension = self.k * (length - self.rest) + self.kd * elongation_rate
        return np.asarray(-tension * directions)

    def jacobians(
        self, t: Time, x: FloatArray, v: FloatArray, particles: ParticleState
    ) -> tuple[FloatArray, FloatArray]:
        """Return Jacobians of spring and damper by position and velocity."""
        identity = np.eye(3)
        offsets = x - self._anchors(particles)
        stiffness = np.broadcast_to(-self.k * identity, (len(x), 3, 3))
        if self.rest == 0 and self.kd == 0:
            return stiffness, np.zeros_like(stiffness)
        directions, length = unit_vectors(offsets)
        outer_products = directions[:, :, None] * directions[:, None]
        length_ratio = np.zeros_like(length)
        np.divide(self.rest, length, out=length_ratio, where=length > 0)
        by_position = stiffness + self.k * length_ratio[:, :, None] * (
            identity - outer_products
        )
        return by_position, -self.kd * outer_products

    def _anchors(self, particles: ParticleState) -> FloatArray:
        """Return the anchor of each particle ``(N, 3)``, or of all ``(3,)`` [m]."""
        return particles.origins if self.anchor is None else np.asarray(self.anchor)

    def potential(self, x: FloatArray, particles: ParticleState) -> FloatArray:
        """Return potential energies ``(N,)`` [J]."""
        elongations = np.linalg.norm(x - self._anchors(particles), axis=1) - self.rest
        return np.asarray(0.5 * self.k * elongations**2)

    def stiffness(self) -> float:
        """Return the stiffness of the spring [N/m]."""
        return self.k

    def damping(self, v: FloatArray, particles: ParticleState) -> float:
        """Return the damping of the spring [kg/s]."""
        return self.kd


@dataclass(frozen=True)
class Propulsion(Force):
    """Thrust along the velocity, or in a fixed direction."""

    thrust: Finite = 0.0  # [N]; negative brakes
    direction: AnyVector = None  # of any length above 0; None for along the velocity
    # Duration after birth [s].
    duration: Annotated[float, Range("finite and at least 0", "SIM022", 0.0)] = math.inf

    def force(
        self, t: Time, x: FloatArray, v: FloatArray, particles: ParticleState
    ) -> FloatArray:
        """Return forces ``(N, 3)`` [N]."""
        axis = v
        if self.direction is not None:
            axis = np.broadcast_to(np.asarray(self.direction, np.float64), x.shape)
        directions, _ = unit_vectors(axis)
        is_burning = (t - particles.births <= self.duration)[:, None]
        return np.asarray(self.thrust * directions * is_burning)

    def jacobians(
        self, t: Time, x: FloatArray, v: FloatArray, particles: ParticleState
    ) -> tuple[FloatArray, FloatArray]:
        """Return Jacobians: force over speed for a brake, zero for a thrust."""
        zeros = np.zeros((len(x), 3, 3))
        if self.direction is not None or self.thrust >= 0:
            return zeros, zeros
        is_burning = t - particles.births <= self.duration
        speed = np.maximum(np.linalg.norm(v, axis=1), MIN_BRAKED_SPEED)
        return zeros, (self.thrust * is_burning / speed)[:, None, None] * np.eye(3)

    def faults(self) -> list[tuple[str, str]]:
        """Return the names of invalid options, each with a message."""
        faults = super().faults()
        if self.direction is not None and not any(self.direction):
            faults.append(("direction", "must not be all 0"))
        return faults

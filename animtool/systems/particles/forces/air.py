"""Forces of a medium: drag, viscosity, wind, friction."""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.record import dataclass
from animtool.systems.particles.forces.base import (
    Force,
    NonNegative,
    Positive,
    Time,
    Vector,
    unit_vectors,
)
from animtool.systems.particles.state import ParticleState


@dataclass(frozen=True)
class Drag(Force):
    """Drag against the velocity, linear and quadratic."""

    linear: NonNegative = 0.0  # [kg/s]
    quadratic: NonNegative = 0.0  # density · area · coefficient / 2 [kg/m]

    is_dissipative = True

    def force(
        self, t: Time, x: FloatArray, v: FloatArray, particles: ParticleState
    ) -> FloatArray:
        """Return forces ``(N, 3)`` [N]."""
        if self.quadratic == 0:
            return -self.linear * v
        speed = np.linalg.norm(v, axis=1)[:, None]
        return np.asarray(-(self.linear + self.quadratic * speed) * v)

    def jacobians(
        self, t: Time, x: FloatArray, v: FloatArray, particles: ParticleState
    ) -> tuple[FloatArray, FloatArray]:
        """Return the Jacobians of the force, as `Force.jacobians` does."""
        directions, speed = unit_vectors(v)
        isotropic = (self.linear + self.quadratic * speed)[:, :, None] * np.eye(3)
        radial = (self.quadratic * speed)[:, :, None] * directions[:, :, None]
        return np.zeros_like(isotropic), -isotropic - radial * directions[:, None]

    def damping(self, v: FloatArray, particles: ParticleState) -> float:
        """Return the damping coefficient of the force [kg/s]."""
        max_speed = float(np.linalg.norm(v, axis=1).max(initial=0.0))
        return self.linear + 2 * self.quadratic * max_speed


@dataclass(frozen=True)
class Viscosity(Force):
    """Stokes drag of small, slow spheres: ``6 π η r v``."""

    viscosity: NonNegative = 1e-3  # of the medium [Pa s]; water 1e-3, air 1.8e-5

    is_dissipative = True

    def force(
        self, t: Time, x: FloatArray, v: FloatArray, particles: ParticleState
    ) -> FloatArray:
        """Return forces ``(N, 3)`` [N]."""
        return -6 * np.pi * self.viscosity * particles.radii[:, None] * v

    def jacobians(
        self, t: Time, x: FloatArray, v: FloatArray, particles: ParticleState
    ) -> tuple[FloatArray, FloatArray]:
        """Return the Jacobians of the force, as `Force.jacobians` does."""
        drag = (6 * np.pi * self.viscosity * particles.radii)[:, None, None] * np.eye(3)
        return np.zeros_like(drag), -drag

    def damping(self, v: FloatArray, particles: ParticleState) -> float:
        """Return the damping coefficient of the force [kg/s]."""
        return 6 * np.pi * self.viscosity * float(particles.radii.max(initial=0.0))


@dataclass(frozen=True)
class Wind(Force):
    """Drag relative to moving air."""

    velocity: Vector = (0.0, 0.0, 0.0)  # of the air [m/s]
    drag: NonNegative = 0.0  # drag coefficient [kg/s]

    def force(
        self, t: Time, x: FloatArray, v: FloatArray, particles: ParticleState
    ) -> FloatArray:
        """Return forces ``(N, 3)`` [N]."""
        return self.drag * (np.asarray(self.velocity, np.float64) - v)

    def jacobians(
        self, t: Time, x: FloatArray, v: FloatArray, particles: ParticleState
    ) -> tuple[FloatArray, FloatArray]:
        """Return the Jacobians of the force, as `Force.jacobians` does."""
        drag = np.broadcast_to(self.drag * np.eye(3), (len(x), 3, 3))
        return np.zeros_like(drag), -drag

    def damping(self, v: FloatArray, particles: ParticleState) -> float:
        """Return the damping coefficient of the force [kg/s]."""
        return self.drag


@dataclass(frozen=True)
class Friction(Force):
    """Dry friction against the velocity, everywhere.

    Friction on surfaces is an option of colliders.
    """

    deceleration: NonNegative = 0.0  # [m/s²]
    # Below this speed it fades to 0, so that it never reverses the motion [m/s].
    smooth: Positive = 0.01

    is_dissipative = True

    def force(
        self, t: Time, x: FloatArray, v: FloatArray, particles: ParticleState
    ) -> FloatArray:
        """Return forces ``(N, 3)`` [N]."""
        speed = np.sqrt((v * v).sum(axis=1) + self.smooth**2)
        coefficients = self.deceleration * particles.masses / speed
        return np.asarray(-coefficients[:, None] * v)

    def jacobians(
        self, t: Time, x: FloatArray, v: FloatArray, particles: ParticleState
    ) -> tuple[FloatArray, FloatArray]:
        """Return Jacobians of 0 and of force over speed: motion is never reversed."""
        speed = np.sqrt((v * v).sum(axis=1) + self.smooth**2)
        coefficients = self.deceleration * particles.masses / speed
        drag = coefficients[:, None, None] * np.eye(3)
        return np.zeros_like(drag), -drag

    def damping(self, v: FloatArray, particles: ParticleState) -> float:
        """Return the damping coefficient of the force [kg/s]."""
        speed = np.sqrt((v * v).sum(axis=1) + self.smooth**2)
        return float((self.deceleration * particles.masses / speed).max(initial=0.0))

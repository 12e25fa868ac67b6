"""The particles that live at a time, as integrators see them."""

from __future__ import annotations

import math

import numpy as np

from animtool._types import FloatArray
from animtool.sim.colliders.colliding import Colliders, Contacts, collide
from animtool.sim.system import Energy, FirstOrder, SecondOrder
from animtool.systems.particles.setup import Particles
from animtool.systems.particles.state import ParticleState


class _Living:
    """What particles under forces and in a field have in common."""

    def __init__(
        self,
        setup: Particles,
        colliders: Colliders,
        particles: ParticleState,
        state: FloatArray,
    ) -> None:
        self.setup, self.particles = setup, particles
        self.settles = colliders.meet
        self.contacts: Contacts | None = None
        self._colliders = colliders
        self._state = state

    @property
    def state(self) -> FloatArray:
        """Where they start."""
        return self._state


class ParticleForces(_Living, SecondOrder):
    """Particles that forces move."""

    def acceleration(self, t: float, x: FloatArray, v: FloatArray) -> FloatArray:
        """Return accelerations ``(N, 3)`` [m/s²]."""
        return accelerations(self.setup, self.particles, t, x, v)

    def settle(
        self, t: float, h: float, before: FloatArray, after: FloatArray
    ) -> FloatArray:
        """Return where colliders let a step end."""
        x, v = after
        done = collide(x, v, before, self._colliders, t - h, t, self.particles.radii)
        self.contacts = done.contacts
        if not done.contacts.any.any():
            return after
        return np.stack([done.points, done.velocities])

    def energy(self, t: float, state: FloatArray) -> Energy | None:  # noqa: ARG002
        """Return kinetic and potential energy, None where a force has none."""
        found, known = energies(self.setup, self.particles, state)
        if not known:
            return None
        kinetic, potential = found.sum(axis=1).tolist()
        supply = float(self.particles.masses.sum()) * self._colliders.fastest**2
        return Energy(kinetic, potential, supply)

    def frequencies(self, t: float, state: FloatArray) -> FloatArray | None:  # noqa: ARG002
        """Return the fastest motions that forces bring about ``(M, 2)``."""
        if not len(self.particles):
            return None
        forces, mass = self.setup.forces, float(self.particles.masses.min())
        stiffness = sum(force.stiffness() for force in forces) / mass
        damping = (
            sum(force.damping(state[1], self.particles) for force in forces) / mass
        )
        turning = max((force.turning(self.particles) for force in forces), default=0.0)
        rows = [(turning, 0.0)] if turning > 0 else []
        if stiffness > 0:
            omega = math.sqrt(stiffness)
            rows.append((omega, damping / (2 * omega)))
        elif damping > 0:
            rows.append((damping, 1.0))
        return np.array(rows) if rows else None

    def suspect(self, t: float, state: FloatArray) -> str:
        """Return which particle is accelerated most."""
        pulls = np.linalg.norm(self.acceleration(t, *state), axis=1)
        return (
            f"particle {int(self.particles.ids[np.argmax(pulls)])} is accelerated most"
        )


class ParticleFlow(_Living, FirstOrder):
    """Particles that go with a velocity field; the state is where they are."""

    def rate(self, t: float, y: FloatArray) -> FloatArray:
        """Return velocities ``(N, 3)`` [m/s]."""
        assert self.setup.velocity is not None
        return self.setup.velocity.velocity(t, y, self.particles)

    def settle(
        self, t: float, h: float, before: FloatArray, after: FloatArray
    ) -> FloatArray:
        """Return where colliders let a step end."""
        speed = (after - before) / h
        start = np.stack([before, speed])
        done = collide(
            after, speed, start, self._colliders, t - h, t, self.particles.radii
        )
        self.contacts = done.contacts
        return done.points if done.contacts.any.any() else after


def particle_system(
    setup: Particles, colliders: Colliders, particles: ParticleState, state: FloatArray
) -> ParticleForces | ParticleFlow:
    """Return particles in a state ``(2, N, 3)`` as a system."""
    if setup.velocity is not None:
        return ParticleFlow(setup, colliders, particles, state[0])
    return ParticleForces(setup, colliders, particles, state)


def energies(
    setup: Particles, particles: ParticleState, state: FloatArray
) -> tuple[FloatArray, bool]:
    """Return kinetic and potential energies ``(2, N)`` [J], and whether that is all.

    What forces without a potential do is left out.
    """
    x, v = state
    kinetic = 0.5 * particles.masses * (v * v).sum(axis=1)
    potentials = [force.potential(x, particles) for force in setup.forces]
    known = [found for found in potentials if found is not None]
    potential = np.sum(known, axis=0) if known else np.zeros(len(particles))
    return np.stack([kinetic, potential]), len(known) == len(potentials)


def accelerations(
    setup: Particles,
    particles: ParticleState,
    t: float | FloatArray,
    x: FloatArray,
    v: FloatArray,
) -> FloatArray:
    """Return what all forces do ``(N, 3)`` [m/s²]; times may be one each."""
    whole = np.zeros_like(x)
    for force in setup.forces:
        whole += force.force(t, x, v, particles)
    return whole / particles.masses[:, None]

"""Particles as systems for integrators, and checks for divergence."""

from __future__ import annotations

import math

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.sim.colliders.bodies import Wrenches, exchange_impulses
from animtool.sim.colliders.colliding import (
    Colliders,
    CollisionResult,
    Contacts,
    collide,
)
from animtool.sim.system import Energy, FirstOrder, SecondOrder
from animtool.systems.particles.setup import Particles
from animtool.systems.particles.state import ParticleState


class _ParticleSystem:
    """Base of particles moved by forces, or by a velocity field."""

    def __init__(
        self,
        setup: Particles,
        colliders: Colliders,
        particles: ParticleState,
        state: FloatArray,
    ) -> None:
        self.setup, self.particles = setup, particles
        self.settles = colliders.has_any
        self.contacts: Contacts | None = None
        # Impulses on the bodies of each system so far.
        self.wrenches = [Wrenches.zeros(system.count) for system in colliders.bodies]
        self._colliders = colliders
        self._state = state

    @property
    def state(self) -> FloatArray:
        """State at the start of the step: positions, and velocities with forces."""
        return self._state


class ParticleForces(_ParticleSystem, SecondOrder):
    """Particles that are moved by forces."""

    def acceleration(self, t: float, x: FloatArray, v: FloatArray) -> FloatArray:
        """Return accelerations ``(N, 3)`` [m/s²]."""
        return force_accelerations(self.setup, self.particles, t, x, v)

    def settle(
        self, t: float, h: float, before: FloatArray, after: FloatArray
    ) -> FloatArray:
        """Return the state after collisions."""
        x, v = after
        radii = self.particles.radii
        collision = collide(x, v, before, self._colliders, t - h, t, radii)
        self.contacts = collision.contacts
        if not collision.contacts.any.any():
            return after
        return self._exchange_momentum(t, h, after, collision)

    def _exchange_momentum(
        self,
        t: float,
        h: float,
        without_contacts: FloatArray,
        collision: CollisionResult,
    ) -> FloatArray:
        """Return the state after contacts exchanged momentum with bodies."""
        state = np.stack([collision.points, collision.velocities])
        static_count = len(self._colliders)
        for i, system in enumerate(self._colliders.bodies):
            shape_indices = collision.contacts.colliders - static_count
            shape_indices[shape_indices >= len(system.colliders)] = -1
            static_count += len(system.colliders)
            if not system.count:
                continue
            masses = self.particles.masses
            state, wrenches = exchange_impulses(
                system, t, shape_indices, without_contacts, state, masses
            )
            self.wrenches[i] = Wrenches.sum([self.wrenches[i].delayed_by(h), wrenches])
        return state

    def energy(self, t: float, state: FloatArray) -> Energy | None:  # noqa: ARG002
        """Return the energy of a state; None if a force has no potential."""
        # Energies of resumed states may overflow.
        with np.errstate(over="ignore", invalid="ignore"):
            energies, has_all_potentials = particle_energies(
                self.setup, self.particles, state
            )
            if not has_all_potentials:
                return None
            kinetic, potential = energies.sum(axis=1).tolist()
            supply = float(self.particles.masses.sum()) * self._colliders.max_speed**2
        return Energy(kinetic, potential, supply)

    def frequencies(self, t: float, state: FloatArray) -> FloatArray | None:  # noqa: ARG002
        """Return the fastest modes of the forces ``(M, 2)``."""
        if not len(self.particles):
            return None
        # A numpy number: division by a mass of 0 in a resumed state must not raise.
        forces, mass = self.setup.forces, self.particles.masses.min()
        stiffness = sum(force.stiffness() for force in forces) / mass
        damping = (
            sum(force.damping(state[1], self.particles) for force in forces) / mass
        )
        rotation_rates = [force.turning(self.particles) for force in forces]
        rotation_rate = max(rotation_rates, default=0.0)
        modes = [(rotation_rate, 0.0)] if rotation_rate > 0 else []
        if stiffness > 0:
            omega = math.sqrt(stiffness)
            modes.append((omega, damping / (2 * omega)))
        elif damping > 0:
            modes.append((damping, 1.0))
        return np.array(modes) if modes else None

    def suspected_cause(self, t: float, state: FloatArray) -> str:
        """Return which particle has the largest acceleration, as text."""
        magnitudes = np.linalg.norm(self.acceleration(t, *state), axis=1)
        particle = int(self.particles.ids[np.argmax(magnitudes)])
        return f"particle {particle} has the largest acceleration"


class ParticleFlow(_ParticleSystem, FirstOrder):
    """Particles that a velocity field moves; the state is their positions."""

    def rate(self, t: float, y: FloatArray) -> FloatArray:
        """Return velocities ``(N, 3)`` [m/s]."""
        assert self.setup.velocity is not None
        return self.setup.velocity.velocity(t, y, self.particles)

    def settle(
        self, t: float, h: float, before: FloatArray, after: FloatArray
    ) -> FloatArray:
        """Return the state after collisions."""
        velocities = (after - before) / h
        start_state = np.stack([before, velocities])
        radii = self.particles.radii
        collision = collide(
            after, velocities, start_state, self._colliders, t - h, t, radii
        )
        self.contacts = collision.contacts
        return collision.points if collision.contacts.any.any() else after


def particle_energies(
    setup: Particles, particles: ParticleState, motion: FloatArray
) -> tuple[FloatArray, bool]:
    """Return kinetic and potential energies ``(2, N)`` [J].

    Also returns whether all forces have a potential; forces without one are left out.
    """
    x, v = motion
    kinetic = 0.5 * particles.masses * (v * v).sum(axis=1)
    potentials = [force.potential(x, particles) for force in setup.forces]
    known_potentials = [values for values in potentials if values is not None]
    if known_potentials:
        potential = np.sum(known_potentials, axis=0)
    else:
        potential = np.zeros(len(particles))
    return np.stack([kinetic, potential]), len(known_potentials) == len(potentials)


def force_accelerations(
    setup: Particles,
    particles: ParticleState,
    t: float | FloatArray,
    x: FloatArray,
    v: FloatArray,
) -> FloatArray:
    """Return the accelerations of all forces ``(N, 3)`` [m/s²].

    The time is one for all particles, or one per particle ``(N,)`` [s].
    """
    total_forces = np.zeros_like(x)
    for force in setup.forces:
        total_forces += force.force(t, x, v, particles)
    return total_forces / particles.masses[:, None]


def advance_births(
    setup: Particles,
    colliders: Colliders,
    particles: ParticleState,
    birth_states: FloatArray,
    t0: float,
    t1: float,
) -> FloatArray:
    """Return new particles at the end of the step in which they are born.

    Each starts at its birth time, so that streams have no clumps. Births are always
    integrated by the classical Runge-Kutta method, and do not act on other particles
    before the next step.

    ``birth_states`` are positions and velocities at birth ``(2, N, 3)``. The step is
    from ``t0`` to ``t1`` [s].
    """
    births, radii = particles.births, particles.radii
    end_states = _integrate_births(setup, particles, birth_states, t1 - births)
    if not colliders.has_any:
        return end_states
    x, v = end_states
    collision = collide(x, v, birth_states, colliders, t0, t1, radii, births)
    return np.stack([collision.points, collision.velocities])


def _integrate_births(
    setup: Particles,
    particles: ParticleState,
    birth_states: FloatArray,
    durations: FloatArray,
) -> FloatArray:
    """Advance new particles by their first partial step, by classical Runge-Kutta."""
    h = durations[:, None]

    def rate(fraction: float, state: FloatArray) -> FloatArray:
        times = particles.births + fraction * durations
        if setup.velocity is not None:
            velocities = setup.velocity.velocity(times, state[0], particles)
            return np.stack([velocities, np.zeros_like(velocities)])
        accelerations = force_accelerations(setup, particles, times, *state)
        return np.stack([state[1], accelerations])

    k1 = rate(0.0, birth_states)
    k2 = rate(0.5, birth_states + h / 2 * k1)
    k3 = rate(0.5, birth_states + h / 2 * k2)
    k4 = rate(1.0, birth_states + h * k3)
    return np.asarray(birth_states + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4))


class DivergenceCheck:
    """Detects divergence: particles with non-finite states or too much energy.

    The energy of a particle is relative to that when it was first observed. Births and
    removals are thus no gains, and a slow divergence accumulates over many steps.
    Moving colliders may add the kinetic energy of particles at their speed. If a force
    has no potential, energies are only checked if steps are too long for it, and never
    with pair forces.
    """

    def __init__(self, setup: Particles, colliders: Colliders) -> None:
        self._setup, self._colliders = setup, colliders
        self._particles = ParticleState.empty()
        self._ids: IntArray = np.zeros(0, np.int64)
        # Kinetic and potential energy of each particle when first observed ``(2, N)``.
        self._first_energies: FloatArray = np.zeros((2, 0))
        self.has_long_steps = False

    def set_particles(self, particles: ParticleState, state: FloatArray) -> None:
        """Set the particles to check, in a state ``(2, N, 3)``."""
        if particles is self._particles or self._setup.velocity is not None:
            return
        indices = np.searchsorted(self._ids, particles.ids)
        indices = np.minimum(indices, max(len(self._ids) - 1, 0))
        is_known = np.zeros(len(particles), bool)
        if len(self._ids):
            is_known = self._ids[indices] == particles.ids
        first_energies = np.zeros((2, len(particles)))
        first_energies[:, is_known] = self._first_energies[:, indices[is_known]]
        is_new = ~is_known
        first_energies[:, is_new] = particle_energies(
            self._setup, particles.select(is_new), state[:, is_new]
        )[0]
        self._particles = particles
        self._ids = particles.ids
        self._first_energies = first_energies

    def reset_energies(self, is_moved: BoolArray, state: FloatArray) -> None:
        """Reset the first energies of particles that colliders moved."""
        if self._setup.velocity is None and is_moved.any():
            particles = self._particles.select(is_moved)
            energies, _ = particle_energies(self._setup, particles, state[:, is_moved])
            self._first_energies[:, is_moved] = energies

    def divergence_reason(self, t: float, state: FloatArray) -> str:  # noqa: ARG002
        """Return why a state has diverged; empty if it has not."""
        if not np.isfinite(state).all():
            return "its state is not finite"
        if self._setup.velocity is not None:
            return ""
        current_energies, has_all_potentials = particle_energies(
            self._setup, self._particles, state
        )
        has_pair_forces = any(force.is_pair_force for force in self._setup.forces)
        if not has_all_potentials and (has_pair_forces or not self.has_long_steps):
            return ""
        kinetic, potential = self._first_energies.sum(axis=1).tolist()
        current_kinetic, current_potential = current_energies.sum(axis=1).tolist()
        total, first_total = current_kinetic + current_potential, kinetic + potential
        energy_scale = max(
            abs(first_total),
            kinetic,
            abs(potential),
            potential - current_potential,
            float(self._particles.masses.sum()) * self._colliders.max_speed**2,
        )
        if (
            energy_scale > 0
            and not total - first_total <= self._setup.options.growth * energy_scale
        ):
            return f"its energy rose from {first_total:.3g} J to {total:.3g} J"
        return ""

"""Signs that the motion of particles that come and go has blown up."""

from __future__ import annotations

import numpy as np

from animtool._types import BoolArray, FloatArray, IntArray
from animtool.sim.colliders.colliding import Colliders
from animtool.systems.particles.setup import Particles
from animtool.systems.particles.state import ParticleState
from animtool.systems.particles.system import energies


class DivergenceCheck:
    """Looks at particles for numbers and energy beyond bounds.

    The energy of each counts from where it was first seen, so that neither births nor
    removals are taken for gains, and a slow blow-up adds up over many steps. Moving
    colliders may bring in what particles have at their speed. Where a force has no
    potential, energy tells only what is known to be in steps too long; what particles
    give each other without one is not for it to judge.

    Args:
        setup: Whose particles they are.
        colliders: What they run into.
    """

    def __init__(self, setup: Particles, colliders: Colliders) -> None:
        self._setup, self._colliders = setup, colliders
        self._particles = ParticleState.none()
        self._ids: IntArray = np.zeros(0, np.int64)
        # Kinetic and potential energy of each, where it was first seen.
        self._first: FloatArray = np.zeros((2, 0))
        self.too_long = False

    def look_at(self, particles: ParticleState, state: FloatArray) -> None:
        """Look at particles in a state ``(2, N, 3)`` from now on."""
        if particles is self._particles or self._setup.velocity is not None:
            return
        places = np.searchsorted(self._ids, particles.ids)
        places = np.minimum(places, max(len(self._ids) - 1, 0))
        known = np.zeros(len(particles), bool)
        if len(self._ids):
            known = self._ids[places] == particles.ids
        first = np.zeros((2, len(particles)))
        first[:, known] = self._first[:, places[known]]
        new = ~known
        first[:, new] = energies(self._setup, particles.select(new), state[:, new])[0]
        self._particles, self._ids, self._first = particles, particles.ids, first

    def restart(self, which: BoolArray, state: FloatArray) -> None:
        """Count the energy of some from a state on: what was moved out of colliders."""
        if self._setup.velocity is None and which.any():
            some = self._particles.select(which)
            self._first[:, which] = energies(self._setup, some, state[:, which])[0]

    def sign(self, t: float, state: FloatArray) -> str:  # noqa: ARG002
        """Return why a state is beyond bounds, empty where it is not."""
        if not np.isfinite(state).all():
            return "its state is not finite"
        if self._setup.velocity is not None:
            return ""
        now_energies, known = energies(self._setup, self._particles, state)
        pairs = any(force.pairs for force in self._setup.forces)
        if not known and (pairs or not self.too_long):
            return ""
        kinetic, potential = self._first.sum(axis=1).tolist()
        now_kinetic, now_potential = now_energies.sum(axis=1).tolist()
        now, first = now_kinetic + now_potential, kinetic + potential
        usual = max(
            abs(first),
            kinetic,
            abs(potential),
            potential - now_potential,
            float(self._particles.masses.sum()) * self._colliders.fastest**2,
        )
        if usual > 0 and not now - first <= self._setup.options.growth * usual:
            return f"its energy is {now:.3g} J, and was {first:.3g} J"
        return ""

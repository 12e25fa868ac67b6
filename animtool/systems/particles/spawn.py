"""The first part of a step of those who are born within it.

Each begins at a time of its own, so that streams have no lumps at every step. They go
by the classical method of Runge and Kutta whatever the method of the others is, and do
not act on others before the next step.
"""

from __future__ import annotations

import numpy as np

from animtool._types import FloatArray
from animtool.sim.colliders.colliding import Colliders, collide
from animtool.systems.particles.setup import Particles
from animtool.systems.particles.state import ParticleState
from animtool.systems.particles.system import accelerations


def spawned(
    setup: Particles,
    colliders: Colliders,
    particles: ParticleState,
    born: FloatArray,
    t0: float,
    t1: float,
) -> FloatArray:
    """Return particles at the end of the step that they are born in.

    ``born`` ``(2, N, 3)``, ``t0`` [s], ``t1`` [s].
    """
    done = _moved(setup, particles, born, t1 - particles.births)
    if not colliders.meet:
        return done
    found = collide(
        done[0], done[1], born, colliders, t0, t1, particles.radii, particles.births
    )
    return np.stack([found.points, found.velocities])


def _moved(
    setup: Particles, particles: ParticleState, born: FloatArray, spans: FloatArray
) -> FloatArray:
    h = spans[:, None]

    def rate(share: float, state: FloatArray) -> FloatArray:
        times = particles.births + share * spans
        if setup.velocity is not None:
            speed = setup.velocity.velocity(times, state[0], particles)
            return np.stack([speed, np.zeros_like(speed)])
        return np.stack([state[1], accelerations(setup, particles, times, *state)])

    k1 = rate(0.0, born)
    k2 = rate(0.5, born + h / 2 * k1)
    k3 = rate(0.5, born + h / 2 * k2)
    k4 = rate(1.0, born + h * k3)
    return np.asarray(born + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4))

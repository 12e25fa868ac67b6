"""How particles move in a step, and whether their motion blows up."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from animtool._types import BoolArray, FloatArray, IntArray
from animtool.errors import Fault, Severity
from animtool.sim.checks import check_fit, check_start, ending, step_notices
from animtool.sim.colliders.colliding import Colliders, Contacts, Touch
from animtool.sim.equations import Equations
from animtool.sim.integrating import advance, checkpoint_of, stats_of
from animtool.sim.options import check_options
from animtool.sim.run import Run
from animtool.sim.trajectory import Checkpoint, Status
from animtool.systems.particles.setup import Particles
from animtool.systems.particles.state import ParticleState
from animtool.systems.particles.system import (
    ParticleFlow,
    ParticleForces,
    energies,
    particle_system,
)
from animtool.systems.simulation import StoppedError


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


# Motions that are faster by less than this share need no other steps [1].
NOTABLE = 0.05


@dataclass(frozen=True, slots=True)
class Moved:
    """Particles at the end of a step."""

    state: FloatArray  # positions, then velocities ``(2, N, 3)``
    memory: object  # what the method takes along
    trial: float | None  # the step to try next [s]
    contacts: Contacts | None  # what they met; None where there is nothing to meet


class Mover:
    """Takes particles over steps, by one method.

    Attributes:
        notices: Of steps that are too long.
        taken: Steps of the method so far.

    Args:
        setup: What moves them.
        colliders: What they run into.

    Raises:
        OptionError: The method is not for such particles (SIM006).
    """

    def __init__(self, setup: Particles, colliders: Colliders) -> None:
        self._setup, self._colliders = setup, colliders
        self._integrator = check_options(setup.options)
        none = particle_system(
            setup, colliders, ParticleState.none(), np.zeros((2, 0, 3))
        )
        check_fit(Equations(none), self._integrator)
        self._watch = DivergenceCheck(setup, colliders)
        self._fastest: FloatArray | None = None
        self.notices: list[Fault] = []
        self.taken = 0

    def moved(
        self,
        particles: ParticleState,
        state: FloatArray,
        memory: object,
        trial: float | None,
        now: float,
        until: float,
    ) -> Moved:
        """Return particles after a step.

        ``state`` ``(2, N, 3)``, ``trial`` [s], ``now`` [s], ``until`` [s].
        """
        system = particle_system(self._setup, self._colliders, particles, state)
        begin = Checkpoint(now, system.state, memory, trial)
        with np.errstate(all="ignore"):
            self._watch.look_at(particles, state)
            self._look_at_steps(system, begin.state, now, until)
            run = self._run(system, begin, until)
            status = advance(run, until)
            self.taken += run.steps
            if status is not Status.OK:
                self._stop(run, status, [(now, begin.state), (run.time, run.state)])
        end = run.state
        if isinstance(system, ParticleFlow):
            end = np.stack([end, system.rate(until, end)])
        met = system.contacts
        if met is not None:
            # Of colliders that change their shape nobody knows how fast they are.
            driven = met.colliders >= len(self._colliders)
            self._watch.restart(driven | (met.touches == Touch.UNRESOLVED), end)
        after = checkpoint_of(run, status, until, run.state)
        return Moved(end, after.memory, after.trial, system.contacts)

    def _run(
        self, system: ParticleForces | ParticleFlow, begin: Checkpoint, until: float
    ) -> Run:
        return Run(
            self._integrator,
            Equations(system),
            self._setup.options,
            self._watch,
            until,
            begin.time,
            begin.state,
            begin.memory,
            begin.trial,
        )

    def _look_at_steps(
        self,
        system: ParticleForces | ParticleFlow,
        state: FloatArray,
        now: float,
        until: float,
    ) -> None:
        """Note once that steps are too long, looking where motions became faster."""
        if self.notices:
            return
        modes = system.frequencies(now, state)
        if modes is None or not self._faster(modes):
            return
        self._fastest = modes
        equations, options = Equations(system), self._setup.options
        moments = np.array([now, until])
        self.notices = step_notices(
            equations, self._integrator, options, moments, state
        )
        self._watch.too_long = bool(self.notices)

    def _faster(self, modes: FloatArray) -> bool:
        known = self._fastest
        if known is None or known.shape != modes.shape:
            return True
        return bool((np.abs(modes - known) > NOTABLE * known).any())

    def _stop(
        self, run: Run, status: Status, places: list[tuple[float, FloatArray]]
    ) -> None:
        # A force that is no number at once is no blow-up.
        check_start(run.equations, *places[0])
        stats = stats_of(run, status, places)
        why = ending(self._integrator, self._setup.options, stats)
        raise StoppedError(
            [replace(each, severity=Severity.ERROR) for each in [*self.notices, why]],
            stats,
        )

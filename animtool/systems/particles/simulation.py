"""Particle simulation: births, motion, collisions and removal."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.errors import Fault, Severity, warning
from animtool.core.record import dataclass
from animtool.motion.frames import PointsFrame
from animtool.sim.checks import check_fit, check_start, ending, step_notices
from animtool.sim.colliders.bodies import Wrenches
from animtool.sim.colliders.colliding import Colliders, Contacts, Touch
from animtool.sim.equations import Equations
from animtool.sim.integrating import advance, checkpoint_of, stats_of
from animtool.sim.integrators import find_integrator
from animtool.sim.integrators.implicit import Before
from animtool.sim.modes import allowed_step, modes_at
from animtool.sim.options import check_options
from animtool.sim.run import Run
from animtool.sim.system import Energy
from animtool.sim.trajectory import Status
from animtool.systems.framework.simulation import (
    Diagnostics,
    Stepped,
    StoppedError,
    growing,
    later,
)
from animtool.systems.particles.moving import (
    DivergenceCheck,
    ParticleFlow,
    ParticleForces,
    particle_system,
    spawned,
)
from animtool.systems.particles.setup import Particles
from animtool.systems.particles.state import ParticleState

if TYPE_CHECKING:
    from animtool.systems.framework.simulation import SimContext
    from animtool.systems.particles.spec import ParticlesModel

# Frequency growth below this does not change the stable step [1].
NOTABLE = 0.05


@dataclass(frozen=True, slots=True)
class ParticleRunState:
    """The state at the end of a step."""

    particles: ParticleState = field(metadata=growing())  # living particles
    # Positions, then velocities ``(2, N, 3)``.
    state: FloatArray = field(metadata=growing(1))
    born: int = 0  # number born so far
    missed: int = 0  # number without room so far
    # The method's memory, valid as long as the same particles live.
    memory: object = field(default=None, metadata=later(Before))
    # The next trial step [s].
    trial: float | None = field(default=None, metadata=later())


_NOBODY = ParticleRunState(ParticleState.none(), np.zeros((2, 0, 3)))


def build(spec: ParticlesModel, context: SimContext) -> ParticleSimulation:
    """Return the simulation of a spec.

    Raises:
        OptionError: As of `ParticleSimulation`.
    """
    setup, around = spec.setup(context.parts), context.colliders
    setup = replace(
        setup, colliders=around[:], sheets=around.sheets, bodies=around.bodies
    )
    if context.budget is not None:
        options = replace(setup.options, budget=context.budget)
        setup = replace(setup, options=options)
    return ParticleSimulation(setup, context.begin)


class ParticleSimulation:
    """Particles stepped by one method; step statistics only serve warnings.

    Raises:
        OptionError: Something makes no sense (SIM001, SIM004 to SIM006, SIM020 to
            SIM024).
    """

    def __init__(self, setup: Particles, begin: float) -> None:
        setup.check()
        self.setup, self.begin = setup, begin
        self.colliders = Colliders(setup.colliders, setup.sheets, setup.bodies)
        self.contacts: Contacts | None = None  # as in `ParticleRun`
        self._taken = 0  # steps of the method so far
        self._kills = [Colliders([kill.region.volume()]) for kill in setup.kills]
        self._integrator = check_options(setup.options)
        check_fit(Equations(self._system(_NOBODY)), self._integrator)
        self._watch = DivergenceCheck(setup, self.colliders)
        self._fastest: FloatArray | None = None
        self._too_long: list[Fault] = []
        self._notices: list[Fault] = self.colliders.notices()

    def initial(self) -> ParticleRunState:
        """Return the particles born at the start."""
        return self._start

    @cached_property
    def _start(self) -> ParticleRunState:
        begin = self.begin
        return self._with_born(_NOBODY, None, begin, begin, self._notices)

    def step(
        self, state: ParticleRunState, t: float, dt: float
    ) -> Stepped[ParticleRunState]:
        """Return the state after a step [s], or a part of one.

        Particles born in the step push nothing yet.

        Raises:
            OptionError: A force or a field is no number (SIM003).
            StoppedError: It blew up, or the method could not go on (SIM101 to SIM105).
        """
        same, until, notices = state.particles, t + dt, list[Fault]()
        wrenches: Sequence[Wrenches] = ()
        if len(same):
            state, wrenches = self._moved(state, t, until, notices)
        state = self._with_born(state, t, t, until, notices)
        state = self._without_dead(state, until)
        if state.particles is same:
            return Stepped(state, wrenches, notices)
        if not np.isfinite(state.state).all():
            system = self._system(state)
            check_start(Equations(system), until, system.state)
        return Stepped(replace(state, memory=None, trial=None), wrenches, notices)

    def _system(self, state: ParticleRunState) -> ParticleForces | ParticleFlow:
        setup, colliders = self.setup, self.colliders
        return particle_system(setup, colliders, state.particles, state.state)

    def _moved(
        self, state: ParticleRunState, now: float, until: float, notices: list[Fault]
    ) -> tuple[ParticleRunState, Sequence[Wrenches]]:
        """Return particles after a step [s], and impulses on bodies."""
        system, options = self._system(state), self.setup.options
        first = system.state
        with np.errstate(all="ignore"):
            self._watch.look_at(state.particles, state.state)
            self._look_at_steps(system, now, until)
            notices += self._too_long
            run = Run(
                self._integrator,
                Equations(system),
                options,
                self._watch,
                until,
                now,
                first,
                state.memory,
                state.trial,
            )
            status = advance(run, until)
            self._taken += run.steps
            if status is not Status.OK:
                self._stop(run, status, [(now, first), (run.time, run.state)])
        end = run.state
        if isinstance(system, ParticleFlow):
            end = np.stack([end, system.rate(until, end)])
        self.contacts = met = system.contacts
        if met is not None:
            # The speed of deforming colliders is unknown.
            driven = met.colliders >= len(self.colliders)
            self._watch.restart(driven | (met.touches == Touch.UNRESOLVED), end)
            notices += self._stuck_notices(state.particles, met, until)
        after = checkpoint_of(run, status, until, run.state)
        state = replace(state, state=end, memory=after.memory, trial=after.trial)
        return state, system.wrenches

    def _look_at_steps(
        self, system: ParticleForces | ParticleFlow, now: float, until: float
    ) -> None:
        """Warn once if steps are too long for the fastest motion."""
        modes = None if self._too_long else system.frequencies(now, system.state)
        if modes is None:
            return
        known = self._fastest
        faster = np.ones(1, bool)
        if known is not None and known.shape == modes.shape:
            faster = np.abs(modes - known) > NOTABLE * known
        if not faster.any():
            return
        self._fastest = modes
        self._too_long = step_notices(
            Equations(system),
            self._integrator,
            self.setup.options,
            np.array([now, until]),
            system.state,
        )
        self._watch.too_long = bool(self._too_long)

    def _stop(
        self, run: Run, status: Status, samples: list[tuple[float, FloatArray]]
    ) -> None:
        # Forces that are not finite at the start are no divergence.
        check_start(run.equations, *samples[0])
        stats = stats_of(run, status, samples)
        why = [*self._too_long, ending(self._integrator, self.setup.options, stats)]
        raise StoppedError(
            [replace(each, severity=Severity.ERROR) for each in why], stats
        )

    def _with_born(
        self,
        state: ParticleRunState,
        after: float | None,
        now: float,
        until: float,
        notices: list[Fault],
    ) -> ParticleRunState:
        """Return a state with the births of a step, at its end."""
        room = max(self.setup.max_particles - len(state.particles), 0)
        particles, born, beyond = self._born(after, until, state.born, room)
        total = len(particles) + beyond
        missed = max(total - room, 0)
        if missed and not state.missed:
            most = self.setup.max_particles
            message = f"from {until:g} s on, the limit of {most} particles leaves room "
            message += "for "
            hint = "raise max_particles, or lower rates or lifetimes"
            notices.append(
                warning("SIM121", f"{message}no more", hint, self.setup.name)
            )
        state = replace(state, born=state.born + total, missed=state.missed + missed)
        kept = np.arange(len(particles))[:room]
        particles, born = particles.select(kept), born[:, kept]
        if not len(particles):
            return state
        if until > now:
            born = spawned(self.setup, self.colliders, particles, born, now, until)
        elif self.setup.velocity is not None:
            born[1] = self.setup.velocity.velocity(until, born[0], particles)
        return replace(
            state,
            particles=ParticleState.concatenate([state.particles, particles]),
            state=np.concatenate([state.state, born], axis=1),
        )

    def _born(
        self, after: float | None, until: float, first: int, room: int
    ) -> tuple[ParticleState, FloatArray, int]:
        """Return births in order of time, with ids.

        Of each emitter no more are made than there is room for; last is how many more
        there would be.
        """
        particle_sets, states, beyond = [], [], 0
        for emitter in self.setup.emitters:
            births = emitter.births(self.begin, after, until, room)
            beyond += births.missed
            if not len(births.times):
                continue
            x, v, lifetimes, radii = emitter.drawn(births)
            count = len(x)
            particle_sets.append(
                ParticleState(
                    np.zeros(count, np.int64),
                    np.full(count, float(emitter.mass)),
                    np.full(count, float(emitter.charge)),
                    radii,
                    births.times,
                    births.times + lifetimes,
                    x,
                )
            )
            states.append(np.stack([x, v]))
        if not states:
            return ParticleState.none(), np.zeros((2, 0, 3)), beyond
        particles = ParticleState.concatenate(particle_sets)
        state = np.concatenate(states, axis=1)
        order = np.argsort(particles.births, kind="stable")
        particles, state = particles.select(order), state[:, order]
        ids = first + np.arange(len(particles), dtype=np.int64)
        return replace(particles, ids=ids), state, beyond

    def _stuck_notices(
        self, particles: ParticleState, met: Contacts, t: float
    ) -> Iterator[Fault]:
        """Yield a warning about particles stuck in colliders (SIM123)."""
        (stuck,) = np.nonzero(met.touches == Touch.UNRESOLVED)
        if not len(stuck):
            return
        who = f"particle {int(particles.ids[stuck[0]])}"
        which, solid = int(met.colliders[stuck[0]]), self.setup.colliders
        what = [
            *(one.name or f"colliders[{i}]" for i, one in enumerate(solid)),
            *(one.name for system in self.setup.bodies for one in system.colliders),
            *(one.name or f"sheets[{i}]" for i, one in enumerate(self.setup.sheets)),
        ][which]
        message = f"{who} is inside {what!r} at {t:g} s, and cannot be pushed out at "
        hint = "particles start inside, or colliders close in on them from several "
        yield warning("SIM123", f"{message}once", f"{hint}sides", self.setup.name)

    def _without_dead(self, state: ParticleRunState, t: float) -> ParticleRunState:
        kept: BoolArray = state.particles.deaths > t
        for region in self._kills:
            kept = kept & (region.sample(state.state[0], t).distances[0] >= 0)
        if kept.all():
            return state
        return replace(
            state, particles=state.particles.select(kept), state=state.state[:, kept]
        )

    def frame(self, state: ParticleRunState, t: float) -> PointsFrame:
        """Return the particles of a state at its time [s]."""
        particles, (points, velocities) = state.particles, state.state
        ages = {"age": t - particles.births}
        return PointsFrame(particles.ids, points, velocities, particles.radii, ages)

    def diagnostics(self, state: ParticleRunState, t: float) -> Diagnostics:
        """Return energy, if conserved, and warnings."""
        hint = "set a rate or bursts, and a start and a lifetime with which "
        hint += "particles exist in the range"
        message = "there are no particles in any frame"
        nobody = warning("SIM188", message, hint)
        return Diagnostics(
            self._energy(state, t),
            notices=self._notices,
            if_empty=[nobody],
            steps=self._taken,
            stable_step=lambda: self._stable_step(state),
        )

    def _energy(self, state: ParticleRunState, t: float) -> Energy | None:
        system, forces = self._system(state), self.setup.forces
        if isinstance(system, ParticleFlow) or self.colliders.active:
            return None
        damping = (force.damping(state.state[1], state.particles) for force in forces)
        return None if any(damping) else system.energy(t, state.state)

    def _stable_step(self, state: ParticleRunState) -> float | None:
        """Return the largest stable step at a state [s]."""
        integrator = find_integrator(self.setup.options.method)
        if integrator.limit is None or not len(state.particles):
            return None
        system = self._system(state)
        modes = modes_at(Equations(system), self.begin, system.state)
        return None if modes is None else allowed_step(integrator, modes)

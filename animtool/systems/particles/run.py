"""Particles taken through time: who is born, moves, is stopped and removed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.errors import Fault, Severity
from animtool.motion.frames import PointsFrame
from animtool.sim.checks import check_start
from animtool.sim.colliders.bodies import Wrenches
from animtool.sim.colliders.colliding import Colliders, Contacts, Touch
from animtool.sim.equations import Equations
from animtool.sim.integrators.implicit import Before
from animtool.sim.integrators.table import find_integrator
from animtool.sim.modes import allowed_step, modes_at
from animtool.sim.system import Energy
from animtool.systems.particles.moving import (
    Mover,
    ParticleFlow,
    ParticleForces,
    particle_system,
    spawned,
)
from animtool.systems.particles.setup import Particles
from animtool.systems.particles.state import ParticleState
from animtool.systems.run import Reached, SimulationRun
from animtool.systems.simulation import Diagnostics, Stepped, growing, later

_NONE = np.zeros((2, 0, 3))


@dataclass(frozen=True, slots=True)
class ParticleRunState:
    """Where a simulation stands at the end of a step, to go on from."""

    particles: ParticleState = field(metadata=growing())  # who lives
    # Positions, then velocities ``(2, N, 3)``.
    state: FloatArray = field(metadata=growing(1))
    born: int = 0  # how many were born so far
    missed: int = 0  # how many were not, for want of room
    # What the method takes along, as long as the same particles live.
    memory: object = field(default=None, metadata=later(Before))
    # The step to try next [s].
    trial: float | None = field(default=None, metadata=later())


class ParticleSimulation:
    """Particles in steps; what moved them is kept for warnings alone.

    Raises:
        OptionError: Something makes no sense (SIM001, SIM004 to SIM006, SIM020 to
            SIM024).
    """

    def __init__(self, setup: Particles, begin: float) -> None:
        setup.check()
        self.setup, self.begin = setup, begin
        self.colliders = Colliders(setup.colliders, setup.sheets, setup.bodies)
        self.contacts: Contacts | None = None  # as in `ParticleRun`
        self._notices: list[Fault] = self.colliders.notices()
        self._kills = [Colliders([kill.region.volume()]) for kill in setup.kills]
        self._held = False
        self._mover = Mover(setup, self.colliders)

    def initial(self) -> ParticleRunState:
        """Return those who are born at the very beginning."""
        nobody = ParticleRunState(ParticleState.none(), _NONE)
        return self._with_born(nobody, None, self.begin, self.begin)

    def step(
        self, state: ParticleRunState, t: float, dt: float
    ) -> Stepped[ParticleRunState]:
        """Return who lives a step later, or a part of one [s].

        Those who are born in the step push nothing yet.

        Raises:
            OptionError: A force or a field is no number (SIM003).
            StoppedError: It blew up, or the method could not go on (SIM101 to SIM105).
        """
        same, until = state.particles, t + dt
        wrenches: Sequence[Wrenches] = ()
        if len(same):
            state, wrenches = self._moved(state, t, until)
        state = self._with_born(state, t, t, until)
        state = self._without_dead(state, until)
        if state.particles is same:
            return Stepped(state, wrenches)
        if not np.isfinite(state.state).all():
            system = self._system(state)
            check_start(Equations(system), until, system.state)
        return Stepped(replace(state, memory=None, trial=None), wrenches)

    def _system(self, state: ParticleRunState) -> ParticleForces | ParticleFlow:
        setup, colliders = self.setup, self.colliders
        return particle_system(setup, colliders, state.particles, state.state)

    def _moved(
        self, state: ParticleRunState, now: float, until: float
    ) -> tuple[ParticleRunState, Sequence[Wrenches]]:
        said = len(self._mover.notices)
        moved = self._mover.moved(
            state.particles, state.state, state.memory, state.trial, now, until
        )
        self._notices += self._mover.notices[said:]
        self.contacts = moved.contacts
        self._say_held(state.particles, until)
        after = replace(
            state, state=moved.state, memory=moved.memory, trial=moved.trial
        )
        return after, moved.wrenches

    def _with_born(
        self, state: ParticleRunState, after: float | None, now: float, until: float
    ) -> ParticleRunState:
        """Return a state with those who are born in a step, at its end."""
        room = max(self.setup.max_particles - len(state.particles), 0)
        particles, born, beyond = self._born(after, until, state.born, room)
        made = len(particles) + beyond
        missed = max(made - room, 0)
        if missed and not state.missed:
            most = self.setup.max_particles
            message = f"there is room for {most} particles, from {until:g} s on for "
            hint = "raise max_particles, or lower rates or lifetimes"
            self._warn("SIM121", f"{message}no more", hint)
        state = replace(state, born=state.born + made, missed=state.missed + missed)
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
            particles=ParticleState.joined([state.particles, particles]),
            state=np.concatenate([state.state, born], axis=1),
        )

    def _born(
        self, after: float | None, until: float, first: int, room: int
    ) -> tuple[ParticleState, FloatArray, int]:
        """Return who is born, with ids in the order of births, and how.

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
        particles = ParticleState.joined(particle_sets)
        state = np.concatenate(states, axis=1)
        order = np.argsort(particles.births, kind="stable")
        particles, state = particles.select(order), state[:, order]
        ids = first + np.arange(len(particles), dtype=np.int64)
        return replace(particles, ids=ids), state, beyond

    def _say_held(self, particles: ParticleState, t: float) -> None:
        """Say once that particles stay inside colliders."""
        if self._held or self.contacts is None:
            return
        (held,) = np.nonzero(self.contacts.touches == Touch.UNRESOLVED)
        if not len(held):
            return
        self._held = True
        who = f"particle {int(particles.ids[held[0]])}"
        which, solid = int(self.contacts.colliders[held[0]]), self.setup.colliders
        what = [
            *(one.name or f"colliders[{i}]" for i, one in enumerate(solid)),
            *(one.name for own in self.setup.bodies for one in own.colliders),
            *(one.name or f"sheets[{i}]" for i, one in enumerate(self.setup.sheets)),
        ][which]
        message = f"{who} is inside {what!r} at {t:g} s, and cannot be moved out at "
        hint = "particles begin inside, or colliders close in on them from several "
        self._warn("SIM123", f"{message}once", f"{hint}sides")

    def _warn(self, code: str, message: str, hint: str) -> None:
        name, severity = self.setup.name, Severity.WARNING
        fault = Fault(code, message, where=name, hint=hint, severity=severity)
        self._notices.append(fault)

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
        """Return the energy, where nothing takes or brings any, and warnings."""
        hint = "give emitters a rate or bursts, and a start and a lifetime by which "
        hint += "their particles are there in the range"
        message = "there is no particle at any frame"
        nobody = Fault("SIM188", message, hint=hint, severity=Severity.WARNING)
        return Diagnostics(
            self._energy(state, t),
            notices=self._notices,
            if_empty=[nobody],
            steps=self._mover.taken,
            stable_step=lambda: self._stable_step(state),
        )

    def _energy(self, state: ParticleRunState, t: float) -> Energy | None:
        system, forces = self._system(state), self.setup.forces
        if isinstance(system, ParticleFlow) or self.colliders.active:
            return None
        damping = (force.damping(state.state[1], state.particles) for force in forces)
        return None if any(damping) else system.energy(t, state.state)

    def _stable_step(self, state: ParticleRunState) -> float | None:
        """Return the largest step that is stable for a state [s]."""
        integrator = find_integrator(self.setup.options.method)
        if integrator.limit is None or not len(state.particles):
            return None
        system = self._system(state)
        modes = modes_at(Equations(system), self.begin, system.state)
        return None if modes is None else allowed_step(integrator, modes)


@dataclass(frozen=True, slots=True)
class ParticleFrame(PointsFrame):
    """Particles at a time.

    Attributes:
        ids: ``(N,)``, ascending.
        points: ``(N, 3)`` [m].
        velocities: ``(N, 3)`` [m/s].
        radii: ``(N,)`` [m].
        time: [s].
    """

    time: float = 0.0

    @property
    def ages(self) -> FloatArray:
        """Since birth ``(N,)`` [s]."""
        return np.asarray(self.primvars["age"], np.float64)


class ParticleRun(SimulationRun):
    """Particles under way, born, moved, stopped and removed in steps of one length.

    Attributes:
        state: At the end of the last whole step.
        notices: What is odd so far.

    Args:
        setup: What there is.
        begin: Time of the first step [s].
        state: Where to go on from, in place of the beginning.

    Raises:
        OptionError: Something makes no sense (SIM001, SIM004 to SIM006, SIM020 to
            SIM024).
    """

    def __init__(
        self,
        setup: Particles,
        begin: float = 0.0,
        state: Reached[ParticleRunState] | None = None,
    ) -> None:
        self._particles = ParticleSimulation(setup, begin)
        step = setup.options.step
        assert step is not None
        super().__init__(setup.name, self._particles, begin, step, state)

    @property
    def contacts(self) -> Contacts | None:
        """What particles met in the last step that was taken; None where it took none.

        Those who were born in it are not among them.
        """
        return self._particles.contacts

    def at(self, t: float) -> ParticleFrame:
        """Return the particles at a time [s], not before the last one asked for.

        Raises:
            OptionError: Time runs backwards (SIM002).
            ToleranceError: They blew up (SIM102), or the method could not go on.
        """
        frame = super().at(t)
        assert isinstance(frame, PointsFrame)
        return ParticleFrame(
            frame.ids,
            frame.points,
            frame.velocities,
            frame.radii,
            frame.primvars,
            max(t, self.time(self.state.steps)),
        )

"""Simulation of particles: births, motion, collisions and removal."""

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
from animtool.sim.checks import (
    check_start,
    check_supported,
    step_warnings,
    stop_warning,
)
from animtool.sim.colliders import Plane
from animtool.sim.colliders.bodies import Wrenches
from animtool.sim.colliders.colliding import Colliders, ContactKind, Contacts
from animtool.sim.equations import Equations
from animtool.sim.integrating import advance_run, checkpoint_of, stats_of
from animtool.sim.integrators import find_integrator
from animtool.sim.integrators.implicit import PreviousStep
from animtool.sim.integrators.integrator import allowed_step
from animtool.sim.modes import modes_at
from animtool.sim.options import checked_integrator
from animtool.sim.run import IntegrationRun
from animtool.sim.system import Energy
from animtool.sim.trajectory import Status
from animtool.systems.framework.simulation import (
    Diagnostics,
    SteppedState,
    StoppedError,
    field_set_later,
    growing_field,
)
from animtool.systems.particles.moving import (
    DivergenceCheck,
    ParticleFlow,
    ParticleForces,
    advance_births,
)
from animtool.systems.particles.setup import Particles
from animtool.systems.particles.state import ParticleState

if TYPE_CHECKING:
    from animtool.systems.framework.simulation import SimContext
    from animtool.systems.particles.spec import ParticlesModel

# Relative change of frequencies below which the stable step is not checked again [1].
MODE_TOLERANCE = 0.05


@dataclass(frozen=True, slots=True)
class ParticleRunState:
    """State of a particle simulation at the end of a step."""

    particles: ParticleState = field(metadata=growing_field())  # living particles
    # Positions, then velocities ``(2, N, 3)``.
    state: FloatArray = field(metadata=growing_field(1))
    born: int = 0  # number of births so far, with skipped ones
    missed: int = 0  # number of skipped births so far
    # Memory of the integrator, valid for the same particles.
    memory: object = field(default=None, metadata=field_set_later(PreviousStep))
    # Next trial step of an adaptive integrator [s].
    trial: float | None = field(default=None, metadata=field_set_later())


_NO_PARTICLES = ParticleRunState(ParticleState.empty(), np.zeros((2, 0, 3)))


def build(spec: ParticlesModel, context: SimContext) -> ParticleSimulation:
    """Build the simulation of a spec; raise as `ParticleSimulation` does."""
    setup, colliders = spec.setup(context.entry_data), context.colliders
    setup = replace(
        setup, colliders=colliders[:], sheets=colliders.sheets, bodies=colliders.bodies
    )
    if context.budget is not None:
        options = replace(setup.options, budget=context.budget)
        setup = replace(setup, options=options)
    return ParticleSimulation(setup, context.begin)


class ParticleSimulation:
    """Simulates particles with one integrator.

    Raises:
        OptionError: The setup is invalid (SIM001, SIM004 to SIM006, SIM020 to SIM024).
    """

    def __init__(self, setup: Particles, begin: float) -> None:
        setup.check()
        self.setup, self.begin = setup, begin
        self.colliders = Colliders(setup.colliders, setup.sheets, setup.bodies)
        self.contacts: Contacts | None = None  # as in `ParticleRun`
        self._steps_taken = 0  # steps of the method so far
        self._kill_regions = [
            Colliders([kill.region.as_solid()]) for kill in setup.kills
        ]
        self._integrator = checked_integrator(setup.options)
        check_supported(Equations(self._system(_NO_PARTICLES)), self._integrator)
        self._divergence_check = DivergenceCheck(setup, self.colliders)
        self._fastest_modes: FloatArray | None = None
        self._step_warnings: list[Fault] = []
        self._notices: list[Fault] = self.colliders.notices()

    def initial_state(self) -> ParticleRunState:
        """Return the particles born at the start."""
        return self._initial_state

    @cached_property
    def _initial_state(self) -> ParticleRunState:
        begin = self.begin
        return self._add_births(_NO_PARTICLES, None, begin, begin, self._notices)

    def step(
        self, state: ParticleRunState, t: float, dt: float
    ) -> SteppedState[ParticleRunState]:
        """Return the state after a full or partial step [s].

        Particles born in the step do not push bodies in it.
        """
        particles, end, notices = state.particles, t + dt, list[Fault]()
        wrenches: Sequence[Wrenches] = ()
        if len(particles):
            state, wrenches = self._advance(state, t, end, notices)
        state = self._add_births(state, t, t, end, notices)
        state = self._remove_particles(state, end)
        if state.particles is particles:
            return SteppedState(state, wrenches, notices)
        if not np.isfinite(state.state).all():
            system = self._system(state)
            check_start(Equations(system), end, system.state)
        return SteppedState(replace(state, memory=None, trial=None), wrenches, notices)

    def _system(self, state: ParticleRunState) -> ParticleForces | ParticleFlow:
        """Return the particles of a state as a system for integrators."""
        setup, colliders, motion = self.setup, self.colliders, state.state
        if setup.velocity is not None:
            return ParticleFlow(setup, colliders, state.particles, motion[0])
        return ParticleForces(setup, colliders, state.particles, motion)

    def _advance(
        self, state: ParticleRunState, start: float, end: float, notices: list[Fault]
    ) -> tuple[ParticleRunState, Sequence[Wrenches]]:
        """Return particles after a step [s], and impulses on bodies."""
        system, options = self._system(state), self.setup.options
        start_state = system.state
        with np.errstate(all="ignore"):
            self._divergence_check.set_particles(state.particles, state.state)
            self._check_step_length(system, start, end)
            notices += self._step_warnings
            integration = IntegrationRun(
                self._integrator,
                Equations(system),
                options,
                self._divergence_check,
                end,
                start,
                start_state,
                state.memory,
                state.trial,
            )
            status = advance_run(integration, end)
            self._steps_taken += integration.step_count
            if status is not Status.OK:
                stop_sample = integration.time, integration.state
                self._stop(integration, status, [(start, start_state), stop_sample])
        end_state = integration.state
        if isinstance(system, ParticleFlow):
            end_state = np.stack([end_state, system.rate(end, end_state)])
        self.contacts = contacts = system.contacts
        if contacts is not None:
            # The speed of deforming colliders is unknown.
            is_moved = contacts.colliders >= len(self.colliders)
            is_moved |= contacts.touches == ContactKind.UNRESOLVED
            self._divergence_check.reset_energies(is_moved, end_state)
            notices += self._stuck_notices(state.particles, contacts, end)
        checkpoint = checkpoint_of(integration, status, end, integration.state)
        state = replace(
            state, state=end_state, memory=checkpoint.memory, trial=checkpoint.trial
        )
        return state, system.wrenches

    def _check_step_length(
        self, system: ParticleForces | ParticleFlow, start: float, end: float
    ) -> None:
        """Check whether steps are too long for the fastest motion; warn once."""
        modes = None if self._step_warnings else system.frequencies(start, system.state)
        if modes is None:
            return
        previous_modes = self._fastest_modes
        has_changed = np.ones(1, bool)
        if previous_modes is not None and previous_modes.shape == modes.shape:
            has_changed = (
                np.abs(modes - previous_modes) > MODE_TOLERANCE * previous_modes
            )
        if not has_changed.any():
            return
        self._fastest_modes = modes
        self._step_warnings = step_warnings(
            Equations(system),
            self._integrator,
            self.setup.options,
            np.array([start, end]),
            system.state,
        )
        self._divergence_check.has_long_steps = bool(self._step_warnings)

    def _stop(
        self,
        integration: IntegrationRun,
        status: Status,
        samples: list[tuple[float, FloatArray]],
    ) -> None:
        """Raise a `StoppedError` with the reason that integration stopped."""
        # Forces that are not finite at the start are a fault, not a divergence.
        check_start(integration.equations, *samples[0])
        stats = stats_of(integration, status, samples)
        stop_fault = stop_warning(self._integrator, self.setup.options, stats)
        warnings = [*self._step_warnings, stop_fault]
        faults = [replace(fault, severity=Severity.ERROR) for fault in warnings]
        raise StoppedError(faults, stats)

    def _add_births(
        self,
        state: ParticleRunState,
        start_time: float | None,
        start: float,
        end_time: float,
        notices: list[Fault],
    ) -> ParticleRunState:
        """Return a state with the births of a step, at the end of the step."""
        capacity = max(self.setup.max_particles - len(state.particles), 0)
        particles, birth_states, skipped_count = self._sample_births(
            start_time, end_time, state.born, capacity
        )
        birth_count = len(particles) + skipped_count
        new_skipped_count = max(birth_count - capacity, 0)
        if new_skipped_count and not state.missed:
            limit = self.setup.max_particles
            message = f"from {end_time:g} s on, the limit of {limit} particles leaves "
            message += "room for no more"
            hint = "raise max_particles, or lower rates or lifetimes"
            notices.append(warning("SIM121", message, hint, self.setup.name))
        missed = state.missed + new_skipped_count
        state = replace(state, born=state.born + birth_count, missed=missed)
        indices = np.arange(len(particles))[:capacity]
        particles, birth_states = particles.select(indices), birth_states[:, indices]
        if not len(particles):
            return state
        if end_time > start:
            birth_states = advance_births(
                self.setup, self.colliders, particles, birth_states, start, end_time
            )
        elif self.setup.velocity is not None:
            flow = self.setup.velocity
            birth_states[1] = flow.velocity(end_time, birth_states[0], particles)
        particles = ParticleState.concatenate([state.particles, particles])
        motion = np.concatenate([state.state, birth_states], axis=1)
        return replace(state, particles=particles, state=motion)

    def _sample_births(
        self, start_time: float | None, end_time: float, first_id: int, capacity: int
    ) -> tuple[ParticleState, FloatArray, int]:
        """Return the births of a time interval in order, with ids.

        Each emitter has at most ``capacity`` births; also returns the number of births
        that were skipped.
        """
        particle_sets, states, skipped_count = [], [], 0
        for emitter in self.setup.emitters:
            births = emitter.births(self.begin, start_time, end_time, capacity)
            skipped_count += births.skipped_count
            if not len(births.times):
                continue
            x, v, lifetimes, radii = emitter.sample_births(births)
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
            return ParticleState.empty(), np.zeros((2, 0, 3)), skipped_count
        particles = ParticleState.concatenate(particle_sets)
        state = np.concatenate(states, axis=1)
        order = np.argsort(particles.births, kind="stable")
        particles, state = particles.select(order), state[:, order]
        ids = first_id + np.arange(len(particles), dtype=np.int64)
        return replace(particles, ids=ids), state, skipped_count

    def _stuck_notices(
        self, particles: ParticleState, contacts: Contacts, t: float
    ) -> Iterator[Fault]:
        """Yield a warning about particles that stay inside colliders (SIM123)."""
        (stuck_indices,) = np.nonzero(contacts.touches == ContactKind.UNRESOLVED)
        if not len(stuck_indices):
            return
        label = f"particle {int(particles.ids[stuck_indices[0]])}"
        collider_index, setup = int(contacts.colliders[stuck_indices[0]]), self.setup
        collider_names = [
            collider.name or f"colliders[{i}]"
            for i, collider in enumerate(setup.colliders)
        ]
        collider_names += [
            collider.name for system in setup.bodies for collider in system.colliders
        ]
        collider_names += [
            collider.name or f"sheets[{i}]" for i, collider in enumerate(setup.sheets)
        ]
        message = f"{label} is inside {collider_names[collider_index]!r} at {t:g} s, "
        message += "and cannot be pushed out in one step"
        hint = "move emitters out of colliders, and keep gaps between closing colliders"
        yield warning("SIM123", message, hint, self.setup.name)

    def _remove_particles(self, state: ParticleRunState, t: float) -> ParticleRunState:
        """Return a state without particles that died or are in kill regions."""
        is_alive: BoolArray = state.particles.deaths > t
        for region in self._kill_regions:
            is_alive = is_alive & (region.sample(state.state[0], t).distances[0] >= 0)
        if is_alive.all():
            return state
        particles = state.particles.select(is_alive)
        return replace(state, particles=particles, state=state.state[:, is_alive])

    def frame(self, state: ParticleRunState, t: float) -> PointsFrame:
        """Return the particles of a state as points."""
        particles, (points, velocities) = state.particles, state.state
        ages = {"age": t - particles.births}
        return PointsFrame(particles.ids, points, velocities, particles.radii, ages)

    def diagnostics(self, state: ParticleRunState, t: float) -> Diagnostics:
        """Return the energy if it is conserved, and warnings about the motion."""
        return Diagnostics(
            self._energy(state, t),
            notices=self._notices,
            notices_if_empty=[self._empty_notice(t)],
            steps=self._steps_taken,
            stable_step=lambda: self._stable_step(state),
        )

    def _empty_notice(self, t: float) -> Fault:
        """Return a warning that no particles exist until a time [s] (SIM188)."""
        message = "no frame has any particles"
        emitters = self.setup.emitters
        covering_regions = [
            k
            for k, region in enumerate(self._kill_regions)
            if all(
                (region.sample(emitter.poses.at(t)[None, :3], t).distances < 0).all()
                for emitter in emitters
            )
        ]
        if covering_regions:
            k = covering_regions[0]
            region = self.setup.kills[k].region
            message += f": kill[{k}] contains all emitters, and removes what is "
            if isinstance(region.shape, Plane):
                message += "above it" if region.container else "below it"
                hint = "lower its offset, or turn its normal"
            elif region.container:
                message += "outside it"
                hint = "move or enlarge it, so that the emitters are inside"
            else:
                message += "inside it"
                hint = "to remove what leaves it, write container: true"
            return warning("SIM188", message, hint, f"kill[{k}]")
        late_start = self.late_start_notice(t)
        if late_start is not None:
            return late_start
        for i, emitter in enumerate(self.setup.emitters):
            if emitter.bursts and not any(count for _, count in emitter.bursts):
                burst_time = emitter.bursts[0][0]
                message += f": a burst of 0 particles is at {burst_time:g} s"
                hint = "rows of bursts are [seconds, number]"
                if burst_time > 0 and burst_time == round(burst_time):
                    hint += f"; for {burst_time:g} particles at the start write "
                    hint += f"[0, {burst_time:g}]"
                location = f"emitters[{i}].bursts[0]"
                return warning("SIM188", message, hint, location)
        hint = "set a rate or bursts, and a start and a lifetime with which "
        return warning("SIM188", message, hint + "particles exist in the range")

    def late_start_notice(self, t: float) -> Fault | None:
        """Return a warning if all emitters start after a time [s] (SIM188)."""
        emitters = self.setup.emitters
        start_times = [
            min(
                [
                    *(time for time, count in emitter.bursts if count),
                    emitter.start if emitter.rate else np.inf,
                ]
            )
            for emitter in emitters
        ]
        first_time = min(start_times, default=np.inf)
        if not t < first_time < np.inf:
            return None
        message = "no frame has any particles: the first emitter starts at "
        message += f"{first_time:g} s, but the last frame is at {t:.3g} s"
        hint = "start it earlier, in seconds from the first frame of the range"
        location = f"emitters[{start_times.index(first_time)}]"
        return warning("SIM188", message, hint, location)

    def _energy(self, state: ParticleRunState, t: float) -> Energy | None:
        """Return the energy of a state; None if the system does not conserve energy."""
        system, forces = self._system(state), self.setup.forces
        if isinstance(system, ParticleFlow) or self.colliders.has_any:
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

"""Runs of a simulation in steps of equal length, sampled at arbitrary times."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Generic, TypeVar

from animtool.core.errors import Fault, OptionError
from animtool.core.record import dataclass
from animtool.motion.frames import Frame, check_bounds, check_finite
from animtool.sim.colliders import MovingBodies
from animtool.sim.colliders.bodies import Pusher, Wrenches
from animtool.systems.framework.body_carriers import CarrierBodies
from animtool.systems.framework.simulation import (
    Diagnostics,
    ManySteps,
    Simulation,
    State,
    SteppedState,
    SystemView,
)
from animtool.systems.framework.surfaces import (
    BodyColliders,
    RigidSystem,
    SystemSurface,
)

Observer = TypeVar("Observer", SystemSurface, BodyColliders)

# Rounding tolerance for a time at the end of a step, in steps [1].
STEP_TOLERANCE = 1e-9


@dataclass(frozen=True, slots=True)
class ReachedState(Generic[State]):
    """A state, and the number of steps from the start to it."""

    step_count: int
    state: State


class EntryRun:
    """Samples one scene entry of a simulation run.

    Attributes:
        name: Name of the entry.
        run: Run of the entry and of all entries joined to it.
        simulation: View of the entry; for a single entry the simulation itself.
        reports_steps: Whether it reports the warnings of steps, as the first of joined
            entries does.
    """

    def __init__(
        self,
        name: str,
        run: SimulationRun,
        view: SystemView[Any],
        *,
        reports_steps: bool = True,
    ) -> None:
        self.name, self.run, self.reports_steps = name, run, reports_steps
        self.simulation: Any = view
        self._was_empty: bool | None = None  # None before the first frame

    def at(self, t: float) -> Frame:
        """Return the frame at a time [s]; requested times must not decrease.

        Raises:
            OptionError: The time is before the last one (SIM002).
            ToleranceError: The simulation diverged (SIM102), or the method failed.
        """
        frame: Frame = self.simulation.frame(*self.run.sample(t))
        check_bounds(self.name, frame, t, self.run.step_length)
        self._was_empty = self._was_empty is not False and not len(frame.points)
        return frame

    @property
    def is_rigid(self) -> bool:
        """Whether the entry has rigid bodies."""
        return isinstance(self.simulation, RigidSystem)

    def body_colliders(
        self, restitution: float, friction: float, *, two_way: bool
    ) -> BodyColliders:
        """Return the rigid bodies of the entry as colliders of other systems."""
        assert isinstance(self.simulation, RigidSystem)
        colliders = BodyColliders(
            self.run, self.simulation, restitution, friction, two_way=two_way
        )
        return self.run.add_observer(colliders)

    def body_carriers(self) -> CarrierBodies:
        """Return the rigid bodies of the entry as carriers for other systems."""
        run, simulation = self.run, self.simulation
        bodies = CarrierBodies(run, simulation, run.begin, run.step_length)
        run.add_observer(bodies)
        return bodies

    def surface(self) -> SystemSurface:
        """Return the surface of the entry as a collider of other systems."""
        return self.run.add_observer(SystemSurface(self.run, self.simulation))

    @property
    def diagnostics(self) -> Diagnostics:
        """Diagnostics of the last sampled state."""
        diagnostics: Diagnostics = self.simulation.diagnostics(*self.run.last_sample)
        return diagnostics

    @property
    def notices(self) -> list[Fault]:
        """Warnings collected so far."""
        diagnostics = self.diagnostics
        step_notices = self.run.step_notices if self.reports_steps else ()
        notices_if_empty = diagnostics.notices_if_empty if self._was_empty else ()
        return [*diagnostics.notices, *step_notices, *notices_if_empty]

    def report(self) -> dict[str, object]:
        """Return values for the report; empty if there are none."""
        values = dict(self.diagnostics.values)
        if not values:
            return {}
        steps = {} if "steps" in values else {"steps": self.run.steps_taken}
        return {"name": self.name, **steps, **values}


class SimulationRun(EntryRun):
    """Runs a simulation in constant steps, and samples it at arbitrary times.

    Steps do not depend on the requested times: a sample between two steps takes a
    partial step that is discarded. The frame rate of an output thus does not change the
    motion. To resume, start from a state of an earlier run. A run with numbers that are
    not finite is stopped.

    Attributes:
        last_sample: The last sampled state and its time [s].
        begin: Time of the first step [s].
        step_length: Length of every step [s].
        state: State at the end of the last full step.
        steps_taken: Number of steps and partial steps so far.
        step_notices: Warnings of steps, the first of each code.
    """

    def __init__(
        self,
        name: str,
        simulation: Simulation[Any],
        begin: float,
        step_length: float,
        state: ReachedState[Any] | None = None,
    ) -> None:
        super().__init__(name, self, simulation)
        self.begin, self.step_length = begin, step_length
        self.state = (
            ReachedState(0, simulation.initial_state()) if state is None else state
        )
        self.steps_taken = 0
        self.step_notices: list[Fault] = []
        # States that observers may still request.
        self._past_states: list[ReachedState[Any]] | None = None
        self._observers: list[SystemSurface | BodyColliders] = []
        self._pushed_bodies: Sequence[MovingBodies] = ()
        # Systems that push it; and queued pushes: time, index of the pusher, impulses.
        self._pushers: list[Pusher] = []
        self._queued_pushes: list[tuple[float, int, Wrenches]] = []
        # Systems with particles attached to its bodies, which pull them during a step.
        self._pullers: list[tuple[CarrierBodies, Any]] = []
        # States at the start of the next step after pushes, by step.
        self._pushed_states: dict[int, ReachedState[Any]] = {}
        start_time = self.step_time(self.state.step_count)
        self.last_sample: tuple[Any, float] = self.state.state, start_time
        self._last_time: float | None = None  # last requested time [s]
        stepper = simulation if isinstance(simulation, ManySteps) else None
        self._many_steps = None if stepper is None else stepper.steps

    def sample(self, t: float) -> tuple[Any, float]:
        """Return the state at a time [s], and that time. Times must not decrease."""
        if t == self._last_time:
            return self.last_sample
        step_count = self.advance(t)
        start = self.state
        if step_count < start.step_count:
            # Systems coupled to it may have advanced it beyond the frame.
            earlier_states = [
                past
                for past in self._past_states or ()
                if past.step_count <= step_count
            ]
            if not earlier_states:
                message = f"time {t:g} s is before that of the simulation"
                raise OptionError(Fault("SIM002", message, hint="begin again"))
            start = earlier_states[-1]
        time = self.step_time(step_count)
        state = self._partial_step(start, t)
        if state is start and self._pullers:
            state = self._with_pushes(start)
        elif state is not start:
            for bodies, puller in self._pullers:
                state = replace(state, state=bodies.pulled_by(puller, state.state, t))
        self.last_sample, self._last_time = (state.state, max(t, time)), t
        return self.last_sample

    def pull(self, t: float, bodies: object) -> tuple[Wrenches, float, float] | None:
        """Return the impulses that attached particles apply to bodies in a step.

        The step is the one that contains the time [s]. Also returns the start and end
        of the step [s]; returns None if there are none.
        """
        step_count = self.advance(t)
        start = self.step_time(step_count)
        is_within = t - start > STEP_TOLERANCE * self.step_length
        if not is_within or step_count != self.state.step_count or t < self.begin:
            return None
        end = self.step_time(step_count + 1)
        wrenches = self.simulation.pulls(self.state.state, start)
        index = [
            pushed_bodies is bodies for pushed_bodies in self._pushed_bodies
        ].index(True)
        return wrenches[index], start, end

    def advance(self, t: float) -> int:
        """Take all full steps up to a time [s]; return the number of steps."""
        end_step = max(self._step_count(t), 0)
        has_observers = self._past_states is not None
        is_coupled = has_observers or self._pushed_bodies or self._pushers
        count = end_step - self.state.step_count
        if self._many_steps is not None and not is_coupled and count > 0:
            start, step = self.step_time(self.state.step_count), self.step_length
            result = self._many_steps(self.state.state, start, step, count)
            self.state = ReachedState(end_step, result.state)
            self.steps_taken += count
            self._record_notices(result.notices)
        while self.state.step_count < end_step:
            self._full_step()
        return end_step

    def _full_step(self) -> None:
        """Take a full step, and push the bodies of other systems."""
        begin, end = self.apply_pushes(), self.step_time(self.state.step_count + 1)
        self.state, wrenches = self._step_until(begin, end)
        if self._past_states is None:
            self._pushed_states.clear()
        else:
            self._past_states.append(self.state)
        for bodies, pushes in zip(self._pushed_bodies, wrenches, strict=False):
            bodies.push(end, pushes)
        for bodies in self._pushed_bodies:
            bodies.forget(end)

    def _partial_step(self, state: ReachedState[Any], t: float) -> ReachedState[Any]:
        """Return a state advanced by a partial step to a time [s]."""
        if t <= self.step_time(state.step_count) + STEP_TOLERANCE * self.step_length:
            return state
        return self._step_until(self._with_pushes(state), t)[0]

    def _with_pushes(self, state: ReachedState[Any]) -> ReachedState[Any]:
        """Return a state with pushes applied, from which the next step starts."""
        is_current = state.step_count == self.state.step_count
        if is_current:
            return self.apply_pushes()
        return self._pushed_states.get(state.step_count, state)

    def push(self, t: float, pusher_index: int, wrenches: Wrenches) -> None:
        """Queue impulses on the bodies at a time [s]."""
        is_after_begin = t > self.begin + STEP_TOLERANCE * self.step_length
        if wrenches.impulses.any() and is_after_begin:
            self._queued_pushes.append((t, pusher_index, wrenches))

    def apply_pushes(self) -> ReachedState[Any]:
        """Return the last state with all pushes until that time applied.

        Pushers are advanced to the same time first, so that the result does not depend
        on the requested times.
        """
        step_count = self.state.step_count
        if not self._pushers:
            return self.state
        if step_count in self._pushed_states:
            return self._pushed_states[step_count]
        assert isinstance(self.simulation, RigidSystem)
        time = self.step_time(step_count)
        for pusher in self._pushers:
            pusher.advance(time)
        latest_time = time + STEP_TOLERANCE * self.step_length
        due_pushes = [push for push in self._queued_pushes if push[0] <= latest_time]
        due_pushes.sort(key=lambda push: push[:2])
        self._queued_pushes = [
            push for push in self._queued_pushes if push[0] > latest_time
        ]
        self._pushed_states[step_count] = self.state
        if due_pushes:
            wrenches = [push[2].delayed_by(time - push[0]) for push in due_pushes]
            pushed_state = self.simulation.pushed(
                self.state.state, Wrenches.sum(wrenches)
            )
            self._pushed_states[step_count] = ReachedState(step_count, pushed_state)
        return self._pushed_states[step_count]

    def collide_with(self, bodies: Sequence[MovingBodies]) -> None:
        """Register bodies of other systems that this simulation pushes."""
        self._pushed_bodies = bodies
        for system in bodies:
            system.register_pusher(self)

    def register_pusher(self, pusher: Pusher) -> int:
        """Register a system that pushes the bodies; return the index of the pusher."""
        self._pushers.append(pusher)
        return len(self._pushers) - 1

    def add_puller(self, bodies: CarrierBodies, puller: Any) -> None:
        """Register a system whose particles are attached to the bodies."""
        self._pullers.append((bodies, puller))

    def add_observer(self, observer: Observer) -> Observer:
        """Register an observer of past states, which are stored from now on."""
        if self._past_states is None:
            self._past_states = [self.state]
        self._observers.append(observer)
        return observer

    def _record_notices(self, notices: Sequence[Fault]) -> None:
        """Record the warnings of a step that have new codes."""
        for notice in notices:
            if notice.code not in {
                recorded_notice.code for recorded_notice in self.step_notices
            }:
                self.step_notices.append(notice)

    def _step_count(self, t: float) -> int:
        """Return the number of full steps to time t [s]; negative before the start."""
        return math.floor((t - self.begin) / self.step_length + STEP_TOLERANCE)

    def step_time(self, step_count: int) -> float:
        """Return the time after a number of steps [s]."""
        return self.begin + step_count * self.step_length

    def past_state(self, t: float, *, with_pushes: bool = False) -> tuple[Any, float]:
        """Return the current or a past state at a time [s], and that time.

        Times before the start return the first state. With ``with_pushes``, pushes
        until then are applied.
        """
        assert self._past_states is not None
        count = self.advance(t)
        # A resumed run has no earlier states.
        states = self._past_states
        reached_states = (past for past in reversed(states) if past.step_count <= count)
        state = next(reached_states, states[0])
        time, sampled_state = (
            self.step_time(state.step_count),
            self._partial_step(state, t),
        )
        if with_pushes and sampled_state is state:
            sampled_state = self._with_pushes(state)
        return sampled_state.state, max(t, time)

    def forget(self) -> None:
        """Discard past states that no observer needs."""
        assert self._past_states is not None
        t = min(observer.earliest_time for observer in self._observers)
        if t == -math.inf:
            return
        count, states = self._step_count(t), self._past_states
        expired_indices = [
            k for k, past in enumerate(states) if past.step_count <= count
        ]
        del states[: expired_indices[-1] if expired_indices else 0]
        first_step, pushed_states = states[0].step_count, self._pushed_states
        self._pushed_states = {
            k: pushed_states[k] for k in pushed_states if k >= first_step
        }

    def _step_until(
        self, state: ReachedState[Any], end: float
    ) -> tuple[ReachedState[Any], Sequence[Wrenches]]:
        """Return the state after a full or partial step to a time [s].

        Also returns impulses on bodies of other systems.
        """
        start = self.step_time(state.step_count)
        result = self.simulation.step(state.state, start, end - start)
        result = result if isinstance(result, SteppedState) else SteppedState(result)
        self.steps_taken += 1
        self._record_notices(result.notices)
        if not getattr(self.simulation, "checked", False):
            frame = self.simulation.frame(result.state, end)
            check_finite(self.name, frame, end, self.step_length)
        return ReachedState(state.step_count + 1, result.state), result.wrenches

"""Runs a simulation in even steps, and samples it at any time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Generic, TypeVar

from animtool.core.errors import Fault, OptionError
from animtool.core.record import dataclass
from animtool.motion.frames import Frame
from animtool.sim.colliders import MovingBodies
from animtool.sim.colliders.bodies import Pusher, Wrenches
from animtool.systems.framework.bounds import check_bounds, check_finite
from animtool.systems.framework.simulation import (
    Diagnostics,
    ManySteps,
    Simulation,
    State,
    Stepped,
    SystemView,
)
from animtool.systems.framework.surfaces import (
    BodyColliders,
    RigidSystem,
    SystemSurface,
)
from animtool.systems.framework.tied import TiedBodies

Watcher = TypeVar("Watcher", SystemSurface, BodyColliders)

# Tolerance for a time at the end of a step [steps].
ON_STEP = 1e-9


@dataclass(frozen=True, slots=True)
class Reached(Generic[State]):
    """A state and the number of steps taken."""

    steps: int
    state: State


class EntryRun:
    """View of one scene entry on a simulation run.

    Attributes:
        name: Name of the entry.
        run: Run of the entry and of all entries joined to it.
        simulation: View of the entry; for a single entry the simulation itself.
        speaks: Whether it reports warnings of steps: the first of joined entries.
    """

    def __init__(
        self,
        name: str,
        run: SimulationRun,
        view: SystemView[Any],
        *,
        speaks: bool = True,
    ) -> None:
        self.name, self.run, self.speaks = name, run, speaks
        self.simulation: Any = view
        self._empty: bool | None = None  # None before the first look

    def at(self, t: float) -> Frame:
        """Return the frame at a time [s] not before the last requested one.

        Raises:
            OptionError: The time is before the last one (SIM002).
            ToleranceError: It blew up (SIM102), or the method failed.
        """
        frame: Frame = self.simulation.frame(*self.run.reach(t))
        check_bounds(self.name, frame, t, self.run.step_length)
        self._empty = self._empty is not False and not len(frame.points)
        return frame

    @property
    def rigid(self) -> bool:
        """Whether it has rigid bodies."""
        return isinstance(self.simulation, RigidSystem)

    def bodies(
        self, restitution: float, friction: float, *, two_way: bool
    ) -> BodyColliders:
        """Return its bodies as colliders of others, which push them if two-way."""
        assert isinstance(self.simulation, RigidSystem)
        return self.run.watched_by(
            BodyColliders(
                self.run, self.simulation, restitution, friction, two_way=two_way
            )
        )

    def tied(self) -> TiedBodies:
        """Return its bodies as carriers of particles of others."""
        run, simulation = self.run, self.simulation
        bodies = TiedBodies(run, simulation, run.begin, run.step_length)
        run.watched_by(bodies)
        return bodies

    def surface(self) -> SystemSurface:
        """Return its surface as a collider of others."""
        return self.run.watched_by(SystemSurface(self.run, self.simulation))

    @property
    def diagnostics(self) -> Diagnostics:
        """Diagnostics of the last sampled state."""
        diagnostics: Diagnostics = self.simulation.diagnostics(*self.run.observed)
        return diagnostics

    @property
    def notices(self) -> list[Fault]:
        """Warnings collected so far."""
        diagnostics = self.diagnostics
        step_notices = self.run.step_notices if self.speaks else ()
        return [
            *diagnostics.notices,
            *step_notices,
            *(diagnostics.if_empty if self._empty else ()),
        ]

    def report(self) -> dict[str, object]:
        """Return result values for a report."""
        values = dict(self.diagnostics.values)
        if not values:
            return {}
        steps = {} if "steps" in values else {"steps": self.run.taken}
        return {"name": self.name, **steps, **values}


class SimulationRun(EntryRun):
    """Runs a simulation in steps of constant length, and samples it at any time.

    Steps do not depend on the requested times: a sample between two steps takes a
    partial step that is discarded. The frame rate of an output thus does not change the
    motion. To resume, start from a state of an earlier run. A run with numbers that are
    not finite is stopped.

    Attributes:
        observed: The last sampled state and its time [s].
        begin: Time of the first step [s].
        step_length: Length of every step [s].
        state: State at the end of the last full step.
        taken: Steps and partial steps so far.
        step_notices: Warnings of these, the first of each code.
    """

    def __init__(
        self,
        name: str,
        simulation: Simulation[Any],
        begin: float,
        step_length: float,
        state: Reached[Any] | None = None,
    ) -> None:
        super().__init__(name, self, simulation)
        self.begin, self.step_length = begin, step_length
        self.state = Reached(0, simulation.initial()) if state is None else state
        self.taken = 0
        self.step_notices: list[Fault] = []
        # States that observers may still request.
        self._kept: list[Reached[Any]] | None = None
        self._watchers: list[SystemSurface | BodyColliders] = []
        self._pushed_bodies: Sequence[MovingBodies] = ()
        # Who pushes it: when, who, and with what.
        self._pushers: list[Pusher] = []
        self._pushes: list[tuple[float, int, Wrenches]] = []
        # Systems that hang on its bodies and pull them during a step.
        self._pullers: list[tuple[TiedBodies, Any]] = []
        # States at the start of the next step after pushes, by step.
        self._begun: dict[int, Reached[Any]] = {}
        self.observed: tuple[Any, float] = self.state.state, self.time(self.state.steps)
        self._asked: float | None = None  # last requested time [s]
        many = simulation if isinstance(simulation, ManySteps) else None
        self._steps = None if many is None else many.steps

    def reach(self, t: float) -> tuple[Any, float]:
        """Return the state at a time [s] not before the last one, and its time."""
        if t == self._asked:
            return self.observed
        count = self.advance(t)
        begun = self.state
        if count < begun.steps:
            # Systems that collide with it or hang on it may be ahead of the frame.
            kept = [one for one in self._kept or () if one.steps <= count]
            if not kept:
                message = f"time {t:g} s is before that of the simulation"
                raise OptionError(Fault("SIM002", message, hint="begin again"))
            begun = kept[-1]
        now = self.time(count)
        state = self._part(begun, t)
        if state is begun and self._pullers:
            state = self._pushed(begun)
        elif state is not begun:
            for bodies, puller in self._pullers:
                state = replace(state, state=bodies.pulled_by(puller, state.state, t))
        self.observed, self._asked = (state.state, max(t, now)), t
        return self.observed

    def pull(self, t: float, bodies: object) -> tuple[Wrenches, float, float] | None:
        """Return the pull on bodies in the step at a time [s].

        With begin and end of the step [s]; None if it pulls none.
        """
        count = self.advance(t)
        now = self.time(count)
        part = t - now > ON_STEP * self.step_length
        if not part or count != self.state.steps or t < self.begin:
            return None
        until = self.time(count + 1)
        wrenches = self.simulation.pulls(self.state.state, now)
        number = [pushed is bodies for pushed in self._pushed_bodies].index(True)
        return wrenches[number], now, until

    def advance(self, t: float) -> int:
        """Take all full steps that end at a time [s] or before; return their number."""
        end_step = max(math.floor((t - self.begin) / self.step_length + ON_STEP), 0)
        alone = self._kept is None and not self._pushed_bodies and not self._pushers
        if self._steps is not None and alone and self.state.steps < end_step:
            steps, count = self.state.steps, end_step - self.state.steps
            step = self.step_length
            stepped = self._steps(self.state.state, self.time(steps), step, count)
            self.state, self.taken = (
                Reached(end_step, stepped.state),
                self.taken + count,
            )
            self._tell(stepped.notices)
        while self.state.steps < end_step:
            self._go_on()
        return end_step

    def _go_on(self) -> None:
        """Take a full step."""
        begin, until = self.receive(), self.time(self.state.steps + 1)
        self.state, wrenches = self._stepped(begin, until)
        if self._kept is None:
            self._begun.clear()
        if self._kept is not None:
            self._kept.append(self.state)
        for bodies, pushes in zip(self._pushed_bodies, wrenches, strict=False):
            bodies.push(until, pushes)
        for bodies in self._pushed_bodies:
            bodies.forget(until)

    def _part(self, state: Reached[Any], t: float) -> Reached[Any]:
        """Return a state advanced by a partial step to a time [s]."""
        if t <= self.time(state.steps) + ON_STEP * self.step_length:
            return state
        return self._stepped(self._pushed(state), t)[0]

    def _pushed(self, state: Reached[Any]) -> Reached[Any]:
        """Return a state with pushes applied, as the next step starts."""
        current = state.steps == self.state.steps
        return self.receive() if current else self._begun.get(state.steps, state)

    def push(self, t: float, who: int, wrenches: Wrenches) -> None:
        """Queue a push of bodies at a time [s] by the pusher's index."""
        if wrenches.impulses.any() and t > self.begin + ON_STEP * self.step_length:
            self._pushes.append((t, who, wrenches))

    def receive(self) -> Reached[Any]:
        """Return the last state with all pushes until then applied.

        Pushers are advanced to the same time first, so that the result does not depend
        on the requested times.
        """
        steps = self.state.steps
        if not self._pushers:
            return self.state
        if steps in self._begun:
            return self._begun[steps]
        assert isinstance(self.simulation, RigidSystem)
        now = self.time(steps)
        for pusher in self._pushers:
            pusher.advance(now)
        until = now + ON_STEP * self.step_length
        due = sorted(
            (push for push in self._pushes if push[0] <= until), key=lambda one: one[:2]
        )
        self._pushes = [push for push in self._pushes if push[0] > until]
        self._begun[steps] = self.state
        if due:
            pushed = self.simulation.pushed(
                self.state.state,
                Wrenches.sum([push[2].after(now - push[0]) for push in due]),
            )
            self._begun[steps] = Reached(steps, pushed)
        return self._begun[steps]

    def collide_with(self, bodies: Sequence[MovingBodies]) -> None:
        """Register bodies of other systems that it pushes."""
        self._pushed_bodies = bodies
        for pushed in bodies:
            pushed.pushed_by(self)

    def pushed_by(self, pusher: Pusher) -> int:
        """Register a pusher of its bodies; return its index."""
        self._pushers.append(pusher)
        return len(self._pushers) - 1

    def pulled_by(self, bodies: TiedBodies, puller: Any) -> None:
        """Register a system that hangs on its bodies."""
        self._pullers.append((bodies, puller))

    def watched_by(self, watcher: Watcher) -> Watcher:
        """Register an observer of past states, and keep states from now on."""
        if self._kept is None:
            self._kept = [self.state]
        self._watchers.append(watcher)
        return watcher

    def _tell(self, notices: Sequence[Fault]) -> None:
        """Keep warnings of a step with new codes."""
        for one in notices:
            if one.code not in {each.code for each in self.step_notices}:
                self.step_notices.append(one)

    def time(self, steps: int) -> float:
        """Return the end time of a number of steps [s]."""
        return self.begin + steps * self.step_length

    def look(self, t: float, *, begins: bool = False) -> tuple[Any, float]:
        """Return a kept state at a time [s], and its time.

        Times before the begin return the first state. With ``begins``, pushes until
        then are applied.
        """
        assert self._kept is not None
        count = self.advance(t)
        # A resumed run has no earlier states.
        earlier = (one for one in reversed(self._kept) if one.steps <= count)
        state = next(earlier, self._kept[0])
        now, observed = self.time(state.steps), self._part(state, t)
        if begins and observed is state:
            observed = self._pushed(state)
        return observed.state, max(t, now)

    def forget(self) -> None:
        """Drop the states that no observer needs any more."""
        assert self._kept is not None
        t = min(one.since for one in self._watchers)
        if t == -math.inf:
            return
        count = math.floor((t - self.begin) / self.step_length + ON_STEP)
        first = [k for k, one in enumerate(self._kept) if one.steps <= count]
        del self._kept[: first[-1] if first else 0]
        least = self._kept[0].steps
        self._begun = {k: one for k, one in self._begun.items() if k >= least}

    def _stepped(
        self, state: Reached[Any], until: float
    ) -> tuple[Reached[Any], Sequence[Wrenches]]:
        """Return the state after a full or partial step until a time [s].

        With its pushes on bodies of other systems.
        """
        now = self.time(state.steps)
        after = self.simulation.step(state.state, now, until - now)
        after = after if isinstance(after, Stepped) else Stepped(after)
        self.taken += 1
        self._tell(after.notices)
        if getattr(self.simulation, "checked", False):
            return Reached(state.steps + 1, after.state), after.wrenches
        frame = self.simulation.frame(after.state, until)
        check_finite(self.name, frame, until, self.step_length)
        return Reached(state.steps + 1, after.state), after.wrenches

"""A simulation as steps from state to state, and what takes it through time."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

from animtool.errors import Fault, OptionError, ToleranceError
from animtool.frames import Frame, TransformsFrame
from animtool.sim.colliders import Colliders
from animtool.sim.system import Energy

State = TypeVar("State")
FrameT_co = TypeVar("FrameT_co", covariant=True)


@dataclass(frozen=True, slots=True)
class Diagnostics:
    """What a state is like, for reports and tables."""

    energy: Energy | None = None  # None where it may come and go
    values: Mapping[str, float] = field(default_factory=dict)  # for the report
    notices: Sequence[Fault] = ()  # warnings so far


class SimContext(Protocol):
    """What a simulation may ask for while it is built.

    Attributes:
        begin: Time of its first step [s].
        last: The last time that will be asked for [s].
        colliders: All that its entry says it runs into: shapes, characters, meshes of
            files, and surfaces of other systems, at any time of a step.
        parts: What other keys of its entry are read as, by key, a list for a list:
            forces, places, shapes and arrays where a `Part` marks them, a `Collider`
            of what has a shape, and of other models such parts again, with the
            ``poses`` of those that are placed. Plain values are in the spec alone.
    """

    @property
    def begin(self) -> float:
        """Time of its first step [s]."""

    @property
    def last(self) -> float:
        """The last time that will be asked for [s]."""

    @property
    def colliders(self) -> Colliders:
        """All that its entry says it runs into."""

    @property
    def parts(self) -> Mapping[str, Any]:
        """What other keys of its entry are read as, by key, a list for a list."""


class Simulation(Protocol[State]):
    """A system as a scene simulates it: pure steps from state to state."""

    def initial(self) -> State:
        """Return the state at the time of the first step."""

    def step(self, state: State, t: float, dt: float) -> State:
        """Return a new state, a step [s] after a time [s]."""

    def frame(self, state: State, t: float) -> Frame:
        """Return what a state shows at its time [s]."""

    def diagnostics(self, state: State, t: float) -> Diagnostics:
        """Return what a state is like at its time [s]."""


class Progressed(Protocol):
    """A state that counts the steps that led to it."""

    @property
    def steps(self) -> int:
        """Whole steps since the beginning."""


ProgressedT = TypeVar("ProgressedT", bound=Progressed)


# A time that is as near to the end of a step is that end [steps].
ON_STEP = 1e-9


class SteppedRun(ABC, Generic[ProgressedT, FrameT_co]):
    """Takes a state through time in steps of one length, and looks at any time.

    Steps begin at the beginning and do not heed the times that are asked for: a look
    between two steps takes a part of a step that is not kept. So the frame rate of an
    output changes nothing of the motion. To resume, begin with a state of an earlier
    run.

    Attributes:
        begin: Time of the first step [s].
        step_length: Of every step [s].
        state: At the end of the last whole step.
    """

    begin: float
    step_length: float
    state: ProgressedT

    @abstractmethod
    def stepped(self, state: ProgressedT, until: float) -> ProgressedT:
        """Return the state at the end of a step, or of a part of one [s]."""

    @abstractmethod
    def frame(self, state: ProgressedT, t: float) -> FrameT_co:
        """Return what a state shows at its time [s]."""

    def at(self, t: float) -> FrameT_co:
        """Return what there is at a time, not before the last one asked for.

        Raises:
            OptionError: Time runs backwards (SIM002).
            ToleranceError: It blew up (SIM102), or the method could not go on.
        """
        whole = max(math.floor((t - self.begin) / self.step_length + ON_STEP), 0)
        if whole < self.state.steps:
            message = f"time {t:g} s is before that of the simulation"
            raise OptionError(Fault("SIM002", message, hint="begin again"))
        while self.state.steps < whole:
            self.state = self.stepped(self.state, self.time(self.state.steps + 1))
        now = self.time(whole)
        part = t > now + ON_STEP * self.step_length
        state = self.stepped(self.state, t) if part else self.state
        return self.frame(state, max(t, now))

    def time(self, steps: int) -> float:
        """Return when a number of steps ends [s]."""
        return self.begin + steps * self.step_length


@dataclass(frozen=True, slots=True)
class Reached(Generic[State]):
    """A state, and the steps that led to it."""

    steps: int
    state: State


class SimulationRun(SteppedRun[Reached[Any], Frame]):
    """A simulation under way; one whose numbers do not stay finite is stopped."""

    def __init__(
        self,
        name: str,
        simulation: Simulation[Any],
        begin: float,
        step_length: float,
        state: Reached[Any] | None = None,
    ) -> None:
        self.name, self.simulation = name, simulation
        self.begin, self.step_length = begin, step_length
        self.state = Reached(0, simulation.initial()) if state is None else state
        self.taken = 0  # steps and parts of steps
        self._seen = self.state.state, self.time(self.state.steps)

    def stepped(self, state: Reached[Any], until: float) -> Reached[Any]:
        """Return the state at the end of a step, or of a part of one [s].

        Raises:
            ToleranceError: It blew up (SIM102).
        """
        now = self.time(state.steps)
        after = self.simulation.step(state.state, now, until - now)
        self.taken += 1
        frame = self.simulation.frame(after, until)
        arrays = [frame.points, frame.velocities]
        if isinstance(frame, TransformsFrame):
            arrays += [frame.rotations, frame.spins, frame.scales]
        finite = np.isfinite(np.concatenate(arrays, axis=1))
        (bad,) = np.nonzero(~finite.all(axis=1))
        if len(bad):
            message = f"{self.name} blew up at {until:g} s: point {int(bad[0])} is"
            hint = "take shorter steps"
            raise ToleranceError(Fault("SIM102", f"{message} not finite", hint=hint))
        return Reached(state.steps + 1, after)

    def frame(self, state: Reached[Any], t: float) -> Frame:
        """Return what a state shows at its time [s]."""
        self._seen = state.state, t
        return self.simulation.frame(state.state, t)

    @property
    def diagnostics(self) -> Diagnostics:
        """What the state that was looked at last is like."""
        return self.simulation.diagnostics(*self._seen)

    @property
    def notices(self) -> list[Fault]:
        """Warnings so far."""
        return list(self.diagnostics.notices)

    def report(self) -> dict[str, object]:
        """Return what became of it, as plain values."""
        values = dict(self.diagnostics.values)
        return {"name": self.name, "steps": self.taken, **values} if values else {}

"""A simulation as steps from state to state, and what takes it through time."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

from animtool._types import FloatArray, IntArray
from animtool.errors import Fault, OptionError, ToleranceError
from animtool.frames import Frame, TransformsFrame
from animtool.maths import so3
from animtool.maths.faces import triangulated
from animtool.sim.colliders import Colliders
from animtool.sim.system import Energy
from animtool.sim.trajectory import Stats

State = TypeVar("State")


@dataclass(frozen=True, slots=True)
class Diagnostics:
    """What a state is like, for reports and tables."""

    energy: Energy | None = None  # None where it may come and go
    values: Mapping[str, float] = field(default_factory=dict)  # for the report
    notices: Sequence[Fault] = ()  # warnings so far
    if_empty: Sequence[Fault] = ()  # more of them, where no frame had a point
    steps: int | None = None  # of the method so far; None is one a step
    # Returns the largest that is stable from here on [s]: 0 where none is, infinite
    # where all are, None where it is not known.
    stable_step: Callable[[], float | None] = lambda: None


class SimContext(Protocol):
    """What a simulation may ask for while it is built.

    Attributes:
        begin: Time of its first step [s].
        last: The last time that will be asked for [s].
        colliders: All that its entry says it runs into: shapes, characters, meshes of
            files, and surfaces of other systems, at any time of a step.
        parts: What other keys of its entry are read as, by key, a list for a list:
            forces, places, shapes and arrays where a `Part` marks them, a `Collider`
            of what has a shape, the record of a `RecordModel`, and of other models such
            parts again, with the ``poses`` of those that are placed. Plain values are
            in the spec alone.
        budget: Most evaluations of a step; None is the usual one.
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

    @property
    def budget(self) -> int | None:
        """Most evaluations of a step; None is the usual one."""


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


# A time that is as near to the end of a step is that end [steps].
ON_STEP = 1e-9


# Metadata of fields of a state, so that it can be saved and resumed.


def growing(axis: int = 0) -> dict[str, Any]:
    """Mark a field whose arrays change their length along an axis, all alike."""
    return {"grows": axis}


def later(*records: type[Any]) -> dict[str, Any]:
    """Mark a field that is None at first: later one of some records, or a number."""
    return {"later": records}


@dataclass(frozen=True, slots=True)
class Reached(Generic[State]):
    """A state, and the steps that led to it."""

    steps: int
    state: State


class StoppedError(ToleranceError):
    """A method that could not go on, and what it took; None from another process."""

    def __init__(self, faults: Sequence[Fault], stats: Stats | None = None) -> None:
        super().__init__(faults)
        self.stats = stats


# Half the thickness of a surface that is that of a body [m].
SKIN = 1e-3


class SimulationRun:
    """Takes a simulation through time in steps of one length, and looks at any time.

    Steps begin at the beginning and do not heed the times that are asked for: a look
    between two steps takes a part of a step that is not kept. So the frame rate of an
    output changes nothing of the motion. To resume, begin with a state of an earlier
    run. One whose numbers do not stay finite is stopped.

    Attributes:
        begin: Time of the first step [s].
        step_length: Of every step [s].
        state: At the end of the last whole step.
        taken: Steps and parts of steps so far.
    """

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
        self.taken = 0
        # States that who looks at the surface may still ask for, from the latest.
        self._kept: list[Reached[Any]] | None = None
        self._surfaces: list[Surface] = []
        self._seen = self.state.state, self.time(self.state.steps)
        self._empty: bool | None = None  # None before the first look

    def at(self, t: float) -> Frame:
        """Return what there is at a time [s], not before the last one asked for.

        Raises:
            OptionError: Time runs backwards (SIM002).
            ToleranceError: It blew up (SIM102), or the method could not go on.
        """
        whole = max(math.floor((t - self.begin) / self.step_length + ON_STEP), 0)
        if whole < self.state.steps:
            message = f"time {t:g} s is before that of the simulation"
            raise OptionError(Fault("SIM002", message, hint="begin again"))
        while self.state.steps < whole:
            self._go_on()
        now = self.time(whole)
        part = t > now + ON_STEP * self.step_length
        state = self._stepped(self.state, t) if part else self.state
        self._seen = state.state, max(t, now)
        frame = self.simulation.frame(*self._seen)
        self._empty = self._empty is not False and not len(frame.points)
        return frame

    def _go_on(self) -> None:
        """Take a whole step."""
        self.state = self._stepped(self.state, self.time(self.state.steps + 1))
        if self._kept is not None:
            self._kept.append(self.state)

    def time(self, steps: int) -> float:
        """Return when a number of steps ends [s]."""
        return self.begin + steps * self.step_length

    radius = SKIN  # half the thickness of its surface [m]
    closed = True  # its surface is met from outside alone

    def watched(self, begin: float, step: float) -> Surface:  # noqa: ARG002
        """Return its surface, which others run into."""
        if self._kept is None:
            self._kept = [self.state]
        self._surfaces.append(Surface(self))
        return self._surfaces[-1]

    def look(self, t: float) -> Frame:
        """Return what there is at a time since the last that was forgotten [s]."""
        assert self._kept is not None
        whole = max(math.floor((t - self.begin) / self.step_length + ON_STEP), 0)
        while self.state.steps < whole:
            self._go_on()
        state = next(one for one in reversed(self._kept) if one.steps <= whole)
        now = self.time(state.steps)
        if t > now + ON_STEP * self.step_length:
            state = self._stepped(state, t)
        return self.simulation.frame(state.state, max(t, now))

    def forget(self) -> None:
        """Let go of the states that nobody asks for any more."""
        assert self._kept is not None
        t = min(surface.since for surface in self._surfaces)
        if t == -math.inf:
            return
        whole = math.floor((t - self.begin) / self.step_length + ON_STEP)
        first = [k for k, one in enumerate(self._kept) if one.steps <= whole]
        del self._kept[: first[-1] if first else 0]

    def _stepped(self, state: Reached[Any], until: float) -> Reached[Any]:
        """Return the state at the end of a step, or of a part of one [s]."""
        now = self.time(state.steps)
        after = self.simulation.step(state.state, now, until - now)
        self.taken += 1
        frame = self.simulation.frame(after, until)
        # Velocities of a field may have no value where no frame is.
        arrays = [frame.points]
        if isinstance(frame, TransformsFrame):
            arrays += [frame.rotations, frame.scales]
        if not all(np.isfinite(array).all() for array in arrays):
            finite = np.isfinite(np.concatenate(arrays, axis=1))
            (bad,) = np.nonzero(~finite.all(axis=1))
            message = f"{self.name} blew up at {until:g} s: point {int(bad[0])} is"
            hint = "take shorter steps"
            raise ToleranceError(Fault("SIM102", f"{message} not finite", hint=hint))
        return Reached(state.steps + 1, after)

    @property
    def diagnostics(self) -> Diagnostics:
        """What the state that was looked at last is like."""
        return self.simulation.diagnostics(*self._seen)

    @property
    def notices(self) -> list[Fault]:
        """Warnings so far."""
        found = self.diagnostics
        return [*found.notices, *(found.if_empty if self._empty else ())]

    def report(self) -> dict[str, object]:
        """Return what became of it, as plain values."""
        values = dict(self.diagnostics.values)
        return {"name": self.name, "steps": self.taken, **values} if values else {}


# Looks at a surface that are kept: both ends of a step, and those within.
LOOKS = 4


class Surface:
    """The meshes of a simulation, as others run into them: one surface."""

    def __init__(self, run: SimulationRun) -> None:
        self._run = run
        self.since = -math.inf  # no time before will be asked for [s]
        self._looks: dict[float, FloatArray] = {}
        self._faces: IntArray | None = None

    def points(self, t: float) -> FloatArray:
        """Return its points ``(N, 3)`` at a time [s] [m]."""
        if t not in self._looks:
            while len(self._looks) >= LOOKS:
                del self._looks[min(self._looks)]
            self._looks[t] = self._placed(self._run.look(t))
        return self._looks[t]

    def _placed(self, frame: Frame) -> FloatArray:
        if not isinstance(frame, TransformsFrame):
            return frame.points
        rows = [
            so3.rotate(turn, scale * frame.meshes[mesh].points) + at
            for at, turn, scale, mesh in zip(
                frame.points, frame.rotations, frame.scales, frame.copied, strict=True
            )
        ]
        return np.concatenate(rows) if rows else np.zeros((0, 3))

    def triangles(self, t: float) -> IntArray:
        """Return corners of its triangles ``(T, 3)``: always the same."""
        if self._faces is None:
            frame = self._run.look(t)
            meshes: Sequence[Any] = [frame]
            if isinstance(frame, TransformsFrame):
                meshes = [frame.meshes[k] for k in frame.copied]
            faces, base = [np.zeros((0, 3), np.int64)], 0
            for mesh in meshes:
                faces.append(triangulated(mesh.counts, mesh.indices) + base)
                base += len(mesh.points)
            self._faces = np.concatenate(faces)
        return self._faces

    def forget(self, t: float) -> None:
        """Take note that no time before one will be asked for [s]."""
        if t > self.since:
            self.since = t
            self._run.forget()

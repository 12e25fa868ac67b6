"""A simulation as a scene has it: pure steps from state to state."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import field
from typing import (
    TYPE_CHECKING,
    Any,
    Generic,
    Protocol,
    TypeAlias,
    TypeVar,
    runtime_checkable,
)

from animtool.core.errors import Fault, ToleranceError
from animtool.core.record import dataclass
from animtool.motion.frames import Frame
from animtool.sim.colliders import Colliders, Poses
from animtool.sim.colliders.bodies import Wrenches
from animtool.sim.system import Energy
from animtool.sim.trajectory import Stats

if TYPE_CHECKING:
    from animtool.sim.trials.trial import Setting
    from animtool.systems.framework.spec import Member
    from animtool.systems.framework.tied import TiedBodies

State = TypeVar("State")
# Told how far work is; None where nobody looks.
Progress: TypeAlias = Callable[[float], None] | None
State_contra = TypeVar("State_contra", contravariant=True)


@dataclass(frozen=True, slots=True)
class Diagnostics:
    """What a state is like, for reports and tables."""

    energy: Energy | None = None  # None where it may come and go
    values: Mapping[str, Any] = field(default_factory=dict)  # for the report
    notices: Sequence[Fault] = ()  # warnings so far
    if_empty: Sequence[Fault] = ()  # more of them, where no frame had a point
    steps: int | None = None  # of the method so far; None is one a step
    # Returns the largest that is stable from here on [s]: 0 where none is, infinite
    # where all are, None where it is not known.
    stable_step: Callable[[], float | None] = lambda: None
    # Most that a spring was longer than at rest so far, over that [1].
    stretch: float | None = None


@dataclass(frozen=True, slots=True)
class Stepped(Generic[State]):
    """A state after a step, and what bodies of other systems were pushed by in it."""

    state: State
    wrenches: Sequence[Wrenches] = ()  # of each of the colliders' `bodies`
    notices: Sequence[Fault] = ()  # warnings of it; a run tells the first of each code


@dataclass(frozen=True, slots=True)
class SimContext:
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
        poses: Returns where a part that carries others is over time.
        budget: Most evaluations of a step; None is the usual one.
        members: Entries that are simulated as one: of kinds that cannot be joined, one.
        clock: Returns what is told the time that was reached in a long call [s].
        phase: Returns what long work before the first step tells the share done.
        carriers: Rigid systems whose bodies carry particles, by name.
    """

    begin: float
    last: float
    colliders: Colliders
    parts: Mapping[str, Any]
    poses: Callable[[Any], Poses]
    budget: int | None = None
    members: Sequence[Member] = ()
    clock: Callable[[], Progress] = lambda: None
    phase: Callable[[], Progress] = lambda: None
    carriers: Mapping[str, TiedBodies] = field(default_factory=dict)


class SystemView(Protocol[State_contra]):
    """What an entry shows of a simulation."""

    def frame(self, state: State_contra, t: float) -> Frame:
        """Return what a state shows at its time [s]."""

    def diagnostics(self, state: State_contra, t: float) -> Diagnostics:
        """Return what a state is like at its time [s]."""


class Simulation(Protocol[State]):
    """A system as a scene simulates it: pure steps from state to state.

    One whose frames take long has an attribute ``checked``, True: its steps raise
    where numbers do not stay finite (SIM102), and frames are not made to see that.
    Others that one may have: `ManySteps`, `Joined`, `NeedsFinalState`, `Resumed`,
    `Tried` and, where others run into it, `RigidSystem` or `Skinned`. With an attribute
    ``step_length`` [s], it chose that step itself.
    """

    def initial(self) -> State:
        """Return the state at the time of the first step."""

    def step(self, state: State, t: float, dt: float) -> State | Stepped[State]:
        """Return a new state, a step [s] after a time [s].

        With what it pushed bodies of others by, if it runs into any.
        """

    def frame(self, state: State, t: float) -> Frame:
        """Return what a state shows at its time [s]."""

    def diagnostics(self, state: State, t: float) -> Diagnostics:
        """Return what a state is like at its time [s]."""


@runtime_checkable
class ManySteps(Protocol[State]):
    """A simulation that takes many steps at once, with the answer of each alone."""

    def steps(self, state: State, t: float, dt: float, count: int) -> Stepped[State]:
        """Return a new state, a number of whole steps [s] after a time [s]."""


@runtime_checkable
class Joined(Protocol[State_contra]):
    """A simulation of entries that are joined; its own frame shows all of them."""

    @property
    def views(self) -> Sequence[SystemView[State_contra]]:
        """What each entry shows."""


@runtime_checkable
class NeedsFinalState(Protocol[State_contra]):
    """A simulation whose frames need to know how it ends: it is run twice."""

    @property
    def needs_final_state(self) -> bool:
        """Whether they do."""

    def set_final_state(self, last: State_contra) -> None:
        """Take note of the state that it ends in, before the first frame is shown."""


@runtime_checkable
class Resumed(Protocol[State_contra]):
    """A simulation whose states must fit in more than the shapes of their arrays."""

    def incompatibility(self, state: State_contra, t: float) -> str:
        """Return why it cannot go on from a state of a file; empty where it can."""


@dataclass(frozen=True, slots=True)
class TrialSettings:
    """The settings that a table of time against error simulates a system with."""

    chosen: Setting  # of the file
    settings: Callable[[], list[Setting]]  # as in `Trial`
    references: Callable[[], list[list[Setting]]]  # likewise
    # From a setting to what of the spec is another.
    changes: Callable[[Setting], Mapping[str, Any]]


@runtime_checkable
class Tried(Protocol):
    """A simulation that gives the settings for its own table."""

    def trial_settings(self) -> TrialSettings:
        """Return the settings, around the one that it was built with."""


# Metadata of fields of a state, so that it can be saved and resumed.


def growing(axis: int = 0) -> dict[str, Any]:
    """Mark a field whose arrays change their length along an axis, all alike."""
    return {"grows": axis}


def later(*records: type[Any]) -> dict[str, Any]:
    """Mark a field that is None at first: later a number, or one of some records.

    ``np.ndarray`` among these is an array.
    """
    return {"later": records}


def added() -> dict[str, Any]:
    """Mark a field that older files of states lack: it begins as it does in a scene."""
    return {"added": True}


class StoppedError(ToleranceError):
    """A method that could not go on, and what it took; None from another process."""

    def __init__(self, faults: Sequence[Fault], stats: Stats | None = None) -> None:
        super().__init__(faults)
        self.stats = stats

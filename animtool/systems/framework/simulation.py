"""Protocols of simulations in scenes: pure steps from state to state."""

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
# Progress callback; None without.
Progress: TypeAlias = Callable[[float], None] | None
State_contra = TypeVar("State_contra", contravariant=True)


@dataclass(frozen=True, slots=True)
class Diagnostics:
    """Diagnostics of a state, for reports and tables."""

    energy: Energy | None = None  # None if it is not conserved
    values: Mapping[str, Any] = field(default_factory=dict)  # for the report
    notices: Sequence[Fault] = ()  # warnings so far
    if_empty: Sequence[Fault] = ()  # more warnings, if no frame had a point
    steps: int | None = None  # method steps so far; None is one per step
    # Returns the largest stable step from here on [s]: 0 if none is, infinite if all
    # are, None if unknown.
    stable_step: Callable[[], float | None] = lambda: None
    # Largest strain of a spring so far [1].
    stretch: float | None = None


@dataclass(frozen=True, slots=True)
class Stepped(Generic[State]):
    """A state after a step, with impulses on bodies of other systems."""

    state: State
    wrenches: Sequence[Wrenches] = ()  # one for each of the colliders' `bodies`
    notices: Sequence[Fault] = ()  # warnings; a run keeps the first of each code


@dataclass(frozen=True, slots=True)
class SimContext:
    """Context for building a simulation.

    Attributes:
        begin: Time of its first step [s].
        last: Last requested time [s].
        colliders: Colliders of its entry: shapes, characters, meshes of files, and
            surfaces of other systems, at any time of a step.
        parts: Parts read for the other keys of its entry, by key, a list for a list:
            forces, emitter shapes, shapes and arrays marked by `EntryPart`, a
            `Collider` for an entry with a shape, the record of a `RecordModel`, and
            nested parts of other models, with ``poses`` of placed ones. Plain values
            are only in the spec.
        poses: Returns the poses of a carrier over time.
        budget: Most evaluations of a step; None is the default.
        members: Entries that are simulated as one; a single one if joins are not
            supported.
        clock: Returns a callback for the time reached in a long call [s].
        phase: Returns a callback for the fraction done before the first step.
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
    """View of an entry on a simulation."""

    def frame(self, state: State_contra, t: float) -> Frame:
        """Return the frame of a state at its time [s]."""

    def diagnostics(self, state: State_contra, t: float) -> Diagnostics:
        """Return the diagnostics of a state at its time [s]."""


class Simulation(Protocol[State]):
    """A system in a scene: pure steps from state to state.

    With an attribute ``checked``, True, its steps raise if numbers are not finite
    (SIM102), and frames are not checked for that. Optional protocols:
    `ManySteps`, `Joined`, `NeedsFinalState`, `Resumed`, `Tried` and, as a collider of
    others, `RigidSystem` or `Skinned`. An attribute ``step_length`` [s] overrides the
    step.
    """

    def initial(self) -> State:
        """Return the state at the time of the first step."""

    def step(self, state: State, t: float, dt: float) -> State | Stepped[State]:
        """Return a new state, a step [s] after a time [s].

        Also returns impulses on bodies of other systems, if it collides with any.
        """

    def frame(self, state: State, t: float) -> Frame:
        """Return the frame of a state at its time [s]."""

    def diagnostics(self, state: State, t: float) -> Diagnostics:
        """Return the diagnostics of a state at its time [s]."""


@runtime_checkable
class ManySteps(Protocol[State]):
    """A simulation that takes many steps at once, equal to single steps."""

    def steps(self, state: State, t: float, dt: float, count: int) -> Stepped[State]:
        """Return a new state, a number of full steps [s] after a time [s]."""


@runtime_checkable
class Joined(Protocol[State_contra]):
    """A simulation of joined entries; its frame shows all of them."""

    @property
    def views(self) -> Sequence[SystemView[State_contra]]:
        """One view for each entry."""


@runtime_checkable
class NeedsFinalState(Protocol[State_contra]):
    """A simulation whose frames depend on its final state: it is run twice."""

    @property
    def needs_final_state(self) -> bool:
        """Whether frames depend on the final state."""

    def set_final_state(self, last: State_contra) -> None:
        """Set the final state, before the first frame is requested."""


@runtime_checkable
class Resumed(Protocol[State_contra]):
    """A simulation with additional checks of resumed states."""

    def incompatibility(self, state: State_contra, t: float) -> str:
        """Return why it cannot resume from a state; empty if it can."""


@dataclass(frozen=True, slots=True)
class TrialSettings:
    """Settings of a work-precision table of a system."""

    chosen: Setting  # configured setting
    settings: Callable[[], list[Setting]]  # as in `Trial`
    references: Callable[[], list[list[Setting]]]  # as in `Trial`
    # Maps a setting to changed keys of the spec.
    changes: Callable[[Setting], Mapping[str, Any]]


@runtime_checkable
class Tried(Protocol):
    """A simulation that provides settings for its table."""

    def trial_settings(self) -> TrialSettings:
        """Return settings around the configured one."""


# Metadata of fields of a state, so that it can be saved and resumed.


def growing(axis: int = 0) -> dict[str, Any]:
    """Mark a field whose arrays change their length along an axis, all equally."""
    return {"grows": axis}


def later(*records: type[Any]) -> dict[str, Any]:
    """Mark a field that starts as None, and is later a number or one of the records.

    ``np.ndarray`` allows an array.
    """
    return {"later": records}


def added() -> dict[str, Any]:
    """Mark a field missing in older state files: it keeps its initial value."""
    return {"added": True}


class StoppedError(ToleranceError):
    """A failed method with its statistics; None from another process."""

    def __init__(self, faults: Sequence[Fault], stats: Stats | None = None) -> None:
        super().__init__(faults)
        self.stats = stats

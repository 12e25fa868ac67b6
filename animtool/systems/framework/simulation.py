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
    from animtool.systems.framework.body_carriers import CarrierBodies
    from animtool.systems.framework.spec import JoinedEntry

State = TypeVar("State")
# Progress callback; None if no progress is shown.
Progress: TypeAlias = Callable[[float], None] | None
State_contra = TypeVar("State_contra", contravariant=True)


@dataclass(frozen=True, slots=True)
class Diagnostics:
    """Energy, warnings and report values of a state."""

    energy: Energy | None = None  # energy; None if it is not conserved
    values: Mapping[str, Any] = field(default_factory=dict)  # report values by name
    notices: Sequence[Fault] = ()  # warnings so far
    notices_if_empty: Sequence[Fault] = ()  # more warnings, if no frame had a point
    steps: int | None = None  # method steps so far; None is one per step
    # Returns the largest step that is stable from here on [s]: 0 if none is, infinite
    # if all are, None if unknown.
    stable_step: Callable[[], float | None] = lambda: None
    # Largest strain of a spring so far [1].
    stretch: float | None = None


@dataclass(frozen=True, slots=True)
class SteppedState(Generic[State]):
    """A state after a step, with impulses on bodies of other systems, and warnings."""

    state: State
    wrenches: Sequence[Wrenches] = ()  # one for each of the colliders' `bodies`
    notices: Sequence[Fault] = ()  # warnings; a run keeps the first of each code


@dataclass(frozen=True, slots=True)
class SimContext:
    """Inputs of the function that builds a simulation from its spec.

    Attributes:
        begin: Time of the first step [s].
        last: Last requested time [s].
        colliders: Colliders of the entry: shapes, characters, meshes of files, and
            surfaces of other systems, at any time of a step.
        entry_data: Data read for the keys of the entry, by key; a list for a list of
            entries. It has forces, emitter shapes, shapes and arrays (`FieldKind`), a
            `Collider` for an entry with a shape, the record of a `RecordModel`, and a
            nested mapping for other models, with ``poses`` of placed ones. Plain values
            are only in the spec.
        poses: Function that returns the poses of a carrier over time.
        budget: Largest number of evaluations of a step; None is the default.
        members: Entries that are simulated as one; a single one if joins are not
            supported.
        clock: Function that returns a progress callback for the simulated time [s].
        phase: Function that returns a progress callback for the fraction done before
            the first step.
        carriers: Rigid systems whose bodies carry particles, by name.
    """

    begin: float
    last: float
    colliders: Colliders
    entry_data: Mapping[str, Any]
    poses: Callable[[Any], Poses]
    budget: int | None = None
    members: Sequence[JoinedEntry] = ()
    clock: Callable[[], Progress] = lambda: None
    phase: Callable[[], Progress] = lambda: None
    carriers: Mapping[str, CarrierBodies] = field(default_factory=dict)


class SystemView(Protocol[State_contra]):
    """Frames and diagnostics of one entry of a simulation."""

    def frame(self, state: State_contra, t: float) -> Frame:
        """Return the frame of a state at its time [s]."""

    def diagnostics(self, state: State_contra, t: float) -> Diagnostics:
        """Return the diagnostics of a state at its time [s]."""


class Simulation(Protocol[State]):
    """A system in a scene: pure steps from state to state.

    With an attribute ``checked``, True, its steps raise if numbers are not finite
    (SIM102), and frames are not checked for that. Optional protocols:
    `ManySteps`, `HasEntryViews`, `NeedsFinalState`, `ChecksResumedState`,
    `HasTrialSettings` and, as a collider of others, `RigidSystem` or
    `HasCollisionSurface`. An attribute ``step_length`` [s] overrides the step.
    """

    def initial_state(self) -> State:
        """Return the state at the time of the first step."""

    def step(self, state: State, t: float, dt: float) -> State | SteppedState[State]:
        """Return a new state, a step [s] after a time [s].

        Also returns impulses on bodies of other systems, if there are any.
        """

    def frame(self, state: State, t: float) -> Frame:
        """Return the frame of a state at its time [s]."""

    def diagnostics(self, state: State, t: float) -> Diagnostics:
        """Return the diagnostics of a state at its time [s]."""


@runtime_checkable
class ManySteps(Protocol[State]):
    """A simulation that takes many steps in one call, equal to single steps."""

    def steps(
        self, state: State, t: float, dt: float, count: int
    ) -> SteppedState[State]:
        """Return the state after ``count`` full steps [s] from a time [s]."""


@runtime_checkable
class HasEntryViews(Protocol[State_contra]):
    """A simulation of several joined scene entries."""

    @property
    def views(self) -> Sequence[SystemView[State_contra]]:
        """One view for each entry."""


@runtime_checkable
class NeedsFinalState(Protocol[State_contra]):
    """A simulation whose frames depend on its final state: it is run twice."""

    @property
    def needs_final_state(self) -> bool:
        """Whether frames depend on the final state."""

    def set_final_state(self, final_state: State_contra) -> None:
        """Set the final state, before the first frame is requested."""


@runtime_checkable
class StartsLater(Protocol):
    """A simulation that may hold nothing until a time."""

    def late_start_notice(self, t: float) -> Fault | None:
        """Return a warning if nothing exists until a time [s]; None if it may."""


@runtime_checkable
class ChecksResumedState(Protocol[State_contra]):
    """A simulation with additional checks of resumed states."""

    def incompatibility(self, state: State_contra, t: float) -> str:
        """Return why the simulation cannot resume from a state; empty if it can."""


@dataclass(frozen=True, slots=True)
class TrialSettings:
    """Settings and references that a work-precision table compares."""

    configured_setting: Setting  # the setting of the spec
    settings: Callable[[], list[Setting]]  # as in `Trial`
    references: Callable[[], list[list[Setting]]]  # as in `Trial`
    # Maps a setting to the keys of the spec that it changes.
    changes: Callable[[Setting], Mapping[str, Any]]


@runtime_checkable
class HasTrialSettings(Protocol):
    """A simulation that provides the settings of its work-precision table."""

    def trial_settings(self) -> TrialSettings:
        """Return the settings to compare, around the configured setting."""


# Metadata of fields of a state, so that it can be saved and resumed.


def growing_field(axis: int = 0) -> dict[str, Any]:
    """Mark a field whose arrays grow along an axis, in step with all such fields."""
    return {"grows": axis}


def field_set_later(*record_types: type[Any]) -> dict[str, Any]:
    """Mark a field that starts as None and is a number or a record later.

    ``np.ndarray`` allows an array.
    """
    return {"later": record_types}


def field_added_later() -> dict[str, Any]:
    """Mark a field that older state files lack; it keeps its initial value then."""
    return {"added": True}


def saved_as(name: str) -> dict[str, Any]:
    """Mark a field that has another name in state files."""
    return {"saved_name": name}


class StoppedError(ToleranceError):
    """Raised if a method cannot continue; holds the run's statistics, if known."""

    def __init__(self, faults: Sequence[Fault], stats: Stats | None = None) -> None:
        super().__init__(faults)
        self.stats = stats

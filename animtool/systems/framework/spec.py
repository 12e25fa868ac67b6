"""Base model of system entries in scenes, and their records."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Annotated, Any, ClassVar, Protocol

from annotated_types import Gt
from pydantic import Field

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, Problem, counted
from animtool.core.options import key
from animtool.core.record import dataclass
from animtool.documents.check import FileModel
from animtool.documents.fields import Frame, Name, Real
from animtool.systems.framework.fields import (
    Characters,
    Colliders,
    Forces,
    Meshes,
    Preroll,
    PrimName,
    Surfaces,
)


class SystemSpec(FileModel):
    """Base model of the keys of a system in a scene: subclass it and add keys.

    Attributes:
        methods: Choices of its key ``method``, if it adds one; ``--table`` compares
            them with several steps or tolerances. None is every integrator.
        reference_method: Reference integrator of a table, used with finer steps; empty
            is the configured one.
        method_key: Key that names the method, if there is one.
        has_trial_settings: Whether its simulation provides settings for a table
            (`HasTrialSettings`).
        components: Keys whose entries `counts` counts.
        counted_keys: Keys whose entries `reads` counts.
        code: Code of the faults from `problems`; SIM032 is conflicting options.
        quantities: Choices of its key ``colour``, if it adds one.
    """

    methods: ClassVar[Sequence[str] | None] = ()
    reference_method: ClassVar[str] = ""
    method_key: ClassVar[str] = "method"
    has_trial_settings: ClassVar[bool] = False
    components: ClassVar[Sequence[str]] = ()
    counted_keys: ClassVar[Sequence[str]] = ("forces",)
    code: ClassVar[str] = "SIM032"
    quantities: ClassVar[Sequence[str]] = ()

    name: PrimName = Field(examples=["chain"])
    step: Annotated[Real, Gt(0)] = key(
        "Step of the simulation [s], independent of the frame rate.",
        0.005,
        default=0.01,
    )
    preroll: Preroll = 0.0
    save: Name | None = key(
        "File (`.npz`) for its state at `save_at`; like an output it is replaced "
        "only with `overwrite`.",
        "birds.npz",
        default=None,
    )
    save_at: Frame | None = key(
        "Time code at which the state is saved. Default: the last that is written.",
        48,
        default=None,
    )
    resume: Name | None = key(
        "A saved state to resume from: later frames are identical to those of the "
        "whole run, to the bit; earlier ones cannot be requested.",
        "birds.npz",
        default=None,
    )

    @property
    def title(self) -> str:
        """Name of the entry in messages."""
        return self.name

    @property
    def reads(self) -> list[str]:
        """External inputs as text, such as ``2 forces``; colliders are not included."""
        counts = {name: len(getattr(self, name, ())) for name in self.counted_keys}
        return [counted(n, name.removesuffix("s")) for name, n in counts.items() if n]

    @property
    def counts(self) -> dict[str, int]:
        """Counts of components, by kind."""
        counts = {name: len(getattr(self, name)) for name in self.components}
        return {name: count for name, count in counts.items() if count}

    def faults(self, entry_data: Mapping[str, Any]) -> Sequence[Fault]:  # noqa: ARG002
        """Return faults for conflicting keys, with the key as ``where``.

        ``entry_data`` is the data read for the keys, as in a `SimContext`.
        """
        faults = [
            Fault(self.code, message, hint=hint, where=location)
            for message, location, hint in self.problems()
        ]
        colour = getattr(self, "colour", None)
        return faults + (colour.faults(self.quantities, self.code) if colour else [])

    def problems(self) -> Iterator[Problem]:
        """Yield conflicts between keys that need no other files to detect."""
        yield from ()

    def build_record(
        self,
        entry_data: Mapping[str, Any],  # noqa: ARG002
    ) -> tuple[Any, Sequence[Fault]]:
        """Return the record of the entry, and its faults, when the file is read.

        A kind with properties beyond its keys, or that can be joined to others, returns
        an `EntryRecord`, or None if it cannot be built; `build` gets it from
        `SimContext.members`. ``entry_data`` is the data read for the keys, as in a
        `SimContext`; data that cannot be read is None.
        """
        return None, ()

    def shared(self, *, has_colliders: bool = True) -> Mapping[str, Any]:  # noqa: ARG002
        """Return the keys whose values apply to all joined entries.

        ``has_colliders``: whether any of them has colliders.
        """
        return {}


class CollidingSpec(SystemSpec):
    """Base model of a system with colliders."""

    colliders: Colliders = Field([])
    characters: Characters = Field([])
    systems: Surfaces = Field([])
    meshes: Meshes = Field([])


class ForcedSpec(CollidingSpec):
    """Base model of a system with colliders and external forces."""

    forces: Forces = Field([])


@dataclass(frozen=True, slots=True)
class JoinedEntry:
    """One of the scene entries that are simulated together."""

    name: str
    kind: str
    spec: Any
    entry_data: Mapping[str, Any]  # data read for the keys of the entry, by key
    record: Any = None  # record built by the spec of the entry


@dataclass(frozen=True, slots=True)
class PinnedPoints:
    """Points that follow a carrier."""

    where: str  # location in the scene entry
    carrier: Any  # carrier, for `SimContext.poses`
    # Maps carrier poses to point positions in the carrier's frame ``(P, 3)`` [m].
    local_positions: Callable[[Any], FloatArray]


class EntryRecord(Protocol):
    """Properties of an entry that are known once its files are read."""

    @property
    def title(self) -> str:
        """Name of the entry in messages."""

    @property
    def reads(self) -> Sequence[str]:
        """External inputs as text, such as ``2 forces``; colliders are not included."""

    @property
    def counts(self) -> dict[str, int]:
        """Counts of components, by kind."""

    @property
    def joined_systems(self) -> Sequence[tuple[str, str]]:
        """Names of joined systems, and the keys that name them."""

    def joined_faults(self, members: Sequence[JoinedEntry]) -> Sequence[Fault]:
        """Return faults for invalid joins with other systems, each with its key."""

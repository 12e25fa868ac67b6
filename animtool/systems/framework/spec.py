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
        exact: Reference integrator of a table, in finer steps; empty is the configured
            one.
        method_key: Key that names the method, if there is one.
        tried: Whether its simulation provides `TrialSettings`.
        components: Keys whose entries are counted as components.
        acted_on: Keys whose entries are counted as external forces.
        code: Code of the faults from `problems`; SIM032 is conflicting options.
        quantities: Choices of its key ``colour``, if it adds one.
    """

    methods: ClassVar[Sequence[str] | None] = ()
    exact: ClassVar[str] = ""
    method_key: ClassVar[str] = "method"
    tried: ClassVar[bool] = False
    components: ClassVar[Sequence[str]] = ()
    acted_on: ClassVar[Sequence[str]] = ("forces",)
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
        """Title for messages."""
        return self.name

    @property
    def reads(self) -> list[str]:
        """Numbers of external forces by kind, as text; without colliders."""
        counts = {name: len(getattr(self, name, ())) for name in self.acted_on}
        return [counted(n, name.removesuffix("s")) for name, n in counts.items() if n]

    @property
    def counts(self) -> dict[str, int]:
        """Counts of components, by kind."""
        counts = {name: len(getattr(self, name)) for name in self.components}
        return {name: count for name, count in counts.items() if count}

    def faults(self, parts: Mapping[str, Any]) -> Sequence[Fault]:  # noqa: ARG002
        """Return faults of conflicting keys, with the key as ``where``.

        ``parts`` are those of a `SimContext`.
        """
        faults = [
            Fault(self.code, message, hint=hint, where=where)
            for message, where, hint in self.problems()
        ]
        colour = getattr(self, "colour", None)
        return faults + (colour.faults(self.quantities, self.code) if colour else [])

    def problems(self) -> Iterator[Problem]:
        """Yield conflicts between keys that show without other files."""
        yield from ()

    def build_record(self, parts: Mapping[str, Any]) -> tuple[Any, Sequence[Fault]]:  # noqa: ARG002
        """Return the record of the entry when the file is read, and its faults.

        A kind with facts beyond its keys, or one that can be joined to others, returns
        an `EntryRecord`, or None if it cannot be built; `build` gets it from
        `SimContext.members`. Parts that cannot be read are None.
        """
        return None, ()

    def shared(self, *, meets: bool = True) -> Mapping[str, Any]:  # noqa: ARG002
        """Return the keys it sets for all joined entries.

        ``meets``: whether any of them has colliders.
        """
        return {}


class CollidingSpec(SystemSpec):
    """A system with colliders: see `AROUND`."""

    colliders: Colliders = Field([])
    characters: Characters = Field([])
    systems: Surfaces = Field([])
    meshes: Meshes = Field([])


class ForcedSpec(CollidingSpec):
    """A system with colliders and external forces."""

    forces: Forces = Field([])


@dataclass(frozen=True, slots=True)
class Member:
    """A scene entry among those that are simulated as one."""

    name: str
    kind: str
    spec: Any
    parts: Mapping[str, Any]  # parts read for its keys, by key
    record: Any = None  # record built by its spec


@dataclass(frozen=True, slots=True)
class PinnedPoints:
    """Points held by a carrier."""

    where: str  # its key
    carrier: Any  # carrier, for `SimContext.poses`
    # Maps carrier poses to positions in its frame ``(P, 3)`` [m].
    local_positions: Callable[[Any], FloatArray]


class EntryRecord(Protocol):
    """Record of an entry after reading, with its title and counts."""

    @property
    def title(self) -> str:
        """Title for messages."""

    @property
    def reads(self) -> Sequence[str]:
        """Numbers of external forces by kind, as text; without colliders."""

    @property
    def counts(self) -> dict[str, int]:
        """Counts of components, by kind."""

    @property
    def joined_systems(self) -> Sequence[tuple[str, str]]:
        """Names of joined systems, and the keys that name them."""

    def joined_faults(self, members: Sequence[Member]) -> Sequence[Fault]:
        """Return faults of joins with others, each with its key."""

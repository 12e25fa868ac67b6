"""What a scene says of a system of any kind, and what an entry is made into."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Annotated, Any, ClassVar, Protocol

from annotated_types import Gt
from pydantic import Field

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, Problem, counted
from animtool.core.record import dataclass
from animtool.documents.check import FileModel
from animtool.documents.fields import Frame, Name, Real, key
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
    """What a scene says of a system that steps evenly: subclass it, and add keys.

    Attributes:
        methods: What its key ``method``, if it adds one, may be; ``--table`` compares
            them, each with several steps or tolerances. None is every integrator.
        exact: The integrator that others are compared with, in finer steps; empty is
            that of the file.
        method_key: The key that names the method, if there is one.
        tried: Whether its simulation gives its own `TrialSettings`.
        made_of: Keys whose entries are counted as what it is made of.
        acted_on: Likewise, as what acts on it.
        code: Of the faults that `problems` are; SIM032 is options that do not go
            together.
        quantities: What its key ``colour``, if it adds one, may be by.
    """

    methods: ClassVar[Sequence[str] | None] = ()
    exact: ClassVar[str] = ""
    method_key: ClassVar[str] = "method"
    tried: ClassVar[bool] = False
    made_of: ClassVar[Sequence[str]] = ()
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
        """What it is called in words."""
        return self.name

    @property
    def reads(self) -> list[str]:
        """What acts on it, in words; what it runs into is left out."""
        found = {name: len(getattr(self, name, ())) for name in self.acted_on}
        return [counted(n, name.removesuffix("s")) for name, n in found.items() if n]

    @property
    def counts(self) -> dict[str, int]:
        """What it is made of, by kind."""
        found = {name: len(getattr(self, name)) for name in self.made_of}
        return {name: count for name, count in found.items() if count}

    def faults(self, parts: Mapping[str, Any]) -> Sequence[Fault]:  # noqa: ARG002
        """Return which keys make no sense together, each fault's ``where`` a key.

        ``parts`` are those of a `SimContext`.
        """
        found = [
            Fault(self.code, message, hint=hint, where=where)
            for message, where, hint in self.problems()
        ]
        colour = getattr(self, "colour", None)
        return found + (colour.faults(self.quantities, self.code) if colour else [])

    def problems(self) -> Iterator[Problem]:
        """Yield which keys make no sense together, where no part is looked at."""
        yield from ()

    def made(self, parts: Mapping[str, Any]) -> tuple[Any, Sequence[Fault]]:  # noqa: ARG002
        """Return what is made of it when the file is read, and all that is wrong.

        A kind whose facts are not in its keys alone, or that can be joined to others,
        returns an `EntryRecord`, or None where faults leave none; `build` finds it in
        `SimContext.members`. Parts that cannot be read are None.
        """
        return None, ()

    def shared(self, *, meets: bool = True) -> Mapping[str, Any]:  # noqa: ARG002
        """Return what it states for all that it is joined to, by key.

        ``meets``: whether any of them runs into anything.
        """
        return {}


class CollidingSpec(SystemSpec):
    """A system under forces that collides with its surroundings: see `AROUND`."""

    forces: Forces = Field([])
    colliders: Colliders = Field([])
    characters: Characters = Field([])
    systems: Surfaces = Field([])
    meshes: Meshes = Field([])


@dataclass(frozen=True, slots=True)
class Member:
    """An entry of a scene, of those that are simulated as one."""

    name: str
    kind: str
    spec: Any
    parts: Mapping[str, Any]  # what its keys are read as, by key
    record: Any = None  # what its spec makes of it when it is read


@dataclass(frozen=True, slots=True)
class PinnedPoints:
    """Points that are held by something else."""

    where: str  # the key that says so
    carrier: Any  # what carries them, for `SimContext.poses`
    # From where that is over time to where they are in its frame ``(P, 3)`` [m].
    inside: Callable[[Any], FloatArray]


class EntryRecord(Protocol):
    """What an entry is made into when it is read; it speaks for its spec."""

    @property
    def title(self) -> str:
        """What it is called in words."""

    @property
    def reads(self) -> Sequence[str]:
        """What acts on it, in words; what it runs into is left out."""

    @property
    def counts(self) -> dict[str, int]:
        """What it is made of, by kind."""

    @property
    def joined(self) -> Sequence[tuple[str, str]]:
        """Names of systems that it is one with, and the keys that say so."""

    def joined_faults(self, members: Sequence[Member]) -> Sequence[Fault]:
        """Return what keeps it from being one with others, each with its key."""

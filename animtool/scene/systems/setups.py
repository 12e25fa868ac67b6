"""What readers of systems give: setups, before anything is simulated."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeAlias

from animtool.documents.document import Document, Location


@dataclass(frozen=True, slots=True)
class SystemFacts:
    """A system in numbers, before it is simulated."""

    counts: dict[str, int]  # what it is made of, by kind
    method: str  # its solver, or its integrator
    step: float | None  # the longest that it takes [s]; None leaves it to the method
    # Of its own, meshes of files among them; those of characters are not counted.
    colliders: int


class SystemSetup(Protocol):
    """What a system is made of, as its file says it.

    Attributes:
        joined: Names of systems that it is one with, and where they stand.
        needs: Names of systems that are to be there before it, and where they stand.
        files: What is read beside the scene.
        reads: What acts on it, in words.
        makes: What becomes of it, in words.
        facts: What it is made of, in numbers.
        preroll: Time before 0 s that it begins in [s].
    """

    @property
    def joined(self) -> tuple[tuple[str, Location], ...]:
        """Names of systems that it is one with, and where they stand."""

    @property
    def needs(self) -> tuple[tuple[str, Location], ...]:
        """Names of systems that are to be there before it, and where they stand."""

    @property
    def files(self) -> tuple[Path, ...]:
        """What is read beside the scene."""

    @property
    def reads(self) -> tuple[str, ...]:
        """What acts on it, in words."""

    @property
    def makes(self) -> str:
        """What becomes of it, in words."""

    @property
    def facts(self) -> SystemFacts:
        """What it is made of, in numbers."""

    @property
    def preroll(self) -> float:
        """Time before 0 s that it begins in [s]."""


# Where faults are noted, place and keys of the entry, and folders files may be in.
SystemReader: TypeAlias = Callable[
    [Document, Location, Any, Sequence[Path]], SystemSetup | None
]

"""A file's content in memory while it is fixed, whatever kind of file it is."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from animtool.errors import Fault
from animtool.validation.subjects.subject import Opened


class Draft(Protocol):
    """Content of a file; a step returns another draft and leaves this one."""

    @property
    def opened(self) -> Opened:
        """The content as rules look at it."""

    @property
    def found(self) -> Sequence[Fault]:
        """Findings of the rules in it."""

    def batch(self, cases: Sequence[Fault]) -> Sequence[Fault]:
        """Return the findings that one step fixes, of all that are left to try."""

    def step(self, faults: Sequence[Fault]) -> Step:
        """Return the content with findings of `batch` fixed."""

    def finish(self, cases: Sequence[Fault], /) -> Step:
        """Return the content with those findings fixed that had to wait."""

    def fixable(self, faults: Sequence[Fault]) -> Iterator[Fault]:
        """Yield the findings that can be fixed, each on its own."""

    def difference(self) -> str:
        """Return what fixes changed in the file, for a person."""

    def outputs(self) -> Sequence[Path]:
        """Return new files that the content needs beside it."""

    def write(self, output: Path) -> Sequence[str]:
        """Write the content to the file or another, and return remarks on it.

        Raises:
            OutputError: It cannot be written.
        """


@dataclass(frozen=True, slots=True)
class Step:
    """The result of one step."""

    draft: Draft  # the content after it
    done: Sequence[tuple[Fault, str]] = ()  # findings that were fixed, and how
    refused: Sequence[tuple[Fault, str]] = ()  # findings that were not, and why

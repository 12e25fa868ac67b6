"""A draft of files with fixes: what is edited, and what one fix says of another."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import field
from pathlib import Path
from typing import Any, Protocol, cast

import numpy.typing as npt

from animtool.core.errors import Fault
from animtool.core.plugins import load_object
from animtool.core.record import dataclass
from animtool.documents.edit import Edit
from animtool.usd.fixes.table import EDITS
from animtool.validation.subjects.subject import CheckedFile


class FileDraft(Protocol):
    """Content of a file; a step returns another draft and leaves this one."""

    @property
    def checked(self) -> CheckedFile:
        """The content as rules look at it."""

    @property
    def findings(self) -> Sequence[Fault]:
        """Findings of the rules in it."""

    def batch(self, cases: Sequence[Fault]) -> Sequence[Fault]:
        """Return the findings that one step fixes, of all that are left to try."""

    def step(self, faults: Sequence[Fault]) -> FixStep:
        """Return the content with findings of `batch` fixed."""

    def finish(self, cases: Sequence[Fault], /) -> FixStep:
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
class FixStep:
    """The result of one step."""

    draft: FileDraft  # the content after it
    done: Sequence[tuple[Fault, str]] = ()  # findings that were fixed, and how
    refused: Sequence[tuple[Fault, str]] = ()  # findings that were not, and why


# What a finding's code is mended by in documents; USD layers have edits of their own.
FIXES = {
    "RIG210": "animtool.validation.fixes.texts:summed",
    "RIG219": "animtool.validation.fixes.names:distinct",
    "RIG221": "animtool.validation.fixes.names:allowed",
    "RIG222": "animtool.validation.fixes.texts:from_bind",
    "VAL001": "animtool.validation.fixes.texts:left_out",
}


class NotMendedError(Exception):
    """A finding of a code that has a fix, which is not safe here; says why."""


@dataclass(frozen=True, slots=True)
class Mend:
    """What mends a finding."""

    remedy: str  # what is done, for the report
    edits: tuple[Edit, ...]  # of the file's text
    # Of new npz files, by file and name.
    arrays: Mapping[Path, Mapping[str, npt.NDArray[Any]]] = field(default_factory=dict)


# Raises NotMendedError where it would not be safe.
Fix = Callable[[CheckedFile, Fault], Mend]


def fix_of(code: str) -> Fix | None:
    """Return what mends findings of a code; None where nothing does.

    >>> fix_of("RIG201") is None
    True
    """
    return cast(Fix, load_object(FIXES[code])) if code in FIXES else None


def has_fix(code: str) -> bool:
    """Return whether findings of a code may have a safe remedy.

    >>> has_fix("RIG210"), has_fix("USD204"), has_fix("RIG201")
    (True, True, False)
    """
    return code in FIXES or code in EDITS

"""Drafts of files under repair: one interface for texts and layers."""

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
from animtool.usd.fixes.table import EDITS_BY_CODE
from animtool.validation.subjects.subject import CheckedFile


class FileDraft(Protocol):
    """Content of a file under repair; each step returns a new draft."""

    @property
    def checked_file(self) -> CheckedFile:
        """The parsed content, as the subject of the rules."""

    @property
    def findings(self) -> Sequence[Fault]:
        """Findings of all rules in the current content."""

    def next_batch(self, findings: Sequence[Fault]) -> Sequence[Fault]:
        """Return the findings to fix in the next step."""

    def fix_batch(self, faults: Sequence[Fault]) -> FixStepResult:
        """Return a draft in which the findings of `next_batch` are fixed."""

    def fix_deferred(self, findings: Sequence[Fault], /) -> FixStepResult:
        """Return a draft in which the deferred findings are fixed."""

    def fixable_findings(self, faults: Sequence[Fault]) -> Iterator[Fault]:
        """Yield the findings that can be fixed one by one."""

    def diff_text(self) -> str:
        """Return the changes so far as a diff or a list of edits."""

    def outputs(self) -> Sequence[Path]:
        """Return the new files to write next to the repaired file."""

    def write(self, output: Path) -> Sequence[str]:
        """Write the content to a file and return notices.

        Raises:
            OutputError: It cannot be written.
        """


@dataclass(frozen=True, slots=True)
class FixStepResult:
    """Result of one step of fixes."""

    draft: FileDraft  # the content after the step
    fixed_findings: Sequence[tuple[Fault, str]] = ()  # fixed findings, and how
    unfixed_findings: Sequence[tuple[Fault, str]] = ()  # other findings, and why


# Fixes of documents by code; USD layers have a separate table.
FIXES = {
    "RIG109": "animtool.validation.fixes.names:make_names_legal",
    "RIG210": "animtool.validation.fixes.texts:normalize_weights",
    "RIG219": "animtool.validation.fixes.names:make_name_unique",
    "RIG221": "animtool.validation.fixes.names:make_names_legal",
    "RIG222": "animtool.validation.fixes.texts:rest_from_bind",
    "VAL001": "animtool.validation.fixes.texts:remove_ignore_entry",
}


class NotFixedError(Exception):
    """A finding cannot be fixed safely; the message states the reason."""


@dataclass(frozen=True, slots=True)
class FixEdits:
    """Edits of a file's text, and new npz files, that fix one finding."""

    description: str  # description of the fix for the report
    edits: tuple[Edit, ...]  # edits of the file's text
    # Arrays of new npz files, by file and name.
    arrays: Mapping[Path, Mapping[str, npt.NDArray[Any]]] = field(default_factory=dict)


# Raises NotFixedError if the fix would not be safe.
FixFunction = Callable[[CheckedFile, Fault], FixEdits]


def load_fix(code: str) -> FixFunction | None:
    """Import the function that fixes a code's findings; None if there is none.

    >>> load_fix("RIG201") is None
    True
    """
    return cast(FixFunction, load_object(FIXES[code])) if code in FIXES else None


def has_fix(code: str) -> bool:
    """Return whether findings of a code may have a safe fix.

    >>> has_fix("RIG210"), has_fix("USD204"), has_fix("RIG201")
    (True, True, False)
    """
    return code in FIXES or code in EDITS_BY_CODE

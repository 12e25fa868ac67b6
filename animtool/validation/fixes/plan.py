"""Files mended in memory: one finding after another, each checked before the next."""

from __future__ import annotations

import difflib
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy.typing as npt

from animtool.documents.document import document_of, read_text
from animtool.documents.edit import EditError, edited
from animtool.errors import AnimtoolError, Fault
from animtool.validation.fixes.mend import FIXES, Mend, NotMendedError, fix_of
from animtool.validation.options import ValidateOptions
from animtool.validation.run import Report, findings_in
from animtool.validation.subjects.open import open_document
from animtool.validation.subjects.subject import Opened

__all__ = ["FileMend", "plan_file", "reopened", "with_fixable"]


@dataclass(slots=True)
class FileMend:
    """A file, and what mending it makes of it.

    Attributes:
        path: The file.
        before: Its text.
        after: Its text when mended.
        mended: Findings, each as it stood when its turn came, and what was done.
        left: Findings of a code that has a fix, and why they stay.
        arrays: Of new npz files, by file and name.
    """

    path: Path
    before: str
    after: str
    mended: list[tuple[Fault, str]] = field(default_factory=list)
    left: list[tuple[Fault, str]] = field(default_factory=list)
    arrays: dict[Path, dict[str, npt.NDArray[Any]]] = field(default_factory=dict)

    def difference(self) -> str:
        """Return what changes, as ``diff -u`` writes it."""
        name = self.path.as_posix()
        lines = difflib.unified_diff(
            _lines(self.before), _lines(self.after), f"a/{name}", f"b/{name}"
        )
        return "".join(
            line if line.endswith("\n") else f"{line}\n\\ No newline at end of file\n"
            for line in lines
        )


def plan_file(path: Path, options: ValidateOptions) -> FileMend:
    """Return a file with what is wrong mended as far as that is safe, in memory.

    A mend is kept where its finding is gone and none has come. What writes arrays
    comes last, as the rest is checked on files that are there.

    Args:
        path: A rig, clip, scene or targets file.
        options: Which codes count.

    Raises:
        FormatError: It cannot be read, or is of no kind that is known.
    """
    text = read_text(path)
    plan = FileMend(path, text, text)
    opened, found = reopened(text, path)
    given_up: set[tuple[str, str | None, str]] = set()
    while (fault := next(_open_cases(found, options, given_up), None)) is not None:
        try:
            mend = _mend(opened, fault)
            after = edited(plan.after, path, mend.edits)
            if mend.arrays:
                given_up.add(_key(fault))
                continue
            other, left = reopened(after, path)
            _refuse_worse(fault, found, left)
        except (NotMendedError, EditError, AnimtoolError) as error:
            given_up.add(_key(fault))
            plan.left.append((fault, str(error)))
            continue
        plan.after, opened, found = after, other, left
        plan.mended.append((fault, mend.said))
        # The others may stand elsewhere now, and fare better.
        given_up.clear()
        plan.left.clear()
    _with_arrays(plan, opened, found, options)
    return plan


def reopened(text: str, path: Path) -> tuple[Opened, list[Fault]]:
    """Return a text as rules look at the file, and what they find."""
    opened = open_document(document_of(text, path))
    return opened, findings_in(opened)


def with_fixable(report: Report) -> Report:
    """Return a report that knows which of its findings have a safe remedy."""
    cases: dict[str, list[Fault]] = {}
    for fault in report.findings:
        if fault.code in FIXES and fault.path is not None:
            cases.setdefault(fault.path, []).append(fault)
    fixable = (fault for path, own in cases.items() for fault in _fixable(path, own))
    return replace(report, fixable=frozenset(fixable))


def _fixable(name: str, faults: Sequence[Fault]) -> Iterator[Fault]:
    """Yield the findings in a file that can be mended, each on its own."""
    path = Path(name)
    text = read_text(path)
    opened = open_document(document_of(text, path))
    for fault in faults:
        try:
            edited(text, path, _mend(opened, fault).edits)
        except (NotMendedError, EditError):
            continue
        yield fault


def _mend(opened: Opened, fault: Fault) -> Mend:
    fix = fix_of(fault.code)
    if fix is None:
        raise NotMendedError("it has no fix")
    return fix(opened, fault)


def _open_cases(
    found: Sequence[Fault],
    options: ValidateOptions,
    given_up: set[tuple[str, str | None, str]],
) -> Iterator[Fault]:
    """Yield findings that count, have a fix, and were not tried yet."""
    for fault in found:
        wanted = fault.code in FIXES and options.counts(fault.code)
        if wanted and _key(fault) not in given_up:
            yield fault


def _key(fault: Fault) -> tuple[str, str | None, str]:
    return fault.code, fault.where, fault.message


def _refuse_worse(
    fault: Fault, before: Sequence[Fault], after: Sequence[Fault]
) -> None:
    """Refuse a mend that leaves its finding or brings others."""
    old = Counter(f.code for f in before)
    new = Counter(f.code for f in after)
    more = sorted(code for code in new if new[code] > old[code])
    if more:
        raise NotMendedError(f"{more[0]} would come of it")
    if new[fault.code] >= old[fault.code]:
        raise NotMendedError("it would still be found")


def _with_arrays(
    plan: FileMend, opened: Opened, found: Sequence[Fault], options: ValidateOptions
) -> None:
    """Add the mends that write arrays, which the last state of the file asks for."""
    for fault in _open_cases(found, options, set()):
        try:
            mend = _mend(opened, fault)
            if not mend.arrays:
                continue
            plan.after = edited(plan.after, plan.path, mend.edits)
        except (NotMendedError, EditError):
            continue
        plan.mended.append((fault, mend.said))
        for path, arrays in mend.arrays.items():
            plan.arrays.setdefault(path, {}).update(arrays)


def _lines(text: str) -> list[str]:
    r"""Return lines with their ends, of which only \n counts."""
    return [line + "\n" for line in text.split("\n")[:-1]] + [
        rest for rest in text.split("\n")[-1:] if rest
    ]

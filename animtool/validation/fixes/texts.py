"""Documents mended in memory, a finding at a time, with all else as it stands."""

from __future__ import annotations

import codecs
import difflib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy.typing as npt

from animtool.documents.document import document_of, read_text
from animtool.documents.edit import EditError, edited
from animtool.errors import AnimtoolError, Fault
from animtool.files import read_input
from animtool.output import ahead, replacing, together
from animtool.placing import output_error
from animtool.scene.convert_rig import write_arrays
from animtool.validation.fixes.draft import Step
from animtool.validation.fixes.mend import Mend, NotMendedError, fix_of
from animtool.validation.run import findings_in
from animtool.validation.subjects.open import open_document
from animtool.validation.subjects.subject import Opened


@dataclass(frozen=True, eq=False)
class TextDraft:
    """The text of a rig, clip, scene or targets file.

    Attributes:
        path: The file.
        text: Its content.
        before: The file's own text.
        arrays: Of new npz files that the text names, by file and name.
        awaited: Codes of findings that these files fix.
    """

    path: Path
    text: str
    before: str
    arrays: Mapping[Path, Mapping[str, npt.NDArray[Any]]] = field(default_factory=dict)
    awaited: frozenset[str] = frozenset()

    @classmethod
    def read(cls, path: Path) -> TextDraft:
        """Return a file as it is.

        Raises:
            FormatError: It cannot be read.
        """
        text = read_text(path)
        return cls(path, text, text)

    @cached_property
    def opened(self) -> Opened:
        """The text as rules look at the file."""
        return open_document(document_of(self.text, self.path))

    @cached_property
    def found(self) -> Sequence[Fault]:
        """Findings of the rules in it."""
        return findings_in(self.opened)

    def batch(self, cases: Sequence[Fault]) -> Sequence[Fault]:
        """Return the first: after it the others may stand elsewhere."""
        return cases[:1]

    def step(self, faults: Sequence[Fault]) -> Step:
        """Return the text with a finding fixed, unless that writes arrays.

        What writes arrays comes last, as the rest is checked on files that are there.
        """
        fault = faults[0]
        try:
            mend = self._mend(fault)
            text = edited(self.text, self.path, mend.edits)
            if mend.arrays:
                return Step(self)
            other = replace(self, text=text)
            # That it can be read is looked at here.
            _ = other.found
        except (NotMendedError, EditError, AnimtoolError) as error:
            return Step(self, refused=[(fault, str(error))])
        return Step(other, [(fault, mend.said)])

    def finish(self, cases: Sequence[Fault]) -> Step:
        """Return the text with the findings fixed whose remedy writes arrays."""
        text, done = self.text, []
        added = {path: dict(arrays) for path, arrays in self.arrays.items()}
        for fault in cases:
            try:
                mend = self._mend(fault)
                if not mend.arrays:
                    continue
                text = edited(text, self.path, mend.edits)
            except (NotMendedError, EditError):
                continue
            done.append((fault, mend.said))
            for path, arrays in mend.arrays.items():
                added.setdefault(path, {}).update(arrays)
        codes = frozenset(fault.code for fault, _ in done)
        return Step(replace(self, text=text, arrays=added, awaited=codes), done)

    def fixable(self, faults: Sequence[Fault]) -> Iterator[Fault]:
        """Yield the findings that can be fixed, each on its own."""
        for fault in faults:
            try:
                edited(self.text, self.path, self._mend(fault).edits)
            except (NotMendedError, EditError):
                continue
            yield fault

    def difference(self) -> str:
        """Return what changes, as ``diff -u`` writes it."""
        name = self.path.as_posix()
        lines = difflib.unified_diff(
            _lines(self.before), _lines(self.text), f"a/{name}", f"b/{name}"
        )
        return "".join(
            line if line.endswith("\n") else f"{line}\n\\ No newline at end of file\n"
            for line in lines
        )

    def outputs(self) -> Sequence[Path]:
        """Return the npz files that the text needs beside it."""
        return tuple(self.arrays)

    def write(self, output: Path) -> Sequence[str]:
        """Write the text to a file, its new arrays before it."""
        with together():
            with ahead(list(self.arrays)):
                for path, arrays in self.arrays.items():
                    write_arrays(path, dict(arrays))
                self._check_arrays()
            _write_text(output, self.text)
        return ()

    def _check_arrays(self) -> None:
        """Refuse arrays that are read otherwise than they were written."""
        if not self.arrays:
            return
        unread = {*self.awaited, "RIG018", "RIG019"}
        again = replace(self, arrays={})
        if any(fault.code in unread for fault in again.found):
            path = next(iter(self.arrays))
            raise output_error(path, "it is read otherwise than written")

    def _mend(self, fault: Fault) -> Mend:
        fix = fix_of(fault.code)
        if fix is None:
            raise NotMendedError("it has no fix")
        return fix(self.opened, fault)


def _write_text(path: Path, text: str) -> None:
    mark = read_input(path).startswith(codecs.BOM_UTF8)
    with replacing(path) as temporary:
        try:
            encoding = "utf-8-sig" if mark else "utf-8"
            temporary.write_text(text, encoding, newline="")
        except OSError as error:
            raise output_error(path, error) from error


def _lines(text: str) -> list[str]:
    r"""Return lines with their ends, of which only \n counts."""
    return [line + "\n" for line in text.split("\n")[:-1]] + [
        rest for rest in text.split("\n")[-1:] if rest
    ]

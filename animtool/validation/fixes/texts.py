"""Fixes documents in memory, one finding at a time, and keeps all other text."""

from __future__ import annotations

import codecs
import difflib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from animtool.core.errors import AnimtoolError, Fault, excerpt
from animtool.core.files.commit import output_error
from animtool.core.files.output import (
    atomic_outputs,
    early_outputs,
    name_problem,
    write_arrays,
    write_parts,
)
from animtool.core.files.reading import read_input
from animtool.core.record import dataclass
from animtool.documents.document import parse_document, parse_location, read_text
from animtool.documents.edit import Add, EditError, Remove, Replace, apply_edits
from animtool.documents.references import split_reference
from animtool.rig.parts import ArrayRef
from animtool.validation.fixes.draft import (
    FixEdits,
    FixStepResult,
    NotFixedError,
    load_fix,
)
from animtool.validation.run import findings_in
from animtool.validation.subjects.open import open_document
from animtool.validation.subjects.rig import RigSubject
from animtool.validation.subjects.subject import CheckedFile


def pointer_of(fault: Fault) -> tuple[Any, ...]:
    """Split a finding's ``where`` into keys and list indices.

    >>> pointer_of(Fault("RIG210", "", where="meshes[2].skin.weights"))
    ('meshes', 2, 'skin', 'weights')
    """
    return parse_location(fault.where or "")


def remove_ignore_entry(checked_file: CheckedFile, fault: Fault) -> FixEdits:
    """Return the edit that removes an unused ``ignore`` entry, or its list if empty."""
    if checked_file.document is None:
        raise NotFixedError("the file has no text")
    ignore_entries = checked_file.document.value["ignore"]
    pointer = pointer_of(fault)
    ignore_entry = ignore_entries[pointer[1]]
    location = pointer if len(ignore_entries) > 1 else ("ignore",)
    return FixEdits(
        f"removes the entry for {ignore_entry['code']}", (Remove(location),)
    )


def rest_from_bind(checked_file: CheckedFile, fault: Fault) -> FixEdits:
    """Return edits that set a joint's missing rest pose to its bind pose."""
    rig: RigSubject = checked_file.subject
    pointer = pointer_of(fault)
    joint = rig.file_entries("joints")[pointer[1]]
    pose = rig.document.value["bind"][joint["name"]]
    pose_keys = [key for key in ("translate", "rotate") if pose.get(key) is not None]
    edits = tuple(Add(pointer, key, pose[key]) for key in pose_keys)
    return FixEdits(f"sets the rest pose of {joint['name']!r} to its bind pose", edits)


def normalize_weights(checked_file: CheckedFile, fault: Fault) -> FixEdits:
    """Return a new npz file with normalized skin weights, and the edit that names it.

    Every reader of the file normalises the weights anyway. Other rigs may use the
    current npz, so it stays unchanged.
    """
    rig: RigSubject = checked_file.subject
    pointer = pointer_of(fault)
    skin = rig.rig.meshes[pointer[1]].skin
    if "from" in rig.document.value or skin is None:
        raise NotFixedError("the mesh is in another file")
    weights_reference = skin.weights
    if not isinstance(weights_reference, ArrayRef):
        raise NotFixedError("the weights are not in an npz file")
    new_path = _unused_path(weights_reference.path, weights_reference.key)
    npz_name, _ = split_reference(weights_reference.text, weights_reference.key)
    folder_text = npz_name[: -len(weights_reference.path.name)]
    reference_text = f"{folder_text}{new_path.name}#{weights_reference.key}"
    remedy = f"writes {new_path.name} with the weights divided by their sums"
    weights = weights_reference.load()
    normalized_weights = np.asarray(
        weights / weights.sum(axis=1, keepdims=True), np.float32
    )
    arrays = {new_path: {weights_reference.key: normalized_weights}}
    return FixEdits(remedy, (Replace(pointer, reference_text),), arrays)


def _unused_path(path: Path, key: str) -> Path:
    """Return an unused path next to an npz file, for a file with one of its arrays."""
    problem = name_problem(f"{path.stem}_{key}.npz")
    if problem is not None:
        raise NotFixedError(f"the name of the array, {excerpt(key)}, {problem}")
    suffix_number, unused_path = 2, path.with_name(f"{path.stem}_{key}.npz")
    while unused_path.exists():
        unused_path = path.with_name(f"{path.stem}_{key}_{suffix_number}.npz")
        suffix_number += 1
    return unused_path


@dataclass(frozen=True, eq=False)
class TextDraft:
    """The text of a rig, clip, scene or targets file."""

    path: Path  # the file
    text: str  # its content
    original_text: str  # the file's original text
    # Arrays of new npz files that the text refers to, by file and name.
    arrays: Mapping[Path, Mapping[str, npt.NDArray[Any]]] = field(default_factory=dict)
    # Codes of findings that these files fix.
    fixed_by_arrays: frozenset[str] = frozenset()

    @classmethod
    def read(cls, path: Path) -> TextDraft:
        """Return the draft of a file, unchanged."""
        text = read_text(path)
        return cls(path, text, text)

    @cached_property
    def checked_file(self) -> CheckedFile:
        """The parsed text, as the subject of the rules."""
        return open_document(parse_document(self.text, self.path))

    @cached_property
    def findings(self) -> Sequence[Fault]:
        """Findings of all rules in the current text."""
        return findings_in(self.checked_file)

    def next_batch(self, findings: Sequence[Fault]) -> Sequence[Fault]:
        """Return the first finding only, since its fix may move the other ones."""
        return findings[:1]

    def fix_batch(self, faults: Sequence[Fault]) -> FixStepResult:
        """Return the text with the first finding fixed, unless its fix writes arrays.

        Fixes that write arrays come last, since other fixes are validated with existing
        files.
        """
        fault = faults[0]
        try:
            fix = self._fix_edits(fault)
            text = apply_edits(self.text, self.path, fix.edits)
            if fix.arrays:
                return FixStepResult(self)
            new_draft = replace(self, text=text)
            # Check that it can be read.
            _ = new_draft.findings
        except (NotFixedError, EditError, AnimtoolError) as error:
            return FixStepResult(self, unfixed_findings=[(fault, str(error))])
        return FixStepResult(new_draft, [(fault, fix.description)])

    def fix_deferred(self, findings: Sequence[Fault]) -> FixStepResult:
        """Return the text with the findings fixed whose fixes write arrays."""
        text, fixed_findings = self.text, []
        new_arrays = {path: dict(arrays) for path, arrays in self.arrays.items()}
        for fault in findings:
            try:
                fix = self._fix_edits(fault)
                if not fix.arrays:
                    continue
                text = apply_edits(text, self.path, fix.edits)
            except (NotFixedError, EditError):
                continue
            fixed_findings.append((fault, fix.description))
            for path, arrays in fix.arrays.items():
                new_arrays.setdefault(path, {}).update(arrays)
        codes = frozenset(fault.code for fault, _ in fixed_findings)
        draft = replace(self, text=text, arrays=new_arrays, fixed_by_arrays=codes)
        return FixStepResult(draft, fixed_findings)

    def fixable_findings(self, faults: Sequence[Fault]) -> Iterator[Fault]:
        """Yield the findings that can be fixed one by one."""
        for fault in faults:
            try:
                apply_edits(self.text, self.path, self._fix_edits(fault).edits)
            except (NotFixedError, EditError):
                continue
            yield fault

    def diff_text(self) -> str:
        """Return the changes as a unified diff."""
        name = self.path.as_posix()
        old, new = map(_split_lines, (self.original_text, self.text))
        diff_lines = difflib.unified_diff(old, new, f"a/{name}", f"b/{name}")
        return "".join(
            line if line.endswith("\n") else f"{line}\n\\ No newline at end of file\n"
            for line in diff_lines
        )

    def outputs(self) -> Sequence[Path]:
        """Return the paths of the npz files that `write` adds."""
        return tuple(self.arrays)

    def write(self, output: Path) -> Sequence[str]:
        """Write the new arrays and then the text to files; return no notices."""
        with atomic_outputs():
            with early_outputs(list(self.arrays)):
                for path, arrays in self.arrays.items():
                    write_arrays(path, dict(arrays))
                self._check_written_arrays()
            has_bom = read_input(output).startswith(codecs.BOM_UTF8)
            encoding = "utf-8-sig" if has_bom else "utf-8"
            write_parts(output, [self.text.encode(encoding)])
        return ()

    def _check_written_arrays(self) -> None:
        """Raise OutputError if faults remain when the written arrays are read back."""
        if not self.arrays:
            return
        unwanted_codes = {*self.fixed_by_arrays, "RIG018", "RIG019"}
        draft_without_arrays = replace(self, arrays={})
        if any(fault.code in unwanted_codes for fault in draft_without_arrays.findings):
            path = next(iter(self.arrays))
            raise output_error(path, "it would not be read back as written")

    def _fix_edits(self, fault: Fault) -> FixEdits:
        fix = load_fix(fault.code)
        if fix is None:
            raise NotFixedError("there is no automatic fix")
        return fix(self.checked_file, fault)


def _split_lines(text: str) -> list[str]:
    r"""Split text into lines that keep their ends; only ``\n`` separates lines."""
    *lines, last_line = text.split("\n")
    return [*(f"{line}\n" for line in lines), *([last_line] if last_line else [])]

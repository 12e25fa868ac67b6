"""Files of an older version of their format, rewritten as the newest."""

from __future__ import annotations

import copy
import difflib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

from animtool.core.arguments import argument
from animtool.core.errors import (
    AnimtoolError,
    Fault,
    FormatError,
    OptionError,
    Severity,
    listed,
    refuse_warnings,
)
from animtool.core.files.output import atomic_outputs, check_outputs, write_parts
from animtool.core.record import dataclass
from animtool.documents.document import (
    Document,
    document_of,
    read_document,
    read_text,
    spelled,
)
from animtool.documents.edit import EditError, Rename, edited
from animtool.documents.versions import (
    STEPS,
    Steps,
    newest,
    renamed_keys,
    version_of,
)
from animtool.documents.yaml_text import comments_in, json_text, yaml_text


@dataclass(frozen=True, slots=True)
class Migration:
    """A file, and what it is in the newest version of its format."""

    path: Path  # the file
    kind: str  # ``rig``, ``clip`` or ``scene``
    version: int  # that it is written in
    newest: int  # that it becomes
    before: str  # its text
    after: str  # its new text; the same where it is of the newest version
    notices: tuple[Fault, ...] = ()  # comments that are not kept
    written: bool = False  # whether the file is replaced
    json_keys: ClassVar[str] = (
        "path kind from=version to=newest needed written difference notices"
    )

    @property
    def renames(self) -> bool:
        """Whether keys alone are of old names."""
        return self.needed and self.version == self.newest

    @property
    def needed(self) -> bool:
        """Whether the file is of an older version, or has keys of old names."""
        return self.before != self.after

    @property
    def difference(self) -> list[str]:
        """Return the lines that change, as ``diff -u`` writes them."""
        lines = difflib.unified_diff(
            self.before.splitlines(),
            self.after.splitlines(),
            f"{self.path} (animtool/{self.version})",
            f"{self.path} (animtool/{self.newest})",
            lineterm="",
        )
        return list(lines)


@dataclass(frozen=True, slots=True)
class Migrations:
    """What became of files, or would become of them."""

    files: Sequence[Migration]
    json_keys: ClassVar[str] = "'migrate' files"


def plan_migration(path: Path | str, table: Mapping[str, Steps] = STEPS) -> Migration:
    """Return what a file is in the newest version of its format; nothing is written.

    Where only the version's name changes, so does one word of the text; else the file
    is written anew, without its comments.
    """
    path = Path(path)
    document, before = read_document(path), read_text(path)
    kind, version = version_of(document, table)
    last = newest(table[kind])
    if version == last:
        return _with_new_keys(Migration(path, kind, version, last, before, before))
    old = document.value
    new = copy.deepcopy(old)
    for step in range(version, last):
        new = table[kind][step](new)
    new[kind] = f"animtool/{last}"
    if {**new, kind: old[kind]} == old:
        after = _renamed(document, before, kind, f"animtool/{last}")
        return Migration(path, kind, version, last, before, after)
    # The kind is the first word of a file, whatever the steps did.
    ordered = {kind: new.pop(kind), **new}
    if path.suffix == ".json":
        return Migration(path, kind, version, last, before, json_text(ordered))
    lost = comments_in(before)
    notices = []
    if lost:
        count = "a comment is" if len(lost) == 1 else f"{len(lost)} comments are"
        message = f"{count} lost: the file is rewritten"
        hint = "copy important ones from the old file"
        notices.append(
            Fault("DOC101", message, str(path), tuple(lost), hint, Severity.WARNING)
        )
    after = yaml_text(ordered)
    return Migration(path, kind, version, last, before, after, tuple(notices))


def _with_new_keys(plan: Migration) -> Migration:
    """Return a file with the new names of its keys; all else stays as it is."""
    value = document_of(plan.before, plan.path).value
    edits = [
        Rename(location, name) for location, name in renamed_keys(plan.kind, value)
    ]
    if not edits:
        return plan
    try:
        return replace(plan, after=edited(plan.before, plan.path, edits))
    except EditError as error:
        message = f"its keys cannot be renamed: {error}"
        hint = f"rename {listed([spelled(edit.location) for edit in edits])} by hand"
        raise FormatError(Fault("DOC026", message, str(plan.path), (), hint)) from error


def migrate(
    paths: Sequence[Path | str],
    *,
    overwrite: bool = False,
    check: bool = False,
    strict: bool = False,
    table: Mapping[str, Steps] = STEPS,
) -> list[Migration]:
    """Rewrite files of older versions, in place, all of them or none.

    All are read and checked before the first is written.

    Args:
        paths: Rigs, clips and scenes.
        overwrite: Replace them; without it none may need it.
        check: Write nothing.
        strict: Treat warnings as errors, and write nothing.
        table: Steps from each version to the next, by kind.

    Raises:
        FormatError: With the faults of every file.
        OptionError: A file needs to be replaced, and ``overwrite`` is off.
        OutputError: A file cannot be written.
        StrictError: There were warnings, and ``strict`` is on.
    """
    plans = _plans(paths, table)
    refuse_warnings([note for p in plans for note in p.notices], strict=strict)
    # A file and a link to it are one.
    own = {plan.path.resolve(): plan for plan in reversed(plans) if plan.needed}
    needed = list(reversed(own.values()))
    if check or not needed:
        return plans
    if not overwrite:
        hint = (
            f"{argument('overwrite', True)} replaces it, {argument('check')} shows "
            "what would change"
        )
        message = "would be replaced"
        raise OptionError(
            [Fault("OUT001", message, str(plan.path), (), hint) for plan in needed]
        )
    check_outputs([plan.path for plan in needed], [], overwrite=True)
    with atomic_outputs():
        for plan in needed:
            write_parts(plan.path, [plan.after.encode()])
    return [replace(plan, written=plan.needed) for plan in plans]


def _plans(paths: Sequence[Path | str], table: Mapping[str, Steps]) -> list[Migration]:
    plans: list[Migration] = []
    faults: list[Fault] = []
    for path in dict.fromkeys(map(Path, paths)):
        try:
            plans.append(plan_migration(path, table))
        except AnimtoolError as error:
            faults += error.faults
    if faults:
        raise FormatError(faults)
    return plans


def _renamed(document: Document, text: str, kind: str, new: str) -> str:
    """Return a text with another version, and nothing else changed."""
    line, column = document.place((kind,))
    lines = text.splitlines(keepends=True)
    head, tail = lines[line - 1][: column - 1], lines[line - 1][column - 1 :]
    old: Any = document.value[kind]
    lines[line - 1] = head + tail.replace(old, new, 1)
    return "".join(lines)

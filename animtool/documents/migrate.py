"""Migrates files to the newest version of their format."""

from __future__ import annotations

import contextlib
import copy
import difflib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, cast

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
from animtool.core.plugins import load_object
from animtool.core.record import dataclass
from animtool.documents.check import validate_document
from animtool.documents.document import (
    Document,
    location_text,
    parse_document,
    read_document,
    read_text,
)
from animtool.documents.edit import EditError, Rename, apply_edits
from animtool.documents.versions import (
    FILE_MODELS,
    MIGRATION_STEPS,
    MigrationSteps,
    kind_and_version,
    newest_version_of,
    renamed_keys,
)
from animtool.documents.yaml_text import comments_in, json_text, yaml_text

if TYPE_CHECKING:
    from pydantic import BaseModel

_SCENE_CHECK = "animtool.scene.file.read:check_scene_values"
# Codes of unknown keys, missing keys and invalid values.
_VALUE_CODES = {"DOC020", "DOC021", "DOC022"}


@dataclass(frozen=True, slots=True)
class Migration:
    """A file and its text in the newest version of the format."""

    path: Path
    kind: str  # ``rig``, ``clip`` or ``scene``
    version: int  # current version of the file
    newest: int  # version after the migration
    old_text: str  # current text
    new_text: str  # text in the newest version
    # Comments that the migration removes, and faults that it leaves.
    notices: tuple[Fault, ...] = ()
    written: bool = False  # whether the file was replaced
    json_keys: ClassVar[str] = (
        "path kind from=version to=newest needed written difference notices"
    )

    @property
    def is_renames_only(self) -> bool:
        """Whether the migration only renames keys."""
        return self.needed and self.version == self.newest

    @property
    def needed(self) -> bool:
        """Whether the file has an older version or outdated names of keys."""
        return self.old_text != self.new_text

    @property
    def difference(self) -> list[str]:
        """Lines of a unified diff from the current text to the new text."""
        lines = difflib.unified_diff(
            self.old_text.splitlines(),
            self.new_text.splitlines(),
            f"{self.path} (animtool/{self.version})",
            f"{self.path} (animtool/{self.newest})",
            lineterm="",
        )
        return list(lines)


@dataclass(frozen=True, slots=True)
class Migrations:
    """Migrations of several files, written or only planned."""

    files: Sequence[Migration]
    json_keys: ClassVar[str] = "'migrate' files"


def plan_migration(
    path: Path | str, table: Mapping[str, MigrationSteps] = MIGRATION_STEPS
) -> Migration:
    """Return the text of a file in the newest version, without writing it.

    If only the version changes, one word of the text does; otherwise the file
    is rewritten without its comments.
    """
    path = Path(path)
    document, old_text = read_document(path), read_text(path)
    kind, version = kind_and_version(document, table)
    newest_version = newest_version_of(table[kind])
    plan = Migration(path, kind, version, newest_version, old_text, old_text)
    if version == newest_version:
        return _rename_keys(plan)
    old_value = document.value
    new_value = copy.deepcopy(old_value)
    for step_version in range(version, newest_version):
        new_value = table[kind][step_version](new_value)
    new_value[kind] = f"animtool/{newest_version}"
    if {**new_value, kind: old_value[kind]} == old_value:
        new_version = f"animtool/{newest_version}"
        new_text = _replace_version(document, old_text, kind, new_version)
        return replace(plan, new_text=new_text)
    # The kind comes first in a file, in whatever order the steps left the keys.
    kind_first = {kind: new_value.pop(kind), **new_value}
    if path.suffix == ".json":
        return replace(plan, new_text=json_text(kind_first))
    plan = replace(plan, new_text=yaml_text(kind_first))
    comment_lines = tuple(comments_in(old_text))
    if not comment_lines:
        return plan
    count_text = (
        "a comment is"
        if len(comment_lines) == 1
        else f"{len(comment_lines)} comments are"
    )
    message = f"{count_text} lost: the file is rewritten"
    hint = "copy important ones from the old file"
    notice = Fault("DOC101", message, str(path), comment_lines, hint, Severity.WARNING)
    return replace(plan, notices=(notice,))


def _rename_keys(plan: Migration) -> Migration:
    """Return a migration that renames keys and changes nothing else."""
    value = parse_document(plan.old_text, plan.path).value
    edits = [Rename(location, n) for location, n in renamed_keys(plan.kind, value)]
    if not edits:
        return plan
    try:
        return replace(plan, new_text=apply_edits(plan.old_text, plan.path, edits))
    except EditError as error:
        message = f"its keys cannot be renamed: {error}"
        hint = f"rename {listed([location_text(edit.location) for edit in edits])} by "
        hint += "hand"
        raise FormatError(Fault("DOC026", message, str(plan.path), (), hint)) from error


def migrate(
    paths: Sequence[Path | str],
    *,
    overwrite: bool = False,
    check: bool = False,
    strict: bool = False,
    table: Mapping[str, MigrationSteps] = MIGRATION_STEPS,
) -> list[Migration]:
    """Rewrite files of older versions in place; if one fails, none is rewritten.

    All are read and checked before the first is written.

    Args:
        paths: Rig, clip and scene files.
        overwrite: Replace files; otherwise fail if a file would change.
        check: Write nothing.
        strict: Treat warnings as errors, and write nothing.
        table: Migration steps between versions, by kind.
    """
    plans = _plan_migrations(paths, table)
    if table is MIGRATION_STEPS:
        plans = [_with_value_faults(plan) for plan in plans]
    refuse_warnings([note for plan_ in plans for note in plan_.notices], strict=strict)
    # A file and links to it are migrated once.
    plan_by_path = {p.path.resolve(): p for p in reversed(plans) if p.needed}
    outdated_documents = list(reversed(plan_by_path.values()))
    if check or not outdated_documents:
        return plans
    if not overwrite:
        hint = f"{argument('overwrite', True)} replaces it, {argument('check')} shows "
        hint += "what would change"
        message = "would be replaced"
        paths_to_replace = [str(plan.path) for plan in outdated_documents]
        raise OptionError(
            [Fault("OUT001", message, name, (), hint) for name in paths_to_replace]
        )
    check_outputs([plan.path for plan in outdated_documents], [], overwrite=True)
    with atomic_outputs():
        for plan in outdated_documents:
            write_parts(plan.path, [plan.new_text.encode()])
    return [replace(plan, written=plan.needed) for plan in plans]


def _plan_migrations(
    paths: Sequence[Path | str], table: Mapping[str, MigrationSteps]
) -> list[Migration]:
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


def _with_value_faults(plan: Migration) -> Migration:
    """Return a migration with the faults of its new text as warnings.

    Only faults of keys and values are added; a migration does not fix them.
    """
    document = parse_document(plan.new_text, plan.path)
    if plan.kind == "scene":
        check_values = cast("Callable[[Document], object]", load_object(_SCENE_CHECK))
    else:
        model = cast("type[BaseModel]", load_object(FILE_MODELS[plan.kind]))
        check_values = partial(validate_document, model=model)
    # Too many faults are raised at once.
    with contextlib.suppress(FormatError):
        check_values(document)
    faults = [
        replace(fault, severity=Severity.WARNING)
        for fault in document.faults
        if fault.code in _VALUE_CODES
    ]
    return replace(plan, notices=(*plan.notices, *faults))


def _replace_version(document: Document, text: str, kind: str, version: str) -> str:
    """Return a text with only its version number replaced."""
    line, column = document.position((kind,))
    lines = text.splitlines(keepends=True)
    before_version = lines[line - 1][: column - 1]
    after_version = lines[line - 1][column - 1 :]
    old_version: Any = document.value[kind]
    lines[line - 1] = before_version + after_version.replace(old_version, version, 1)
    return "".join(lines)

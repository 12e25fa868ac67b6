"""Files that a document refers to, with paths relative to its folder."""

from __future__ import annotations

import os
from collections.abc import Sequence
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

from animtool.core.arguments import flag
from animtool.core.config import outside_hint, project_roots
from animtool.core.errors import counted
from animtool.core.files.reading import (
    MAX_SEARCHED_NAMES,
    exists,
    is_pattern,
    nearest_file,
    unexpanded_hint,
    url_hint,
)

if TYPE_CHECKING:
    from animtool.documents.document import Document, Location


def split_reference(text: str, default_key: str) -> tuple[str, str]:
    """Split a reference ``file#array`` into the file and the name of the array.

    >>> split_reference("face.npz#smile", "deltas"), split_reference("a.npz", "points")
    (('face.npz', 'smile'), ('a.npz', 'points'))
    """
    name, _, key = text.partition("#")
    return name, key or default_key


def resolve_path(folder: Path, roots: Sequence[Path], name: str) -> Path:
    """Return the path of a file name in a folder; refuse paths outside the roots."""
    try:
        path = (folder / name).resolve()
    except (OSError, RuntimeError, ValueError) as error:
        raise ValueError(f"{name!r} cannot be resolved: {error}") from error
    if not any(path.is_relative_to(root.resolve()) for root in roots):
        roots_text = ", ".join(str(root) for root in roots)
        raise ValueError(f"{name!r} leads outside {roots_text}")
    return path


def resolve_reference(
    document: Document,
    location: Location,
    name: str,
    roots: Sequence[Path],
    *,
    is_output: bool = False,
) -> Path | None:
    """Resolve a file reference of a document; record a fault if it is not allowed.

    Args:
        document: The file that has the reference.
        location: Location of the reference.
        name: The reference as written.
        roots: Folders that references may lead into.
        is_output: The file is an output and need not exist.
    """
    folder = document.path.resolve().parent
    try:
        return resolve_path(folder, roots, name)
    except ValueError as error:
        hint = outside_hint(document.path, name, is_output=is_output)
        document.add("DOC014", location, str(error), hint)
        return None


def similar_file_hint(document: Document, name: str) -> str | None:
    """Return a hint for a missing file: a similar name, or how to spell its path."""
    # On Windows it separates folders, too.
    if "\\" in name and os.sep == "/":
        return f"write / in paths: {name.replace(chr(92), '/')}"
    return (
        unexpanded_hint(name)
        or url_hint(name)
        or _pattern_hint(document, name)
        or nearest_file(Path(name), document.path.parent)
    )


def _pattern_hint(document: Document, name: str) -> str | None:
    """Return a hint for a glob where one file is needed; None for other names."""
    # Counting the files of `**` could search a whole disk.
    if not is_pattern(name) or "**" in name or Path(name).is_absolute():
        return None
    try:
        paths = islice(document.path.parent.glob(name), MAX_SEARCHED_NAMES)
        file_count = sum(1 for _ in paths)
    except (OSError, ValueError, NotImplementedError):
        return None
    hint = f"it is a pattern, of {counted(file_count, 'file')}: name one file"
    if {"scene", "batch"}.intersection(document.value) == {"scene"} and file_count > 1:
        command = f"animtool batch '{name}' {flag('scene', document.path.name)}"
        hint += f", or write ${{input}} and bake the scene for each with {command}"
    return hint


def resolve_input(
    document: Document, location: Location, name: str, roots: Sequence[Path]
) -> Path | None:
    """Resolve an input file of a document; record a fault if it cannot be read.

    The arguments and the result are those of `resolve_reference`.
    """
    path = resolve_reference(document, location, name, roots)
    if path is not None and not exists(path):
        message = f"{name!r} does not exist"
        document.add("DOC015", location, message, similar_file_hint(document, name))
        return None
    return path


def resolve_named_rig(
    document: Document, name: str | None, *, is_replaced: bool
) -> Path | None:
    """Resolve the rig that a document names in ``rig``; None if it names none.

    A rig that another one replaces may be missing.
    """
    if name is None:
        return None
    roots = project_roots(document.path)
    if not is_replaced:
        return resolve_input(document, ("rig",), name, roots)
    try:
        path = resolve_path(document.path.resolve().parent, roots, name)
    except ValueError:
        return None
    return path if exists(path) else None

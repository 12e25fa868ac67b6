"""Other files of a project that may name what a rig has."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from animtool.config import project_roots
from animtool.documents.document import document_of, read_document, read_text
from animtool.errors import AnimtoolError, FormatError
from animtool.files import files_meant
from animtool.readers import DOCUMENT, READERS
from animtool.validation.subjects.open import DOCUMENT_SUFFIXES


def naming(rig: Path, names: Sequence[str]) -> Iterator[tuple[Path, str]]:
    """Yield files that use one of the names of a rig, and the first of them.

    A use is a key or value that is the name, or has it as a part, such as
    ``joint/NAME.rotation``; words in comments and texts are none. Rigs with joints of
    their own, and files for one of these, have names of their own and are left out.
    """
    own = rig.resolve()
    for path in _documents(rig):
        if path.resolve() == own:
            continue
        try:
            text = read_text(path)
        except FormatError:
            continue
        if not any(name in text for name in names):
            continue
        found = _first_use(path, text, own, names)
        if found is not None:
            yield path, found


def _first_use(path: Path, text: str, rig: Path, names: Sequence[str]) -> str | None:
    """Return the first name that a file uses for something of a rig."""
    try:
        value = document_of(text, path).value
    except AnimtoolError:
        # What cannot be parsed may use any name in it.
        return next(name for name in names if name in text)
    if not _may_mean(path, value, rig):
        return None
    texts = list(_texts(value))
    return next((name for name in names if _is_used(name, texts)), None)


def _is_used(name: str, texts: Sequence[str]) -> bool:
    """Return whether a name is one of some keys and values, or a part of one."""
    part = re.compile(rf"(?:^|[/\[#,]){re.escape(name)}(?:$|[/.\]#,])")
    return any(part.search(text) for text in texts)


def _texts(value: Any) -> Iterator[str]:
    """Yield every key and text of a document."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping):
        for key, inner in value.items():
            yield str(key)
            yield from _texts(inner)
    elif isinstance(value, list):
        for inner in value:
            yield from _texts(inner)


def _documents(rig: Path) -> Iterator[Path]:
    for root in project_roots(rig):
        for file in files_meant(str(root), DOCUMENT_SUFFIXES):
            yield file.path


def _may_mean(path: Path, value: Mapping[str, Any], rig: Path) -> bool:
    """Return whether a file's names may be those of a rig."""
    stated = value.get("rig")
    if not isinstance(stated, str):
        return True
    if stated.startswith("animtool/"):
        return "from" in value
    return _has_names_of((path.parent / stated).resolve(), rig)


def _has_names_of(other: Path, rig: Path) -> bool:
    """Return whether a rig is that one, or a sidecar of some rig."""
    if other == rig:
        return True
    if READERS.get(other.suffix.lower()) is not DOCUMENT:
        return False
    try:
        return "from" in read_document(other).value
    except AnimtoolError:
        return True

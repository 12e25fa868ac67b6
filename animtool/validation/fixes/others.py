"""Other files of a project that may name what a rig has."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from animtool.config import project_roots
from animtool.documents.document import document_of, read_document
from animtool.errors import AnimtoolError
from animtool.readers import DOCUMENT, READERS
from animtool.validation.subjects.open import DOCUMENT_SUFFIXES

__all__ = ["naming"]


def naming(rig: Path, names: Sequence[str]) -> Iterator[tuple[Path, str]]:
    """Yield files with one of the names of a rig in their text, and the first of them.

    Whatever it means there. Rigs of their own, and what is for one of these, have
    names of their own, and are left out.
    """
    own = rig.resolve()
    for path in _documents(rig):
        try:
            text = path.read_text("utf-8-sig")
        except (OSError, UnicodeDecodeError):
            continue
        found = next((name for name in names if name in text), None)
        if found is not None and path.resolve() != own and _may_mean(path, text, own):
            yield path, found


def _documents(rig: Path) -> Iterator[Path]:
    for root in project_roots(rig):
        for path in sorted(root.rglob("*")):
            if path.name.lower().endswith(DOCUMENT_SUFFIXES):
                yield path


def _may_mean(path: Path, text: str, rig: Path) -> bool:
    """Return whether a file's names may be those of a rig."""
    try:
        value = document_of(text, path).value
    except AnimtoolError:
        return True
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

"""Files that a document refers to, by names seen from its folder."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from animtool.documents.document import Document, Location

__all__ = ["reference", "referred", "referred_input", "split_reference"]


def split_reference(text: str, default: str) -> tuple[str, str]:
    """Return file and array name of a reference.

    >>> split_reference("face.npz#smile", "deltas"), split_reference("a.npz", "points")
    (('face.npz', 'smile'), ('a.npz', 'points'))
    """
    name, _, key = text.partition("#")
    return name, key or default


def reference(folder: Path, roots: Sequence[Path], name: str) -> Path:
    """Return the file that a name means, seen from a folder.

    Raises:
        ValueError: It leads out of the roots.
    """
    try:
        path = (folder / name).resolve()
    except (OSError, RuntimeError) as error:
        raise ValueError(f"{name!r} leads nowhere: {error}") from error
    if not any(path.is_relative_to(root.resolve()) for root in roots):
        shown = ", ".join(str(root) for root in roots)
        raise ValueError(f"{name!r} leads out of {shown}")
    return path


def referred(
    document: Document,
    location: Location,
    name: str,
    roots: Sequence[Path],
    code: str,
) -> Path | None:
    """Return the file that a document refers to; None, and a fault, where it may not.

    Args:
        document: Whose folder names start from.
        location: Where the name stands in it.
        name: As written.
        roots: Folders that references may lead into.
        code: Of the fault.
    """
    try:
        return reference(document.path.resolve().parent, roots, name)
    except ValueError as error:
        hint = "roots in animtool.toml allows more folders"
        document.add(code, location, str(error), hint)
        return None


def referred_input(
    document: Document,
    location: Location,
    name: str,
    roots: Sequence[Path],
    codes: tuple[str, str],
) -> Path | None:
    """Return a file that a document reads; None, and a fault, where it cannot.

    Args:
        document: Whose folder names start from.
        location: Where the name stands in it.
        name: As written.
        roots: Folders that references may lead into.
        codes: Of faults: one that leads out of them, and one that is not there.
    """
    path = referred(document, location, name, roots, codes[0])
    if path is not None and not path.exists():
        document.add(codes[1], location, f"{name!r} does not exist")
        return None
    return path

"""Which files names, folders and globs mean."""

from __future__ import annotations

import difflib
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from animtool.errors import Fault, FormatError

__all__ = [
    "FoundFile",
    "Places",
    "files_meant",
    "nearest_file",
    "seen_from",
    "unreadable",
]

# More names than a person sees in a folder are not looked at.
MAX_NAMES = 10_000

_WILD = frozenset("*?[")


@dataclass(frozen=True, slots=True)
class FoundFile:
    """A file that was meant.

    Attributes:
        path: The file, spelled as its folder was.
        base: The folder that was searched; of a named file its own.
    """

    path: Path
    base: Path


class Places:
    """Where paths lead, links of folders followed, and those of files not.

    Each folder is looked up once.
    """

    def __init__(self) -> None:
        self._folders: dict[Path, Path] = {}

    def __call__(self, path: Path) -> Path:
        """Return the same path for every way to spell it."""
        folder = path.parent
        if folder not in self._folders:
            self._folders[folder] = folder.resolve()
        return self._folders[folder] / path.name


def unreadable(path: Path, reason: OSError | str) -> FormatError:
    """Return the error of a file that cannot be read (IO001).

    Args:
        path: The file, as the user named it.
        reason: Why.
    """
    if isinstance(reason, OSError):
        reason = reason.strerror or str(reason)
    message = f"cannot be read: {reason}"
    return FormatError(Fault("IO001", message, str(path), (), nearest_file(path)))


def nearest_file(path: Path, folder: Path = Path()) -> str | None:
    """Return a hint that names the file that was meant by one that does not exist.

    It names the nearest name in the same folder, or the nearest of the folder that is
    missing. None where the file exists, or no name is near.

    Args:
        path: The file.
        folder: Where a relative path starts.
    """
    around = [path, *path.parents]
    missing = next((p for p in reversed(around) if not (folder / p).exists()), None)
    if missing is None or not missing.name:
        return None
    try:
        with os.scandir(folder / missing.parent) as found:
            names = sorted(entry.name for entry in islice(found, MAX_NAMES))
    except OSError:
        return None
    folded = {name.casefold(): name for name in reversed(names)}
    near = difflib.get_close_matches(missing.name.casefold(), sorted(folded), 1, 0.7)
    if not near:
        return None
    meant = missing.with_name(folded[near[0]]).as_posix()
    return f"did you mean {'' if missing is path else 'the folder '}{meant!r}?"


def files_meant(text: str, suffixes: Sequence[str]) -> Iterator[FoundFile]:
    """Yield the files that a name, a folder or a glob means, in order.

    Of a folder all files with one of the suffixes, those of folders in it too. Of a
    glob the files that it matches; ``**`` is any number of folders. Names that begin
    with a dot are left out where the glob has none. A name that is there is meant as
    it is, and so is one that is nowhere.

    Args:
        text: What was given.
        suffixes: How the names end, lower case, of files that folders are searched
            for.
    """
    path = Path(text)
    if path.is_dir():
        known = tuple(suffixes)
        for file in sorted(path.rglob("*")):
            if file.name.lower().endswith(known) and _is_shown(file, path):
                yield FoundFile(file, path)
    elif _WILD & set(text) and not path.exists():
        # Folders without a wildcard stay as the user spells them.
        parts = path.parts
        first = next(i for i, part in enumerate(parts) if _WILD & set(part))
        base = Path(*parts[:first])
        named = any(part.startswith(".") for part in parts[first:])
        for file in sorted(base.glob("/".join(parts[first:]))):
            if file.is_file() if named else _is_shown(file, base):
                yield FoundFile(file, base)
    else:
        yield FoundFile(path, path.parent)


def _is_shown(file: Path, folder: Path) -> bool:
    parts = file.relative_to(folder).parts
    return not any(part.startswith(".") for part in parts) and file.is_file()


def seen_from(path: Path, folder: Path) -> str:
    """Return what files of a folder call a file: relative to it, where there is a way.

    >>> seen_from(Path("/shots/rigs/hero.usda"), Path("/shots/sh010"))
    '../rigs/hero.usda'
    """
    path, folder = path.resolve(), folder.resolve()
    parents = (folder, *folder.parents)
    above = next((up for up in parents if path.is_relative_to(up)), None)
    if above is None:
        # Another drive.
        return path.as_posix()
    steps = [".."] * len(folder.relative_to(above).parts)
    return "/".join([*steps, *path.relative_to(above).parts])

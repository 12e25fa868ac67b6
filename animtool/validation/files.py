"""Which files to look at: named, in folders, by globs."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from animtool.errors import AnimtoolError, ExitCode, Fault
from animtool.validation.subjects.open import SUFFIXES

__all__ = ["NothingFoundError", "find_files"]

_WILD = frozenset("*?[")


class NothingFoundError(AnimtoolError):
    """There is no file to look at."""

    exit_code = ExitCode.NOTHING_MATCHED


def find_files(paths: Iterable[Path | str]) -> list[Path]:
    """Return the files that paths mean, each once, in the order of the paths.

    Of a folder all files that animtool knows by name, those of folders in it too. Of a
    glob the files that it matches; ``**`` is any number of folders. Names that begin
    with a dot are left out where the glob has none. A name that is there is meant as it
    is.

    Raises:
        NothingFoundError: There is none (VAL006).
    """
    given = [str(path) for path in paths]
    found = list(dict.fromkeys(file for text in given for file in _files(text)))
    if not found:
        shown = ", ".join(given) or "nothing"
        message = f"no file to check in {shown}"
        hint = f"folders are searched for {', '.join(SUFFIXES)}"
        raise NothingFoundError(Fault("VAL006", message, hint=hint))
    return found


def _files(text: str) -> Iterator[Path]:
    path = Path(text)
    if path.is_dir():
        yield from sorted(file for file in path.rglob("*") if _is_ours(file, path))
    elif _WILD & set(text) and not path.exists():
        # Folders without a wildcard stay as the user spells them.
        parts = path.parts
        first = next(i for i, part in enumerate(parts) if _WILD & set(part))
        base = Path(*parts[:first])
        pattern = "/".join(parts[first:])
        named = any(part.startswith(".") for part in parts[first:])
        matched = (file for file in base.glob(pattern) if file.is_file())
        yield from sorted(file for file in matched if named or not _hidden(file, base))
    else:
        yield path


def _is_ours(file: Path, folder: Path) -> bool:
    known = file.name.lower().endswith(SUFFIXES)
    return known and not _hidden(file, folder) and file.is_file()


def _hidden(file: Path, folder: Path) -> bool:
    return any(part.startswith(".") for part in file.relative_to(folder).parts)

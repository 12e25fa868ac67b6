"""Which files to look at: named, in folders, by globs."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from animtool.errors import Fault, NothingFoundError
from animtool.files import files_meant
from animtool.validation.subjects.open import SUFFIXES


def find_files(paths: Iterable[Path | str]) -> list[Path]:
    """Return the files that paths mean, each once, in the order of the paths.

    See `animtool.files.files_meant`; folders are searched for all files that animtool
    knows by name.

    Raises:
        NothingFoundError: There is none (VAL006).
    """
    # Of a variable of a shell that is not set; the folder that it is run in is ".".
    given = [text for path in paths if (text := str(path))]
    meant = (found.path for text in given for found in files_meant(text, SUFFIXES))
    files = list(dict.fromkeys(meant))
    if not files:
        shown = ", ".join(given) or "nothing"
        message = f"no file to check in {shown}"
        hint = f"folders are searched for {', '.join(SUFFIXES)}"
        raise NothingFoundError(Fault("VAL006", message, hint=hint))
    return files

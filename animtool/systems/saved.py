"""Files of saved states: what their formats share, an npz with a header."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from animtool.documents.arrays import Archives
from animtool.errors import Fault, FormatError
from animtool.output import replacing
from animtool.placing import output_error


def write_saved(path: Path, form: str, arrays: Mapping[str, Any]) -> None:
    """Write arrays of a format in place of what a file held.

    Raises:
        OutputError: It cannot be written.
    """
    try:
        with replacing(path) as temporary, temporary.open("wb") as file:
            np.savez(file, **{"format": np.array(form), **arrays})
    except OSError as error:
        raise output_error(path, error) from error


@contextmanager
def open_saved(path: Path, form: str, content: str) -> Iterator[Archives]:
    """Give the arrays of a file of a format, to be read in the block.

    Raises:
        FormatError: It cannot be read, or is no such file (SIM035).
    """
    try:
        with Archives() as archives:
            known = archives.has(path, "format")
            if not known or archives.text(path, "format") != form:
                message = f"is no file of {content} saved"
                raise FormatError(Fault("SIM035", message, str(path)))
            yield archives
    except ValueError as error:
        raise FormatError(Fault("SIM035", f"{error}", str(path))) from error

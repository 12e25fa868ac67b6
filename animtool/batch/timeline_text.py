"""What a timeline's file may be before OpenTimelineIO reads it.

Its parser has no bound on size, and ends the process where text nests too deeply, or
where it finds a mistake in the middle of an object.
"""

from __future__ import annotations

import json
import re
from dataclasses import replace
from itertools import accumulate
from pathlib import Path
from zipfile import ZipFile

from animtool.errors import Fault, FormatError, excerpt
from animtool.files import open_input

# A feature film with all its metadata takes a fifth [bytes].
MAX_BYTES = 100_000_000
# A stack in a stack takes three.
MAX_NESTING = 300
CONTENT = "content.otio"

_STRING = re.compile(rb'"(?:[^"\\]|\\.)*"', re.S)
_BRACKETS = b"[]{}"
_OTHERS = bytes(set(range(256)) - set(_BRACKETS))


def check_text(path: Path) -> None:
    """Refuse a timeline that is too large, nests too deeply, or is no file.

    Raises:
        FormatError: It is one of these (BAT041).
    """
    try:
        problem = _problem(path)
    except FormatError as error:
        raise FormatError(replace(error.faults[0], code="BAT041")) from error
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or excerpt(str(error), 200)
        problem = f"cannot be read as a timeline: {why}"
    if problem is not None:
        raise FormatError(Fault("BAT041", problem, str(path)))


def _problem(path: Path) -> str | None:
    kind = path.suffix.lower()
    if kind == ".otiod":
        path = path / CONTENT
    text = b"null"
    with open_input(path, None if kind == ".otioz" else MAX_BYTES) as file:
        if kind in {".otio", ".otiod"}:
            text = file.whole()
        elif kind == ".otioz":
            try:
                with ZipFile(file) as archive, archive.open(CONTENT) as content:
                    text = content.read(MAX_BYTES + 1)
            except MemoryError:
                raise
            except Exception as error:
                # Of archives that are damaged, the library raises almost anything.
                return f"cannot be read: {excerpt(str(error), 200)}"
        if len(text) > MAX_BYTES:
            return f"holds more than {MAX_BYTES // 1_000_000} MB"
    if nesting(text) > MAX_NESTING:
        return f"nests more than {MAX_NESTING} deep"
    json.loads(text.decode("utf-8"))
    return None


def nesting(text: bytes) -> int:
    """Return how deep JSON nests.

    >>> nesting(b'[{"a": "[[[", "b": [1]}, 2]')
    3
    """
    brackets = _STRING.sub(b"", text).translate(None, _OTHERS)
    return max(accumulate(1 if b in b"[{" else -1 for b in brackets), default=0)

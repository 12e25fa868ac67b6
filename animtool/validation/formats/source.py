"""The line of a file that a finding is in, cut to what a terminal shows."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from animtool.errors import FormatError
from animtool.files import read_input

# What YAML takes for the end of a line.
_ENDS = re.compile("\r\n|[\n\r\x85\u2028\u2029]")
# Longer files are arrays, of which no one reads a line.
MAX_BYTES = 4_000_000
WIDTH = 96
# How much of a cut line stands before the place.
BEFORE = 32


@dataclass(slots=True)
class Sources:
    """Lines of files; the last file read is kept.

    Attributes:
        path: The file that is kept.
        lines: Of it.
    """

    path: str | None = None
    lines: list[str] = field(default_factory=list)

    def line(self, path: str, number: int) -> str | None:
        """Return a 1-based line of a file; None where it cannot be read."""
        if path != self.path:
            self.path, self.lines = path, _lines(Path(path))
        return self.lines[number - 1] if 0 < number <= len(self.lines) else None


def _lines(path: Path) -> list[str]:
    try:
        data = read_input(path, MAX_BYTES, noted=False)
        return _ENDS.split(data.decode("utf-8-sig"))
    except (FormatError, UnicodeDecodeError):
        return []


def cut(line: str, column: int) -> Iterator[str]:
    """Yield a line, and a line with a caret below a 1-based column of it.

    >>> list(cut("joints: []", 9))
    ['joints: []', '        ^']
    """
    shown = line.rstrip()
    start = 0
    if len(shown) > WIDTH:
        start = max(0, min(column - 1 - BEFORE, len(shown) - WIDTH))
    part = shown[start : start + WIDTH]
    part = "".join(c if c.isprintable() else " " for c in part)
    if start:
        part = "\N{HORIZONTAL ELLIPSIS}" + part[1:]
    if start + WIDTH < len(shown):
        part = part[:-1] + "\N{HORIZONTAL ELLIPSIS}"
    yield part
    yield " " * (column - 1 - start) + "^"

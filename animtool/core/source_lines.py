"""Source lines of faults, with a caret below the column."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import field
from pathlib import Path

from animtool.core.errors import Fault, FormatError
from animtool.core.files.reading import read_input
from animtool.core.record import dataclass

# Line ends according to YAML.
_LINE_ENDS = re.compile("\r\n|[\n\r\x85\u2028\u2029]")
# Longer files are arrays; their lines are not shown.
MAX_FILE_BYTES = 4_000_000
MAX_LINE_WIDTH = 96
# Number of characters shown before the fault's column in a shortened line.
CONTEXT_CHARACTERS = 32


@dataclass(slots=True)
class SourceLineCache:
    """Source lines of files; the last file read is cached."""

    path: str | None = None  # path of the cached file
    lines: list[str] = field(default_factory=list)  # its lines

    def line(self, path: str, number: int) -> str | None:
        """Return the line of a file by its 1-based number; None if it is unreadable."""
        if path != self.path:
            self.path, self.lines = path, _lines(Path(path))
        return self.lines[number - 1] if 0 < number <= len(self.lines) else None


def _lines(path: Path) -> list[str]:
    try:
        data = read_input(path, MAX_FILE_BYTES, is_recorded=False)
        return _LINE_ENDS.split(data.decode("utf-8-sig"))
    except (FormatError, UnicodeDecodeError):
        return []


def crop_line(line: str, column: int) -> Iterator[str]:
    """Yield a source line, and a line with a caret below a 1-based column.

    >>> list(crop_line("joints: []", 9))
    ['joints: []', '        ^']
    """
    stripped_line = line.rstrip()
    offset = 0
    if len(stripped_line) > MAX_LINE_WIDTH:
        last_offset = len(stripped_line) - MAX_LINE_WIDTH
        offset = max(0, min(column - 1 - CONTEXT_CHARACTERS, last_offset))
    excerpt = stripped_line[offset : offset + MAX_LINE_WIDTH]
    excerpt = "".join(c if c.isprintable() else " " for c in excerpt)
    if offset:
        excerpt = "\N{HORIZONTAL ELLIPSIS}" + excerpt[1:]
    if offset + MAX_LINE_WIDTH < len(stripped_line):
        excerpt = excerpt[:-1] + "\N{HORIZONTAL ELLIPSIS}"
    yield excerpt
    yield " " * (column - 1 - offset) + "^"


def excerpt_lines(fault: Fault, sources: SourceLineCache) -> tuple[str, ...]:
    """Return the source line of a fault and a caret line; empty if it has no line."""
    if fault.path is None or not fault.lines:
        return ()
    number = fault.lines[0]
    line = sources.line(fault.path, number)
    if line is None or not line.strip():
        return ()
    text, caret = crop_line(line, fault.column or len(line) - len(line.lstrip()) + 1)
    margin = f"{number:>5} | "
    return margin + text, " " * (len(margin) - 2) + "| " + caret

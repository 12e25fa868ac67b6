"""A report for a terminal: each finding with its line and a caret."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeAlias

from animtool.errors import Fault, FormatError, Severity, counted
from animtool.files import read_input
from animtool.quantities import escaped
from animtool.validation.run import Report

# What YAML takes for the end of a line.
_ENDS = re.compile("\r\n|[\n\r\x85\u2028\u2029]")
# Longer files are arrays, of which no one reads a line.
MAX_BYTES = 4_000_000
WIDTH = 96
# How much of a cut line stands before the place.
BEFORE = 32


@dataclass(slots=True)
class Sources:
    """Lines of files; the last file read is kept."""

    path: str | None = None  # the file that is kept
    lines: list[str] = field(default_factory=list)  # of it

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


_Kind: TypeAlias = tuple[str | None, str, Severity]


def text_report(report: Report, *, whole: bool = False) -> str:
    """Return the findings, each with the line it is in, and a last line that counts."""
    sources = Sources()
    counts = Counter(map(_kind, report.findings))
    printed: set[_Kind] = set()
    lines: list[str] = []
    for fault in report.findings:
        kind = _kind(fault)
        if whole or fault.lines:
            lines += _finding(fault, sources)
        elif kind not in printed:
            printed.add(kind)
            more = counts[kind] - 1
            lines.append(
                f"{fault}" + (f" ({more} more like it, see -v)" if more else "")
            )
    return "".join(f"{escaped(line)}\n" for line in [*lines, summary(report)])


def _kind(fault: Fault) -> _Kind:
    """Return what findings share that say the same of one file."""
    return fault.path, fault.code, fault.severity


def summary(report: Report) -> str:
    """Return what was found, in one line.

    >>> summary(Report((), ()))
    '0 files: nothing found'
    """
    parts = [
        counted(count, str(severity))
        for severity in Severity
        if (count := report.count(severity))
    ]
    files = counted(len(report.files), "file")
    fixable = f", --fix mends {len(report.fixable)}" if report.fixable else ""
    return f"{files}: {', '.join(parts) or 'nothing found'}{fixable}"


def _finding(fault: Fault, sources: Sources) -> Iterator[str]:
    yield str(fault)
    if fault.path is None or not fault.lines:
        return
    number = fault.lines[0]
    line = sources.line(fault.path, number)
    if line is None or not line.strip():
        return
    text, caret = cut(line, fault.column or len(line) - len(line.lstrip()) + 1)
    margin = f"{number:>5} | "
    yield margin + text
    yield " " * (len(margin) - 2) + "| " + caret

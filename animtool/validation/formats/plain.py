"""A report for a terminal: each finding with its line and a caret."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import TypeAlias

from animtool.errors import Fault, Severity, counted
from animtool.printing import escaped
from animtool.validation.formats.source import Sources, cut
from animtool.validation.run import Report

_Kind: TypeAlias = tuple[str | None, str, Severity]


def text_report(report: Report, *, whole: bool = False) -> str:
    """Return the findings, each with the line it is in, and a last line that counts.

    Args:
        report: What was found.
        whole: Print findings that repeat one of their file too; those in lines of a
            text are never repeats.
    """
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

"""A report for a terminal: each finding with its line and a caret."""

from __future__ import annotations

from collections.abc import Iterator

from animtool.errors import Fault, Severity, counted
from animtool.validation.formats.source import Sources, cut
from animtool.validation.run import Report

__all__ = ["summary", "text_report"]


def text_report(report: Report) -> str:
    """Return the findings, each with the line it is in, and a last line that counts."""
    sources = Sources()
    lines = [line for fault in report.findings for line in _finding(fault, sources)]
    return "\n".join([*lines, summary(report)]) + "\n"


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

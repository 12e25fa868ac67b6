"""Collects warnings and notes about a file that is being read."""

from __future__ import annotations

from dataclasses import field
from typing import NoReturn

from animtool.core.errors import Fault, FormatError, Severity
from animtool.core.record import dataclass

# Maximum number of warnings per code.
MAX_WARNINGS = 20


@dataclass(slots=True)
class FileNotices:
    """Warnings and notes gathered while a file is read."""

    path: str
    notices: list[Fault] = field(default_factory=list)
    counts: dict[str, int] = field(default_factory=dict)  # number of warnings by code
    reported: set[tuple[str, str, str]] = field(default_factory=set)

    def fail(
        self, code: str, where: str, message: str, hint: str | None = None
    ) -> NoReturn:
        """Raise a `FormatError` about the file."""
        raise FormatError(Fault(code, message, self.path, (), hint, where=where))

    def warn(
        self,
        code: str,
        where: str,
        message: str,
        hint: str | None = None,
        severity: Severity = Severity.WARNING,
    ) -> None:
        """Record a warning or note once, and at most `MAX_WARNINGS` per code."""
        if (code, where, message) in self.reported:
            return
        self.reported.add((code, where, message))
        count = self.counts[code] = self.counts.get(code, 0) + 1
        if count <= MAX_WARNINGS:
            fault = Fault(code, message, self.path, (), hint, severity, where=where)
            self.notices.append(fault)

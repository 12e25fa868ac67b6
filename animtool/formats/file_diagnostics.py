"""Collects warnings and notes about a file that is being read."""

from __future__ import annotations

from dataclasses import field
from typing import NoReturn

from animtool.core.errors import Fault, FormatError, Severity
from animtool.core.record import dataclass

# Maximum number of warnings per code.
MAX_WARNINGS = 20


@dataclass(slots=True)
class FileDiagnostics:
    """Warnings and notes gathered while a file is read."""

    path: str
    remedy: str | None = None  # hint of errors without their own
    notices: list[Fault] = field(default_factory=list)
    warning_counts: dict[str, int] = field(default_factory=dict)  # by code
    # Code, location and message of each warning, to report it once.
    reported_warnings: set[tuple[str, str, str]] = field(default_factory=set)

    def fail(
        self, code: str, location: str, message: str, hint: str | None = None
    ) -> NoReturn:
        """Raise a `FormatError` at a location in the file."""
        hint = hint or self.remedy
        raise FormatError(Fault(code, message, self.path, (), hint, where=location))

    def warn(
        self,
        code: str,
        location: str,
        message: str,
        hint: str | None = None,
        severity: Severity = Severity.WARNING,
    ) -> None:
        """Record a warning or note once, and at most `MAX_WARNINGS` per code."""
        if (code, location, message) in self.reported_warnings:
            return
        self.reported_warnings.add((code, location, message))
        warning_count = self.warning_counts[code] = self.warning_counts.get(code, 0) + 1
        if warning_count <= MAX_WARNINGS:
            fault = Fault(code, message, self.path, (), hint, severity, where=location)
            self.notices.append(fault)

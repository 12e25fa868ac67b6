"""A report as workflow commands of GitHub, which it shows beside the lines.

References:
    GitHub Docs, "Workflow commands for GitHub Actions", setting an error message; the
    escapes are those of ``command.ts`` of actions/toolkit.
"""

from __future__ import annotations

from animtool.errors import Fault, Severity
from animtool.printing import escaped
from animtool.validation.run import Report

_LEVELS = {
    Severity.ERROR: "error",
    Severity.WARNING: "warning",
    Severity.NOTE: "notice",
}


def github_report(report: Report) -> str:
    """Return a command for each finding."""
    return "".join(_command(fault) + "\n" for fault in report.findings)


def _command(fault: Fault) -> str:
    properties: dict[str, object] = {}
    if fault.path is not None:
        properties["file"] = fault.path.replace("\\", "/")
    if fault.lines:
        properties["line"] = fault.lines[0]
        if fault.column is not None:
            properties["col"] = fault.column
    properties["title"] = fault.code
    listed = ",".join(f"{key}={_property(value)}" for key, value in properties.items())
    where = f"{fault.where}: " if fault.where else ""
    hint = f", {fault.hint}" if fault.hint else ""
    text = _data(f"{where}{fault.message}{hint}")
    return f"::{_LEVELS[fault.severity]} {listed}::{text}"


def _data(text: str) -> str:
    return escaped(text).replace("%", "%25")


def _property(value: object) -> str:
    return _data(str(value)).replace(":", "%3A").replace(",", "%2C")

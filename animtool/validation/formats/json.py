"""A report as JSON."""

from __future__ import annotations

from animtool.errors import Severity
from animtool.printing import json_printed
from animtool.validation.run import Report


def json_report(report: Report) -> str:
    """Return every file that was looked at, and every finding."""
    value = {
        "validate": "animtool/1",
        "files": [str(path) for path in report.files],
        "findings": [
            {**fault.as_dict(), "fixable": fault in report.fixable}
            for fault in report.findings
        ],
        "mended": [{**fault.as_dict(), "done": done} for fault, done in report.mended],
        "summary": {str(kind): report.count(kind) for kind in Severity},
    }
    return json_printed(value, indent=2) + "\n"

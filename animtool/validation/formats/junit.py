"""Reports for services: JUnit, GitHub and JSON.

No times: the same files give the same bytes.

References:
    GitHub Docs, "Workflow commands for GitHub Actions", setting an error message; the
    escapes are those of ``command.ts`` of actions/toolkit.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

from animtool.errors import Fault, Severity
from animtool.junit import JunitCase, junit_xml
from animtool.quantities import escaped, json_printed
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


def junit_report(report: Report) -> str:
    """Return a suite of all files; warnings and notes are what a case says."""
    found: dict[str, list[Fault]] = defaultdict(list)
    for fault in report.findings:
        found[fault.path or "animtool"].append(fault)
    named = dict.fromkeys([*map(str, report.files), *sorted(found)])
    unreadable = report.unreadable()
    cases = (_case(name, found[name], unreadable=name in unreadable) for name in named)
    return junit_xml("animtool validate", cases)


def _case(name: str, faults: Sequence[Fault], *, unreadable: bool) -> JunitCase:
    wrong = [fault for fault in faults if fault.severity is Severity.ERROR]
    odd = [fault for fault in faults if fault.severity is not Severity.ERROR]
    said = "\n".join(map(str, odd))
    if not wrong:
        return JunitCase(name, said=said)
    return JunitCase(
        name,
        "error" if unreadable else "failure",
        wrong[0].code,
        wrong[0].message,
        "\n".join(map(str, wrong)),
        said,
    )

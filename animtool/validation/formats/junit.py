"""A report as JUnit XML: a test case a file, which fails where errors are in it.

No times: the same files give the same bytes.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

from animtool.errors import Fault, Severity
from animtool.junit import JunitCase, junit_xml
from animtool.validation.run import Report


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

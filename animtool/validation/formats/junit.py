"""A report as JUnit XML: a test case a file, which fails where errors are in it.

The form is that of Jenkins's ``junit-10.xsd``, which GitLab and others read too. No
times: the same files give the same bytes.
"""

from __future__ import annotations

import re
from collections import defaultdict
from pathlib import PurePath
from xml.etree import ElementTree

from animtool.errors import Fault, Severity
from animtool.validation.run import Report

__all__ = ["junit_report"]

# What XML 1.0 cannot hold.
_FORBIDDEN = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def junit_report(report: Report) -> str:
    """Return a suite of all files; warnings and notes are what a case says."""
    found: dict[str, list[Fault]] = defaultdict(list)
    for fault in report.findings:
        found[fault.path or "animtool"].append(fault)
    named = dict.fromkeys([*map(str, report.files), *sorted(found)])
    unreadable = report.unreadable()
    suite = ElementTree.Element("testsuite", name="animtool validate")
    for name in named:
        _case(suite, name, found[name], unreadable=name in unreadable)
    counts = {
        "tests": str(len(named)),
        "failures": str(len(suite.findall("testcase/failure"))),
        "errors": str(len(suite.findall("testcase/error"))),
        "skipped": "0",
    }
    suite.attrib |= counts
    root = ElementTree.Element("testsuites", name="animtool validate")
    root.append(suite)
    ElementTree.indent(root)
    text = ElementTree.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'


def _case(
    suite: ElementTree.Element, name: str, faults: list[Fault], *, unreadable: bool
) -> None:
    folder = PurePath(name).parent.as_posix()
    case = ElementTree.SubElement(
        suite, "testcase", classname=_clean(folder), name=_clean(PurePath(name).name)
    )
    wrong = [fault for fault in faults if fault.severity is Severity.ERROR]
    odd = [fault for fault in faults if fault.severity is not Severity.ERROR]
    if wrong:
        kind = "error" if unreadable else "failure"
        first = wrong[0]
        entry = ElementTree.SubElement(
            case, kind, type=first.code, message=_clean(first.message)
        )
        entry.text = _clean("\n".join(map(str, wrong)))
    if odd:
        said = ElementTree.SubElement(case, "system-out")
        said.text = _clean("\n".join(map(str, odd)))


def _clean(text: str) -> str:
    return _FORBIDDEN.sub("\N{REPLACEMENT CHARACTER}", text)

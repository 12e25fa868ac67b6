"""Findings as text, JSON and JUnit XML.

Contains no times, so that the same files give the same bytes.

References:
    GitHub Docs, "Workflow commands for GitHub Actions", setting an error message; the
    escapes are those of ``command.ts`` of actions/toolkit.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from typing import TypeAlias

from animtool.core.arguments import (
    ArgumentNamer,
    argument,
    as_text,
    clause,
    name_arguments,
    python_name,
)
from animtool.core.errors import Fault, Severity, counted
from animtool.core.junit import JunitCase, junit_xml
from animtool.core.quantities import escaped, printable_json
from animtool.core.record import dataclass
from animtool.core.source_lines import SourceLineCache, excerpt_lines
from animtool.core.values import plain_value
from animtool.report.text import Each, Template
from animtool.validation.run import Report

_RepeatKey: TypeAlias = tuple[str | None, str, Severity]


@dataclass(frozen=True, slots=True)
class ShownFinding:
    """A finding with its source excerpt, or with the number of omitted repeats."""

    fault: Fault
    repeat_count: int = 0  # number of equal findings in its file that are not shown
    excerpt: tuple[str, ...] = ()  # its source line, and a caret line


@dataclass(frozen=True, slots=True)
class Findings:
    """Record that the template `FINDINGS` prints."""

    shown: list[ShownFinding]


_SEE_CLAUSE = clause(f", see {argument('command.verbose')}")
FINDINGS = Template(
    "animtool.validation.formats.plain:Findings",
    (
        Each(
            "shown",
            (
                "{fault}[{?repeat_count} "
                f"({{repeat_count}} more like it{_SEE_CLAUSE})]",
                Each("excerpt", ("{self}",)),
            ),
        ),
    ),
)
SUMMARY = Template(
    "animtool.validation.run:Report",
    ("[{files:n file}|0 files]: [{summary:found}|nothing found][, {fixable:mends}]",),
    {
        "found": lambda counts: ", ".join(
            counted(count, kind) for kind, count in counts.items() if count
        ),
        "mends": lambda fixable: f"{argument('fix', True)} repairs {len(fixable)}",
    },
)


def text_report(
    report: Report, *, shows_repeats: bool = False, namer: ArgumentNamer = python_name
) -> str:
    """Format findings with their source lines, and a summary in the last line."""
    report = report.with_argument_names(namer)
    lines = [
        *FINDINGS.text(
            Findings(_findings_to_print(report, shows_repeats=shows_repeats))
        ),
        summary(report),
    ]
    return "".join(f"{escaped(name_arguments(line, namer))}\n" for line in lines)


def _findings_to_print(report: Report, *, shows_repeats: bool) -> list[ShownFinding]:
    """Return the findings to print; those without a line are merged by code."""
    sources = SourceLineCache()
    repeat_counts = Counter(map(_repeat_key, report.findings))
    first_by_key: dict[_RepeatKey, Fault] = {}
    shown_findings = []
    for fault in report.findings:
        repeat_key = _repeat_key(fault)
        if shows_repeats or fault.lines:
            excerpt = excerpt_lines(fault, sources)
            shown_findings.append(ShownFinding(fault, excerpt=excerpt))
        elif first_by_key.setdefault(repeat_key, fault) is fault:
            shown_findings.append(ShownFinding(fault, repeat_counts[repeat_key] - 1))
    return shown_findings


def _repeat_key(fault: Fault) -> _RepeatKey:
    """Return a key that is equal for repetitions of a finding in one file."""
    return fault.path, fault.code, fault.severity


def summary(report: Report) -> str:
    """Return a summary of findings in one line.

    >>> summary(Report((), ()))
    '0 files: nothing found'
    """
    return as_text(SUMMARY.text(report)[0])


_ANNOTATION_LEVELS = {
    Severity.ERROR: "error",
    Severity.WARNING: "warning",
    Severity.NOTE: "notice",
}


def github_report(report: Report) -> str:
    """Return a GitHub workflow command for each finding."""
    return "".join(_workflow_command(fault) + "\n" for fault in report.findings)


def _workflow_command(fault: Fault) -> str:
    properties: dict[str, object] = {}
    if fault.path is not None:
        properties["file"] = fault.path.replace("\\", "/")
    if fault.lines:
        properties["line"] = fault.lines[0]
        if fault.column is not None:
            properties["col"] = fault.column
    properties["title"] = fault.code
    property_text = ",".join(
        f"{key}={_escape_data(str(value)).replace(':', '%3A').replace(',', '%2C')}"
        for key, value in properties.items()
    )
    location = f"{fault.where}: " if fault.where else ""
    hint = f"; {fault.hint}" if fault.hint else ""
    text = _escape_data(f"{location}{fault.message}{hint}")
    return f"::{_ANNOTATION_LEVELS[fault.severity]} {property_text}::{text}"


def _escape_data(text: str) -> str:
    return escaped(text).replace("%", "%25")


def json_report(report: Report) -> str:
    """Format all checked files and all findings as indented JSON."""
    return printable_json(plain_value(report), indent=2) + "\n"


def junit_report(report: Report) -> str:
    """Return a JUnit suite of all files; warnings and notes are system output."""
    faults_by_file: dict[str, list[Fault]] = defaultdict(list)
    for fault in report.findings:
        faults_by_file[fault.path or "animtool"].append(fault)
    file_names = dict.fromkeys([*map(str, report.files), *sorted(faults_by_file)])
    unreadable_files = report.unreadable()
    cases = (
        _junit_case(name, faults_by_file[name], is_unreadable=name in unreadable_files)
        for name in file_names
    )
    return junit_xml("animtool validate", cases)


def _junit_case(
    name: str, faults: Sequence[Fault], *, is_unreadable: bool
) -> JunitCase:
    errors = [fault for fault in faults if fault.severity is Severity.ERROR]
    other_faults = [fault for fault in faults if fault.severity is not Severity.ERROR]
    text = "\n".join(map(str, other_faults))
    if not errors:
        return JunitCase(name, output=text)
    return JunitCase(
        name,
        "error" if is_unreadable else "failure",
        errors[0].code,
        errors[0].message,
        "\n".join(map(str, errors)),
        text,
    )

"""Report formats for people and services."""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

from animtool.core.arguments import ArgumentNamer, python_name
from animtool.core.plugins import load_object
from animtool.validation.formats.plain import text_report
from animtool.validation.run import Report

__all__ = ["FORMATS", "format_report"]

FORMATS = {
    "text": "animtool.validation.formats.plain:text_report",
    "json": "animtool.validation.formats.plain:json_report",
    "github": "animtool.validation.formats.plain:github_report",
    "sarif": "animtool.validation.formats.sarif:sarif_report",
    "junit": "animtool.validation.formats.plain:junit_report",
}


def format_report(
    report: Report,
    format_name: str,
    *,
    shows_repeats: bool = False,
    namer: ArgumentNamer = python_name,
) -> str:
    """Format a report as text, JSON, GitHub commands, SARIF or JUnit XML.

    Args:
        report: The report.
        format_name: Name in `FORMATS`.
        shows_repeats: Whether the text format includes repeated findings of a file.
            Other formats always contain all findings.
        namer: Returns the spelling of an argument in the caller's interface.
    """
    if format_name == "text":
        return text_report(report, shows_repeats=shows_repeats, namer=namer)
    write_report = cast(Callable[[Report], str], load_object(FORMATS[format_name]))
    return write_report(report.with_argument_names(namer))

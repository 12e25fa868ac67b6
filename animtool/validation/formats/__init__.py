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
    form: str,
    *,
    repeats: bool = False,
    namer: ArgumentNamer = python_name,
) -> str:
    """Return a report in one of `FORMATS`.

    Args:
        report: The report.
        form: Name in `FORMATS`.
        repeats: Whether the text format includes repeated findings of a file. Other
            formats always contain all findings.
        namer: Returns the spelling of an argument in the caller's interface.
    """
    if form == "text":
        return text_report(report, repeats=repeats, namer=namer)
    write = cast(Callable[[Report], str], load_object(FORMATS[form]))
    return write(report.with_argument_names(namer))

"""Reports in the forms that people and services read, as text."""

from __future__ import annotations

from collections.abc import Callable

from animtool.validation.formats.github import github_report
from animtool.validation.formats.json import json_report
from animtool.validation.formats.junit import junit_report
from animtool.validation.formats.plain import text_report
from animtool.validation.formats.sarif import sarif_report
from animtool.validation.run import Report

__all__ = ["FORMATS"]

FORMATS: dict[str, Callable[[Report], str]] = {
    "text": text_report,
    "json": json_report,
    "github": github_report,
    "sarif": sarif_report,
    "junit": junit_report,
}

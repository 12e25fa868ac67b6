"""Findings of `validate` on a page, with their frames and joints."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from animtool.core.errors import AnimtoolError, Fault, Severity
from animtool.validation.options import ValidateOptions
from animtool.validation.run import validate_files

_QUOTED_TEXT = re.compile(r"'((?:[^'\\]|\\.)*)'|\"((?:[^\"\\]|\\.)*)\"")
# Maximum number of findings listed on a page; the others are only counted.
MAX_FINDINGS = 500


def find_faults(files: Sequence[Path]) -> list[Fault]:
    """Return the findings of `validate` in files, skipping files it cannot check."""
    faults: list[Fault] = []
    for path in files:
        try:
            report = validate_files([path], ValidateOptions(jobs=1))
        except AnimtoolError:
            continue
        faults += report.findings
    return faults


def finding_entry(
    fault: Fault, takes: Mapping[str, tuple[int, Sequence[str]]]
) -> dict[str, Any]:
    """Return the entry of a finding in the page manifest.

    ``takes`` maps the path of a file to the index of its take and the names of its
    joints.
    """
    take, joints = takes.get(fault.path or "", (None, ()))
    joint = fault.joint
    if joint is None:
        # Rules quote the joints concerned in their messages.
        quoted_texts = [a or b for a, b in _QUOTED_TEXT.findall(fault.message)]
        joint = next((name for name in quoted_texts if name in set(joints)), None)
    hint = f"; {fault.hint}" if fault.hint else ""
    return {
        "code": fault.code,
        "severity": str(fault.severity),
        "message": f"{fault.message}{hint}",
        "frame": fault.frame,
        "joint": joint,
        "take": take,
    }


def errors_first(faults: Sequence[Fault]) -> list[Fault]:
    """Return findings sorted with errors first."""
    rank = {Severity.ERROR: 0, Severity.WARNING: 1, Severity.NOTE: 2}
    return sorted(dict.fromkeys(faults), key=lambda fault: rank[fault.severity])

"""Mended files, written: each whole or not at all."""

from __future__ import annotations

import codecs
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from animtool.errors import Fault
from animtool.output import check_outputs, output_error, replacing
from animtool.scene.convert_rig import write_arrays
from animtool.validation.fixes.mend import FIXES
from animtool.validation.fixes.plan import FileMend, plan_file, reopened
from animtool.validation.options import ValidateOptions
from animtool.validation.run import Report, validate_files
from animtool.validation.settings import settings_of

__all__ = ["Fixes", "fix_files", "plan_files"]


@dataclass(frozen=True, slots=True)
class Fixes:
    """What was mended.

    Attributes:
        files: Those with findings of a code that has a fix.
        report: What is found after it.
    """

    files: tuple[FileMend, ...]
    report: Report

    @property
    def left(self) -> tuple[tuple[Fault, str], ...]:
        """Findings that have a fix and stay, and why."""
        return tuple(entry for file in self.files for entry in file.left)


def plan_files(report: Report, options: ValidateOptions) -> Iterator[FileMend]:
    """Yield what mending makes of the files of a report; nothing is written.

    Args:
        report: Of `validate_files`, with the same options.
        options: Which codes count.
    """
    for path in _having_fixes(report):
        yield plan_file(path, options.within(settings_of(path)))


def fix_files(files: Sequence[Path], options: ValidateOptions | None = None) -> Fixes:
    """Mend what is wrong in files as far as that is safe, and validate them again.

    Raises:
        OutputError: A file cannot be written.
    """
    options = options or ValidateOptions()
    report = validate_files(files, options)
    check_outputs(_having_fixes(report), [], overwrite=True)
    plans = []
    for plan in plan_files(report, options):
        if plan.after != plan.before:
            _write(plan)
        plans.append(plan)
    if any(plan.mended for plan in plans):
        report = validate_files(files, options)
    mended = tuple(entry for plan in plans for entry in plan.mended)
    return Fixes(tuple(plans), replace(report, mended=mended))


def _having_fixes(report: Report) -> list[Path]:
    named = {fault.path for fault in report.findings if fault.code in FIXES}
    return [path for path in report.files if str(path) in named]


def _write(plan: FileMend) -> None:
    """Write a file, its new arrays before it."""
    try:
        for path, arrays in plan.arrays.items():
            write_arrays(path, dict(arrays))
        _check_arrays(plan)
        _write_text(plan.path, plan.after)
    except BaseException:
        for path in plan.arrays:
            path.unlink(missing_ok=True)
        raise


def _check_arrays(plan: FileMend) -> None:
    """Refuse arrays that are read otherwise than they were written."""
    if not plan.arrays:
        return
    last, _ = plan.mended[-1]
    _, found = reopened(plan.after, plan.path)
    if any(fault.code in {last.code, "RIG018", "RIG019"} for fault in found):
        raise output_error(next(iter(plan.arrays)), "it is read otherwise than written")


def _write_text(path: Path, text: str) -> None:
    mark = path.read_bytes().startswith(codecs.BOM_UTF8)
    with replacing(path) as temporary:
        try:
            encoding = "utf-8-sig" if mark else "utf-8"
            temporary.write_text(text, encoding, newline="")
        except OSError as error:
            raise output_error(path, error) from error

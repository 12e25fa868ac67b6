"""Writes fixed files atomically: all of them, or none."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from animtool.core.arguments import argument
from animtool.core.errors import Fault, counted
from animtool.core.files.output import atomic_outputs, check_outputs
from animtool.core.record import dataclass
from animtool.validation.fixes.draft import has_fix
from animtool.validation.fixes.plan import (
    FixPlan,
    is_fixable,
    is_layer,
    is_package,
    mark_fixable,
    plan_fixes,
)
from animtool.validation.options import ValidateOptions
from animtool.validation.run import Report, validate_files


@dataclass(frozen=True, slots=True)
class FixResult:
    """Result of fixing files: the fixes made and the remaining findings."""

    files: tuple[FixPlan, ...]  # files with findings of codes that have a fix
    report: Report  # validation after the fixes
    notes: tuple[str, ...] = ()  # notes about entire files

    @property
    def unfixed_findings(self) -> tuple[tuple[Fault, str], ...]:
        """Findings that have a fix but remain, each with the reason."""
        return tuple(entry for file in self.files for entry in file.unfixed_findings)


def plan_files(report: Report, options: ValidateOptions) -> Iterator[FixPlan]:
    """Yield the planned fixes of a report's files; nothing is written.

    The report is that of `validate_files` with the same options.
    """
    options = options.with_profile_levels()
    for path in _fixable_files(report):
        yield plan_fixes(path, options)


def fix_files(
    files: Sequence[Path],
    options: ValidateOptions | None = None,
    *,
    overwrite: bool = False,
) -> FixResult:
    """Apply all safe fixes to files, and validate them again.

    Args:
        files: Files of any kind that is validated.
        options: Selected codes.
        overwrite: Whether to replace USD files; else they stay unchanged.

    Raises:
        OutputError: A file cannot be written.
    """
    options = (options or ValidateOptions()).with_profile_levels()
    report = validate_files(files, options)
    fixable_files = _fixable_files(report)
    kept_files = [path for path in fixable_files if is_layer(path) and not overwrite]
    # A file and a link to it are the same file.
    files_to_fix = [path for path in reversed(fixable_files) if path not in kept_files]
    unique_files = list(reversed({p.resolve(): p for p in files_to_fix}.values()))
    check_outputs(unique_files, [], overwrite=True)
    plans = [plan_fixes(path, options) for path in unique_files]
    with atomic_outputs():
        for plan in plans:
            if plan.fixed_findings:
                plan.draft.write(plan.path)
    note = "packages are not edited: unpack it, and fix its layers"
    package_notes = [
        f"{path}: {note}" for path in _fixable_files(report, are_packages=True)
    ]
    notes = (*_unfixed_file_notes(report, kept_files), *package_notes)
    if any(plan.fixed_findings for plan in plans):
        report = validate_files(files, options)
    fixed_findings = tuple(entry for plan in plans for entry in plan.fixed_findings)
    return FixResult(tuple(plans), replace(report, mended=fixed_findings), notes)


def fix_copy(
    source: Path,
    output: Path,
    options: ValidateOptions | None = None,
    *,
    overwrite: bool = False,
) -> FixResult:
    """Write a fixed copy of a USD layer, and validate the copy.

    A layer with nothing to fix is copied unchanged.

    Args:
        source: The layer, which stays unchanged.
        output: The copy.
        options: Selected codes.
        overwrite: Whether the copy may replace a file.

    Raises:
        FormatError: The layer cannot be read.
        OptionError: The copy exists (OUT001), is the layer itself or one that it
            includes (OUT003), or one of the two is not a plain layer (OUT004).
        OutputError: It cannot be written.
    """
    from animtool.usd.fixes.target import check_copy_suffixes, refuse_overwriting_layers

    options = (options or ValidateOptions()).with_profile_levels()
    check_copy_suffixes(source, output)
    check_outputs([output], [source], overwrite=overwrite)
    refuse_overwriting_layers(source, output)
    plan = plan_fixes(source, options)
    notes = plan.draft.write(output)
    report = validate_files([output], options)
    report = replace(report, mended=tuple(plan.fixed_findings))
    return FixResult((plan,), report, tuple(notes))


def _fixable_files(report: Report, *, are_packages: bool = False) -> list[Path]:
    """Return the files with fixable findings: USD packages, or all other files."""
    named_paths = {fault.path for fault in report.findings if has_fix(fault.code)}
    fixable_files = [path for path in report.files if str(path) in named_paths]
    return [p for p in fixable_files if is_fixable(p) and is_package(p) is are_packages]


def _unfixed_file_notes(report: Report, paths: Sequence[Path]) -> Iterator[str]:
    """Yield a message for each unchanged USD file that has fixable findings."""
    if not paths:
        return
    fixable_faults = mark_fixable(report).fixable
    for path in paths:
        count = sum(fault.path == str(path) for fault in fixable_faults)
        if count:
            findings_text = counted(count, "finding")
            yield (
                f"{path}: {findings_text} can be fixed: {argument('output')} NEW.usdc "
                "writes a repaired copy, "
                f"{argument('overwrite', True)} replaces the file"
            )

"""``animtool validate``: checks files, and fixes what is safe to fix."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from animtool.cli.console import Console
from animtool.cli.help import command
from animtool.cli.options import (
    common_options,
    listed_paths,
    read_values,
    record_options,
)
from animtool.core.options import clash_messages
from animtool.validation.options import ReportOptions, ValidateOptions, matches_code

if TYPE_CHECKING:
    from animtool.core.errors import ExitCode, Fault
    from animtool.validation.run import Report


@command(
    epilog="""\b
Examples:
  animtool validate rigs samples
  animtool validate "shots/**/*.clip.yaml" --ignore CLIP2 --strict
  animtool validate . --format sarif --output-file animtool.sarif
  animtool validate rigs --diff
  animtool validate rigs --fix
  animtool validate shot.usdc --fix -o repaired.usdc
  git diff --name-only main -- "*.rig.yaml" | animtool validate -"""
)
@click.argument("paths", nargs=-1, required=True)
@record_options(ValidateOptions, "select", "ignore", "severity", "profile")
@record_options(
    ReportOptions, "strict", "exit_zero", "fix", "output", "overwrite", "diff"
)
@record_options(ValidateOptions, "jobs")
@record_options(ReportOptions, "report_format", "output_file")
@common_options
@click.pass_obj
def validate(console: Console, /, paths: tuple[str, ...], **params: Any) -> None:
    """Check rigs, clips, scenes, captures, BVH, glTF, FBX and USD files.

    PATHS are files, folders, globs ("**" matches any folders) or - for a list on
    stdin, one path per line. animtool explain describes a code. To accept a finding,
    list it in the file, with the reason: ignore: [{code, where, why}].

    Exit code 1: errors were found; 3: a file cannot be read; 5: nothing to check.
    """
    from animtool.validation.run import match_files

    options = ValidateOptions(**read_values(ValidateOptions, params))
    options = options.with_profile_levels()
    report_options = ReportOptions(**read_values(ReportOptions, params))
    for message in clash_messages(report_options):
        raise click.UsageError(f"{message}.")
    for text in paths:
        if matches_code(text) and not Path(text).exists():
            message = f"{text!r} is a code, not a file: animtool explain {text} "
            message += f"describes it, animtool validate PATHS --ignore {text} skips it"
            raise click.UsageError(f"{message}.")
    files, match_warnings = match_files(listed_paths(paths))
    path_warnings = [
        options.with_severity(warning)
        for warning in match_warnings
        if options.selects(warning.code)
    ]
    console.faults(path_warnings)
    if report_options.diff:
        _show_difference(console, files, options, report_options, path_warnings)
        return
    if report_options.output_file is not None:
        from animtool.core.files.output import check_outputs

        check_outputs([report_options.output_file], files, overwrite=True)
    if report_options.fix:
        report = _fix_files(console, files, options, report_options)
    else:
        report = _validate(files, options)
    _print_report(console, report, report_options, path_warnings)


def _validate(files: Sequence[Path], options: ValidateOptions) -> Report:
    from animtool.validation.run import validate_files

    report = validate_files(files, options)
    if not report.findings:
        return report
    from animtool.validation.fixes.plan import mark_fixable

    return mark_fixable(report)


def _fix_files(
    console: Console,
    files: Sequence[Path],
    options: ValidateOptions,
    report_options: ReportOptions,
) -> Report:
    """Fix files, and return a report of the remaining findings."""
    from animtool.validation.fixes.run import fix_copy, fix_files

    overwrite = report_options.overwrite
    if report_options.output is None:
        fixes = fix_files(files, options, overwrite=overwrite)
    elif len(files) == 1:
        fixes = fix_copy(files[0], report_options.output, options, overwrite=overwrite)
    else:
        raise click.UsageError(f"-o is for one USD file, not {len(files)} files.")
    for note in fixes.notes:
        console.say(note)
    for fault, remedy in fixes.report.mended:
        console.say(f"{fault.path}: {fault.code} fixed: {remedy}")
    for fault, reason in fixes.unfixed_findings:
        console.say(f"{fault.path}: {fault.code} not fixed: {reason}")
    return fixes.report


def _show_difference(
    console: Console,
    files: Sequence[Path],
    options: ValidateOptions,
    report_options: ReportOptions,
    path_warnings: Sequence[Fault],
) -> None:
    """Print the diff of `--fix` and the remaining findings.

    The process exits with 1 if a file would change, else with the exit code of the
    findings.
    """
    from animtool.core.errors import ExitCode
    from animtool.validation.fixes.run import plan_files
    from animtool.validation.formats.plain import summary
    from animtool.validation.run import validate_files

    report = validate_files(files, options)
    console.faults(report.broken_rules)
    exit_code = _exit_code(report, report_options, path_warnings)
    fixed_keys: set[tuple[str | None, str, str | None]] = set()
    has_changes = False
    for plan in plan_files(report, options):
        for fault, reason in plan.unfixed_findings:
            console.say(f"{fault.path}: {fault.code} not fixed: {reason}")
        if not plan.fixed_findings:
            continue
        fixed_keys |= {_finding_key(fault) for fault, _ in plan.fixed_findings}
        has_changes = True
        console.result(*plan.draft.diff_text().removesuffix("\n").split("\n"))
        for path in plan.draft.outputs():
            console.say(f"{path} would be written")
        if exit_code is ExitCode.OK and not report_options.exit_zero:
            exit_code = ExitCode.FINDINGS
    console.faults(f for f in report.findings if _finding_key(f) not in fixed_keys)
    if report.findings and not has_changes:
        console.say("nothing to change: no finding has a safe fix")
    console.say(summary(report))
    click.get_current_context().exit(int(exit_code))


def _finding_key(fault: Fault) -> tuple[str | None, str, str | None]:
    """Return a key of a finding that stays the same when others are fixed."""
    return fault.path, fault.code, fault.where


def _print_report(
    console: Console,
    report: Report,
    report_options: ReportOptions,
    path_warnings: Sequence[Fault],
) -> None:
    """Print the report in the chosen format, then exit with its exit code."""
    from animtool.validation.formats import format_report
    from animtool.validation.formats.plain import summary

    console.faults(report.broken_rules)
    is_verbose, namer = console.verbosity > 0, console.namer
    report_format = report_options.report_format
    text = format_report(report, report_format, shows_repeats=is_verbose, namer=namer)
    if report_options.output_file is None:
        console.document(text)
    else:
        from animtool.core.files.output import write_parts

        # File names may contain bytes that are not text.
        write_parts(report_options.output_file, [text.encode("utf-8", "replace")])
    if report_options.output_file is not None or report_options.report_format != "text":
        console.say(summary(report))
    exit_code = _exit_code(report, report_options, path_warnings)
    click.get_current_context().exit(int(exit_code))


def _exit_code(
    report: Report, report_options: ReportOptions, path_warnings: Sequence[Fault]
) -> ExitCode:
    """Return the exit code of a report and of the warnings about paths."""
    complete_report = replace(report, findings=(*report.findings, *path_warnings))
    return complete_report.exit_code(
        strict=report_options.strict, exit_zero=report_options.exit_zero
    )

"""``animtool validate``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from animtool.cli.console import Console
from animtool.cli.options import (
    common_options,
    listed_paths,
    read_values,
    record_option,
)
from animtool.validation.options import ValidateOptions

if TYPE_CHECKING:
    from animtool.validation.run import Report

FORMATS = ("text", "json", "github", "sarif", "junit")


@click.command(
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
@record_option(ValidateOptions, "select", "ignore", "severity", "profile")
@click.option("--strict", is_flag=True, help="End with 1 where there are warnings.")
@click.option("--exit-zero", is_flag=True, help="End with 0 whatever is found.")
@click.option(
    "--fix",
    is_flag=True,
    help="Fix in place what has a safe remedy in rigs, clips, scenes and targets, and "
    "report what is left. A USD file needs -o or --overwrite; BVH is not written.",
)
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path, dir_okay=False),
    help="With --fix and one USD file: write the repaired copy there.",
)
@click.option(
    "--overwrite",
    is_flag=True,
    help="With --fix: replace the file of -o; without -o, USD files themselves.",
)
@click.option(
    "--diff", is_flag=True, help="Show what --fix would change, and write nothing."
)
@record_option(ValidateOptions, "jobs")
@click.option(
    "--format",
    "report_format",
    type=click.Choice(FORMATS),
    default="text",
    show_default=True,
    help="text, JSON, annotations of GitHub, SARIF 2.1.0 or JUnit XML.",
)
@click.option(
    "--output-file",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Write the report there, and what it comes to on stderr.",
)
@common_options
@click.pass_obj
def validate(console: Console, /, paths: tuple[str, ...], **params: Any) -> None:
    """Check rigs, clips, scenes, BVH and USD files, and say what to do.

    PATHS are files, folders, globs ("**" is any folders) or - for a list on stdin,
    a path a line. animtool explain says more of a code. A finding that is meant is
    named in the file, with the reason: ignore: [{code, where, why}].

    Ends with 1 where there are errors, 3 where a file cannot be read, 5 where there
    is none to check.
    """
    from animtool.validation.run import find_files

    options = ValidateOptions(**read_values(ValidateOptions, params)).resolved()
    _check_fix(params)
    files = find_files(listed_paths(paths))
    if params["diff"]:
        _show_difference(console, files, options, params)
        return
    if params["output_file"] is not None:
        from animtool.output import check_outputs

        check_outputs([params["output_file"]], files, overwrite=True)
    if params["fix"]:
        report = _fixed(console, files, options, params)
    else:
        report = _checked(files, options)
    _say(console, report, params)


def _check_fix(params: Mapping[str, Any]) -> None:
    """Refuse options of `--fix` without it, or that `--diff` cannot follow."""
    named = "-o" if params["output"] is not None else "--overwrite"
    if params["output"] is None and not params["overwrite"]:
        return
    if not params["fix"] or params["diff"]:
        raise click.UsageError(f"{named} is for --fix, which writes.")


def _checked(files: Sequence[Path], options: ValidateOptions) -> Report:
    from animtool.validation.run import validate_files

    report = validate_files(files, options)
    if not report.findings:
        return report
    from animtool.validation.fixes.plan import with_fixable

    return with_fixable(report)


def _fixed(
    console: Console,
    files: Sequence[Path],
    options: ValidateOptions,
    params: Mapping[str, Any],
) -> Report:
    """Mend files, and return what is left."""
    from animtool.validation.fixes.run import fix_copy, fix_files

    overwrite = params["overwrite"]
    if params["output"] is None:
        fixes = fix_files(files, options, overwrite=overwrite)
    elif len(files) == 1:
        fixes = fix_copy(files[0], params["output"], options, overwrite=overwrite)
    else:
        raise click.UsageError(f"-o is for one USD file, not {len(files)} files.")
    for note in fixes.notes:
        console.say(note)
    for fault, remedy in fixes.report.mended:
        console.say(f"{fault.path}: {fault.code} mended: {remedy}")
    for fault, reason in fixes.left:
        console.say(f"{fault.path}: {fault.code} not mended: {reason}")
    return fixes.report


def _show_difference(
    console: Console,
    files: Sequence[Path],
    options: ValidateOptions,
    params: Mapping[str, Any],
) -> None:
    """Print what `--fix` would change; ends with 1 where that is something."""
    if params["report_format"] != "text" or params["output_file"] is not None:
        raise click.UsageError("--diff writes a diff, not a report: no --format.")
    from animtool.errors import ExitCode
    from animtool.validation.fixes.run import plan_files
    from animtool.validation.formats.plain import summary
    from animtool.validation.run import validate_files

    report = validate_files(files, options)
    console.faults(report.broken)
    code = report.exit_code(strict=params["strict"], exit_zero=params["exit_zero"])
    for plan in plan_files(report, options):
        if not plan.mended:
            continue
        console.result(*plan.difference().removesuffix("\n").split("\n"))
        for path in plan.after.outputs():
            console.say(f"{path} would be written")
        if code is ExitCode.OK and not params["exit_zero"]:
            code = ExitCode.FINDINGS
    console.say(summary(report))
    click.get_current_context().exit(int(code))


def _say(console: Console, report: Report, params: Mapping[str, Any]) -> None:
    """Write the report where it is wanted, and end as it says."""
    from animtool.validation.formats import written
    from animtool.validation.formats.plain import summary

    console.faults(report.broken)
    text = written(report, params["report_format"], whole=console.verbosity > 0)
    if params["output_file"] is None:
        console.document(text)
    else:
        from animtool.output import write_parts

        # Names of files may hold bytes that are no text.
        write_parts(params["output_file"], [text.encode("utf-8", "replace")])
    if params["output_file"] is not None or params["report_format"] != "text":
        console.say(summary(report))
    code = report.exit_code(strict=params["strict"], exit_zero=params["exit_zero"])
    click.get_current_context().exit(int(code))

"""``animtool batch``: bakes many files, and resumes where it was stopped."""

from __future__ import annotations

import re
import shlex
from collections.abc import Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from animtool.cli.batch_options import (
    cut_arguments,
    cut_options,
    variant_arguments,
    variant_options,
    with_cuts,
    with_variants,
)
from animtool.cli.console import Console
from animtool.cli.help import command
from animtool.cli.options import (
    FILE,
    Count,
    ParsedType,
    bake_option,
    common_options,
    count_or_auto,
    variables_option,
)
from animtool.core.errors import Fault, Severity, listed
from animtool.core.names import has_kind_suffix
from animtool.core.process.signals import TerminatedError
from animtool.core.process.supervisor import stdin_lines
from animtool.core.record import dataclass

if TYPE_CHECKING:
    from animtool.batch.report import BatchReport, ItemReport
    from animtool.batch.spec import BatchSpec


@dataclass(frozen=True, slots=True)
class _ItemRange:
    """Item numbers as on the command line, such as ``3``, ``3-7`` or ``3+5``."""

    first: int
    last: int
    is_open: bool = False

    def clamp(self, item_count: int) -> tuple[int, int]:
        """Return the first and last item number, clamped to the number of items."""
        open_end = self.is_open and self.first <= item_count
        return self.first, min(self.last, item_count) if open_end else self.last


def _parse_item_range(text: str) -> _ItemRange:
    match = re.fullmatch(r"(\d{1,9})(?:([-+])(\d{1,9}))?", text)
    if match is None:
        message = f"{text!r} is neither a number nor a range such as 1-20 or 1+20"
        raise ValueError(message)
    first, last = int(match[1]), int(match[3] or match[1])
    if match[2] == "+":
        return _ItemRange(first, first + last - 1, is_open=True)
    return _ItemRange(first, last)


def _parse_record_name(text: str) -> str:
    if re.fullmatch(r"[\w-][\w.-]*", text) is None:
        message = f"{text!r} is not a valid name: use letters, digits, '_', '-' and '.'"
        raise ValueError(message)
    return text


def _parse_size(text: str) -> int:
    from animtool.batch.spec import parse_bytes

    return parse_bytes(text)


def _parse_duration(text: str) -> float:
    from animtool.batch.spec import parse_seconds

    return parse_seconds(text)


@command(
    epilog="""\b
Examples:
  animtool batch nightly.batch.yaml
  animtool batch "takes/**/*.bvh" -o "out/{parent}/{stem}.usdc" -j 8
  animtool batch takes --scene clean.scene.yaml --set shot=sh010 -o "out/{stem}.usdc"
  animtool batch --scene flag.scene.yaml --vary k=50,100,200 -o "out/flag_{k}.usdc"
  animtool batch edit.otio -o "out/{shot}.usdc" --handles 8
  animtool batch edit.otio --scene shot.scene.yaml -o "out/{shot}.usdc"
  animtool batch nightly.batch.yaml -n
  animtool batch nightly.batch.yaml --retry-failed --time-limit 600
  animtool batch nightly.batch.yaml --items 1-20
  find takes -newer stamp -name "*.bvh" | animtool batch - -o "out/{stem}.usdc\""""
)
@click.argument("inputs", metavar="JOB|INPUT...", nargs=-1)
@click.option(
    "-o",
    "--output",
    metavar="PATTERN",
    help="File to write for each input, with {stem}, {name}, {parent}, {folder}, or "
    "a variable; FOLDER/ is short for FOLDER/{parent}/{stem}.usdc.  [default: "
    "as the scene states, else next to the input, as .usdc]",
)
@click.option(
    "--scene",
    type=FILE,
    metavar="FILE",
    help="A scene to run for each input, which it names as ${input}.",
)
@variables_option
@cut_options
@variant_options
@click.option(
    "--exclude", multiple=True, metavar="INPUT", help="Inputs to exclude; repeatable."
)
@click.option(
    "-j",
    "--jobs",
    type=ParsedType("processes", count_or_auto),
    metavar="N|auto",
    help="Number of processes.  [default: auto, one per processor]",
)
@click.option(
    "--executor",
    metavar="NAME[=ARGUMENT]",
    default="processes",
    show_default=True,
    help="How items are run; animtool plugins lists the executors.",
)
@click.option(
    "--items",
    "numbers",
    type=ParsedType("range", _parse_item_range),
    metavar="A-B|A+N",
    help="Run only some items, numbered from 1 in the order of their names: A to B, "
    "or N of them from A. Other runs may build the others at the same time.",
)
@click.option(
    "--name",
    type=ParsedType("name", _parse_record_name),
    metavar="NAME",
    help="Name of the records; runs with other names may run at the same time.  "
    "[default: the batch file's name, else batch]",
)
@click.option(
    "-n",
    "--dry-run",
    is_flag=True,
    help="Build nothing; list what would be built, and why.",
)
@click.option(
    "--force", is_flag=True, help="Rebuild everything, even what is up to date."
)
@click.option(
    "--verify",
    is_flag=True,
    help="Hash every file again, even if its size and time are unchanged.",
)
@click.option("--retry-failed", is_flag=True, help="Build only what failed last time.")
@click.option("--fail-fast", is_flag=True, help="Start nothing more after a failure.")
@click.option(
    "--max-failures",
    type=Count(1),
    metavar="N",
    help="Start nothing more after this many failures.",
)
@click.option(
    "--time-limit",
    type=ParsedType("seconds", _parse_duration),
    metavar="SECONDS",
    help="Time limit of each item.",
)
@click.option(
    "--memory-limit",
    type=ParsedType("size", _parse_size),
    metavar="SIZE",
    help="Memory limit of the process that builds an item, such as 2GB.",
)
@bake_option("strict", help_text="Treat warnings as errors.")
@bake_option("overwrite", help_text="Replace files that no run of the batch made.")
@click.option(
    "--format",
    "report_format",
    type=click.Choice(["text", "json", "jsonl"]),
    default="text",
    show_default=True,
    help="Report as text, as JSON on stdout at the end, or as a line of JSON for each "
    "item when it ends.",
)
@click.option(
    "--lines",
    type=click.Choice(["text", "openjd"]),
    default="text",
    show_default=True,
    help="What to print for each item when it ends: openjd also writes to stdout the "
    "progress, status and failures that a session of Open Job Description reads.",
)
@click.option(
    "--path-mapping",
    type=FILE,
    metavar="RULES",
    help="Where folders of other machines are on this one, as Open Job Description "
    "JSON: for the inputs and outputs of a batch file.",
)
@click.option(
    "--junit", type=FILE, metavar="FILE", help="Also write a report as JUnit XML."
)
@common_options
@click.pass_obj
def batch(console: Console, /, inputs: tuple[str, ...], **params: Any) -> None:
    """Bake many files on every core, skipping what is up to date.

    JOB is a batch file; INPUT is a file, a folder, a glob ("**" matches any folders),
    or - for a list on stdin, one path per line. Results and their inputs are recorded
    in .animtool in the output folder. Run the same command again to resume; items
    whose inputs changed are rebuilt.

    With --variants or --vary, each row of a table is an item: ${k} in the scene and
    {k} in -o are replaced by its values. Without INPUT, the scene itself is varied.

    If an INPUT is a timeline, each of its clips is an item, with the part of its media
    that the edit shows, in frames of the shot. Its scene can use ${shot}, ${first} and
    ${last} of the cut, ${begin} and ${end} with the handles, ${head}, ${tail},
    ${handles}, ${fps} and others, all in frames of the shot.

    Exit code 1: items failed; 5: no input.
    """
    from animtool.batch.discover import find_batch
    from animtool.batch.run import RunOptions, run_batch
    from animtool.cli.batch_progress import openjd_failure, openjd_lines, show_progress

    if params["fail_fast"] and params["max_failures"] not in {None, 1}:
        raise click.UsageError("--fail-fast is --max-failures 1: use one of them.")
    has_variants = params["table"] is not None or params["columns"]
    if not inputs and params["cuts"] is None and not (has_variants and params["scene"]):
        raise click.UsageError("Pass a batch file, inputs, or --cut.")
    prints_openjd = params["lines"] == "openjd"
    if prints_openjd and params["report_format"] != "text":
        raise click.UsageError("--lines openjd and --format both write to stdout.")
    with openjd_failure(console.namer, is_requested=prints_openjd):
        lines = stdin_lines() if "-" in inputs else []
        resolved_batch = find_batch(_read_spec(inputs, lines, params))
    console.faults([_located_input(n, inputs, lines) for n in resolved_batch.notices])
    item_range = params["numbers"]
    options = RunOptions(
        params["jobs"],
        params["executor"],
        None if item_range is None else item_range.clamp(len(resolved_batch.items)),
        params["dry_run"],
        params["force"],
        params["verify"],
        params["retry_failed"],
        1 if params["fail_fast"] else params["max_failures"],
        params["overwrite"],
    )
    is_jsonl = params["report_format"] == "jsonl"
    try:
        with (
            openjd_failure(console.namer, is_requested=prints_openjd),
            show_progress(console, prints_json=is_jsonl) as listener,
        ):
            outer_listener = listener
            if prints_openjd:
                outer_listener = openjd_lines(listener, console.namer)
            report = run_batch(resolved_batch, options, outer_listener)
    except (KeyboardInterrupt, TerminatedError):
        console.say("finished items are recorded; run the same command again to resume")
        raise
    notices = [n for n in report.notices if n not in listener.shown_warnings]
    _print_results(console, report, params, _RepeatCommand(inputs, params), notices)
    if params["junit"] is not None:
        from animtool.batch.report import junit_report
        from animtool.core.files.output import check_outputs, write_parts

        check_outputs([params["junit"]], [], overwrite=True)
        reports = [r.with_argument_names(console.namer) for r in report.items]
        write_parts(params["junit"], [junit_report(reports).encode()])
    click.get_current_context().exit(int(report.exit_code))


def _located_input(
    fault: Fault, inputs: tuple[str, ...], lines: Sequence[str]
) -> Fault:
    """Return a fault of an input, located at its line if it was read from stdin.

    Faults of arguments get no location, since the message has the text of the argument.
    """
    match = re.fullmatch(r"inputs\[(\d+)\]|exclude\[\d+\]", fault.where or "")
    if match is None or fault.path is not None:
        return fault
    if match[1] is None or inputs != ("-",):
        return replace(fault, where=None)
    numbers = [number for number, line in enumerate(lines, 1) if line]
    return replace(fault, where=f"line {numbers[int(match[1])]} of stdin")


def _refuse_output(inputs: tuple[str, ...], output: str | None) -> None:
    """Refuse a last input that was likely meant as the output."""
    if len(inputs) < 2 or output is not None:
        return
    from animtool.batch.inputs import INPUT_SUFFIXES, SCENE_SUFFIXES
    from animtool.core.files.reading import is_pattern, matching_files

    last_input, path = inputs[-1], Path(inputs[-1])
    readable_suffixes = (*INPUT_SUFFIXES, *SCENE_SUFFIXES)
    if path.is_dir():
        is_input = any(matching_files(last_input, readable_suffixes))
        problem = "has no file to bake"
    else:
        is_input = path.exists() or is_pattern(last_input)
        is_input = is_input or last_input.lower().endswith(readable_suffixes)
        problem = "does not exist"
    if not is_input or "{" in last_input:
        output_text = last_input if path.suffix else f"{last_input.rstrip('/')}/"
        hint = f"to write there, use -o {shlex.quote(output_text)}"
        raise click.UsageError(f"{last_input} {problem}; {hint}")


def _read_spec(
    inputs: tuple[str, ...], lines: Sequence[str], params: dict[str, Any]
) -> BatchSpec:
    """Return the spec of a batch file, with values overridden by options."""
    from animtool.batch.spec import BatchSpec

    batch_files = [text for text in inputs if has_kind_suffix(Path(text), "batch")]
    if batch_files and len(inputs) > 1:
        raise click.UsageError(f"{batch_files[0]} is a batch file: pass it alone.")
    _refuse_output(inputs, params["output"])
    scene = params["scene"]
    if scene is not None and has_kind_suffix(scene, "batch"):
        text = f"{scene} is a batch file, not a scene; run it: animtool batch {scene}"
        raise click.UsageError(f"{text}.")
    if batch_files:
        from animtool.batch.file import load_batch

        uses_timeline = params["cuts"] is not None
        spec = load_batch(Path(batch_files[0]), uses_timeline=uses_timeline)
    else:
        texts = [[*filter(None, lines)] if t == "-" else [t] for t in inputs]
        spec = BatchSpec(tuple(chain.from_iterable(texts)))
    if params["path_mapping"] is not None:
        from animtool.batch.item import map_batch_paths, read_path_rules

        spec = map_batch_paths(spec, read_path_rules(params["path_mapping"]))
    folder = Path.cwd()
    if params["output"] is not None:
        output = params["output"]
        if batch_files:
            # Paths have lost the trailing slash that marks a folder.
            slash = "/" if output.endswith("/") else ""
            output = f"{folder / output}{slash}"
        spec = replace(spec, output=output, roots=())
    if params["scene"] is not None:
        spec = replace(spec, scene=params["scene"])
    spec = with_variants(with_cuts(spec, params), params)
    excluded_inputs = params["exclude"]
    if batch_files:
        excluded_inputs = tuple(str(folder / text) for text in excluded_inputs)
    limits = spec.limits
    if params["time_limit"] is not None:
        limits = replace(limits, seconds=params["time_limit"])
    if params["memory_limit"] is not None:
        limits = replace(limits, memory=params["memory_limit"])
    variables = dict(params["variables"])
    overrides = tuple(override.without_names(variables) for override in spec.overrides)
    if params["strict"]:
        spec = replace(spec, options=replace(spec.options, strict=True))
    return replace(
        spec,
        name=params["name"] or spec.name,
        exclude=(*spec.exclude, *excluded_inputs),
        variables={**spec.variables, **variables},
        overrides=overrides,
        limits=limits,
    )


class _RepeatCommand:
    """Builds the command line that builds one item again."""

    def __init__(self, inputs: tuple[str, ...], params: dict[str, Any]) -> None:
        self._inputs, self._params = inputs, params

    def with_command(self, report: ItemReport) -> ItemReport:
        """Return the report of an item; if it failed, with the command to repeat it."""
        return (
            replace(report, repeat_command=self.command(report))
            if report.failed
            else report
        )

    def command(self, report: ItemReport) -> str:
        """Return the command; empty if its input does not exist."""
        if not report.item.file.path.exists():
            return ""
        params, item = self._params, report.item
        inputs, output = list(self._inputs), params["output"]
        # Stdin cannot be read again.
        reads_stdin = "-" in inputs
        if reads_stdin:
            inputs = [str(item.file.path)]
            output = str(item.output).replace("{", "{{").replace("}", "}}")
        words = ["animtool", "batch", *inputs]
        words += [] if output is None else ["-o", output]
        words += [] if params["name"] is None else ["--name", params["name"]]
        words += ["--strict"] if params["strict"] else []
        words += [] if params["scene"] is None else ["--scene", str(params["scene"])]
        if params["cuts"] is not None:
            words += ["--cut", str(params["cuts"])]
        words += cut_arguments(params)
        for name, value in params["variables"]:
            words += ["--set", f"{name}={value}"]
        words += variant_arguments(params)
        if not reads_stdin:
            for text in params["exclude"]:
                words += ["--exclude", text]
            words += ["--items", str(item.number)]
        return shlex.join(words)


def _print_results(
    console: Console,
    report: BatchReport,
    params: dict[str, Any],
    repeat_command: _RepeatCommand,
    notices: Sequence[Fault],
) -> None:
    from animtool.cli.batch_progress import (
        DRY_RUN_TEMPLATE,
        PLANNED_TEMPLATE,
        SUMMARY_TEMPLATE,
    )

    report_format = params["report_format"]
    if report_format == "json":
        items = tuple(map(repeat_command.with_command, report.items))
        console.result_json(replace(report, items=items))
    elif report_format == "jsonl":
        if params["dry_run"]:
            for item_report in report.items:
                console.result_json(item_report, is_one_line=True)
        console.result_json(report.summary, is_one_line=True)
    elif params["dry_run"]:
        console.result(*PLANNED_TEMPLATE.text(report))
    console.faults(notices)
    _print_notices(console, report)
    template = DRY_RUN_TEMPLATE if params["dry_run"] else SUMMARY_TEMPLATE
    console.lines(template.text(report))
    for item_report in report.failed:
        console.error(f"{item_report.item.label} failed")
        console.faults(item_report.faults, is_fatal=True)
        if command := repeat_command.command(item_report):
            console.say(f"  again: {command}")


def _print_notices(console: Console, report: BatchReport) -> None:
    """Print each distinct warning once, with the items that have it."""
    for notice, item_reports in report.notices_of_items().items():
        paths = {r.item.file.path.absolute() for r in item_reports}
        # A notice located in the only input needs no item line.
        is_located = notice.path is not None and paths == {Path(notice.path).absolute()}
        labels = listed([r.item.label for r in item_reports])
        item_lines = [] if is_located else [f"  of {labels}"]
        if notice.severity is Severity.NOTE:
            text = str(notice.with_argument_names(console.namer))
            console.details([text, *item_lines])
            continue
        console.faults([notice])
        console.lines(item_lines)

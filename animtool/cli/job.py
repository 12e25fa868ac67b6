"""``animtool job``: a batch as a bundle for a render farm."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

import click

from animtool.cli.batch_options import cut_arguments, cut_options, with_cuts
from animtool.cli.console import Console
from animtool.cli.help import command
from animtool.cli.options import (
    FILE,
    ParsedType,
    bake_option,
    common_options,
    count_or_auto,
    format_option,
    parse_positive,
)
from animtool.core.names import has_kind_suffix
from animtool.report.text import Template

BUNDLE_TEMPLATE = Template(
    "animtool.batch.bundle:WrittenBundle",
    (
        "{folder}: {bundle.item_count} items, {bundle.chunk_size} a task, "
        "{bundle.task_count} tasks",
        "  here: {run:command}",
    ),
    {"command": shlex.join},
)


@command(
    epilog="""\b
Examples:
  animtool job nightly.batch.yaml -o nightly.job
  animtool batch nightly.batch.yaml --items 1-20 --force --format json > costs.json
  animtool job nightly.batch.yaml --costs costs.json -o nightly.job
  animtool job shots.batch.yaml --cut edit.otio --handles 8 -o edit.job"""
)
@click.argument("batch_file", metavar="JOB", type=FILE)
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path, file_okay=False),
    metavar="FOLDER",
    required=True,
    help="The bundle: a folder with template.yaml and parameter_values.yaml.",
)
@click.option(
    "--chunk",
    type=ParsedType("items", count_or_auto),
    default="auto",
    show_default=True,
    metavar="N|auto",
    help="Items per task; auto is as many as take --task-seconds by --costs, else 100.",
)
@click.option(
    "--costs",
    type=FILE,
    metavar="REPORT",
    help="Duration of items: a report of animtool batch --format json.",
)
@click.option(
    "--task-seconds",
    type=ParsedType("number", parse_positive),
    default=120.0,
    show_default=True,
    metavar="SECONDS",
    help="Target duration of a task on one processor.",
)
@cut_options
@bake_option("overwrite", help_text="Replace a bundle that is there.")
@format_option
@common_options
@click.pass_obj
def job(console: Console, /, batch_file: Path, **params: Any) -> None:
    """Write a batch as an Open Job Description bundle, for a render farm.

    JOB is a batch file. Its items are found and its outputs checked now; each task of
    the job builds a chunk of them like animtool batch JOB --items, with its exit code.
    """
    from animtool.batch.bundle import (
        CutArguments,
        batch_bundle,
        chunk_size,
        mean_item_seconds,
        write_bundle,
    )
    from animtool.batch.discover import find_batch
    from animtool.batch.file import load_batch
    from animtool.batch.plan import check_output_files

    if not has_kind_suffix(batch_file, "batch"):
        text = f"{batch_file} is not a batch file; pass a *.batch.yaml"
        if has_kind_suffix(batch_file, "scene"):
            text += f" that names it: scene: {batch_file.name}"
        raise click.UsageError(f"{text}.")
    spec = load_batch(batch_file, uses_timeline=params["cuts"] is not None)
    resolved_batch = find_batch(with_cuts(spec, params))
    console.faults(resolved_batch.notices)
    check_output_files(resolved_batch)
    costs = params["costs"]
    seconds = None if costs is None else mean_item_seconds(costs)
    item_count = len(resolved_batch.items)
    items_per_chunk = params["chunk"] or chunk_size(
        item_count, seconds, params["task_seconds"]
    )
    cuts = CutArguments(params["cuts"], tuple(cut_arguments(params)))
    bundle = batch_bundle(
        resolved_batch, batch_file, min(items_per_chunk, item_count), cuts
    )
    written = write_bundle(bundle, params["output"], overwrite=params["overwrite"])
    console.report(params["report_format"], written, BUNDLE_TEMPLATE)

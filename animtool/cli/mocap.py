"""``animtool mocap``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from animtool.cli.console import Console
from animtool.cli.options import (
    INPUT,
    common_options,
    format_option,
    source_option,
    source_options,
    source_options_record,
    strict_option,
)
from animtool.cli.outputs import all_named, existing_options, skipped


@click.group(
    epilog="""\b
Examples:
  animtool mocap clean take.bvh -o clean.usdc"""
)
def mocap() -> None:
    """Mend what was captured."""


@mocap.command(
    epilog="""\b
Examples:
  animtool mocap clean take.bvh -o clean.usdc
  animtool mocap clean take.bvh -o clean.bvh --spikes 2 --no-smooth
  animtool mocap clean take.usdc -o clean.clip.yaml --cutoff 6"""
)
@click.argument("source", type=INPUT)
@click.option(
    "-o",
    "--output",
    type=INPUT,
    required=True,
    help="What to write: a USD file (.usda, .usdc, .usd), .clip.yaml or .bvh.",
)
@click.option(
    "--spikes",
    type=int,
    default=3,
    show_default=True,
    metavar="FRAMES",
    help="Longest spike that is removed; 0 leaves them.",
)
@click.option(
    "--smooth/--no-smooth",
    default=True,
    show_default=True,
    help="Filter each joint at the cut-off that its noise asks for.",
)
@click.option(
    "--cutoff",
    type=float,
    metavar="HZ",
    help="Filter every joint at this frequency instead.",
)
@source_options
@click.option(
    "--prim-path", metavar="PATH", help="The character, where a stage has several."
)
@source_option("take")
@strict_option
@existing_options
@format_option
@common_options
@click.pass_obj
def clean(console: Console, /, source: Path, output: Path, **given: Any) -> None:
    """Remove spikes and noise from the take of SOURCE, a BVH, USD or clip file.

    Filters have no lag. What was removed, and at which frequencies, is said.
    """
    from animtool.mocap.clean import CleanOptions
    from animtool.scene.clean import clean_source
    from animtool.scene.convert import convert_outputs

    if skipped(console, "mocap clean", given, output, lambda: convert_outputs(output)):
        return
    with all_named(), console.progress(f"clean {source.name}") as progress:
        report = clean_source(
            source,
            output,
            CleanOptions(given["spikes"], given["smooth"], given["cutoff"]),
            source_options_record(given, "take", prim_path=given["prim_path"]),
            overwrite=given["overwrite"],
            strict=given["strict"],
            progress=progress,
        )
    console.faults(report.notices)
    from animtool.cli.summary import convert_json, convert_text

    if given["report_format"] == "json":
        console.result_json(convert_json(report))
        return
    for line in convert_text(report):
        console.say(line)

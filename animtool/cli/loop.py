"""``animtool loop``: finds the cycle of a take and repeats it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from animtool.cli.console import Console
from animtool.cli.help import command
from animtool.cli.options import (
    INPUT,
    bake_option,
    output_option,
    read_source_options,
    read_values,
    record_options,
    source_option,
    source_options,
    strict_option,
)
from animtool.cli.outputs import atomic_command, skip_existing_outputs, writing_options
from animtool.edit.loop_options import LoopOptions
from animtool.report.text import Template


@command(
    epilog="""\b
Examples:
  animtool loop walk.bvh
  animtool loop walk.bvh -o cycle.usdc --repeats 8
  animtool loop walk.bvh -o cycle.bvh --first 12 --last 44"""
)
@click.argument("source", type=INPUT)
@output_option(
    "File to write: USD (.usda, .usdc, .usd), .clip.yaml or .bvh.  [default: nothing]"
)
@record_options(LoopOptions)
@source_options
@source_option("prim_path", "take", "positions")
@bake_option("placement")
@strict_option
@writing_options
def loop(console: Console, /, source: Path, output: Path | None, **params: Any) -> None:
    """Find the cycle in the take of SOURCE, and repeat it without a seam.

    The best cycle is searched for, or set by --first and --last. With -o it is
    written, repeated --repeats times.
    """
    from animtool.core.writers import take_writer
    from animtool.scene.solves.cycle import loop_source

    if output is not None and skip_existing_outputs(
        console, "loop", params, output, lambda: take_writer(output).files(output)
    ):
        return
    values = read_values(LoopOptions, params)
    for name in ("first", "last"):
        values[name] = None if values[name] is None else float(values[name])
    finds_cycle = values["first"] is None or values["last"] is None
    with atomic_command(), console.progress(f"loop {source.name}") as progress:
        result = loop_source(
            source,
            output,
            LoopOptions(find=finds_cycle, **values),
            read_source_options(
                params,
                *("prim_path", "take", "positions"),
                placement=params["placement"],
            ),
            overwrite=params["overwrite"],
            strict=params["strict"],
            progress=progress,
        )
    console.report(params["report_format"], result, _TEMPLATE, result.notices)
    if result.written is not None and params["report_format"] != "json":
        from animtool.cli.summary import CONVERT_TEMPLATE

        console.lines(CONVERT_TEMPLATE.text(result.written))


_TEMPLATE = Template(
    "animtool.scene.solves.cycle:LoopResult",
    (
        "{source}: a cycle of {seconds:plain 4} s, frames {cycle.first:g} to "
        "{cycle.last:g}; difference of its ends {cycle.apart:length}, "
        "{cycle.share:percent} of the motion",
    ),
)

"""``animtool loop``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from animtool.cli.console import Console
from animtool.cli.options import (
    INPUT,
    bake_option,
    read_values,
    record_option,
    source_option,
    source_options,
    source_options_record,
    strict_option,
)
from animtool.cli.outputs import all_named, skipped, writing_options
from animtool.core.errors import percent
from animtool.core.quantities import length_text, plain
from animtool.edit.loop_options import LoopOptions


@click.command(
    epilog="""\b
Examples:
  animtool loop walk.bvh
  animtool loop walk.bvh -o cycle.usdc --repeats 8
  animtool loop walk.bvh -o cycle.bvh --first 12 --last 44"""
)
@click.argument("source", type=INPUT)
@click.option(
    "-o",
    "--output",
    type=INPUT,
    help="What to write: a USD file (.usda, .usdc, .usd), .clip.yaml or .bvh.  "
    "[default: nothing]",
)
@record_option(LoopOptions)
@source_options
@source_option("prim_path", "take", "positions")
@bake_option("placement")
@strict_option
@writing_options
def loop(console: Console, /, source: Path, output: Path | None, **params: Any) -> None:
    """Find the cycle of the take of SOURCE, and repeat it without a seam.

    The best cycle between --first and --last is taken; where both are given, they are
    the cycle. With -o it is written, repeated as often as is said.
    """
    from animtool.core.writers import take_writer
    from animtool.scene.solves.cycle import loop_source

    if output is not None and skipped(
        console, "loop", params, output, lambda: take_writer(output).files(output)
    ):
        return
    values = read_values(LoopOptions, params)
    for end in ("first", "last"):
        values[end] = None if values[end] is None else float(values[end])
    find = values["first"] is None or values["last"] is None
    with all_named(), console.progress(f"loop {source.name}") as progress:
        result, report = loop_source(
            source,
            output,
            LoopOptions(find=find, **values),
            source_options_record(
                params,
                *("prim_path", "take", "positions"),
                placement=params["placement"],
            ),
            overwrite=params["overwrite"],
            strict=params["strict"],
            progress=progress,
        )
    notices = result.notices if report is None else report.notices
    console.faults(notices)
    if params["report_format"] == "json":
        console.result_json(
            {
                "loop": "animtool/1",
                "source": str(source),
                "output": None if output is None else str(output),
                "first": result.cycle.first,
                "last": result.cycle.last,
                "seconds": result.seconds,
                "apart": result.cycle.apart,
                "share": result.cycle.share,
                "notices": [notice.as_dict() for notice in notices],
            }
        )
        return
    best = result.cycle
    console.say(
        f"{source}: a cycle of {plain(result.seconds, 4)} s, frames {best.first:g} to "
        f"{best.last:g}; its ends differ by {length_text(best.apart)}, "
        f"{percent(best.share)} of what moves"
    )
    if report is not None:
        from animtool.cli.convert_summary import convert_text

        for line in convert_text(report):
            console.say(line)

"""``animtool report``."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import click

from animtool.cli.bake_options import opened_sources
from animtool.cli.console import Console
from animtool.cli.options import (
    INPUT,
    LENGTH,
    OUTPUT,
    common_options,
    format_option,
    overwrites,
    read_values,
    record_option,
    set_option,
    source_option,
    source_options,
    source_options_record,
)
from animtool.cli.outputs import say_tradeoffs
from animtool.core.errors import counted
from animtool.scene.bake.options import BakeOptions

_OF_SOURCE = ("rig", "prim_path", "take", "positions", "template", "cameras")


@click.command(
    epilog="""\b
Examples:
  animtool report shot.scene.yaml
  animtool report shot.scene.yaml --budget 0.5mm
  animtool report walk.bvh -o walk.html
  animtool report wave.clip.yaml --rig hero.rig.yaml --format json"""
)
@click.argument("source", type=INPUT)
@click.option(
    "--budget",
    type=LENGTH,
    metavar="LENGTH",
    help="The error that will do, such as 0.5mm: the cheapest setting within is named, "
    "with what to write for it.  [default: as exact as the present setting]",
)
@click.option(
    "-o",
    "--output",
    type=OUTPUT,
    metavar="FILE",
    help="Write a page too (.html): plots, tables, and two settings that play beside "
    "each other.",
)
@record_option(BakeOptions, "fps", "reduce", "frame_range")
@set_option
@source_options
@source_option(*_OF_SOURCE)
@overwrites("a page that exists")
@format_option
@common_options
@click.pass_obj
def report(
    console: Console, /, source: Path, output: Path | None, **params: Any
) -> None:
    """Measure time against error of what SOURCE can trade.

    Of a scene, the integrators, steps and tolerances of what it simulates and solves;
    of what has joints, sample rates, samples left out and keys too. Each setting is
    compared with the finest, which is compared with one twice as fine: that tells what
    it is worth. No result is written.
    """
    from animtool.core.files.output import check_outputs
    from animtool.preview.tradeoff_page import write_tradeoff_page
    from animtool.scene.tables.tradeoffs import measure_tradeoffs

    (opened,) = opened_sources([source], dict(params["variables"]))
    if output is not None:
        if output.suffix.lower() != ".html":
            raise click.UsageError(f"The page is HTML: name it {output.stem}.html.")
        inputs = [opened] if isinstance(opened, Path) else opened.inputs
        check_outputs([output], list(inputs), overwrite=params["overwrite"])
    own = source_options_record(params, *_OF_SOURCE)
    options = BakeOptions(source=own, **read_values(BakeOptions, _written(params)))
    budget = params["budget"]
    with tempfile.TemporaryDirectory() as name:
        folder = None if output is None else Path(name)
        with console.progress(f"measure {source.name}") as progress:
            found = measure_tradeoffs(
                opened, options, budget=budget, folder=folder, progress=progress
            )
        say_tradeoffs(console, found, params["report_format"])
        if output is not None:
            size = write_tradeoff_page(
                found,
                output,
                overwrite=params["overwrite"],
                calling=console.calling,
            )
            tables = counted(len(found.tables), "table")
            console.say(f"{output}: {tables}, {size / 1e3:.0f} kB")


def _written(params: dict[str, Any]) -> dict[str, Any]:
    """Return what is asked of the output."""
    return {name: params[name] for name in ("fps", "reduce", "frame_range")}

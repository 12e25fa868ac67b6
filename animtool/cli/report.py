"""``animtool report``: time against error for the settings of a file."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from animtool.cli.bake_options import load_sources
from animtool.cli.console import Console
from animtool.cli.help import command
from animtool.cli.options import (
    INPUT,
    LENGTH,
    OUTPUT,
    bake_option,
    common_options,
    format_option,
    output_option,
    read_source_options,
    read_values,
    record_options,
    source_option,
    source_options,
    variables_option,
)
from animtool.cli.outputs import print_tradeoffs
from animtool.core.errors import counted
from animtool.scene.bake.options import BakeOptions

if TYPE_CHECKING:
    from animtool.scene.scene import Scene
    from animtool.scene.tables.tradeoffs import Tradeoffs

_OUTPUT_OPTIONS = ("fps", "reduce", "frame_range")
_SOURCE_OPTIONS = ("rig", "prim_path", "take", "positions", "template", "cameras")


@command(
    epilog="""\b
Examples:
  animtool report shot.scene.yaml
  animtool report shot.scene.yaml --budget 0.5mm
  animtool report walk.bvh -o walk.html
  animtool report wave.clip.yaml --rig hero.rig.yaml --format json
  animtool report --suite"""
)
@click.argument("source", type=INPUT, required=False)
@click.option(
    "--suite",
    is_flag=True,
    help="Measure animtool's own examples on this machine instead of SOURCE.",
)
@click.option(
    "--budget",
    type=LENGTH,
    metavar="LENGTH",
    help="Error budget, such as 0.5mm: the cheapest setting within it is "
    "recommended.  [default: the error of the current setting]",
)
@output_option(
    "Also write a page (.html): plots, tables, and two settings side by side.",
    kind=OUTPUT,
    metavar="FILE",
)
@record_options(BakeOptions, *_OUTPUT_OPTIONS)
@variables_option
@source_options
@source_option(*_SOURCE_OPTIONS)
@bake_option("overwrite", help_text="Replace a page that exists.")
@format_option
@common_options
@click.pass_obj
def report(
    console: Console, /, source: Path | None, output: Path | None, **params: Any
) -> None:
    """Measure time against error for the settings of SOURCE.

    For a scene: integrators, steps and tolerances of its simulations and IK passes.
    For joints: sample rates, samples left out, and keys. Each setting is compared with
    a reference at the finest one; the error of the reference is estimated from its last
    two refinements. Nothing is baked.
    """
    if (source is None) is not params["suite"]:
        raise click.UsageError("Pass a SOURCE, or --suite.")
    if output is not None and output.suffix.lower() != ".html":
        raise click.UsageError(f"The page is HTML: name it {output.stem}.html.")
    with tempfile.TemporaryDirectory() as folder:
        tradeoffs = _measure_tradeoffs(console, source, output, params, Path(folder))
        print_tradeoffs(console, tradeoffs, params["report_format"])
        if output is None:
            return
        from animtool.preview.tradeoff_page import write_tradeoff_page

        size = write_tradeoff_page(
            tradeoffs, output, overwrite=params["overwrite"], namer=console.namer
        )
        tables = counted(len(tradeoffs.tables), "table")
        console.say(f"{output}: {tables}, {size / 1e3:.0f} kB")


def _measure_tradeoffs(
    console: Console,
    source: Path | None,
    output: Path | None,
    params: dict[str, Any],
    folder: Path,
) -> Tradeoffs:
    """Measure tradeoffs; for a page, also write stages to a folder."""
    from animtool.core.files.output import check_outputs
    from animtool.scene.tables.tradeoffs import measure_tradeoffs, suite_tradeoffs

    budget, inputs = params["budget"], []
    loaded_source: Path | Scene | None = None
    if source is not None:
        (loaded_source,) = load_sources([source], dict(params["variables"]))
        inputs = [source]
        if not isinstance(loaded_source, Path):
            inputs = list(loaded_source.inputs)
    if output is not None:
        check_outputs([output], inputs, overwrite=params["overwrite"])
    name = "the suite" if source is None else source.name
    with console.progress(f"measure {name}") as progress:
        if loaded_source is None:
            return suite_tradeoffs(budget=budget, progress=progress)
        source_options = read_source_options(params, *_SOURCE_OPTIONS)
        values = {name: params[name] for name in _OUTPUT_OPTIONS}
        options = BakeOptions(source=source_options, **read_values(BakeOptions, values))
        return measure_tradeoffs(
            loaded_source,
            options,
            budget=budget,
            folder=None if output is None else folder,
            progress=progress,
        )

"""``animtool mocap clean``: removes spikes and noise from a take."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from animtool.capture.options import CleanOptions
from animtool.cli.console import Console
from animtool.cli.help import command
from animtool.cli.options import (
    INPUT,
    output_option,
    read_source_options,
    read_values,
    record_options,
    source_option,
    source_options,
    strict_option,
)
from animtool.cli.outputs import atomic_command, skip_existing_outputs, writing_options


@command(
    epilog="""\b
Examples:
  animtool mocap clean take.bvh -o clean.usdc
  animtool mocap clean take.bvh -o clean.bvh --spikes 2 --noise keep
  animtool mocap clean take.bvh -o clean.usdc --drift remove --feet hold
  animtool mocap clean take.usdc -o clean.clip.yaml --cutoff 6"""
)
@click.argument("source", type=INPUT)
@output_option(
    "File to write: USD (.usda, .usdc, .usd), .clip.yaml or .bvh.", required=True
)
@record_options(CleanOptions)
@click.option(
    "--feet",
    type=click.Choice(["free", "hold"]),
    default="free",
    help="Let planted feet slide, as captured, or hold them.  [default: free]",
)
@click.option(
    "--drift",
    type=click.Choice(["keep", "remove"]),
    default="keep",
    help="Keep the drift of the root over the ground and in height, or remove it so "
    "that planted feet stay in place.  [default: keep]",
)
@source_options
@source_option("prim_path", "take", "positions")
@strict_option
@writing_options
def clean(console: Console, /, source: Path, output: Path, **params: Any) -> None:
    """Remove spikes and noise from the take of SOURCE, a BVH, USD or clip file.

    Filters have no lag. The report lists what was removed, and the frequencies.
    """
    from animtool.core.errors import Fault, OptionError
    from animtool.core.writers import take_writer
    from animtool.formats.marker_files import is_marker_file
    from animtool.motion.passes import find_pass
    from animtool.scene.convert.takes import convert_with_passes

    if skip_existing_outputs(
        console,
        "mocap clean",
        params,
        output,
        lambda: take_writer(output).files(output),
    ):
        return
    if source.exists() and is_marker_file(source):
        message = "holds markers, not joints"
        hint = f"to repair markers: animtool mocap fill {source}; to solve them onto a "
        hint += f"rig first: animtool mocap solve {source}"
        raise OptionError(Fault("SOL007", message, str(source), (), hint))
    options = CleanOptions(**read_values(CleanOptions, params))
    passes: list[tuple[Any, Any]] = [(find_pass("clean"), options)]
    if params["drift"] == "remove":
        passes.append((find_pass("root_drift"), find_pass("root_drift").options()))
    if params["feet"] == "hold":
        passes.append((find_pass("feet"), find_pass("feet").options()))
    with atomic_command(), console.progress(f"clean {source.name}") as progress:
        report = convert_with_passes(
            source,
            output,
            passes,
            read_source_options(params, "take", "prim_path", "positions"),
            overwrite=params["overwrite"],
            strict=params["strict"],
            progress=progress,
        )
    console.faults(report.notices)
    from animtool.cli.summary import CONVERT_TEMPLATE

    report = replace(report, command="mocap clean")
    console.report(params["report_format"], report, CONVERT_TEMPLATE)

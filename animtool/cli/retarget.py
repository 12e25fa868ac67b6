"""``animtool retarget``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from animtool.cli.console import Console
from animtool.cli.options import (
    INPUT,
    OUTPUT,
    bake_option,
    read_values,
    record_option,
    source_option,
    source_options,
    source_options_record,
)
from animtool.cli.outputs import (
    goes_to_stdout,
    skipped,
    take_output_option,
    writing_options,
    written_options,
    written_options_record,
)
from animtool.cli.retarget_summary import MAX_NAMED, retarget_json, retarget_text
from animtool.core.options import options_of
from animtool.retarget.options import RetargetOptions

# Options of retargeting that those of writing do not have.
OWN_OPTIONS = tuple(name for name in options_of(RetargetOptions) if name != "force_fit")


@click.command(
    epilog="""\b
Examples:
  animtool retarget walk.bvh --to hero.rig.yaml -o walk.usdc
  animtool retarget walk.bvh --to hero.rig.yaml
  animtool retarget walk.bvh --to hero.usda --rig-layer hero.usda -o walk_layer.usdc
  animtool retarget walk.bvh --to hero.rig.yaml --write-map walk.map.yaml
  animtool retarget walk.bvh --to hero.rig.yaml --map walk.map.yaml -o walk.bvh
  animtool retarget take.bvh --to hero.rig.yaml --rest frame:1 -o take.usdc
  animtool retarget take.bvh --to hero.rig.yaml -o cut.usdc --fps 24 --range 1-48"""
)
@click.argument("source", type=INPUT)
@click.option(
    "--to",
    "rig",
    type=INPUT,
    required=True,
    metavar="RIG",
    help="The rig that the take goes onto: a rig file, USD file or BVH.",
)
@take_output_option
@record_option(RetargetOptions, *OWN_OPTIONS)
@click.option(
    "--write-map",
    type=OUTPUT,
    metavar="FILE",
    help="Write the map of joints that was used (.map.yaml), to be edited.",
)
@written_options
@source_options
@source_option("prim_path", "take", "positions")
@bake_option("fps", "frame_range", "start", "placement")
@writing_options
def retarget(
    console: Console, /, source: Path, output: Path | None, **params: Any
) -> None:
    """Bring the take of SOURCE, a BVH, USD or clip file, onto another rig.

    Joints are paired by their names, by where they are in the body, or by a map file.
    Rest poses are aligned, legs scale the way, limits are kept, and feet stay where
    they stand. Without -o the report is all.
    """
    to_stdout = goes_to_stdout(output, params)
    from animtool.scene.retarget import RetargetJob, retarget_outputs, run_retarget

    job = RetargetJob(
        source,
        params["rig"],
        source_options_record(params, "prim_path", "take", "positions"),
        RetargetOptions(**read_values(RetargetOptions, params)),
        None if to_stdout else output,
        to_stdout,
        params["write_map"],
        written_options_record(
            params,
            *("fps", "frame_range", "start", "placement"),
            strict=params["strict"],
        ),
    )
    if job.output is not None and skipped(
        console, "retarget", params, job.output, lambda: retarget_outputs(job)
    ):
        return
    with console.progress(f"retarget {source.name}", stdout=to_stdout) as progress:
        report = run_retarget(job, progress=progress)
    console.faults(report.notices)
    most = MAX_NAMED if console.verbosity <= 0 else None
    console.summary(
        params["report_format"],
        lambda: retarget_json(report),
        lambda: retarget_text(report, most),
        report.seconds,
    )

"""``animtool convert``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from animtool.cli.console import Console
from animtool.cli.options import (
    common_options,
    format_option,
    source_options,
    source_options_record,
)

__all__ = ["convert"]


@click.command(
    epilog="""\b
Examples:
  animtool convert walk.usdc walk.bvh
  animtool convert shot.usda hero.bvh --prim-path /World/hero"""
)
@click.argument("source", type=click.Path(path_type=Path, readable=False))
@click.argument("output", type=click.Path(path_type=Path, readable=False))
@source_options
@click.option(
    "--prim-path", metavar="PATH", help="The character, where a stage has several."
)
@click.option(
    "--strict", is_flag=True, help="Take warnings for errors and write nothing."
)
@click.option("--overwrite", is_flag=True, help="Replace an output that exists.")
@click.option(
    "--skip-existing", is_flag=True, help="Do nothing where the output exists."
)
@format_option
@common_options
@click.pass_obj
def convert(console: Console, /, source: Path, output: Path, **given: Any) -> None:
    """Convert SOURCE to OUTPUT: BVH to USD, USD to BVH.

    Joints that came from a BVH get their channel order and names back.
    """
    if given["skip_existing"] and output.exists():
        console.say(f"{output} exists: skipped")
        if given["report_format"] == "json":
            console.result_json({"convert": "animtool/1", "skipped": str(output)})
        return
    from animtool.scene.convert import convert as run_convert

    options = source_options_record(
        given["units"], given["up"], given["source_fps"], given["prim_path"]
    )
    with console.progress(f"convert {source.name}") as progress:
        report = run_convert(
            source,
            output,
            options,
            overwrite=given["overwrite"],
            strict=given["strict"],
            progress=progress,
        )
    console.faults(report.notices)
    if given["report_format"] == "json":
        console.result_json(
            {
                "convert": "animtool/1",
                "output": str(report.output),
                "frames": report.frames,
                "joints": report.joints,
                "notices": [notice.as_dict() for notice in report.notices],
            }
        )
        return
    console.say(f"{report.output}: {report.frames} frames, {report.joints} joints")

"""``animtool diff``."""

from __future__ import annotations

from dataclasses import asdict
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

__all__ = ["diff"]

_KINDS = (("world", "m"), ("translation", "m"), ("rotation", "deg"), ("scale", ""))


@click.command(
    epilog="""\b
Examples:
  animtool diff walk.bvh walk.usdc
  animtool diff old.usdc new.usdc --tol 1e-4 --tol-degrees .01"""
)
@click.argument("first", type=click.Path(path_type=Path, readable=False))
@click.argument("second", type=click.Path(path_type=Path, readable=False))
@click.option(
    "--tol",
    type=click.FloatRange(0),
    default=1e-5,
    show_default=True,
    metavar="METRES",
    help="Distance that is no difference.",
)
@click.option(
    "--tol-degrees",
    type=click.FloatRange(0),
    default=1e-3,
    show_default=True,
    metavar="DEGREES",
    help="Rotation that is no difference.",
)
@source_options
@format_option
@common_options
@click.pass_obj
def diff(console: Console, /, first: Path, second: Path, **given: Any) -> None:
    """Compare the takes of FIRST and SECOND, joints by name, in metres.

    Exit code 1 where they differ by more than the tolerances, or one has joints,
    frames or a rate that the other has not.
    """
    from animtool.errors import ExitCode
    from animtool.report.compare import compare

    options = source_options_record(given["units"], given["up"], given["source_fps"])
    found = compare(first, second, options)
    same = found.within(given["tol"], given["tol_degrees"])
    if given["report_format"] == "json":
        console.result_json({"diff": "animtool/1", "same": same, **asdict(found)})
    else:
        lines = [f"{found.joints} joints, {found.frames} frames compared"]
        for kind, unit in _KINDS:
            largest = getattr(found, kind)
            line = f"  {kind:<12}{largest.value:.3g} {unit}"
            if largest.value:
                line += f"  joint {largest.joint!r}, time code {largest.code:g}"
            lines.append(line)
        lines += [f"  {text}" for text in found.mismatches]
        lines.append("same" if same else "different")
        console.result("\n".join(lines))
    click.get_current_context().exit(int(ExitCode.OK if same else ExitCode.FINDINGS))

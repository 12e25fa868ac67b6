"""``animtool mocap fill``."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import click

from animtool.cli.console import Console
from animtool.cli.marker_files import marker_options, output_option, run_on_markers
from animtool.cli.options import INPUT, read_values, record_option
from animtool.mocap.markers.fill_options import FillOptions


@click.command(
    epilog="""\b
Examples:
  animtool mocap fill take.c3d -o whole.c3d
  animtool mocap fill take.trc -o whole.npz --longest 0.5
  animtool mocap fill take.c3d -o clean.c3d --gaps keep --format json"""
)
@click.argument("markers", type=INPUT)
@output_option
@record_option(FillOptions)
@marker_options
@click.pass_obj
def fill(console: Console, /, markers: Path, output: Path, **given: Any) -> None:
    """Repair swapped names and spikes of MARKERS, and fill gaps.

    MARKERS is a C3D, TRC or npz file with named markers. Gaps up to 50 ms are filled by
    a curve, longer ones by the other markers; a last position is never held. What was
    filled is marked in C3D and npz files.
    """

    def work(read: Any) -> tuple[Any, Any]:
        from animtool.mocap.markers.fill import fill as run_fill

        return run_fill(read, FillOptions(**read_values(FillOptions, given)))

    run_on_markers(console, "fill", (markers,), output, given, work, _said)


def _said(report: Any) -> list[str]:
    """Return what was done, in words."""
    from animtool.errors import counted

    lines = []
    for swap in report.swaps:
        pair = " and ".join(swap.markers)
        lines.append(f"  swapped: {pair} in frames {swap.first} to {swap.last}")
    for spike in report.spikes:
        where = f"frames {spike.first} to {spike.last}"
        lines.append(
            f"  spike: {spike.marker} by {1000 * spike.size:.0f} mm in {where}"
        )
    methods = Counter(gap.method for gap in report.gaps)
    words = {"curve": "by a curve", "markers": "by other markers", "": "left"}
    parts = [f"{methods[m]} {words[m]}" for m in words if methods[m]]
    gaps = counted(len(report.gaps), "gap")
    lines.append(f"  {gaps}" + (f": {', '.join(parts)}" if parts else ""))
    lines.append(f"  {report.filled} positions filled, {report.left} still missing")
    return lines

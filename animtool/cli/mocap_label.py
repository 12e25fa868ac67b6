"""``animtool mocap label``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from animtool.cli.console import Console
from animtool.cli.marker_files import marker_options, output_option, run_on_markers
from animtool.cli.options import INPUT


@click.command(
    epilog="""\b
Examples:
  animtool mocap label cloud.c3d --static static.c3d -o named.c3d
  animtool mocap label "take.npz#unlabelled_mm" --static rest.trc -o a.npz"""
)
@click.argument("cloud", type=INPUT)
@output_option
@click.option(
    "--static",
    type=INPUT,
    required=True,
    metavar="FILE",
    help="A labelled trial of the same subject at rest: names and distances.",
)
@marker_options
def label(
    console: Console, /, cloud: Path, output: Path, static: Path, **params: Any
) -> None:
    """Give the points of CLOUD the names of the markers of a trial at rest.

    Points are followed over time, matched by the distances that stay the same as the
    subject moves, and named again after every gap. Points at no marker's place, such
    as reflections, are left out.
    """

    def work(points: Any, trial: Any) -> tuple[Any, Any]:
        from animtool.capture.markers.label import label as run_label

        return run_label(points, trial)

    run_on_markers(console, "mocap label", (cloud, static), output, params, work, _said)


def _said(report: Any) -> list[str]:
    """Return what was found, in words."""
    share = 100.0 * report.labelled / max(1, report.points)
    lines = [
        f"  {report.labelled} of {report.points} points named ({share:.1f}%), "
        f"{report.rejected} are no marker; {report.runs} runs"
    ]
    partial = [(n, c) for n, c in report.coverage.items() if c < 0.5]
    for name, coverage in sorted(partial, key=lambda entry: entry[1]):
        lines.append(f"  {name}: seen in {100 * coverage:.0f}% of the frames")
    return lines

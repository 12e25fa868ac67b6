"""``animtool mocap label``: names unlabelled marker points."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from animtool.cli.console import Console
from animtool.cli.help import command
from animtool.cli.marker_files import (
    marker_options,
    marker_output_option,
    run_on_markers,
)
from animtool.cli.options import INPUT
from animtool.report.text import Each, Template


@command(
    epilog="""\b
Examples:
  animtool mocap label cloud.c3d --static static.c3d -o named.c3d
  animtool mocap label "take.npz#unlabelled_mm" --static rest.trc -o a.npz"""
)
@click.argument("cloud", type=INPUT)
@marker_output_option
@click.option(
    "--static",
    type=INPUT,
    required=True,
    metavar="FILE",
    help="A labelled trial of the same subject at rest, for names and distances.",
)
@marker_options
def label(
    console: Console, /, cloud: Path, output: Path, static: Path, **params: Any
) -> None:
    """Label the points of CLOUD with the marker names of a static trial.

    Points are tracked over time, matched by the distances that stay constant as the
    subject moves, and labelled again after every gap. Points that match no marker,
    such as reflections, are removed.
    """

    def label_points(points: Any, trial: Any) -> tuple[Any, Any]:
        from animtool.capture.markers.label import label_points as run_label
        from animtool.core.errors import faults_in

        with faults_in(cloud):
            return run_label(points, trial, str(static))

    run_on_markers(
        console, "mocap label", (cloud, static), output, params, label_points, _TEMPLATE
    )


def _rarely_visible_markers(coverage: dict[str, float]) -> list[str]:
    """Return the markers that are visible in less than half of the frames."""
    return [
        f"{name}: seen in {100 * coverage[name]:.0f}% of the frames"
        for name in sorted(coverage, key=coverage.__getitem__)
        if coverage[name] < 0.5
    ]


_TEMPLATE = Template(
    "animtool.capture.markers.label:LabelReport",
    (
        "  {labelled} of {points} points named ({fraction:.1%}), {rejected} are not "
        "markers; {runs} runs",
        Each("coverage:partial", ("  {self}",)),
    ),
    {"partial": _rarely_visible_markers},
)

"""``animtool mocap fill``: repairs markers and fills their gaps."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import click

from animtool.capture.options import FillOptions
from animtool.cli.console import Console
from animtool.cli.help import command
from animtool.cli.marker_files import (
    marker_options,
    marker_output_option,
    run_on_markers,
)
from animtool.cli.options import INPUT, read_values, record_options
from animtool.core.errors import faults_in
from animtool.report.text import Each, Template


@command(
    epilog="""\b
Examples:
  animtool mocap fill take.c3d -o whole.c3d
  animtool mocap fill take.trc -o whole.npz --longest 0.5
  animtool mocap fill take.c3d -o whole.c3d --template ann.markers.yaml
      --static tpose.c3d
  animtool mocap fill take.c3d -o clean.c3d --gaps keep --format json"""
)
@click.argument("markers", type=INPUT)
@marker_output_option
@click.option(
    "--template",
    type=INPUT,
    metavar="FILE",
    help="Fill gaps from the skeleton: a template with the markers on its rig "
    "(.markers.yaml), accurate to a few centimetres.",
)
@click.option(
    "--rig",
    type=INPUT,
    metavar="RIG",
    help="The rig of the template, built like the subject: a rig file, USD file or "
    "BVH.  [default: the template's]",
)
@click.option(
    "--static",
    type=INPUT,
    metavar="FILE",
    help="With a skeleton: markers of the subject standing roughly in the rest pose.",
)
@record_options(FillOptions)
@marker_options
def fill(
    console: Console,
    /,
    markers: Path,
    output: Path,
    template: Path | None,
    rig: Path | None,
    static: Path | None,
    **params: Any,
) -> None:
    """Repair swapped names and spikes of MARKERS, and fill gaps.

    MARKERS is a C3D, TRC or npz file with named markers. With a template, gaps are
    filled from the skeleton, whose bones and poses are fitted to the take. Without one,
    gaps up to 50 ms are filled by a curve, longer ones from the other markers. The last
    position is never just held. Filled positions are flagged in C3D and npz files.
    """
    for option, path in (("--rig", rig), ("--static", static)):
        if path is not None and template is None:
            raise click.UsageError(f"{option} needs a skeleton: pass --template too.")

    def fill_gaps(marker_data: Any, static_markers: Any = None) -> tuple[Any, Any]:
        from animtool.capture.markers.fill import fill_markers as run_fill

        options = FillOptions(**read_values(FillOptions, params))
        if template is None:
            return run_fill(marker_data, options)
        from animtool.capture.markers.skeleton import MarkerSubject
        from animtool.capture.solve.source import rig_of_template
        from animtool.capture.templates.file import load_template
        from animtool.scene.sources.onto_rig import open_rig

        loaded_template = load_template(template, rig)
        subject_rig, notices = open_rig(rig_of_template(loaded_template, rig, template))
        subject = MarkerSubject(subject_rig, loaded_template, static_markers)
        with faults_in(markers):
            filled_markers, report = run_fill(marker_data, options, subject)
        report.notices[:0] = notices
        return filled_markers, report

    sources = (markers,) if static is None else (markers, static)
    run_on_markers(console, "mocap fill", sources, output, params, fill_gaps, _TEMPLATE)


_METHODS = {
    "skeleton": "by the skeleton",
    "curve": "by a curve",
    "markers": "by other markers",
    "": "left",
}


def _method_counts(gaps: Any) -> str:
    """Format the number of filled gaps for each method."""
    counts = Counter(gap.method for gap in gaps)
    methods = [method for method in _METHODS if counts[method]]
    return ", ".join(f"{counts[method]} {_METHODS[method]}" for method in methods)


_TEMPLATE = Template(
    "animtool.capture.markers.fill:FillReport",
    (
        Each("swaps", ("  swapped: {markers:pair} in frames {first} to {last}",)),
        Each(
            "spikes",
            ("  spike: {marker} by {size:mm_whole} in frames {first} to {last}",),
        ),
        "  [{gaps:n gap}: {gaps:methods}|0 gaps]",
        "  {filled} positions filled, {left} still missing",
    ),
    {
        "pair": " and ".join,
        "mm_whole": lambda size: f"{1000 * size:.0f} mm",
        "methods": _method_counts,
    },
)

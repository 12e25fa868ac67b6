"""``animtool mocap solve``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from animtool.capture.options import SolveOptions
from animtool.cli.console import Console
from animtool.cli.options import (
    INPUT,
    OUTPUT,
    read_values,
    record_option,
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
from animtool.core.errors import percent
from animtool.core.quantities import length_text
from animtool.report.text import SECONDS, Template

if TYPE_CHECKING:
    from animtool.capture.solve.calibration import Calibration
    from animtool.capture.solve.report import MarkerScore
    from animtool.capture.solve.run import MarkerSolve


@click.command(
    epilog="""\b
Examples:
  animtool mocap solve walk.c3d --template ann.markers.yaml -o walk.usdc
  animtool mocap solve range.c3d --template biped.markers.yaml --calibrate
      --static tpose.c3d --write-rig ann.rig.yaml --write-template ann.markers.yaml
  animtool mocap solve walk.trc --template ann.markers.yaml --rig-layer ann.usda
      -o walk_layer.usda"""
)
@click.argument("source", metavar="MARKERS", type=INPUT)
@click.option(
    "--template",
    type=INPUT,
    required=True,
    metavar="FILE",
    help="Where the markers are on the rig (.markers.yaml).",
)
@click.option(
    "--rig",
    type=INPUT,
    metavar="RIG",
    help="The subject's rig: a rig file, USD file or BVH.  [default: the template's]",
)
@click.option(
    "--calibrate",
    is_flag=True,
    help="Fit the lengths of bones and the offsets of markers to the subject first.",
)
@click.option(
    "--static",
    type=INPUT,
    metavar="FILE",
    help="Of a calibration: markers of the subject standing in about the rest pose.",
)
@take_output_option
@click.option(
    "--write-rig",
    type=OUTPUT,
    metavar="FILE",
    help="Of a calibration: write the subject's rig (.rig.yaml).",
)
@click.option(
    "--write-template",
    type=OUTPUT,
    metavar="FILE",
    help="Of a calibration: write the subject's template (.markers.yaml).",
)
@record_option(SolveOptions)
@written_options
@source_options
@writing_options
def solve(
    console: Console, /, source: Path, output: Path | None, **params: Any
) -> None:
    """Solve the motion of a rig from MARKERS: a C3D, TRC or npz file with labels.

    Markers that are missing, far off or mixed up are told from those that fit; limits
    are kept. Without -o the report is all.
    """
    to_stdout = goes_to_stdout(output, params)
    if params["static"] is not None and not params["calibrate"]:
        raise click.UsageError("--static is for a calibration: give --calibrate too.")
    from animtool.scene.solves.mocap_solve import (
        MocapSolveJob,
        run_solve,
    )

    job = MocapSolveJob(
        source,
        params["template"],
        params["rig"],
        params["static"],
        params["calibrate"],
        source_options_record(params),
        SolveOptions(**read_values(SolveOptions, params)),
        output,
        params["write_rig"],
        params["write_template"],
        written_options_record(params, strict=params["strict"]),
    )
    if skipped(console, "mocap solve", params, output, lambda: job.target.files):
        return
    with console.progress(f"solve {source.name}", stdout=to_stdout) as progress:
        report = run_solve(job, progress=progress)
    console.faults(report.notices)
    console.report(params["report_format"], report, _TEMPLATE)


def _bones(found: Calibration) -> str:
    """Return how far bones were scaled, least and most."""
    bones = found.scales[found.scales != 1.0]
    return f"{bones.min(initial=1.0):.3g} to {bones.max(initial=1.0):.3g}"


def _worst(markers: Sequence[MarkerScore]) -> list[str]:
    """Return the markers that are farthest off."""
    worst = sorted(markers, key=lambda each: -each.rms if each.seen else 1.0)
    return [f"{each.name} {length_text(each.rms)}" for each in worst[:3]]


def _strays(markers: Sequence[MarkerScore]) -> list[str]:
    """Return the markers that do not fit in some frames."""
    strays = [each for each in markers if each.outliers > 0.01]
    strays.sort(key=lambda each: -each.outliers)
    return [f"{each.name} ({percent(each.outliers)})" for each in strays]


def _exchanged(solve: MarkerSolve) -> list[str]:
    frames = solve.markers.clock.times
    return [
        f"{each.marker} is {each.label} in {frames[each.first]:g} to "
        f"{frames[each.last]:g}"
        for each in solve.score.exchanged
    ]


_TEMPLATE = Template(
    "animtool.scene.solves.mocap_solve:MocapSolveResult",
    (
        "{source} onto {solve.model.rig.name}: {solve.score.frames:n frame}, "
        "[{solve.score.markers:n marker}|0 markers], {seconds_per_frame:duration} a "
        "frame",
        "[  calibrated over {calibration.frames:n frame} in {calibration.rounds:n step}"
        ": bones {calibration:bones} times as long]",
        "  markers {solve.score.total:length} off (RMS); most: "
        "[{solve.score.markers:worst | names 3}]",
        "[  do not fit in some frames: {solve.score.markers:strays | names}]",
        "[  labels mixed up: {solve:exchanged | names}]",
        "[  not in the capture: {solve.match.missing:names}]",
        "[  not in the template: {solve.match.unused:names}]",
        "[  written: {outputs:join}]",
    ),
    {"bones": _bones, "worst": _worst, "strays": _strays, "exchanged": _exchanged},
    (SECONDS,),
)

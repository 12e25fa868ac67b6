"""``animtool mocap solve``: the motion of a rig from markers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from animtool.capture.options import SolveOptions
from animtool.cli.console import Console
from animtool.cli.help import command
from animtool.cli.options import (
    INPUT,
    OUTPUT,
    read_source_options,
    read_values,
    record_options,
    source_options,
)
from animtool.cli.outputs import (
    goes_to_stdout,
    read_output_options,
    refuse_swapped,
    skip_existing_outputs,
    take_output_option,
    take_output_options,
    writing_options,
)
from animtool.core.errors import percent_text
from animtool.core.quantities import length_text
from animtool.report.text import SECONDS, Template

if TYPE_CHECKING:
    from animtool.capture.solve.calibration import Calibration
    from animtool.capture.solve.report import MarkerScore
    from animtool.capture.solve.run import MarkerSolve


@command(
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
    help="First fit the lengths of bones and the offsets of markers to the subject.",
)
@click.option(
    "--static",
    type=INPUT,
    metavar="FILE",
    help="For calibration: markers of the subject standing roughly in the rest pose.",
)
@take_output_option
@click.option(
    "--write-rig",
    type=OUTPUT,
    metavar="FILE",
    help="After calibration: write the subject's rig (.rig.yaml).",
)
@click.option(
    "--write-template",
    type=OUTPUT,
    metavar="FILE",
    help="After calibration: write the subject's template (.markers.yaml).",
)
@record_options(SolveOptions)
@take_output_options
@source_options
@writing_options
def solve(
    console: Console, /, source: Path, output: Path | None, **params: Any
) -> None:
    """Solve the motion of a rig from MARKERS: a C3D, TRC or npz file with labels.

    Missing, misplaced and swapped markers are detected; joint limits are respected.
    Without -o, only the report is made.
    """
    is_stdout = goes_to_stdout(output, params)
    if output is not None and not params["overwrite"]:
        refuse_swapped(source, output, "MARKERS and -o")
    if params["static"] is not None and not params["calibrate"]:
        raise click.UsageError("--static needs a calibration: pass --calibrate too.")
    from animtool.scene.solves.mocap_solve import MocapSolveJob, run_solve

    job = MocapSolveJob(
        source,
        params["template"],
        params["rig"],
        params["static"],
        params["calibrate"],
        read_source_options(params),
        SolveOptions(**read_values(SolveOptions, params)),
        output,
        params["write_rig"],
        params["write_template"],
        read_output_options(params, strict=params["strict"]),
    )
    if skip_existing_outputs(
        console, "mocap solve", params, output, lambda: job.solved_output.files
    ):
        return
    with console.progress(f"solve {source.name}", is_stdout=is_stdout) as progress:
        report = run_solve(job, progress=progress)
    console.report(params["report_format"], report, _TEMPLATE, report.notices)


def _bone_scale_text(calibration: Calibration) -> str:
    """Format the smallest and largest bone scale."""
    scales = calibration.scales[calibration.scales != 1.0]
    return f"{scales.min(initial=1.0):.3g} to {scales.max(initial=1.0):.3g}"


def _worst_markers(markers: Sequence[MarkerScore]) -> list[str]:
    """Return names and RMS residuals of the three worst markers, unseen ones last."""
    worst_first = sorted(markers, key=lambda m: -m.rms if m.seen else 1.0)
    return [f"{marker.name} {length_text(marker.rms)}" for marker in worst_first[:3]]


def _outlier_markers(markers: Sequence[MarkerScore]) -> list[str]:
    """Return the markers rejected as outliers in over 1 % of the frames."""
    outlier_markers = [marker for marker in markers if marker.outliers > 0.01]
    outlier_markers.sort(key=lambda marker: -marker.outliers)
    return [f"{m.name} ({percent_text(m.outliers)})" for m in outlier_markers]


def _swapped_markers(solve: MarkerSolve) -> list[str]:
    frames = solve.markers.clock.times
    return [
        f"{swap.marker} is {swap.label} in {frames[swap.first]:g} to "
        f"{frames[swap.last]:g}"
        for swap in solve.score.swapped
    ]


_TEMPLATE = Template(
    "animtool.scene.solves.mocap_solve:MocapSolveResult",
    (
        "{source} onto {solve.model.rig.name}: {solve.score.frames:n frame}, "
        "[{solve.score.markers:n marker}|0 markers], {seconds_per_frame:duration} "
        "per frame",
        "[  calibrated over {calibration.frames:n frame} in {calibration.rounds:n "
        "step}: bone lengths {calibration:bones} times the rig's]",
        "  marker error {solve.score.total:length} (RMS); largest: "
        "[{solve.score.markers:worst | names 3}]",
        "[  do not match in some frames: {solve.score.markers:strays | names}]",
        "[  swapped labels: {solve:exchanged | names}]",
        "[  not in the capture: {solve.match.missing:names}]",
        "[  not in the template: {solve.match.unused:names}]",
        "[  written: {outputs:join}]",
    ),
    {
        "bones": _bone_scale_text,
        "worst": _worst_markers,
        "strays": _outlier_markers,
        "exchanged": _swapped_markers,
    },
    (SECONDS,),
)

"""``animtool mocap solve``."""

from __future__ import annotations

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
from animtool.core.errors import listed, percent
from animtool.core.quantities import length_text
from animtool.report.text import Line, render
from animtool.report.values import picked, plain_value

if TYPE_CHECKING:
    from animtool.capture.solve.calibration import Calibration
    from animtool.capture.solve.report import MarkerScore
    from animtool.scene.solves.mocap_solve import MocapSolveResult

MAX_NAMED = 8


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
        solve_outputs,
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
    if (
        output is not None
        and not to_stdout
        and skipped(console, "mocap solve", params, output, lambda: solve_outputs(job))
    ):
        return
    with console.progress(f"solve {source.name}", stdout=to_stdout) as progress:
        report = run_solve(job, progress=progress)
    console.faults(report.notices)
    most = MAX_NAMED if console.verbosity <= 0 else None
    console.summary(
        params["report_format"],
        lambda: solve_json(report),
        lambda: solve_text(report, most),
        report.seconds,
    )


_LINES: tuple[Line, ...] = (
    "{source} onto {solve.model.rig.name}: {score.frames:n frame}, "
    "[{score.markers:n marker}|0 markers], {each:duration} a frame",
    "[  calibrated over {calibration.frames:n frame} in {calibration.rounds:n step}: "
    "bones {calibration:bones} times as long]",
    "  markers {score.total:length} off (RMS); most: [{worst:names 3}]",
    "[  do not fit in some frames: {strays:names}]",
    "[  labels mixed up: {exchanged:names}]",
    "[  not in the capture: {solve.match.missing:names}]",
    "[  not in the template: {solve.match.unused:names}]",
    "[  written: {outputs:join}]",
)


def solve_text(report: MocapSolveResult, most: int | None = MAX_NAMED) -> list[str]:
    """Return the lines of a summary; ``most``: names in a line, None is all."""
    score = report.solve.score
    worst = sorted(score.markers, key=lambda each: -each.rms if each.seen else 1.0)
    strays = [each for each in score.markers if each.outliers > 0.01]
    strays.sort(key=lambda each: -each.outliers)
    return render(
        report,
        _LINES,
        {
            "names": lambda names, usual="": listed(
                list(names), most or int(usual or len(names))
            ),
            "bones": _bones,
        },
        score=score,
        each=report.seconds["solve"] / max(score.frames, 1),
        worst=[_marker(each) for each in worst[:3]],
        strays=[f"{each.name} ({percent(each.outliers)})" for each in strays],
        exchanged=_exchanged(report),
    )


def _bones(found: Calibration) -> str:
    """Return how far bones were scaled, least and most."""
    bones = found.scales[found.scales != 1.0]
    return f"{bones.min(initial=1.0):.3g} to {bones.max(initial=1.0):.3g}"


def _marker(each: MarkerScore) -> str:
    return f"{each.name} {length_text(each.rms)}"


def _exchanged(report: MocapSolveResult) -> list[str]:
    frames = report.solve.markers.clock.times
    return [
        f"{each.marker} is {each.label} in {frames[each.first]:g} to "
        f"{frames[each.last]:g}"
        for each in report.solve.score.exchanged
    ]


def solve_json(report: MocapSolveResult) -> dict[str, object]:
    """Return a summary as plain values; lengths in metres, frames by index."""
    score, solve = report.solve.score, report.solve
    found = report.calibration
    calibration = None
    if found is not None:
        calibration = {
            **picked(found, "rounds frames converged"),
            "bones": dict(zip(found.rig.names, found.scales.tolist(), strict=True)),
            "shifts": dict(
                zip(found.template.names, plain_value(found.shifts), strict=True)
            ),
        }
    return {
        "mocap solve": "animtool/1",
        **picked(report, "source rig outputs"),
        **picked(score, "frames rms=total frame_rms=rms sparse poor searched"),
        "markers": [picked(each, "name rms seen outliers") for each in score.markers],
        "exchanged": [
            picked(each, "marker label first last") for each in score.exchanged
        ],
        **picked(solve.match, "missing unused"),
        "calibration": calibration,
        "seconds": report.seconds,
        "notices": plain_value(report.notices),
    }

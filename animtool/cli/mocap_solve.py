"""``animtool mocap solve``."""

from __future__ import annotations

import math
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
from animtool.core.errors import counted, listed, percent
from animtool.core.quantities import duration_text, length_text

if TYPE_CHECKING:
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
        None if to_stdout else output,
        to_stdout,
        params["write_rig"],
        params["write_template"],
        written_options_record(params, strict=params["strict"]),
    )
    if job.output is not None and skipped(
        console, "mocap solve", params, job.output, lambda: solve_outputs(job)
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


def solve_text(report: MocapSolveResult, most: int | None = MAX_NAMED) -> list[str]:
    """Return the lines of a summary; ``most``: names in a line, None is all."""
    score, solve = report.solve.score, report.solve
    frames = score.frames
    each = duration_text(report.seconds["solve"] / max(frames, 1))
    lines = [
        f"{report.source} onto {solve.model.rig.name}: {counted(frames, 'frame')}, "
        f"{counted(len(score.markers), 'marker')}, {each} a frame"
    ]
    if report.calibration is not None:
        found = report.calibration
        bones = found.scales[found.scales != 1.0]
        lines.append(
            f"  calibrated over {counted(found.frames, 'frame')} in "
            f"{counted(found.rounds, 'step')}: bones {bones.min(initial=1.0):.3g} to "
            f"{bones.max(initial=1.0):.3g} times as long"
        )
    worst = sorted(score.markers, key=lambda each: -each.rms if each.seen else 1.0)
    lines.append(
        f"  markers {length_text(score.total)} off (RMS); most: "
        + listed([_marker(each) for each in worst[:3]], most or 3)
    )
    strays = [each for each in score.markers if each.outliers > 0.01]
    strays.sort(key=lambda each: -each.outliers)
    names = [f"{each.name} ({percent(each.outliers)})" for each in strays]
    for what, items in (
        ("do not fit in some frames", names),
        ("labels mixed up", _exchanged(report)),
        ("not in the capture", list(solve.match.missing)),
        ("not in the template", list(solve.match.unused)),
    ):
        if items:
            lines.append(f"  {what}: {listed(items, most or len(items))}")
    if report.outputs:
        lines.append(f"  written: {', '.join(map(str, report.outputs))}")
    return lines


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
            "rounds": found.rounds,
            "frames": found.frames,
            "converged": found.converged,
            "bones": dict(zip(found.rig.names, found.scales.tolist(), strict=True)),
            "shifts": dict(
                zip(found.template.names, _plain(found.shifts), strict=True)
            ),
        }
    return {
        "mocap solve": "animtool/1",
        "source": str(report.source),
        "rig": str(report.rig),
        "outputs": [str(path) for path in report.outputs],
        "frames": score.frames,
        "rms": _plain([score.total])[0],
        "frame_rms": _plain(score.rms),
        "sparse": score.sparse.tolist(),
        "poor": score.poor.tolist(),
        "searched": score.searched.tolist(),
        "markers": [
            {
                "name": each.name,
                "rms": _plain([each.rms])[0],
                "seen": each.seen,
                "outliers": each.outliers,
            }
            for each in score.markers
        ],
        "exchanged": [
            {
                "marker": each.marker,
                "label": each.label,
                "first": each.first,
                "last": each.last,
            }
            for each in score.exchanged
        ],
        "missing": list(solve.match.missing),
        "unused": list(solve.match.unused),
        "calibration": calibration,
        "seconds": report.seconds,
        "notices": [notice.as_dict() for notice in report.notices],
    }


def _plain(values: Any) -> list[float | None]:
    """Return numbers, None in place of NaN."""
    return [None if math.isnan(value) else float(value) for value in values]

"""``animtool mocap triangulate``: markers from images of several cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from animtool.capture.options import TriangulateOptions
from animtool.cli.console import Console
from animtool.cli.help import command
from animtool.cli.options import (
    INPUT,
    Count,
    output_option,
    read_values,
    record_options,
    source_options,
    strict_option,
)
from animtool.cli.outputs import atomic_command, skip_existing_outputs, writing_options
from animtool.core.errors import Fault, OptionError
from animtool.core.units import LengthUnit, UpAxis
from animtool.report.text import Table, Template

if TYPE_CHECKING:
    from animtool.capture.cameras.report import CameraReport


def _refuse_exchanged_inputs(observations: Path, calibrations: Sequence[Path]) -> None:
    """Raise if a calibration is an npz file, and OBSERVATIONS is none (IO002)."""
    arrays = [path for path in calibrations if path.suffix.lower() == ".npz"]
    if arrays and observations.is_file() and observations.suffix.lower() != ".npz":
        message = "--cameras takes a calibration, and this is an npz file of arrays"
        hint = "OBSERVATIONS and --cameras are exchanged: "
        hint += f"animtool mocap triangulate {arrays[0]} --cameras {observations}"
        raise OptionError(Fault("IO002", message, str(arrays[0]), hint=hint))


@command(
    epilog="""\b
Examples:
  animtool mocap triangulate take.npz --cameras stage.cameras.yaml -o markers.npz
  animtool mocap triangulate take.npz --cameras calib.toml --up Z -o markers.npz
  animtool mocap triangulate pose/ --cameras calib.toml --fps 60 -o people.npz"""
)
@click.argument("observations", type=INPUT)
@click.option(
    "--cameras",
    "calibrations",
    type=INPUT,
    required=True,
    multiple=True,
    help="Calibration: .cameras.yaml, or a file from OpenCV (YAML, JSON), Pose2Sim "
    "or anipose (TOML); repeat it for one file per camera.",
)
@output_option("Marker file to write: .npz, .c3d or .trc.", required=True)
@click.option(
    "--people",
    type=Count(1),
    metavar="N",
    help="For OpenPose keypoints, keep the N people seen most.  [default: all]",
)
@record_options(TriangulateOptions)
@source_options
@strict_option
@writing_options
def triangulate(
    console: Console,
    /,
    observations: Path,
    calibrations: tuple[Path, ...],
    output: Path,
    **params: Any,
) -> None:
    """Triangulate markers from OBSERVATIONS of calibrated cameras.

    OBSERVATIONS is an npz file of pixels, or a folder of OpenPose keypoints with a
    folder for each camera. Wrong observations are excluded, and cameras that moved
    after calibration are reported.
    """
    label = "mocap triangulate"
    if skip_existing_outputs(console, label, params, output, lambda: [output]):
        return
    from animtool.capture.cameras.file import load_all_cameras
    from animtool.capture.cameras.observations import read_observations
    from animtool.capture.cameras.openpose import read_keypoints
    from animtool.capture.cameras.triangulate import triangulate as solve
    from animtool.core.errors import refuse_warnings
    from animtool.core.files.output import check_outputs
    from animtool.core.writers import marker_writer
    from animtool.formats.marker_files import write_markers

    marker_writer(output)
    _refuse_exchanged_inputs(observations, calibrations)
    inputs = [observations, *calibrations]
    check_outputs([output], inputs, overwrite=params["overwrite"])
    options = TriangulateOptions(**read_values(TriangulateOptions, params))
    unit = LengthUnit(params["units"]) if params["units"] else None
    up_axis = UpAxis(params["up"].upper()) if params["up"] else None
    cameras = load_all_cameras(calibrations, unit=unit, up=up_axis)
    name = observations.name
    with atomic_command(), console.progress(f"triangulate {name}") as progress:
        fps, people = params["source_fps"], params["people"]
        if observations.is_dir():
            image_points = read_keypoints(observations, cameras, fps=fps, people=people)
        else:
            image_points = read_observations(observations, fps=fps)
        result = solve(image_points, cameras, options, progress=progress)
        refuse_warnings(result.notices, strict=params["strict"])
        losses = write_markers(result.markers, output, overwrite=params["overwrite"])
    notices = (*result.notices, *losses)
    result = replace(result, source=observations, output=output, notices=notices)
    console.report(params["report_format"], result, _TEMPLATE, result.notices)


def _camera_remarks(report: CameraReport) -> str:
    """Return the frames in which a camera moved or disagrees with others, as text."""
    from animtool.core.shot import frame_spans

    remarks = [
        f"{'off' if shift.kept else 'out'} {shift.first + 1}-{shift.end}"
        for shift in report.shifts
    ]
    if report.disagrees:
        frames = [disagreement.number for disagreement in report.disagrees]
        remarks.append(f"disagrees {frame_spans(frames)}")
    return ", ".join(remarks)


_TEMPLATE = Template(
    "animtool.capture.cameras.report:Triangulation",
    (
        "{output}: {markers:summary}",
        "{triangulated} of {visible} points that two cameras see "
        "({fraction:hundredths2} %), "
        "reprojection {error_px:.3f} px ({error_mm:.3f} mm)",
        Table(
            "cameras",
            {
                "camera": "{name}",
                "seen": "{observed}",
                "used": "{used}",
                "outliers": "{outliers:hundredths2} %",
                "error px": "{error_px:.3f}",
                "error mm": "{error_mm:.3f}",
                "": "{self:remarks}",
            },
            left=("camera", ""),
        ),
    ),
    {
        "summary": lambda markers: f"{markers!r}".strip("<>"),
        "remarks": _camera_remarks,
        "hundredths2": lambda fraction: f"{100 * fraction:.2f}",
    },
)

"""``animtool mocap face``: shape weights from landmarks of a face."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from animtool.capture.options import FaceOptions
from animtool.cli.console import Console
from animtool.cli.help import command
from animtool.cli.options import (
    INPUT,
    output_option,
    read_source_options,
    read_values,
    record_options,
    source_option,
    source_options,
    strict_option,
)
from animtool.cli.outputs import atomic_command, skip_existing_outputs, writing_options
from animtool.core.quantities import length_text
from animtool.report.text import SECONDS, Template

if TYPE_CHECKING:
    from animtool.scene.solves.face import FaceResult


@command(
    epilog="""\b
Examples:
  animtool mocap face take.npz --rig hero.rig.yaml -o face.usdc
  animtool mocap face take.c3d --rig hero.rig.yaml --landmarks hero.landmarks.yaml \\
      -o face.usdc
  animtool mocap face helmet.npz --rig hero.rig.yaml --landmarks hero.landmarks.yaml \\
      --camera helmet.cameras.yaml -o face.usdc"""
)
@click.argument("landmarks", type=INPUT)
@click.option(
    "--rig",
    type=INPUT,
    required=True,
    metavar="RIG",
    help="The rig with the shapes: a rig file or USD file.",
)
@output_option(
    "File to write: USD (.usda, .usdc, .usd), .clip.yaml or .csv.  [default: nothing]"
)
@click.option(
    "--landmarks",
    "landmarks_file",
    type=INPUT,
    metavar="FILE",
    help="Landmarks file (.landmarks.yaml): where landmarks are on the rig.  "
    "[default: the face in LANDMARKS]",
)
@source_option("remap")
@click.option(
    "--camera",
    type=INPUT,
    metavar="FILE",
    help="Camera file of a head-mounted camera, for landmarks in pixels.",
)
@click.option(
    "--camera-name", metavar="NAME", help="The camera, if its file has several."
)
@record_options(FaceOptions)
@source_options
@strict_option
@writing_options
def face(console: Console, /, landmarks: Path, **params: Any) -> None:
    """Solve the blend-shape weights of a rig from face landmarks.

    LANDMARKS is an npz of positions or pixels, or a file of markers. Weights stay
    between 0 and 1, outliers have little weight, gaps are bridged, and head motion
    is solved separately. Without -o, only the report is made.
    """
    from animtool.scene.bake.options import BakeOptions
    from animtool.scene.solves.face import FaceJob, run_face

    job = FaceJob(
        landmarks,
        params["rig"],
        params["output"],
        params["landmarks_file"],
        params["remap"],
        params["camera"],
        params["camera_name"],
        FaceOptions(**read_values(FaceOptions, params)),
        read_source_options(params),
        BakeOptions(overwrite=params["overwrite"], strict=params["strict"]),
    )
    if skip_existing_outputs(
        console, "mocap face", params, job.output, lambda: job.solved_output.files
    ):
        return
    with atomic_command(), console.progress(f"face {landmarks.name}") as progress:
        result = run_face(job, progress=progress)
    template = _report_template(result)
    console.report(params["report_format"], result, template, result.notices)


def _unsolved_counts(status: Sequence[object]) -> list[str]:
    """Return the number of frames with each status; empty if all are solved."""
    counts = Counter(map(str, status))
    status_texts = [f"{count} {name}" for name, count in sorted(counts.items())]
    return [] if set(counts) == {"solved"} else status_texts


def _report_template(result: FaceResult) -> Template:
    def residual_text(value: float) -> str:
        if result.pixels_per_meter is None:
            return length_text(value)
        return f"{value:.3g} px ({length_text(value / result.pixels_per_meter)})"

    return replace(
        _TEMPLATE, printers={"residual": residual_text, "ends": _unsolved_counts}
    )


_TEMPLATE = Template(
    "animtool.scene.solves.face:FaceResult",
    (
        "{job.capture} onto {take.rig.name}: [{fit.weights:n frame}|0 frames], "
        "{fit.model.names:n landmark}, {moving_shape_count} of "
        "[{fit.model.shapes:n shape}|0 shapes] move, {rate:.0f} frames per second",
        "  landmarks within {fit.rms:residual} RMS; noise {fit.noise:residual} per "
        "axis",
        "[  frames: {fit.status:ends | list}]",
        "[  shapes that the rig does not have: {shape_links.unlinked:list 8}]",
        "[  written: {written.files:join}]",
    ),
    details=(SECONDS,),
)

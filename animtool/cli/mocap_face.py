"""``animtool mocap face``."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from animtool.capture.options import FaceOptions
from animtool.cli.console import Console
from animtool.cli.options import (
    INPUT,
    read_values,
    record_option,
    source_option,
    source_options,
    source_options_record,
    strict_option,
)
from animtool.cli.outputs import all_named, skipped, writing_options
from animtool.core.quantities import length_text
from animtool.report.text import Line, render
from animtool.report.values import picked, plain_value

if TYPE_CHECKING:
    from animtool.scene.solves.face import FaceResult


@click.command(
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
    help="The rig whose shapes move: a rig file or USD file.",
)
@click.option(
    "-o",
    "--output",
    type=INPUT,
    help="What to write: a USD file (.usda, .usdc, .usd), .clip.yaml or .csv.  "
    "[default: nothing]",
)
@click.option(
    "--landmarks",
    "landmarks_file",
    type=INPUT,
    metavar="FILE",
    help="Landmarks file (.landmarks.yaml): where landmarks are on the rig.  [default: "
    "the face that LANDMARKS brings]",
)
@source_option("remap")
@click.option(
    "--camera",
    type=INPUT,
    metavar="FILE",
    help="Camera file of a head-mounted camera, for landmarks in pixels.",
)
@click.option(
    "--camera-name", metavar="NAME", help="The camera, where its file has several."
)
@record_option(FaceOptions)
@source_options
@strict_option
@writing_options
def face(console: Console, /, landmarks: Path, **params: Any) -> None:
    """Turn landmarks of a face into weights of a rig's blend shapes.

    LANDMARKS is an npz of positions or pixels, or a file of markers. Weights stay
    between 0 and 1, outliers count little, gaps are bridged, and the head's own motion
    is kept apart. Without -o the report is all.
    """
    from animtool.scene.bake.options import BakeOptions
    from animtool.scene.solves.face import FaceJob, face_outputs, run_face

    job = FaceJob(
        landmarks,
        params["rig"],
        params["output"],
        params["landmarks_file"],
        params["remap"],
        params["camera"],
        params["camera_name"],
        FaceOptions(**read_values(FaceOptions, params)),
        source_options_record(params),
        BakeOptions(overwrite=params["overwrite"], strict=params["strict"]),
    )
    if skipped(console, "mocap face", params, job.output, lambda: face_outputs(job)):
        return
    with all_named(), console.progress(f"face {landmarks.name}") as progress:
        result = run_face(job, progress=progress)
    console.faults(result.notices)
    console.summary(
        params["report_format"],
        lambda: face_json(result),
        lambda: face_text(result),
        result.seconds,
    )


def _residual(result: FaceResult, value: float) -> str:
    if not result.pixels:
        return length_text(value)
    return f"{value:.3g} px ({length_text(value / result.pixels_per_meter)})"


_LINES: tuple[Line, ...] = (
    "{job.capture} onto {take.rig.name}: [{fit.weights:n frame}|0 frames], "
    "{fit.model.names:n landmark}, {moved} of [{fit.model.shapes:n shape}|0 shapes] "
    "move, {rate:.0f} frames a second",
    "  landmarks within {fit.rms:residual} RMS; noise {fit.noise:residual} in each "
    "direction",
    "[  frames: {ends:list}]",
    "[  shapes that the rig lacks: {links.lost:list 8}]",
    "[  written: {written.files:join}]",
)


def face_text(result: FaceResult) -> list[str]:
    """Return the lines of a summary."""
    fit = result.fit
    counts = Counter(map(str, fit.status))
    ends = [f"{count} {name}" for name, count in sorted(counts.items())]
    return render(
        result,
        _LINES,
        {"residual": lambda value: _residual(result, value)},
        moved=int((fit.weights.max(axis=0, initial=0) > 0).sum()),
        rate=len(fit.weights) / max(result.seconds["solve"], 1e-9),
        ends=[] if set(counts) == {"solved"} else ends,
    )


def face_json(result: FaceResult) -> dict[str, object]:
    """Return a summary as plain values; residuals in metres, or pixels of a camera."""
    import numpy as np

    fit = result.fit
    used = np.isfinite(fit.residuals) & (fit.shares >= 0.5)
    squares = np.where(used, fit.residuals, 0.0) ** 2
    rms = np.sqrt(squares.sum(axis=0) / np.maximum(used.sum(axis=0), 1))
    files = [] if result.written is None else result.written.files
    return {
        "mocap face": "animtool/1",
        **picked(result.job, "source=capture rig"),
        "outputs": plain_value(files),
        "frames": len(fit.weights),
        "residual_unit": "px" if result.pixels else "m",
        "pixels_per_meter": result.pixels_per_meter or None,
        **picked(fit, "rms noise rounds change"),
        "landmarks": [
            {
                "name": name,
                "rms": float(rms[i]),
                "seen": int(np.isfinite(fit.residuals[:, i]).sum()),
                "outliers": int((np.isfinite(fit.residuals[:, i]) & ~used[:, i]).sum()),
            }
            for i, name in enumerate(fit.model.names)
        ],
        "shapes": [
            {"name": name, "max": float(fit.weights[:, i].max(initial=0.0))}
            for i, name in enumerate(fit.model.shapes)
        ],
        "status": plain_value(fit.status),
        "lost": list(result.links.lost),
        "seconds": result.seconds,
        "notices": plain_value(result.notices),
    }

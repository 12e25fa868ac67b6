"""``animtool retarget``: transfers a take to another rig."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from animtool.cli.console import Console
from animtool.cli.help import command
from animtool.cli.options import (
    INPUT,
    OUTPUT,
    bake_option,
    read_source_options,
    read_values,
    record_options,
    source_option,
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
from animtool.core.errors import listed, percent_text
from animtool.core.options import options_of
from animtool.core.quantities import angle_text, length_text
from animtool.report.text import SECONDS, Template
from animtool.retarget.options import RetargetOptions

if TYPE_CHECKING:
    from animtool.retarget.verdict import Verdict


MAX_LISTED_RANGES = 6
# Rounding noise of lengths and angles [m, rad].
NEGLIGIBLE_ERROR = 1e-9


def _verdict_text(verdict: Verdict) -> str:
    """Format a verdict: what to check and in which frames."""
    from animtool.retarget.verdict import TakeStatus

    reasons = []
    for reason in verdict.reasons:
        text = f"{reason.what} {reason.text}".rstrip()
        if reason.frames:
            ranges = ["-".join(map(str, dict.fromkeys(ends))) for ends in reason.frames]
            text = f"{listed(ranges, MAX_LISTED_RANGES)} ({text})"
        reasons.append(text)
    if not reasons:
        return str(verdict.status)
    has_frames = any(reason.frames for reason in verdict.reasons)
    is_general = verdict.status is TakeStatus.LOOK and not has_frames
    return f"{'check' if is_general else verdict.status}: {'; '.join(reasons)}"


def _length_text(meters: float) -> str:
    return length_text(meters if meters > NEGLIGIBLE_ERROR else 0.0)


def _angle_text(radians: float) -> str:
    return angle_text(math.degrees(radians if radians > NEGLIGIBLE_ERROR else 0.0))


def _clamped_joints_text(clamped_joints: Mapping[str, float]) -> list[str]:
    most_clamped = sorted(clamped_joints, key=lambda name: -clamped_joints[name])
    return [f"{n} ({percent_text(clamped_joints[n])} of frames)" for n in most_clamped]


def _score_text(value: float, printer: str) -> str:
    """Format a score as an angle, percentage or factor; "" for NaN."""
    if math.isnan(value):
        return ""
    printers = {"angle": _angle_text, "percent": percent_text, "times": "{:.3g}".format}
    return printers[printer](value)


_TEMPLATE = Template(
    "animtool.scene.solves.retarget:RetargetResult",
    (
        "{verdict:verdict}",
        "{source} onto {target.name}: {score.frames:n frame}, {score.pairs:n joint} "
        "paired, scaled by {score.scale:.3g}, {seconds_per_frame:duration} per frame",
        "[{?score.contacts}  feet are planted in {score.contacts:percent} of frames; "
        "they drift {score.drift_mean:metres} on average, {score.drift_max:metres} "
        "at most (the source {score.source_drift_max:metres}, scaled); soles within "
        "{score.sole_error:metres}]",
        "  [limbs differ from the source by {score.bone_angle_mean:scored angle} on "
        "average, {score.bone_angle_max:scored angle} at most|no limb is paired: its "
        "angles have no score][; hands within {score.reach_error:scored percent} of "
        "the arm's reach][; peak acceleration {score.acceleration:scored times} times "
        "the source's]",
        "[{?score.hand_error}  hands within {score.hand_error:length} of what they "
        "hold]",
        "[{?score.lowered}  hips lowered by up to {score.lowered:length} so that the "
        "legs reach]",
        "[  stopped by their limits: {score.held:held | names}]",
        "[  not mapped, of the source: {score.unmapped_source:names}]",
        "[  not mapped, of the rig: {score.unmapped_target:names}]",
        "[  written: {outputs:join}]",
    ),
    {
        "verdict": _verdict_text,
        "metres": _length_text,
        "held": _clamped_joints_text,
        "scored": _score_text,
    },
    (SECONDS,),
)


# Options of retargeting that writing commands lack.
RETARGET_OPTIONS = tuple(
    name for name in options_of(RetargetOptions) if name != "force_fit"
)


@command(
    epilog="""\b
Examples:
  animtool retarget walk.bvh --to hero.rig.yaml -o walk.usdc
  animtool retarget walk.bvh --to hero.rig.yaml
  animtool retarget walk.bvh --to hero.usda --rig-layer hero.usda -o walk_layer.usdc
  animtool retarget walk.bvh --to hero.rig.yaml --write-map walk.map.yaml
  animtool retarget walk.bvh --to hero.rig.yaml --map walk.map.yaml -o walk.bvh
  animtool retarget take.bvh --to hero.rig.yaml --rest frame:1 -o take.usdc
  animtool retarget take.bvh --to hero.rig.yaml -o cut.usdc --fps 24 --range 1-48"""
)
@click.argument("source", type=INPUT)
@click.option(
    "--rig",
    "--to",
    "rig",
    type=INPUT,
    required=True,
    metavar="RIG",
    help="The target rig: a rig file, USD, BVH, glTF, FBX, URDF or MJCF.",
)
@take_output_option
@record_options(RetargetOptions, *RETARGET_OPTIONS)
@click.option(
    "--write-map",
    type=OUTPUT,
    metavar="FILE",
    help="Write the joint map that was used (.map.yaml), for editing.",
)
@take_output_options
@source_options
@source_option("prim_path", "take", "positions")
@bake_option("fps", "frame_range", "start", "placement")
@writing_options
def retarget(
    console: Console, /, source: Path, output: Path | None, **params: Any
) -> None:
    """Transfer the take of SOURCE, a BVH, USD, glTF, FBX or clip file, to another rig.

    Joints are paired by name, by position in the body, or by a map file. Rest poses
    are aligned, root motion is scaled by leg length, joint limits are respected, and
    planted feet are held. Without -o, only the report is made.
    """
    if source.name.endswith((".rig.yaml", ".rig.yml", ".rig.json")):
        text = f"SOURCE is the rig file {source.name}: did you swap SOURCE and --to?"
        raise click.UsageError(text)
    is_stdout = goes_to_stdout(output, params)
    if output is not None and not params["overwrite"]:
        refuse_swapped(source, output, "SOURCE and -o")
    from animtool.scene.solves.retarget import RetargetJob, run_retarget

    job = RetargetJob(
        source,
        params["rig"],
        read_source_options(params, "prim_path", "take", "positions"),
        RetargetOptions(**read_values(RetargetOptions, params)),
        output,
        params["write_map"],
        read_output_options(
            params,
            *("fps", "frame_range", "start", "placement"),
            strict=params["strict"],
        ),
    )
    if skip_existing_outputs(
        console, "retarget", params, output, lambda: job.solved_output.files
    ):
        return
    with console.progress(f"retarget {source.name}", is_stdout=is_stdout) as progress:
        report = run_retarget(job, progress=progress)
    console.report(params["report_format"], report, _TEMPLATE, report.notices)

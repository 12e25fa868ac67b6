"""``animtool ik``: solves a rig for targets, or writes targets of a take."""

from __future__ import annotations

import math
from typing import Any

import click

from animtool.cli.bake_options import SHOT_OPTIONS, timeline_shot
from animtool.cli.console import Console
from animtool.cli.help import command
from animtool.cli.options import (
    INPUT,
    LENGTH,
    OUTPUT,
    RATE,
    TOLERANCE,
    ParsedType,
    bake_option,
    output_option,
    parse_names,
    read_source_options,
    read_values,
    record_options,
    rig_layer_options,
    source_option,
    source_options,
    stack_options,
)
from animtool.cli.outputs import (
    atomic_command,
    check_plot,
    goes_to_stdout,
    plot_option,
    print_tradeoffs,
    read_output_options,
    refuse_plot_without_table,
    skip_existing_outputs,
    split_option,
    writing_options,
)
from animtool.core.names import has_kind_suffix
from animtool.ik.options import REPORTED_MISS, REPORTED_MISS_DEGREES, TakeOptions
from animtool.scene.file.option_text import parse_frame

FIRST_FRAME = "first"
# Options of `--match`, in addition to those of its source.
_MATCH_OPTIONS = frozenset(
    {
        *("rig", "start", "match", "chains", "pose", "output", "reduce"),
        *("overwrite", "skip_existing", "strict", "report_format", "units", "up"),
        *("source_fps", "source_prim", "take", "positions", "placement"),
    }
)


def _parse_pose_frame(text: str) -> Any:
    return text if text == FIRST_FRAME else parse_frame(text)


@command(
    epilog="""\b
Examples:
  animtool ik hero.rig.yaml --targets reach.targets.yaml
  animtool ik hero.rig.yaml --targets reach.targets.yaml --pose 12 -o pose.usda
  animtool ik hero.rig.yaml --targets reach.targets.yaml -o reach.usdc
  animtool ik hero.rig.yaml --targets feet.targets.yaml --clip walk.bvh -o walk.usdc
  animtool ik hero.usda --targets feet.targets.yaml --clip walk.usdc -o fix.usdc
      --rig-layer hero.usda
  animtool ik hero.rig.yaml --targets feet.targets.yaml --clip edit.otio --shot sh010
      -o sh010.usdc
  animtool ik hero.rig.yaml --targets reach.targets.yaml --strict --missed 0.1mm
  animtool ik hero.rig.yaml --targets reach.targets.yaml --table --plot reach.png
  animtool ik hero.rig.yaml --match --clip walk.bvh -o walk.targets.yaml"""
)
@click.argument("rig", type=INPUT)
@click.option(
    "-t",
    "--targets",
    type=INPUT,
    metavar="FILE",
    help="The targets file: goals for joints and chains.",
)
@click.option(
    "--clip",
    "start",
    type=INPUT,
    metavar="START",
    help="Motion to start from, a clip, BVH or USD file, or a shot of a timeline: "
    "each frame stays near its pose.  [default: the rest pose]",
)
@stack_options(*SHOT_OPTIONS)
@click.option(
    "--fps",
    type=RATE,
    metavar="RATE",
    help="For a timeline without a rate, such as an EDL: the rate of its time codes "
    "and shots, such as 24, 25 or 30000/1001.",
)
@click.option(
    "--match",
    is_flag=True,
    help="Reverse: write the targets (-o) that reproduce the limbs of START.",
)
@click.option(
    "--chains",
    metavar="NAME,...",
    help="For --match: chains of the rig's ik, or patterns such as 'leg_*'.  "
    "[default: all]",
)
@click.option(
    "--pose",
    type=ParsedType("frame", _parse_pose_frame),
    is_flag=False,
    flag_value=FIRST_FRAME,
    metavar="[FRAME]",
    help="Solve only one pose: that of the frame, or of the first.  [default: all "
    "frames]",
)
@output_option(
    "File to write: USD (.usda, .usdc, .usd), .clip.yaml or .bvh, or - for usda "
    "on stdout; with --match .targets.yaml. USD is a stage with the rig in it, "
    "or with --rig-layer an animation layer over that.  [default: nothing]",
    kind=OUTPUT,
)
@record_options(TakeOptions)
@click.option(
    "--table",
    is_flag=True,
    help="Write nothing; measure time against error, over tolerances and methods.",
)
@plot_option
@click.option(
    "--missed",
    "tol",
    type=LENGTH,
    metavar="LENGTH",
    help="Report a position as missed if it is farther off than this.  [default: "
    f"{REPORTED_MISS}, or --tolerance if that is larger]",
)
@click.option(
    "--missed-degrees",
    "tol_degrees",
    type=TOLERANCE,
    metavar="DEGREES",
    help="Report an orientation, aim or pole as missed if it is farther off than "
    f"this.  [default: {REPORTED_MISS_DEGREES}, or --angle-tolerance]",
)
@bake_option(
    "strict",
    help_text="Write nothing if a goal is missed (exit code 4) or there are warnings.",
)
@split_option
@rig_layer_options
@click.option(
    "--start",
    "first_code",
    type=ParsedType("frame", parse_frame),
    metavar="FRAME",
    help="Time code of the first frame in USD.  [default: as in the targets or START]",
)
@bake_option(
    "sparse",
    help_text="Write only the joints of a USD output that leave their rest pose.",
)
@bake_option(
    "reduce",
    help_text="Largest error of joints from leaving out keys of a clip or samples of "
    "USD; with --match, from sparse keys.",
)
@source_options
@source_option("prim_path", "take", "positions")
@bake_option("placement")
@writing_options
def ik(console: Console, /, **params: Any) -> None:
    """Solve the joints of RIG for targets: a pose, a clip, or a fix on top of a clip.

    RIG is a rig file, URDF, MJCF, USD file or BVH. The targets file says which
    effectors are to be where, frame by frame; limits of joints are kept. What is not
    reached is named, with how far it is off; without -o that is all. --match writes
    such a file from poses.
    """
    if has_kind_suffix(params["rig"], "targets"):
        text = f"{params['rig']} holds targets: did you swap RIG and --targets?"
        raise click.UsageError(text)
    if params["match"]:
        if params["plot"] is not None:
            raise click.UsageError("--match measures nothing: remove --plot.")
        _run_match_command(console, params, _start_options(params))
        return
    _check_solve_options(params)
    cut = timeline_shot(
        console, params["start"], params, params["first_code"], params["fps"]
    )
    if cut is not None:
        params |= {"start": cut.media.path, "shot": cut.shot, "first_code": None}
    output = params["output"]
    is_stdout = goes_to_stdout(output, params)
    if params["table"]:
        if output is not None:
            raise click.UsageError("--table writes no file: remove -o.")
        if params["strict"]:
            message = "--table measures rows that miss by design: remove --strict."
            raise click.UsageError(message)
        _print_table(console, params)
        return
    if skip_existing_outputs(
        console, "ik", params, output, lambda: _ik_job(params).solved_output.files
    ):
        return
    from animtool.cli.ik_summary import SOLVE_TEMPLATE
    from animtool.scene.solves.ik import MissedGoalsError, run_ik

    label = f"ik {params['targets'].name}"
    with atomic_command(), console.progress(label, is_stdout=is_stdout) as progress:
        try:
            report = run_ik(_ik_job(params), progress=progress)
        except MissedGoalsError as error:
            console.report(params["report_format"], error.report, SOLVE_TEMPLATE)
            raise
    console.report(params["report_format"], report, SOLVE_TEMPLATE, report.notices)


def _run_match_command(console: Console, params: dict[str, Any], source: Any) -> None:
    """Write the targets that match the limbs of a take, and print a summary."""
    _check_match(params)
    output = params["output"]
    if skip_existing_outputs(console, "ik", params, output, lambda: [output]):
        return
    from animtool.cli.ik_summary import MATCH_TEMPLATE
    from animtool.scene.bake.options import BakeOptions
    from animtool.scene.solves.ik_match import MatchJob, run_match

    pose = params["pose"]
    job = MatchJob(
        rig=params["rig"],
        take=params["start"],
        output=output,
        source=source,
        chains=parse_names(params["chains"]),
        pose=pose is not None,
        frame=None if isinstance(pose, str) else pose,
        write_options=BakeOptions(
            **{name: params[name] for name in ("reduce", "overwrite", "strict")}
        ),
    )
    with console.progress(f"match {params['start'].name}") as progress:
        report = run_match(job, progress=progress)
    console.report(params["report_format"], report, MATCH_TEMPLATE, report.notices)


def _check_match(params: dict[str, Any]) -> None:
    """Refuse options that `--match` requires but lacks, or that it would ignore."""
    for name, missing_option in (("start", "--clip"), ("output", "-o")):
        if params[name] is None:
            raise click.UsageError(f"--match needs {missing_option}.")
    if str(params["output"]) == "-":
        raise click.UsageError("--match writes a targets file, not to stdout.")
    context = click.get_current_context()
    default_source = click.core.ParameterSource.DEFAULT
    for option in context.command.params:
        name = option.name or ""
        is_ignored = name in params and name not in _MATCH_OPTIONS
        if is_ignored and context.get_parameter_source(name) is not default_source:
            flag = option.opts[-1]
            text = f"{flag} has no effect with --match, which writes targets: leave "
            text += f"{flag} out, or leave out --match to solve for targets"
            if name == "targets":
                text = "--match writes targets and --targets reads them: leave out "
                text += "--targets to write some from the clip, or --match to solve "
                text += "for those of the file"
            raise click.UsageError(f"{text}.")


def _check_solve_options(params: dict[str, Any]) -> None:
    if params["targets"] is None:
        raise click.UsageError("Pass --targets, or --match to write some.")
    refuse_plot_without_table(params)
    if params["chains"] is not None:
        message = "--chains names the chains that --match writes targets for: leave it "
        message += "out to solve, or write --match in place of --targets."
        raise click.UsageError(message)


def _start_options(params: dict[str, Any]) -> Any:
    """Return the options for reading the start take."""
    source_keys = ("prim_path", "take", "positions")
    other_values = {"shot": params["shot"], "placement": params["placement"]}
    return read_source_options(params, *source_keys, **other_values)


def _print_table(console: Console, params: dict[str, Any]) -> None:
    from animtool.scene.tables.tradeoffs import ik_tradeoffs

    table_inputs = (params["rig"], params["targets"], params["start"])
    inputs = [path for path in table_inputs if path is not None]
    check_plot(params["plot"], inputs, overwrite=params["overwrite"])
    with console.progress(f"measure {params['targets'].name}") as progress:
        report = ik_tradeoffs(_ik_job(params), progress=progress)
    print_tradeoffs(console, report, params["report_format"], params["plot"])


def _ik_job(params: dict[str, Any]) -> Any:
    from animtool.scene.solves.ik import IkJob

    pose, degrees = params["pose"], params["tol_degrees"]
    return IkJob(
        rig=params["rig"],
        targets=params["targets"],
        start=params["start"],
        source=_start_options(params),
        pose=pose is not None,
        frame=None if pose == FIRST_FRAME else pose,
        options=TakeOptions(**read_values(TakeOptions, params)),
        tolerance=params["tol"],
        angle_tolerance=None if degrees is None else math.radians(degrees),
        output=params["output"],
        bake=_bake_options(params),
    )


def _bake_options(params: dict[str, Any]) -> Any:
    """Return the options for writing the output; refuse those without effect on it."""
    output = params["output"]
    value_by_flag = {
        "--split": params["split"],
        "--rig-layer": params["rig_layer"],
        "--force-fit": params["force_fit"],
        "--prim-path": params["prim_path"],
        "--start": params["first_code"],
        "--sparse": params["sparse"],
    }
    if params["reduce"] is not None and output is None:
        raise click.UsageError("--reduce needs an output: pass -o.")
    output_flags = [flag for flag, value in value_by_flag.items() if value]
    from animtool.scene.sources.open import is_usd

    if output_flags and output is None:
        raise click.UsageError(f"{output_flags[0]} needs an output: pass -o.")
    if output_flags and str(output) != "-" and not is_usd(output):
        raise click.UsageError(f"{output_flags[0]} applies to USD, not to {output}.")
    return read_output_options(
        params,
        start=params["first_code"],
        sparse=params["sparse"],
        shot=params["shot"],
        strict=params["strict"],
    )

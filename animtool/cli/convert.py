"""``animtool convert``: takes, rigs and markers to other formats."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from animtool.cli.console import Console
from animtool.cli.help import command
from animtool.cli.options import (
    INPUT,
    bake_option,
    read_source_options,
    source_option,
    source_options,
    source_prim_option,
    strict_option,
)
from animtool.cli.outputs import (
    atomic_command,
    refuse_swapped,
    skip_existing_outputs,
    writing_options,
)
from animtool.clip.reduction.tolerance import KEY_TOLERANCE
from animtool.core.errors import counted
from animtool.core.names import has_kind_suffix
from animtool.core.record import dataclass
from animtool.report.text import Template


@command(
    epilog="""\b
Examples:
  animtool convert walk.usdc walk.bvh
  animtool convert walk.bvh walk.clip.yaml --reduce 0.5mm
  animtool convert shot.usda hero.bvh --source-prim /World/hero
  animtool convert take.csv face.clip.yaml
  animtool convert walk.usdc walk.mot
  animtool convert ik.mot walk.bvh --rig hero.rig.yaml
  animtool convert hero.rig.yaml hero.usda --physics
  animtool convert hero.usda hero.rig.yaml
  animtool convert capture.c3d capture.trc"""
)
@click.argument("source", type=INPUT)
@click.argument("output", type=INPUT, required=False, metavar="OUTPUT")
@click.option(
    "-o",
    "--output",
    "named_output",
    type=INPUT,
    metavar="PATH",
    help="OUTPUT, as other commands name it.",
)
@source_options
@source_prim_option
@source_option("rig", "take", "dropped", "positions")
@bake_option(
    "reduce",
    help_text="For a clip: largest error of joints from leaving out keys, such as "
    f"0.5mm.  [default: {KEY_TOLERANCE}]",
)
@bake_option("reduce_at", "placement")
@click.option(
    "--base",
    type=INPUT,
    metavar="FILE",
    help="SOURCE is an additive take: measure its keys on top of this one.",
)
@click.option(
    "--physics",
    is_flag=True,
    help="For a rig to USD: also write NAME.physics.usda, with joint types and limits.",
)
@strict_option
@writing_options
def convert(
    console: Console, /, source: Path, output: Path | None, **params: Any
) -> None:
    """Convert SOURCE to OUTPUT: BVH, USD, CSV, MOT or a clip to one of these.

    For a glTF with several clips, OUTPUT may be a folder: one USD file per clip.

    A clip (.clip.yaml) gets sparse, editable keys, and its rig file next to it.
    Joints that came from a BVH get their channel order and names back.

    A rig (.rig.yaml) becomes a USD layer for animation layers to go over, and
    converts back unchanged, with its arrays in an npz file next to it.

    Markers are converted between C3D, TRC and npz.
    """
    output = _output_path(source, output, params.pop("named_output"))
    from animtool.formats.marker_files import is_marker_file

    if is_marker_file(source) and is_marker_file(output):
        _convert_markers(console, source, output, params)
        return
    may_be_folder = not output.suffix and params["take"] is None
    if may_be_folder and _convert_all_takes(source, output, params):
        return
    from animtool.core.readers import is_rig_only
    from animtool.core.writers import holds_rig, take_writer
    from animtool.scene.convert.takes import convert as run_convert

    is_rig_conversion = (
        has_kind_suffix(source, "rig")
        or has_kind_suffix(output, "rig")
        or params["physics"]
        or (is_rig_only(source) and holds_rig(output))
    )
    if is_rig_conversion:
        from animtool.scene.convert.rigs import rig_outputs

        outputs = rig_outputs(output, physics=params["physics"])
    else:
        outputs = take_writer(output).files(output)
    if skip_existing_outputs(console, "convert", params, output, lambda: outputs):
        return
    if is_rig_conversion:
        _convert_rig(console, source, output, params)
        return
    options = read_source_options(
        params,
        *("rig", "take", "dropped", "positions"),
        prim_path=params["prim_path"],
        placement=params["placement"],
    )
    with atomic_command(), console.progress(f"convert {source.name}") as progress:
        report = run_convert(
            source,
            output,
            options,
            overwrite=params["overwrite"],
            strict=params["strict"],
            reduce=params["reduce"],
            reduce_at=params["reduce_at"],
            base=params["base"],
            progress=progress,
        )
    from animtool.cli.summary import CONVERT_TEMPLATE

    console.report(params["report_format"], report, CONVERT_TEMPLATE, report.notices)


def _output_path(source: Path, output: Path | None, output_option: Path | None) -> Path:
    """Return OUTPUT from the argument or from -o; refuse swapped arguments."""
    if output is not None and output_option is not None:
        raise click.UsageError("OUTPUT and -o both name the output: use one of them.")
    output = output or output_option
    if output is None:
        context = click.get_current_context()
        raise click.MissingParameter(None, context, None, "'OUTPUT'", "argument")
    refuse_swapped(source, output, "SOURCE and OUTPUT")
    return output


def _convert_all_takes(source: Path, folder: Path, params: dict[str, Any]) -> bool:
    """Convert each take of a file to a USD file in a folder.

    Returns whether the file contains any takes.
    """
    from animtool.core.readers import reader_of
    from animtool.usd.layers.names import distinct_names

    reader = reader_of(source)
    names = [] if reader is None else reader.take_names(source)
    if not names:
        return False
    folder.mkdir(parents=True, exist_ok=True)
    legal_names = distinct_names(names, names, names).names
    context = click.get_current_context()
    for name, stem in zip(names, legal_names, strict=True):
        files = {"source": source, "output": folder / f"{stem}.usdc"}
        take_params = {**params, **files, "named_output": None, "take": name}
        context.invoke(convert, **take_params)
    return True


@dataclass(frozen=True, slots=True)
class _ConvertedFile:
    """Report of a converted marker file."""

    frames: int
    markers: int
    notices: tuple[()] = ()


def _convert_markers(
    console: Console, source: Path, output: Path, params: dict[str, Any]
) -> None:
    from animtool.cli.marker_files import run_on_markers

    names = "prim_path rig take reduce reduce_at base physics placement"
    _refuse_options(params, names, "does not apply to markers")

    def count_markers(markers: Any) -> tuple[Any, Any]:
        return markers, _ConvertedFile(len(markers), len(markers.names))

    run_on_markers(console, "convert", (source,), output, params, count_markers)


def _refuse_options(params: dict[str, Any], names: str, reason: str) -> None:
    """Refuse the first option that is set; ``names`` are separated by spaces."""
    for name in names.split():
        if params[name]:
            raise click.UsageError(f"--{name.replace('_', '-')} {reason}.")


def _convert_rig(
    console: Console, source: Path, output: Path, params: dict[str, Any]
) -> None:
    from animtool.scene.convert.rigs import convert_rig

    names = "reduce reduce_at base units up source_fps take rig placement"
    _refuse_options(params, names, "applies to motion, not to a rig")
    with atomic_command():
        report = convert_rig(
            source,
            output,
            prim_path=params["prim_path"],
            physics=params["physics"],
            overwrite=params["overwrite"],
            strict=params["strict"],
        )
    console.report(params["report_format"], report, _RIG_TEMPLATE, report.notices)


_RIG_TEMPLATE = Template(
    "animtool.scene.convert.rigs:RigReport",
    (
        "{outputs:join}: [{counts:several}]",
        "[  {physics:n joint} as UsdPhysics has them]",
    ),
    {
        "several": lambda counts: ", ".join(
            counted(count, *noun.split("/")) for noun, count in counts.items() if count
        )
    },
)

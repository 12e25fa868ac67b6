"""``animtool diff``: the largest differences of two takes or layers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import click

from animtool.cli.console import Console
from animtool.cli.help import command
from animtool.cli.options import (
    DISTANCE,
    INPUT,
    TOLERANCE,
    Command,
    common_options,
    format_option,
    read_source_options,
    source_option,
    source_options,
)
from animtool.core.errors import ExitCode, counted
from animtool.core.record import dataclass
from animtool.report.text import Each, Template

if TYPE_CHECKING:
    from animtool.report.compare import TakeDifference
    from animtool.report.compare_points import PointsDifference


def _difference_template(kind: str, value_format: str, location_format: str) -> str:
    """Return the text template of the largest difference of one quantity."""
    label_width = 14 if "prim" in location_format else 12
    location = location_format.replace("@", kind)
    return (
        f"  {kind:<{label_width}}{{{kind}.value:{value_format}}}"
        f"[{{?{kind}.value}}  {location}, time code {{{kind}.code:frame}}"
        + (f"[, {{{kind}.skeleton}}]]" if label_width == 12 else "]")
    )


_JOINT, _POINT = "joint {@.joint:repr}", "{@.prim:repr}, point {@.point}"
_SHAPE = "shape {@.shape:repr}"
_DIFFERENCES = (Each("mismatches", ("  {self}",)), Each("notes", ("  note: {self}",)))
_TAKES_TEMPLATE = Template(
    "animtool.report.compare:TakeDifference",
    (
        "[{!joints}{!shapes}no joint is in both files|"
        "[{skeletons:several}, ]{joints:n joint}, [{?shapes}{shapes:n shape}, ]"
        "{frames:n frame} compared]",
        f"[{{?joints}}{_difference_template('world', 'length', _JOINT)}]",
        f"[{{?joints}}{_difference_template('translation', 'length', _JOINT)}]",
        "[{?joints}"
        + _difference_template("rotation", "plain", _JOINT).replace(
            "plain}", "plain} deg"
        )
        + "]",
        f"[{{?joints}}{_difference_template('scale', 'plain', _JOINT)}]",
        f"[{{?shapes}}{_difference_template('weight', 'plain', _SHAPE)}]",
        *_DIFFERENCES,
    ),
    {"several": lambda count: counted(count, "skeleton") if count > 1 else ""},
)
_POINTS_TEMPLATE = Template(
    "animtool.report.compare_points:PointsDifference",
    (
        "{prims:n prim}, {samples:n sample} compared",
        _difference_template("points", "length", _POINT),
        _difference_template("orientations", "plain", _POINT).replace(
            "plain}", "plain} deg"
        ),
        _difference_template("scales", "plain", _POINT),
        *_DIFFERENCES,
    ),
)


@dataclass(frozen=True, slots=True)
class Comparison:
    """Difference of two files, and whether it is within the tolerances."""

    difference: TakeDifference | PointsDifference
    same: bool
    json_keys: ClassVar[str] = "'diff' same *difference"


def _add_source_options(command: Command) -> Command:
    """Add the source options that apply to both files or to one of them."""
    for name, field, metavar, description in (
        ("take", "take", "NAME", "The take to read from clip libraries in USD"),
        ("source-prim", "prim_path", "PATH", "The character, where a file has several"),
    ):
        for flag, param, help_text in (
            (f"--{name}-b", f"{field}_b", "The same, for SECOND only."),
            (f"--{name}-a", f"{field}_a", "The same, for FIRST only."),
            (f"--{name}", field, f"{description}."),
        ):
            option = click.option(flag, param, metavar=metavar, help=help_text)
            command = option(command)
    return command


def _tolerance_option(
    name: str, field: str, default: float, metavar: str, text: str
) -> Callable[[Command], Command]:
    return click.option(
        name,
        field,
        type=TOLERANCE,
        default=default,
        show_default=True,
        metavar=metavar,
        help=text,
    )


@command(
    epilog="""\b
Examples:
  animtool diff walk.bvh walk.usdc
  animtool diff old.usdc new.usdc --tolerance 0.1mm --angle-tolerance .01
  animtool diff walk.bvh library.usda --take-b walk"""
)
@click.argument("first", type=INPUT)
@click.argument("second", type=INPUT)
@click.option(
    "--tolerance",
    "tol",
    type=DISTANCE,
    default=1e-5,
    show_default=True,
    metavar="LENGTH",
    help="Distance to ignore, such as 1mm; a number alone is in metres.",
)
@_tolerance_option(
    "--angle-tolerance", "tol_degrees", 1e-3, "DEGREES", "Rotation to ignore."
)
@_tolerance_option(
    "--weight-tolerance", "tol_weight", 1e-5, "WEIGHT", "Shape weight to ignore."
)
@_add_source_options
@source_options
@source_option("positions")
@format_option
@common_options
@click.pass_obj
def diff(console: Console, /, first: Path, second: Path, **params: Any) -> None:
    """Compare the takes of FIRST and SECOND, joints by name, in metres.

    Weights of blend shapes are compared too, and every skeleton of USD files unless
    --source-prim names one. In USD files without a character, points, curves, meshes
    and instances are compared, by their ids. Exit code 1: they differ by more than
    the tolerances, or in their joints, moving shapes, prims, frames or rates.
    """
    from animtool.report.compare import compare
    from animtool.scene.sources.open import is_usd

    difference: Any = None
    tolerances: tuple[float, ...]
    if is_usd(first) and is_usd(second):
        from animtool.report.compare_points import compare_points

        difference = compare_points(first, second)
    if difference is not None:
        tolerances = params["tol"], params["tol_degrees"]
        template, notices = _POINTS_TEMPLATE, []
    else:
        difference = compare(first, second, *_source_options(first, second, params))
        tolerances = params["tol"], params["tol_degrees"], params["tol_weight"]
        template, notices = _TAKES_TEMPLATE, difference.notices
    is_within = difference.within(*tolerances)
    notices = [*notices, *difference.tolerance_warnings(*tolerances)]
    if params["report_format"] == "json":
        console.result_json(Comparison(difference, is_within))
    else:
        console.result(*template.text(difference), "same" if is_within else "different")
    console.faults(notices)
    exit_code = ExitCode.OK if is_within else ExitCode.FINDINGS
    click.get_current_context().exit(int(exit_code))


def _source_options(first: Path, second: Path, params: dict[str, Any]) -> list[Any]:
    """Return the source options of either file; specific ones override shared ones."""
    from animtool.scene.sources.open import fitting_options

    shared_options = read_source_options(
        params, "take", "positions", prim_path=params["prim_path"]
    )
    options = []
    for path, letter in ((first, "a"), (second, "b")):
        values = {name: params[f"{name}_{letter}"] for name in ("take", "prim_path")}
        specific_values = {k: value for k, value in values.items() if value is not None}
        fitted_options = fitting_options(shared_options, path, [first, second])
        options.append(replace(fitted_options, **specific_values))
    return options

"""Options and value types that commands share."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from animtool.cli.console import Console

if TYPE_CHECKING:
    from animtool.shot import Shot

Command = TypeVar("Command", bound=Callable[..., Any])


class Parsed(click.ParamType[Any]):
    """A value that a function makes of text, `ValueError` being a usage error."""

    def __init__(self, name: str, parse: Callable[[str], Any]) -> None:
        self.name = name
        self._parse = parse

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> Any:
        """Parse text; anything else is a default and stays as it is."""
        if not isinstance(value, str):
            return value
        try:
            return self._parse(value)
        except ValueError as error:
            self.fail(f"{error}.", param, ctx)


def _rate(text: str) -> Any:
    from animtool.rates import parse_rate

    return parse_rate(text)


def _length(text: str) -> float:
    from animtool.units import parse_length

    return parse_length(text)


def _tolerance(text: str) -> float:
    value = float(text)
    # Nothing is within a tolerance that is no number.
    if not value >= 0:
        raise ValueError(f"{text!r} is no tolerance: a number from 0 up is needed")
    return value


def _distance(text: str) -> float:
    """Return a distance [m]; a number alone is in metres."""
    try:
        return _tolerance(text)
    except ValueError:
        return _length(text)


def count_or_auto(text: str) -> int | None:
    """Return a number from 1 up; None for ``auto``."""
    if text == "auto":
        return None
    if not text.isdigit() or not int(text):
        raise ValueError(f"{text!r} is neither auto nor a number from 1 up")
    return int(text)


def _joint_length(text: str) -> tuple[str, float]:
    name, equals, length = text.rpartition("=")
    if not equals or not name:
        raise ValueError(f"{text!r} is not a joint and a length, such as hand_l=0.1mm")
    return name, _length(length)


def _variable(text: str) -> tuple[str, str]:
    from animtool.documents.names import is_variable_name

    name, equals, value = text.partition("=")
    if not equals or not is_variable_name(name):
        raise ValueError(f"{text!r} is not a name and a value, such as shot=sh020")
    return name, value


# What a file cannot be read for is said by whatever reads it.
# A file that is looked for later, with a fault of its own.
FILE = click.Path(path_type=Path, dir_okay=False)
INPUT = click.Path(path_type=Path, readable=False)
OUTPUT = click.Path(path_type=Path, allow_dash=True, readable=False)
RATE = Parsed("rate", _rate)
LENGTH = Parsed("length", _length)
DISTANCE = Parsed("length", _distance)
TOLERANCE = Parsed("tolerance", _tolerance)


def _set(name: str, value: Any) -> Callable[..., None]:
    def apply(ctx: click.Context, _: click.Parameter, given: Any) -> None:
        console = ctx.find_object(Console)
        if console is not None and given:
            setattr(console, name, value)

    return apply


def common_options(command: Command) -> Command:
    """Add the options of every command: how much to say, and how."""
    for decorator in (
        click.option(
            "--debug",
            is_flag=True,
            expose_value=False,
            is_eager=True,
            envvar="ANIMTOOL_DEBUG",
            callback=_set("debug", True),
            help="Show Python tracebacks.",
        ),
        click.option(
            "--log-format",
            type=click.Choice(["text", "json"]),
            default="text",
            expose_value=False,
            is_eager=True,
            envvar="ANIMTOOL_LOG_FORMAT",
            help="How lines on stderr are written.",
            show_default=True,
        ),
        click.option(
            "-v",
            "--verbose",
            is_flag=True,
            expose_value=False,
            callback=_set("verbosity", 1),
            help="Say more.",
        ),
        click.option(
            "-q",
            "--quiet",
            is_flag=True,
            expose_value=False,
            callback=_set("verbosity", -1),
            help="Say nothing but errors.",
        ),
    ):
        command = decorator(command)
    return command


def reduce_at_option(command: Command) -> Command:
    """Add ``--reduce-at``."""
    return click.option(
        "--reduce-at",
        type=Parsed("joint_length", _joint_length),
        metavar="JOINT=LENGTH",
        multiple=True,
        help="Another tolerance of --reduce for a joint, or for those that fit a "
        "pattern, such as 'hand_*=0.1mm'; can be given several times.",
    )(command)


def set_option(command: Command) -> Command:
    """Add ``--set``."""
    return click.option(
        "--set",
        "variables",
        type=Parsed("variable", _variable),
        metavar="NAME=VALUE",
        multiple=True,
        help="What ${NAME} stands for in a scene, such as shot=sh020; can be given "
        "several times.",
    )(command)


def rig_layer_options(command: Command) -> Command:
    """Add ``--rig-layer``, ``--prim-path`` and ``--force-fit``, of layers."""
    prim_path = click.option(
        "--prim-path",
        metavar="PATH",
        help="Where the character stands, such as /World/hero.",
    )
    rig_layer = click.option(
        "--rig-layer",
        type=INPUT,
        metavar="FILE",
        help="The rig in USD that a layer is for, or a shot that holds it; its units, "
        "up axis, rate and start are adopted.",
    )
    force_fit = click.option(
        "--force-fit",
        is_flag=True,
        help="Write a take that does not fit the rig all the same.",
    )
    return rig_layer(prim_path(force_fit(command)))


def strict_option(command: Command) -> Command:
    """Add ``--strict``."""
    return click.option(
        "--strict", is_flag=True, help="Take warnings for errors and write nothing."
    )(command)


def format_option(command: Command) -> Command:
    """Add ``--format``."""
    return click.option(
        "--format",
        "report_format",
        type=click.Choice(["text", "json"]),
        default="text",
        show_default=True,
        help="Report as text, or as JSON on stdout.",
    )(command)


def source_options(command: Command) -> Command:
    """Add what states about a source what its file leaves open."""
    for decorator in (
        click.option(
            "--source-fps",
            type=RATE,
            metavar="RATE",
            help="The real frame rate of a BVH whose Frame Time is wrong.",
        ),
        click.option(
            "--up",
            type=click.Choice(["Y", "Z"], case_sensitive=False),
            help="Up axis of a BVH.  [default: Y]",
        ),
        click.option(
            "--units",
            type=click.Choice(["m", "cm", "mm", "in"]),
            help="Unit of a BVH's lengths.  [default: cm]",
        ),
    ):
        command = decorator(command)
    return command


def take_option(command: Command) -> Command:
    """Add ``--take``."""
    return click.option(
        "--take",
        metavar="NAME",
        help="The take to read of a clip library in USD.  [default: the one selected]",
    )(command)


def source_prim_option(command: Command) -> Command:
    """Add ``--source-prim``."""
    return click.option(
        "--source-prim",
        metavar="PATH",
        help="The character to read, where a USD source has several.",
    )(command)


def source_options_record(
    given: Mapping[str, Any],
    prim_path: str | None = None,
    rig: Path | None = None,
    *,
    clamp: bool = False,
    take: str | None = None,
    shot: Shot | None = None,
) -> Any:
    """Return the record of `source_options`, and of what a command has beside them."""
    units, up = given["units"], given["up"]
    from animtool.scene.sources import SourceOptions
    from animtool.units import LengthUnit, UpAxis

    return SourceOptions(
        None if units is None else LengthUnit(units),
        None if up is None else UpAxis(up.upper()),
        given["source_fps"],
        prim_path,
        rig,
        clamp,
        take,
        shot=shot,
    )

"""Options and value types that several commands share."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any, TypeVar

import click

from animtool.cli.console import SOURCE_NAMES, Console, FlagNamer, flag_of
from animtool.cli.help import ARGUMENTS_KEY
from animtool.core.arguments import name_arguments
from animtool.core.errors import Severity
from animtool.core.names import is_variable_name
from animtool.core.options import Option, options_of
from animtool.core.process.supervisor import stdin_lines
from animtool.core.rates import parse_rate
from animtool.core.timecode import is_timecode
from animtool.core.units import LengthUnit, UpAxis, parse_length
from animtool.scene.bake.options import BakeOptions
from animtool.scene.file.option_text import (
    parse_frame,
    parse_frame_range,
    parse_frames,
    parse_offsets,
    parse_rest,
    parse_source_rest,
)
from animtool.scene.sources.open import SourceOptions

Command = TypeVar("Command", bound=Callable[..., Any])


class ParsedType(click.ParamType[Any]):
    """Click type that converts with a function; its `ValueError` is a usage error."""

    def __init__(self, name: str, parse: Callable[[str], Any]) -> None:
        self.name = name
        self._parse = parse

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> Any:
        """Parse a text; return default values unchanged."""
        if not isinstance(value, str):
            return value
        try:
            return self._parse(value)
        except ValueError as error:
            self.fail(f"{error}.", param, ctx)


def _parse_timecode(text: str) -> str:
    if not is_timecode(text):
        message = f"{text!r} is not a time code such as 01:00:00:00 or 01:00:00;02"
        raise ValueError(message)
    return text.strip()


def _parse_tolerance(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    # NaN is no tolerance.
    if not value >= 0:
        from animtool.documents.value_faults import number_hint

        hint = number_hint("", text) if math.isnan(value) else None
        message = f"{text!r} is not a number from 0 up"
        raise ValueError(f"{message}; {hint}" if hint else message)
    return value


def _parse_distance(text: str) -> float:
    """Parse a distance [m]."""
    try:
        return _parse_tolerance(text)
    except ValueError:
        return parse_length(text)


def count_or_auto(text: str) -> int | None:
    """Parse a positive integer; return None for ``auto``."""
    if text == "auto":
        return None
    if not text.isdigit() or not int(text):
        raise ValueError(f"{text!r} is neither auto nor a whole number from 1 up")
    return int(text)


def parse_names(text: str | None) -> tuple[str, ...]:
    """Parse comma-separated names."""
    return tuple(name.strip() for name in (text or "").split(",") if name.strip())


class Count(click.IntRange):
    """Click type of integers with a minimum."""

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> Any:
        """Return the parsed integer, or fail if it is too small."""
        try:
            return super().convert(value, param, ctx)
        except click.BadParameter:
            range_end = f" to {self.max}" if self.max is not None else " up"
            rule = f"{value!r} is not a whole number from {self.min}{range_end}"
            if param is not None and param.metavar == "FRAMES":
                rule += "; it counts frames, not seconds"
            self.fail(f"{rule}.", param, ctx)


def _parse_integer(text: str) -> int:
    try:
        value = int(text)
    except ValueError:
        value = -1
    if value < 0:
        raise ValueError(f"{text!r} is not a whole number from 0 up")
    return value


def parse_positive(text: str) -> float:
    """Parse a number above 0."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not value > 0:
        raise ValueError(f"{text!r} is not a number above 0")
    return value


def _parse_joint_length(text: str) -> tuple[str, float]:
    name, equals, length = text.rpartition("=")
    if not equals or not name:
        raise ValueError(f"{text!r} is not a joint and a length, such as hand_l=0.1mm")
    return name, parse_length(length)


def _parse_variable(text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not equals or not is_variable_name(name):
        raise ValueError(f"{text!r} is not a name and a value, such as shot=sh020")
    return name, value


class _CodesType(click.ParamType[Any]):
    """Click type of codes, which refuses paths."""

    name = "codes"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> Any:
        """Return the names, or fail if one is the path of a file or folder."""
        if not isinstance(value, str):
            return value
        from animtool.validation.options import matches_code

        names = parse_names(value)
        for name in names:
            path = Path(name)
            if path.exists() and not matches_code(name):
                kind = "folder" if path.is_dir() else "file"
                hint = "a code is such as CLIP2"
                if ctx is not None and param is not None:
                    arguments = ctx.meta.get(ARGUMENTS_KEY, ())
                    code = next(filter(matches_code, (*names, *arguments)), "CODE")
                    hint = f"write {ctx.command_path} {name} {param.opts[-1]} {code}"
                self.fail(f"{name!r} is a {kind}, not a code; {hint}.", param, ctx)
        return names


def _parse_severity(text: str) -> tuple[str, Severity]:
    code, equals, name = text.partition("=")
    if not equals or not code or name not in list(Severity):
        levels = ", ".join(Severity)
        raise ValueError(f"{text!r} is not CODE=SEVERITY; severities are {levels}")
    return code, Severity(name)


def _parse_processes(text: str) -> int:
    if not text.isdigit() or not int(text):
        raise ValueError(f"{text!r} is not a number of processes from 1 up")
    return int(text)


class _FilePath(click.Path):
    """The path of a file; an empty text is refused."""

    def convert(
        self,
        value: Any,
        param: click.Parameter | None,
        ctx: click.Context | None,
    ) -> Any:
        if value == "":
            message = "the path is empty; is a variable of the shell not set?"
            self.fail(message, param, ctx)
        return super().convert(value, param, ctx)


# Unreadable files are reported by their reader.
FILE = _FilePath(path_type=Path, dir_okay=False)
INPUT = _FilePath(path_type=Path, readable=False)
OUTPUT = _FilePath(path_type=Path, allow_dash=True, readable=False)
RATE = ParsedType("rate", parse_rate)
LENGTH = ParsedType("length", parse_length)
DISTANCE = ParsedType("length", _parse_distance)
TOLERANCE = ParsedType("tolerance", _parse_tolerance)


def output_option(
    help_text: str, *, kind: click.Path = INPUT, **settings: Any
) -> Callable[[Command], Command]:
    """Return a decorator that adds ``-o``; ``settings`` are those of `click.option`."""
    return click.option("-o", "--output", type=kind, help=help_text, **settings)


def _console_callback(name: str, value: Any) -> Callable[..., None]:
    def set_value(ctx: click.Context, _: click.Parameter, option_value: Any) -> None:
        console = ctx.find_object(Console)
        if console is not None:
            console.namer = FlagNamer(ctx.command)
            console.context = ctx
        if console is not None and option_value:
            setattr(console, name, value)

    return set_value


def stack_options(*decorators: Callable[[Any], Any]) -> Callable[[Command], Command]:
    """Return a decorator that applies several option decorators in order."""

    def add_options(command: Command) -> Command:
        for option in reversed(decorators):
            command = option(command)
        return command

    return add_options


# Options of every command: verbosity and format of messages.
common_options = stack_options(
    click.option(
        "-q",
        "--quiet",
        is_flag=True,
        expose_value=False,
        callback=_console_callback("verbosity", -1),
        help="Print only errors.",
    ),
    click.option(
        "-v",
        "--verbose",
        is_flag=True,
        expose_value=False,
        callback=_console_callback("verbosity", 1),
        help="Say more.",
    ),
    click.option(
        "--log-format",
        type=click.Choice(["text", "json"]),
        default="text",
        expose_value=False,
        is_eager=True,
        envvar="ANIMTOOL_LOG_FORMAT",
        help="Format of lines on stderr.",
        show_default=True,
    ),
    click.option(
        "--debug",
        is_flag=True,
        expose_value=False,
        is_eager=True,
        envvar="ANIMTOOL_DEBUG",
        callback=_console_callback("debug", True),
        help="Show Python tracebacks.",
    ),
)


# Click type and help metavar of each kind of option.
_CLICK_TYPES: dict[str, tuple[Any, str | None]] = {
    "text": (str, None),
    "file": (INPUT, "FILE"),
    "output": (FILE, None),
    "unit": (click.Choice(["m", "cm", "mm", "in"]), None),
    "axis": (click.Choice(["Y", "Z"], case_sensitive=False), None),
    "rate": (RATE, "RATE"),
    "range": (ParsedType("frame_range", parse_frame_range), "A-B[xN]"),
    "frames": (ParsedType("frames", parse_frames), "A-B[xN]|A,B,..."),
    "texts": (str, "TEXT"),
    "frame": (ParsedType("frame", parse_frame), "FRAME"),
    "rest": (ParsedType("rest", parse_rest), None),
    "source_rest": (ParsedType("rest", parse_source_rest), None),
    "offsets": (ParsedType("offsets", parse_offsets), "OFFSETS"),
    "length": (LENGTH, "LENGTH"),
    "lengths": (ParsedType("joint_length", _parse_joint_length), "JOINT=LENGTH"),
    "names": (ParsedType("text", parse_names), "NAME,..."),
    "angle": (TOLERANCE, "DEGREES"),
    "amount": (TOLERANCE, None),
    "seed": (ParsedType("whole number", _parse_integer), None),
    "codes": (_CodesType(), "CODE,…"),
    "severities": (ParsedType("severity", _parse_severity), "CODE=SEVERITY"),
    "processes": (ParsedType("processes", _parse_processes), "N"),
}
# Kinds whose options can be repeated.
_REPEATABLE_KINDS = {"lengths", "codes", "severities", "texts"}


class _ChoiceType(click.ParamType[Any]):
    """Click type of a name from a list, which the help shows in full."""

    name = "name"

    def __init__(self, names: tuple[str, ...]) -> None:
        self._names = names

    def get_metavar(self, param: click.Parameter, ctx: click.Context) -> str:
        """Return the names for the help."""
        del param, ctx
        return "|".join(self._names)

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> Any:
        """Return the choice that a text names."""
        if value not in self._names:
            self.fail(f"{value!r} is not one of {', '.join(self._names)}.", param, ctx)
        return self._names[self._names.index(value)]


def declare_option(
    option: Option,
    name: str,
    default: Any = None,
    param_name: str | None = None,
    help_text: str | None = None,
) -> Callable[[Command], Command]:
    """Return a decorator that adds the option declared on a field of a record.

    The parameter of the command is called ``param_name`` if that differs from the
    field, and ``help_text`` replaces the help of the record.
    """
    flag_name, metavar = option.flag or name.replace("_", "-"), option.metavar
    flag, text = f"--{flag_name}", name_arguments(help_text or option.help, flag_of)
    param, is_switch = param_name or name, option.kind == "switch"
    if option.kind == "answer":
        both_flags = f"{flag}/--no-{flag_name}"
        return click.option(both_flags, param, default=None, help=text)
    if option.choices and option.kind != "name":
        return click.option(
            flag,
            param,
            type=click.Choice(option.choices),
            default=option.choices[0] if is_switch else default,
            show_default=not is_switch and default is not None,
            help=text,
        )
    if is_switch:
        return click.option(flag, param, is_flag=True, help=text)
    if option.kind == "count":
        click_type: Any = Count(option.min_count)
    elif option.kind == "name":
        click_type = _ChoiceType(option.choices)
    else:
        click_type, default_metavar = _CLICK_TYPES[option.kind]
        metavar = metavar or default_metavar
    default = default if option.text_default is None else option.text_default
    if option.kind == "processes":
        default = None  # commands choose the number; scripts must set it
    return click.option(
        *filter(None, (option.short_flag, flag)),
        param,
        type=click_type,
        metavar=metavar,
        default=default,
        show_default=default not in {None, ()} and "[default: " not in text,
        multiple=option.kind in _REPEATABLE_KINDS,
        help=text,
    )


def record_options(
    record: type,
    *names: str,
    param_names: Mapping[str, str] | None = None,
    help_text: str | None = None,
) -> Callable[[Command], Command]:
    """Return a decorator that adds the named options of a record; without names, all.

    param_names: Names in the command that differ from the fields'.
    help_text: Help texts that differ from the record's.
    """
    options, params = options_of(record), param_names or {}
    defaults = {e.name: e.default for e in fields(record) if e.default is not MISSING}
    decorators = [
        declare_option(options[n], n, defaults.get(n), params.get(n), help_text)
        for n in names or options
    ]
    return stack_options(*decorators)


def read_values(record: type, params: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of a record's fields from the parameters of a command."""
    return {
        name: read_value(option, params[name])
        for name, option in options_of(record).items()
        if name in params
    }


def read_value(option: Option, value: Any) -> Any:
    """Convert a command-line value to the type of a record's option."""
    if value is None:
        return None
    if option.kind == "switch" and option.choices:
        return value == option.choices[1]
    converter = _CONVERTERS.get(option.kind)
    return value if converter is None else converter(value)


_CONVERTERS: dict[str, Callable[[Any], Any]] = {
    "unit": LengthUnit,
    "axis": lambda axis: UpAxis(axis.upper()),
    "angle": math.radians,
    "codes": lambda code_lists: tuple(code for codes in code_lists for code in codes),
    "severities": dict,
}


def source_option(*names: str) -> Callable[[Command], Command]:
    """Return a decorator that adds the named options of `SourceOptions` in order."""
    return record_options(SourceOptions, *names, param_names=SOURCE_NAMES)


def bake_option(
    *names: str, help_text: str | None = None
) -> Callable[[Command], Command]:
    """Return a decorator that adds the named options of `BakeOptions` in order.

    help_text: Help text of a single option, if it differs from the record's.
    """
    return record_options(BakeOptions, *names, help_text=help_text)


rig_layer_options = bake_option("rig_layer", "prim_path", "force_fit")
source_options = source_option("unit", "up", "fps")
# For commands without an option for the output's prim path.
source_prim_option = click.option(
    "--source-prim",
    "prim_path",
    metavar="PATH",
    help="The character, where a stage has several.",
)


variables_option = click.option(
    "--set",
    "variables",
    type=ParsedType("variable", _parse_variable),
    metavar="NAME=VALUE",
    multiple=True,
    help="Value of ${NAME} in a scene, such as shot=sh020; repeatable.",
)


strict_option = bake_option("strict")
format_option = click.option(
    "--format",
    "report_format",
    type=click.Choice(["text", "json"]),
    default="text",
    show_default=True,
    help="Report as text, or as JSON on stdout.",
)


def listed_paths(texts: Iterable[str]) -> Iterator[str]:
    """Yield the paths on the command line; for ``-``, yield the lines of stdin."""
    for text in texts:
        if text == "-":
            yield from filter(None, stdin_lines())
        else:
            yield text


def read_source_options(
    params: Mapping[str, Any], *names: str, **values: Any
) -> SourceOptions:
    """Return `SourceOptions` from the parameters of a command and other values."""
    record_values = {
        name: read_value(option, params[SOURCE_NAMES.get(name, name)])
        for name, option in options_of(SourceOptions).items()
        if name in {"unit", "up", "fps", *names}
    }
    return SourceOptions(**record_values, **values)


# Options of a timeline: first frames of its cuts, and time codes of its media.
TIMECODE_OPTIONS = (
    click.option(
        "--cut-start",
        type=Count(-(10**9), 10**9),
        metavar="FRAME",
        help="First frame of the cut of a timeline, after the handles.  [default: as "
        "the timeline states, else the handles begin at 1001]",
    ),
    click.option(
        "--first-timecode",
        type=ParsedType("timecode", _parse_timecode),
        metavar="HH:MM:SS:FF",
        help="Time code of the first frame of each take of a timeline.  [default: as "
        "the timeline states, else 00:00:00:00]",
    ),
)

"""What commands call arguments that texts name."""

from __future__ import annotations

import click

from animtool.core.arguments import Argument, Calling, flag

# What commands call options of a source, where others of theirs have the name.
SOURCE_NAMES = {"fps": "source_fps", "prim_path": "source_prim", "unit": "units"}


def as_flag(argument: Argument) -> str:
    """Return an argument as commands have it whose options are called as it is.

    >>> as_flag(Argument("rig_layer")), as_flag(Argument("normals", "false"))
    ('--rig-layer', '--no-normals')
    """
    word = argument.field.replace("_", "-")
    if argument.switch is not None:
        return flag(word if argument.switch else f"no-{word}")
    return flag(word, argument.value or "")


def calling_of(command: click.Command) -> Calling:
    """Return what a command calls arguments that it has: its flags."""

    def called(argument: Argument) -> str | None:
        option = _option(command, argument)
        if option is None:
            return None
        name, value = option.opts[0], argument.value or ""
        if argument.switch is False and option.secondary_opts:
            return option.secondary_opts[0]
        if argument.switch is not None:
            kind = option.type
            value = str(kind.choices[-1]) if isinstance(kind, click.Choice) else ""
        return f"{name} {value}".rstrip()

    return called


def _option(command: click.Command, argument: Argument) -> click.Option | None:
    """Return the option that an argument is, None where the command has none."""
    field = argument.field
    names: list[str | None] = [field]
    if argument.name.startswith("source."):
        own = SOURCE_NAMES.get(field)
        names = [own] if field == "fps" else [own, field]
    flags = [f"--{argument.value}"] if field == "form" else []
    flags.append(f"--{field.replace('_', '-')}")
    options = [each for each in command.params if isinstance(each, click.Option)]
    for name in names:
        for option in options:
            if option.name == name:
                return option
    return next((o for o in options if {*flags} & {*o.opts}), None)

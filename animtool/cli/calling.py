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
        value = argument.value or ""
        if argument.field == "form" and _option(command, (value,)) is not None:
            return flag(value)  # --split
        option = _option(command, _names(argument))
        if option is None:
            return None
        if argument.switch is False and option.secondary_opts:
            return option.secondary_opts[0]
        if argument.switch is not None:
            kind = option.type
            value = str(kind.choices[-1]) if isinstance(kind, click.Choice) else ""
        return f"{option.opts[0]} {value}".rstrip()

    return called


def _names(argument: Argument) -> tuple[str, ...]:
    """Return what commands call an argument, the usual name first."""
    field = argument.field
    own = SOURCE_NAMES.get(field) if argument.name.startswith("source.") else None
    if own is None:
        return (field,)
    # What is called so without `source.` is of the output; of a path either is meant.
    return (own,) if field == "fps" else (own, field)


def _option(command: click.Command, names: tuple[str, ...]) -> click.Option | None:
    """Return the option of the first name, None where the command has none."""
    options = [each for each in command.params if isinstance(each, click.Option)]
    for name in names:
        for option in options:
            if option.name == name or f"--{name.replace('_', '-')}" in option.opts:
                return option
    return None

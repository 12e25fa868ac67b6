"""Help: every option below one heading, the short help on one screen."""

from __future__ import annotations

import re
from collections.abc import Iterator
from importlib.metadata import metadata

import click
import pytest
from support.cli import animtool

from animtool.cli.help import Command, LazyGroup, common_options, heading_of
from animtool.cli.main import COMMANDS, SECTIONS, cli


def _commands(group: LazyGroup = cli, path: str = "animtool") -> Iterator[Command]:
    """Yield all commands, those of groups too."""
    context = click.Context(group, info_name=path)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        if isinstance(command, LazyGroup):
            yield from _commands(command, f"{path} {name}")
        else:
            assert isinstance(command, Command), name
            yield command


ALL = list(_commands())


@pytest.mark.parametrize("command", ALL, ids=lambda command: str(command.name))
def test_every_option_has_a_heading(command: Command) -> None:
    name = command.name or ""
    options = [each for each in command.params if isinstance(each, click.Option)]
    assert all(heading_of(name, option) for option in options)
    words = {max(option.opts, key=len).removeprefix("--") for option in options}
    assert words >= set(common_options(name))


@pytest.mark.parametrize("command", ALL, ids=lambda command: str(command.name))
def test_short_help_fits_on_a_screen(command: Command) -> None:
    context = click.Context(command, info_name=str(command.name))
    lines = command.short_help_of(context).splitlines()
    assert len(lines) <= 40
    assert max(map(len, lines)) <= 90
    # The whole help has every option of the command.
    whole = command.get_help(context)
    flags = [
        max(p.opts, key=len) for p in command.params if isinstance(p, click.Option)
    ]
    assert all(flag in whole for flag in flags)


@pytest.mark.parametrize("command", ALL, ids=lambda command: str(command.name))
def test_extras_in_the_help_can_be_installed(command: Command) -> None:
    help_text = command.get_help(click.Context(command, info_name=str(command.name)))
    extras = re.findall(r"\bthe\s+extra\s+`?(\w+)", help_text)
    assert {*extras} <= {*(metadata("animtool").get_all("Provides-Extra") or ())}


def test_every_command_is_in_one_section() -> None:
    names = [name for group in SECTIONS.values() for name in group]
    assert sorted(names) == sorted(COMMANDS)


def test_help_of_a_command_by_name() -> None:
    assert animtool("help", "bake").stdout == animtool("bake", "--help").stdout
    assert animtool("-V").stdout == animtool("--version").stdout


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (("view", "a.bvh"), "'preview'"),
        (("bake", "a.bvh", "--frames", "1-2"), "'--range'"),
        (("bake", "*.bvh"), "animtool batch"),
        (("bake", "takes/**/walk.bvh"), "animtool batch"),
        (
            ("ik", "a.rig.yaml", "--missed-degrees", "0.1deg"),
            "'0.1deg' is not a number from 0 up",
        ),
        (("ik", "a.rig.yaml", "--seed", "random"), "'random' is not a whole number"),
        (("retarget", "a.rig.yaml", "--to", "b.bvh"), "swap SOURCE and --to"),
        (("convert", "a.bvh"), "OUTPUT"),
    ],
)
def test_the_obvious_first_try_is_answered(words: tuple[str, ...], meant: str) -> None:
    done = animtool(*words)
    assert done.code == 2
    assert meant in done.stderr


def test_codes_are_listed_by_a_prefix() -> None:
    lines = animtool("explain", "RIG22").stdout.splitlines()
    assert len(lines) > 1
    assert all(line.startswith("RIG22") for line in lines)

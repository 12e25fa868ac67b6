"""One spelling of an option in every command, and old ones for one version."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import click
import pytest
from support.cli import animtool

from animtool.cli.help import OLD_OPTIONS
from animtool.cli.main import cli

# Parameters with one meaning, and their only spelling.
SPELLINGS = {
    "frame_range": "--range",
    "fps": "--fps",
    "source_fps": "--source-fps",
    "source_prim": "--source-prim",
    "rig_layer": "--rig-layer",
    "output": "--output",
    "overwrite": "--overwrite",
    "skip_existing": "--skip-existing",
    "report_format": "--format",
    "take": "--take",
    "reduce": "--reduce",
    "strict": "--strict",
    "variables": "--set",
    "template": "--template",
    "placement": "--placement",
    "map": "--map",
    "static": "--static",
    "subject": "--subject",
    "units": "--units",
    "up": "--up",
    "jobs": "--jobs",
    "shot": "--shot",
    "handles": "--handles",
}
# Commands that read a character and write none elsewhere.
READERS = ("convert", "diff", "info", "preview")


def commands(
    group: click.Group = cli, above: str = ""
) -> Iterator[tuple[str, click.Command]]:
    context = click.Context(group)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        assert command is not None
        if isinstance(command, click.Group):
            yield from commands(command, f"{name} ")
        else:
            yield above + name, command


def options() -> Iterator[tuple[str, click.Option]]:
    for name, command in commands():
        for option in command.params:
            if isinstance(option, click.Option):
                yield name, option


def test_a_parameter_has_one_spelling() -> None:
    table = defaultdict(set)
    for _, option in options():
        long = [word for word in option.opts if word.startswith("--")]
        table[option.name].update(long)
    assert {name: table[name] for name in SPELLINGS} == {
        name: {word} for name, word in SPELLINGS.items()
    }


def test_what_is_read_and_what_is_written_are_two_options() -> None:
    words = defaultdict(set)
    for name, option in options():
        words[name].update(option.opts)
    for name in READERS:
        assert "--source-prim" in words[name]
        assert "--prim-path" not in words[name]
    assert all("--tol" not in known for known in words.values())
    assert words["retarget"] >= {"--to", "--rig"}


def test_old_names_lead_to_options_that_exist() -> None:
    known = {name: command for name, command in commands()}
    for name, renamed in OLD_OPTIONS.items():
        words = {word for option in known[name].params for word in option.opts}
        assert set(renamed.values()) <= words
        assert words.isdisjoint(renamed)


@pytest.mark.parametrize("given", [("--tol", "1mm"), ("--tol=1mm",)])
def test_an_old_name_works_with_a_note(walk: Path, given: tuple[str, ...]) -> None:
    done = animtool("diff", walk, walk, *given)
    assert done.code == 0
    assert done.stderr == "note: CLI106 --tol is now --tolerance\n"
    assert animtool("diff", walk, walk, *given, "-q").stderr == ""
    assert animtool("diff", walk, walk, "--tolerance", "1mm").stderr == ""


@pytest.mark.parametrize(
    ("arguments", "flag"),
    [
        (("info", "a.bvh", "--json"), "--format"),
        (("bake", "a.bvh", "--scale", "2"), "--units"),
        (("bake", "a.bvh", "--start-frame", "3"), "--range"),
        (("retarget", "a.bvh", "--target", "b"), "--to"),
        (("ik", "a.rig.yaml", "--target", "b"), "--targets"),
    ],
)
def test_an_option_of_another_tool_has_ours_as_hint(
    arguments: tuple[str, ...], flag: str
) -> None:
    done = animtool(*arguments)
    assert done.code == 2
    assert f"did you mean '{flag}'?" in done.stderr

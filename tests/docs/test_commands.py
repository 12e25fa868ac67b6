"""Every command printed in the documents runs, and says what it promises."""

from __future__ import annotations

import re
import shlex
from collections import Counter
from dataclasses import fields
from importlib.util import find_spec
from pathlib import Path

import pytest
from support.printed import Printed, run_printed

from animtool.passes import PASSES, find_pass

DOCUMENTS = [
    "README.md",
    "animtool/docs/guide.md",
    "samples/batch/README.md",
    "samples/bounce/README.md",
    "samples/cape/README.md",
    "samples/carry/README.md",
    "samples/ci/README.md",
    "samples/drape/README.md",
    "samples/embers/README.md",
    "samples/flag/README.md",
    "samples/orbits/README.md",
    "samples/press/README.md",
    "samples/rope/README.md",
    "samples/sheets/README.md",
    "samples/shot/README.md",
    "samples/speech/README.md",
    "samples/stride/README.md",
    "samples/walk/README.md",
    "samples/weld/README.md",
]


def fenced(text: str, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.M | re.S)


def commands_in(text: str) -> list[str]:
    return re.findall(r"^(?:\$|   ) (animtool .*)$", text, re.M)


def is_apart(command: str, workplace: Path, root: Path) -> bool:
    """Return whether no file that a command names was made by those before it."""
    return not any(
        (workplace / word).exists() and not (root / word).exists()
        for word in shlex.split(command)
    )


@pytest.mark.parametrize("name", DOCUMENTS)
def test_printed_commands(
    root: Path, workplace: Path, printed: Printed, name: str
) -> None:
    texts = {document: (root / document).read_text("utf-8") for document in DOCUMENTS}
    everywhere = Counter(
        command for text in texts.values() for command in set(commands_in(text))
    )
    commands = commands_in(texts[name])
    assert commands
    for command in commands:
        if "--plot" in command and find_spec("matplotlib") is None:
            continue
        if everywhere[command] > 1 and is_apart(command, workplace, root):
            printed.copy(command, workplace)
        else:
            run_printed(command, workplace)


def test_the_sample_is_what_its_script_makes(root: Path, tmp_path: Path) -> None:
    import runpy
    import sys

    made = tmp_path / "walk.bvh"
    before = sys.argv
    sys.argv = ["make_walk.py", str(made)]
    try:
        runpy.run_path(str(root / "samples/walk/make_walk.py"), run_name="__main__")
    finally:
        sys.argv = before
    assert made.read_bytes() == (root / "samples/walk/walk.bvh").read_bytes()


def test_setup_commands_are_run_by_ci(root: Path) -> None:
    commands = fenced((root / "README.md").read_text("utf-8"), "sh")
    assert len(commands) == 2
    assert all(len(command.splitlines()) == 1 for command in commands)
    script = (root / ".ci/run").read_text("utf-8")
    assert "README.md" in script


def test_every_pass_and_option_is_in_the_guide(root: Path) -> None:
    guide = (root / "animtool/docs/guide.md").read_text("utf-8")
    table = guide.split("| pass | options | |")[1].split("\n\n")[0]
    rows = [line.split("|")[1:3] for line in table.splitlines()[2:]]
    listed = {
        name.strip(" `"): re.findall(r"`(\w+)`", options) for name, options in rows
    }
    assert listed == {
        name: [field.name for field in fields(find_pass(name).options)]
        for name in listed
    }
    assert set(listed) == set(PASSES)

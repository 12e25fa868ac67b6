"""Every command printed in the documents runs, and says what it promises."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import fields
from fnmatch import fnmatch
from importlib.util import find_spec
from pathlib import Path

import pytest
from support.drawing import can_draw
from support.printed import (
    DOCUMENTS,
    Printed,
    commands_in,
    fenced,
    is_apart,
    run_printed,
    shorten,
)
from support.sections import SECTIONS, TEXTS, needed, output_of
from support.suite import some_quick

from animtool.motion.passes import PASSES, find_pass

# In how many documents a command is.
DOCUMENTS_WITH = Counter(
    command for text in TEXTS.values() for command in set(commands_in(text))
)


# What the commands of a section take, where that is long [s].
SECONDS = {
    "Crowds": 1.4,
    "Look at it": 1,
    "Faces": 1,
    "Batches": 0.7,
    "What is made again": 0.7,
    "Particles": 0.7,
    "Flocks": 0.6,
    "What info says": 0.6,
    "sheets": 0.7,
    "ci": 0.6,
    "robot": 0.6,
    "animtool": 8,
    "Bake, look, compare": 1,
    "Many files": 1,
    "Reach and retarget": 2,
    "Capture": 2,
    "Simulate": 6,
    "Six jobs": 1,
    "Give it back": 2,
    "Cloth and hair on a dancer": 4,
    "Capture from cameras": 2,
    "Look at it and report": 1,
    "Make it faster": 1,
    "Pictures and films": 9,
    "Springs": 2,
    "Inverse kinematics": 2,
    "Time against error": 1,
    "Fewer samples, curves kept": 1,
    "Capture as keys": 1,
    "Retargeting": 2,
    "Rigid bodies": 1,
    "Secondary motion": 1,
    "cape": 1,
    "capture": 1,
    "crowd": 1,
    "dance": 45,
    "drape": 2,
    "face": 1,
}


# What needs the extra `pictures`, and OpenGL.
PICTURE = re.compile(r"animtool preview .* -o \S+\.(?:png|gif|webp|mp4|webm)\b")


def section_parameters() -> list[object]:
    """Return each section with commands."""
    parameters = [
        pytest.param(
            document,
            title,
            id=f"{document}: {title}",
            marks=[pytest.mark.slow(SECONDS[title])] if title in SECONDS else [],
        )
        for document, sections in SECTIONS.items()
        for title in sections
    ]
    return some_quick(parameters, 2)


def is_shared(command: str, workplace: Path) -> bool:
    """Return whether other tests too look at what a command makes."""
    several = DOCUMENTS_WITH[command] > 1 or command.startswith("animtool bake ")
    return several and is_apart(command, workplace)


@pytest.mark.slow
@pytest.mark.parametrize(("document", "title"), section_parameters())
def test_printed_commands(
    workplace: Path,
    tmp_path_factory: pytest.TempPathFactory,
    monkeypatch: pytest.MonkeyPatch,
    document: str,
    title: str,
) -> None:
    # How long the methods of a table take is of no interest here.
    monkeypatch.setattr("animtool.sim.trials.measuring.MAX_REPEATS", 1)
    # Each as it stands there, on fewer frames: what the samples look like over all of
    # theirs, the tests of samples say.
    shorten(workplace)
    printed = Printed(tmp_path_factory, short=True)
    for command in needed(document, title) + SECTIONS[document][title]:
        if "--plot" in command and find_spec("matplotlib") is None:
            continue
        if PICTURE.match(command) and not can_draw():
            continue
        if is_shared(command, workplace):
            printed.copy(command, workplace)
        else:
            run_printed(command, workplace)


def test_slow_sections_are_there() -> None:
    titles = {title for sections in SECTIONS.values() for title in sections}
    assert SECONDS.keys() <= titles


@pytest.mark.parametrize("document", DOCUMENTS)
def test_each_command_is_below_a_heading(document: str) -> None:
    commands = [each for section in SECTIONS[document].values() for each in section]
    assert commands
    assert commands == commands_in(TEXTS[document])


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
    # What one leaves out, the other runs.
    assert commands[1].count("-m 'not slow'") == 1
    assert "slow=${tests/not slow/slow}" in script


def test_every_pass_and_option_is_in_the_reference(root: Path) -> None:
    page = (root / "animtool/docs/reference/passes.md").read_text("utf-8")
    table = page.split("| pass | options | |")[1].split("\n\n")[0]
    rows = [line.split("|")[1:3] for line in table.splitlines()[2:]]
    listed = {
        name.strip(" `"): re.findall(r"`(\w+)`", options) for name, options in rows
    }
    assert listed == {
        name: [field.name for field in fields(find_pass(name).options)]
        for name in listed
    }
    assert set(listed) == set(PASSES)


def test_what_the_readme_writes_is_ignored(root: Path) -> None:
    lines = (root / ".gitignore").read_text("utf-8").splitlines()
    patterns = [line[1:] for line in lines if re.fullmatch(r"/\*\.\w+", line)]
    text = TEXTS["README.md"]
    commands = commands_in(text) + [
        "animtool" + one.rpartition("/animtool")[2]
        for one in fenced(text, "sh")
        if "/animtool " in one
    ]
    outputs = {output for one in commands if (output := output_of(one))}
    assert "walk.usdc" in outputs
    ignored = {name for name in outputs for one in patterns if fnmatch(name, one)}
    assert ignored == outputs

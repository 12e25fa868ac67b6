"""Every command printed in the documents runs, and says what it promises."""

from __future__ import annotations

import re
import shlex
from collections import Counter
from collections.abc import Iterable
from dataclasses import fields
from fnmatch import fnmatch
from importlib.util import find_spec
from pathlib import Path

import pytest
from support.drawing import can_draw
from support.printed import (
    DOCUMENTS,
    ROOT,
    Printed,
    commands_in,
    fenced,
    is_apart,
    run_printed,
    shorten,
)
from support.suite import some_quick

from animtool.motion.passes import PASSES, find_pass


def sections_of(text: str) -> dict[str, list[str]]:
    """Return the commands below each heading of a document that has any."""
    sections: dict[str, list[str]] = {}
    for section in re.split(r"^#+ ", text, flags=re.M)[1:]:
        if commands := commands_in(section):
            sections[section.splitlines()[0]] = commands
    return sections


TEXTS = {document: (ROOT / document).read_text("utf-8") for document in DOCUMENTS}
SECTIONS = {document: sections_of(text) for document, text in TEXTS.items()}
# In how many documents a command is.
DOCUMENTS_WITH = Counter(
    command for text in TEXTS.values() for command in set(commands_in(text))
)


# What the commands of a section take, where that is long [s].
SECONDS = {
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


def output_of(command: str) -> str | None:
    """Return the name of the file that a command writes."""
    words = shlex.split(command)
    if "-o" in words:
        return words[words.index("-o") + 1]
    positional = [word for word in words if not word.startswith("-")]
    return positional[3] if words[1] == "convert" else None


def needed(document: str, title: str) -> list[str]:
    """Return the commands of earlier sections that a section needs, and what they need.

    A file is written by the command that names it as its output, or else, as a rig
    layer is, by those that write one of the same stem: of the same page, or else of any
    page in the folder of documents.
    """
    titles, own = list(SECTIONS[document]), SECTIONS[document][title]
    earlier = unique(
        command
        for each in titles[: titles.index(title)]
        for command in SECTIONS[document][each]
    )
    others = unique(
        command
        for page in DOCUMENTS
        if page != document and page.startswith("animtool/docs/")
        for commands in SECTIONS[page].values()
        for command in commands
    )
    order = unique([*others, *earlier])
    commands: list[str] = []
    pending = list(own)
    while pending:
        command = pending.pop()
        read = {word for word in shlex.split(command)[2:] if "." in word}
        for name in read - {output_of(command)}:
            if (ROOT / name).exists():
                continue
            writers: list[str] = []
            for stem in (False, True):
                if written_by(name, own, stem=stem):
                    break
                writers = written_by(name, earlier, stem=stem)
                writers = writers or written_by(name, others, stem=stem)[:1]
                if writers:
                    break
            pending += [each for each in writers if each not in commands]
            commands += [each for each in writers if each not in commands]
    return sorted(commands, key=order.index)


def unique(commands: Iterable[str]) -> list[str]:
    """Return commands in their order, each once."""
    return list(dict.fromkeys(commands))


def written_by(name: str, commands: list[str], *, stem: bool = False) -> list[str]:
    """Return those of some commands that write a file, or one of the same stem."""

    def key(file: str) -> str:
        return file.split(".", maxsplit=1)[0] if stem else file

    return [each for each in commands if key(output_of(each) or "") == key(name)]


def is_shared(command: str, workplace: Path) -> bool:
    """Return whether other tests too look at what a command makes."""
    several = DOCUMENTS_WITH[command] > 1 or command.startswith("animtool bake ")
    return several and is_apart(command, workplace)


@pytest.mark.parametrize(("document", "title"), section_parameters())
def test_printed_commands(
    workplace: Path,
    tmp_path_factory: pytest.TempPathFactory,
    monkeypatch: pytest.MonkeyPatch,
    document: str,
    title: str,
) -> None:
    # How long the methods of a table take is of no interest here.
    monkeypatch.setattr("animtool.sim.trials.measuring.REPEATS", 1)
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

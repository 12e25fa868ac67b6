"""Tutorials, followed as they are written: files from their blocks, then commands."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from animtool.core.record import dataclass
from support.printed import ROOT, make_project, run_printed

DOCS = ROOT / "animtool/docs"
TUTORIALS = sorted((DOCS / "tutorials").glob("*.md"))
# Those whose commands name samples; others start in an empty folder.
IN_CHECKOUT = {"capture"}
_BLOCK = re.compile(r'^```(\w+)(?: title="([^"]+)")?\n(.*?)^```$', re.M | re.S)


@dataclass(frozen=True, slots=True)
class Step:
    """A file to write, or a command to run."""

    text: str
    file: str = ""  # the name of the file; empty is a command

    @property
    def output(self) -> str:
        """The file that a command names as its output; empty is none."""
        words = shlex.split(self.text)
        return words[words.index("-o") + 1] if "-o" in words[:-1] else ""


def steps_of(text: str) -> Iterator[Step]:
    """Yield the files and commands of a page, in order."""
    for language, file, body in _BLOCK.findall(text):
        if file:
            yield Step(body, file)
        elif language == "console":
            for line in body.splitlines():
                if line.startswith("$ "):
                    yield Step(line[2:])


def pictures_of(text: str) -> list[str]:
    """Return the pictures that a page shows, relative to it."""
    return re.findall(r"^!\[[^]]+\]\(([^)]+)\)$", text, re.M)


def follow(step: Step, folder: Path) -> None:
    """Write the file of a step, or run its command, which is to succeed."""
    if step.file:
        path = folder / step.file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(step.text, "utf-8")
    elif step.text.startswith("mkdir "):
        (folder / step.text.removeprefix("mkdir ")).mkdir()
    elif step.text.startswith("python "):
        words = [sys.executable, *shlex.split(step.text)[1:]]
        subprocess.run(words, cwd=folder, check=True)
    else:
        run_printed(step.text, folder)


def workplace_of(page: Path, folder: Path) -> Path:
    """Return a folder in which a tutorial can be followed, made below another."""
    place = folder / page.stem
    place.mkdir()
    if page.stem in IN_CHECKOUT:
        make_project(place)
    return place


def make_pictures(page: Path, folder: Path) -> None:
    """Follow a tutorial in an empty folder, and keep what it draws beside the page."""
    text, place = page.read_text("utf-8"), workplace_of(page, folder)
    drawn: dict[str, Path] = {}
    for step in steps_of(text):
        follow(step, place)
        drawn[Path(step.output).name] = place / step.output
    for picture in pictures_of(text):
        kept = page.parent / picture
        kept.parent.mkdir(exist_ok=True)
        shutil.copyfile(drawn[kept.name], kept)

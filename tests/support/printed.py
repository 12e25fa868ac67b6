"""Commands of the documents, run once however many tests and documents have them."""

from __future__ import annotations

import hashlib
import os
import re
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest
from filelock import FileLock

from support.cli import Done, animtool

ROOT = Path(__file__).parents[2]


def commands_in(text: str) -> list[str]:
    """Return the commands that a document prints after a prompt or indented."""
    return re.findall(r"^(?:\$|   ) (animtool .*)$", text, re.M)


# Whose commands run here.
DOCUMENTS = [
    "README.md",
    # Tutorials are followed by a test of their own.
    *sorted(
        path.relative_to(ROOT).as_posix()
        for folder in ("animtool/docs", "samples")
        for path in (ROOT / folder).rglob("*.md")
        if path.name not in {"changelog.md", "python.md"}
        if {"rules", "tutorials"}.isdisjoint(path.parts)
        if folder != "samples" or path.parent.parent.name == "samples"
        if commands_in(path.read_text("utf-8"))
    ),
]


# What is recorded of markers and landmarks, and the array that has a row a frame.
RECORDINGS = {
    "samples/capture/take.npz": "uv8",
    "samples/face/helmet.npz": "landmarks_px",
    "samples/face/speech.npz": "landmarks_mm",
}
# What no command reads.
NO_INPUT = shutil.ignore_patterns("*.png", "*.py", "*.md", "__pycache__")


def fenced(text: str, language: str) -> list[str]:
    """Return the blocks of code of a language in a document."""
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.M | re.S)


def is_apart(command: str, workplace: Path) -> bool:
    """Return whether no file that a command names was made by those before it."""
    return not any(
        (workplace / word).exists() and not (ROOT / word).exists()
        for word in shlex.split(command)
    )


def make_project(folder: Path) -> None:
    """Fill a folder with the samples and the rigs that they name."""
    for name in ("samples", "rigs"):
        shutil.copytree(ROOT / name, folder / name, ignore=NO_INPUT)
    (folder / "animtool.toml").touch()


def shorten(folder: Path) -> None:
    """Leave a project a dozen frames of simulations, and a quarter of captures."""
    for path in sorted(folder.glob("samples/*/*.scene.yaml")):
        text = path.read_text("utf-8")
        if "\nsystems:" in text:
            text = re.sub(r"(?<=^range: \[)1, (\d+)", _dozen, text, flags=re.M)
            text = re.sub(r"(preroll): \S+", r"\1: 0.1", text)
        elif re.search("ragdoll|simulate", text):
            # One cycle of the walk, where several are done.
            text = re.sub(r"(repeats): \d", r"\1: 1", text)
        path.write_text(text, "utf-8")
    for name, key in RECORDINGS.items():
        path = folder / name
        with np.load(path) as held:
            arrays = dict(held)
        arrays[key] = arrays[key][: len(arrays[key]) // 4]
        np.savez(path, **arrays)


def _dozen(found: re.Match[str]) -> str:
    return f"1, {min(int(found[1]), 12)}"


def run_printed(command: str, folder: Path) -> Done:
    """Run a command as a document has it, which is to succeed."""
    done = animtool(*shlex.split(command)[1:], cwd=folder)
    assert done.code == 0, f"{command}\n{done.stderr}"
    return done


class Printed:
    """What commands make of a project that nothing else was run in.

    The processes that tests run in share it.

    Args:
        factory: Of temporary folders.
        short: Whether the project is one of few frames.
    """

    def __init__(self, factory: pytest.TempPathFactory, *, short: bool = False) -> None:
        base = factory.getbasetemp()
        among = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base
        self._short = short
        self._folder = among / ("printed-short" if short else "printed")
        self._folder.mkdir(exist_ok=True)

    def __call__(self, command: str) -> Path:
        """Return a folder with the files that a command makes."""
        name = name_of(command)
        made, project = self._folder / name, self._folder / f"{name}.project"
        with FileLock(self._folder / f"{name}.lock"):
            if not made.exists():
                shutil.rmtree(project, ignore_errors=True)
                make_project(project)
                if self._short:
                    shorten(project)
                given = files_in(project)
                done = run_printed(command, project)
                self._stderr(name).write_text(done.stderr, "utf-8")
                for file in given:
                    (project / file).unlink()
                project.rename(made)
        return made

    def stderr(self, command: str) -> str:
        """Return what a command prints to stderr."""
        self(command)
        return self._stderr(name_of(command)).read_text("utf-8")

    def _stderr(self, name: str) -> Path:
        return self._folder / f"{name}.stderr"

    def copy(self, command: str, folder: Path) -> None:
        """Put the files that a command makes into another project."""
        made = self(command)
        for file in files_in(made):
            (folder / file).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(made / file, folder / file)


def name_of(command: str) -> str:
    """Return a short name for the files of a command."""
    return hashlib.sha256(command.encode()).hexdigest()[:16]


def files_in(folder: Path) -> list[Path]:
    """Return the files in a folder and those below it, relative to it."""
    files = (path for path in folder.rglob("*") if path.is_file())
    return sorted(path.relative_to(folder) for path in files)

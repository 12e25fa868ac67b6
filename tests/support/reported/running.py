"""Running rows in copies of their folders."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import count
from pathlib import Path

from support.cli import Done, animtool_process, killable
from support.printed import make_project
from support.reported.outcome import Outcome
from support.reported.rows import Row

# Imported once, before the commands fork.
PRELOADED = (
    *("numpy", "scipy.optimize", "scipy.spatial", "pxr.UsdSkel", "pydantic", "yaml"),
    *("animtool._kernels", "animtool.cli.ik", "animtool.cli.retarget"),
    *("animtool.cli.validate", "animtool.cli.convert", "animtool.cli.info"),
)
INTERNAL = 70
_WARNING = re.compile(r"\.py:\d+: \w*Warning\b.*")

Run = Callable[[Sequence[str], Path], Done]


@contextmanager
def commands(folder: Path) -> Iterator[Run]:
    """Yield what runs commands, each in a process of its own that starts at once.

    Args:
        folder: Of files of its own.
    """
    try:
        from os import fork  # noqa: F401
    except ImportError:
        yield lambda words, cwd: animtool_process(*words, cwd=cwd)
        return
    with killable(folder, *PRELOADED) as run:
        yield lambda words, cwd: run(None, *words, cwd=cwd)


def run_row(row: Row, run: Run, base: Path) -> Outcome:
    """Run the first command of a row whose options there are.

    Args:
        row: What to run.
        run: Runs a command in a folder.
        base: An empty folder.
    """
    folder = _project(row, base) if row.project else _copy(row, base)
    numbers = count(1)

    def attempt(words: Sequence[str]) -> Outcome:
        out = base / f"out{next(numbers)}"
        out.mkdir()
        filled = [
            word.replace("{in}", row.file.name).replace("{out}", str(out))
            for word in words
        ]
        return Outcome(run(filled, folder), folder, out, row.file.name, attempt)

    for words in row.commands:
        outcome = attempt(words)
        if not (outcome.done.code == 2 and "No such option" in outcome.done.stderr):
            break
    return outcome


def _copy(row: Row, base: Path) -> Path:
    """Return the folder of a row in a copy of all."""
    shutil.copytree(row.root, base / row.root.name, copy_function=shutil.copyfile)
    return base / row.root.name / row.file.parent


def _project(row: Row, base: Path) -> Path:
    """Return a project with the files of a row in its root."""
    folder = base / "project"
    make_project(folder)
    for path in (row.root / row.file.parent).iterdir():
        if path.is_file():
            shutil.copyfile(path, folder / path.name)
    return folder


def faults_of(done: Done) -> list[str]:
    """Return what no command may do."""
    texts = done.stdout + done.stderr
    return [
        *([f"exit {INTERNAL}"] if done.code == INTERNAL else ()),
        *([f"ended by signal {-done.code}"] if done.code < 0 else ()),
        *(["a Python traceback"] if "Traceback (most recent call" in texts else ()),
        *(f"a Python warning: {found}" for found in _WARNING.findall(done.stderr)),
    ]

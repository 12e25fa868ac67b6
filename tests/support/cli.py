"""Running the command line, within this process or as a process of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

from animtool.cli.main import run


@dataclass(frozen=True, slots=True)
class Done:
    """What a command returned and said."""

    code: int
    stdout: str
    stderr: str


def animtool(*arguments: object, cwd: Path | None = None) -> Done:
    """Run a command in this process."""
    out, err = StringIO(), StringIO()
    with _inside(cwd), redirect_stdout(out), redirect_stderr(err):
        code = run([str(argument) for argument in arguments])
    return Done(code, out.getvalue(), err.getvalue())


def animtool_process(
    *arguments: object, cwd: Path | None = None, **environment: str
) -> Done:
    """Run a command in a process of its own."""
    done = subprocess.run(
        [sys.executable, "-P", "-m", "animtool", *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
        cwd=cwd,
        env={**os.environ, **environment},
    )
    return Done(done.returncode, done.stdout, done.stderr)


@contextmanager
def _inside(folder: Path | None) -> Iterator[None]:
    before = Path.cwd()
    if folder is not None:
        os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)

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
    return _process("-m", "animtool", *arguments, cwd=cwd, **environment)


def _process(*arguments: object, cwd: Path | None = None, **environment: str) -> Done:
    done = subprocess.run(
        [sys.executable, "-P", *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
        cwd=cwd,
        env={**os.environ, **environment},
    )
    return Done(done.returncode, done.stdout, done.stderr)


# Runs a command and counts its calls; kills it outright at one of them, if told which.
_COUNTED = """
import os, signal, sys
calls, last = 0, int(sys.argv[1])
def count(frame, event, argument):
    global calls
    calls += 1
    if calls == last:
        os.kill(os.getpid(), signal.SIGKILL)
from animtool.cli.main import run
sys.setprofile(count)
code = run(sys.argv[2:])
sys.setprofile(None)
print(calls)
sys.exit(code)
"""


def animtool_killed(last: int, *arguments: object, cwd: Path | None = None) -> Done:
    """Run a command that is killed at one of its calls, in a process of its own.

    Args:
        last: Which call; 0 lets it end, and how many there were is its last line.
        arguments: Of the command.
        cwd: Where it runs.
    """
    return _process("-c", _COUNTED, last, *arguments, cwd=cwd)


@contextmanager
def _inside(folder: Path | None) -> Iterator[None]:
    before = Path.cwd()
    if folder is not None:
        os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)

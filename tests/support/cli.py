"""Running the command line, within this process or as a process of its own."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from io import StringIO
from pathlib import Path

from animtool.cli.main import run

# How long a process that a test started may take, on a busy machine [s].
TIMEOUT = 300.0


@dataclass(frozen=True, slots=True)
class Done:
    """What a command returned and said."""

    code: int
    stdout: str
    stderr: str
    # Of its process, and of those that it waited for; of `Killable` alone [MB].
    peak_mb: float = field(default=0.0, compare=False)

    @property
    def fault_lines(self) -> list[str]:
        """Lines of stderr without the source lines and carets below faults."""
        lines = self.stderr.splitlines()
        return [line for line in lines if not re.match(r" *\d* +\| ", line)]


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
        timeout=TIMEOUT,
        cwd=cwd,
        env={**os.environ, **environment},
    )
    return Done(done.returncode, done.stdout, done.stderr)


# Forks for each line of its input: what a command imports is imported once. The fork
# counts the calls of a command, and kills itself outright at one if told which; it does
# neither where none is told.
_KILLABLE = """
import contextlib, ctypes, json, os, signal, sys
import animtool.batch.run, animtool.cli.bake, animtool.cli.batch
import animtool.formats.bvh.read, animtool.scene.bake.bake, animtool.usd.takes.author
import animtool.batch.preload
from animtool.cli.main import run

calls = last = 0

def count(frame, event, argument):
    global calls
    calls += 1
    if calls == last:
        os.kill(os.getpid(), signal.SIGKILL)

def command(arguments, cwd, said):
    os.chdir(cwd)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    for number in (1, 2):
        os.dup2(os.open(f"{said}.{number}", os.O_CREAT | os.O_WRONLY), number)
    if last is not None:
        sys.setprofile(count)
    code = run(arguments)
    sys.setprofile(None)
    if last is not None:
        print(calls)
    sys.stdout.flush()
    return code

if sys.platform == "linux":
    ctypes.CDLL(None).prctl(36, 1)  # PR_SET_CHILD_SUBREAPER

for line in sys.stdin:
    last, *rest = json.loads(line)
    child = os.fork()
    if not child:
        os._exit(command(*rest))
    _, status, usage = os.wait4(child, 0)
    ended = os.waitstatus_to_exitcode(status)
    # The processes that it began live a moment longer, and may write in it.
    with contextlib.suppress(ChildProcessError):
        while True:
            os.wait()
    print(ended, usage.ru_maxrss, flush=True)
"""
# Of the largest memory of a process, as the system states it [MB].
_PEAK_UNIT = 1e-6 if sys.platform == "darwin" else 1e-3


class Killable:
    """Commands that are killed at one of their calls, each a process of its own."""

    def __init__(self, process: subprocess.Popen[str], folder: Path) -> None:
        self.process, self.folder = process, folder

    def __call__(
        self, last: int | None, *arguments: object, cwd: Path | None = None
    ) -> Done:
        """Run a command.

        Args:
            last: The call that kills it; 0 lets it end, and how many there were is the
                last line that it says. None counts none.
            arguments: Of the command.
            cwd: Where it runs.
        """
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        said = self.folder / "said"
        words = [str(argument) for argument in arguments]
        line = json.dumps([last, words, str(cwd or Path.cwd()), str(said)])
        self.process.stdin.write(f"{line}\n")
        self.process.stdin.flush()
        code, peak = map(int, self.process.stdout.readline().split())
        texts = [Path(f"{said}.{number}") for number in (1, 2)]
        stdout, stderr = (path.read_text("utf-8") for path in texts)
        done = Done(code, stdout, stderr, _PEAK_UNIT * peak)
        for path in texts:
            path.unlink()
        return done


@contextmanager
def killable(folder: Path, *preloaded: str) -> Iterator[Killable]:
    """Yield what runs commands that are killed; a folder has what they say.

    Args:
        folder: Of files of its own.
        preloaded: Further modules that commands need.
    """
    imports = "".join(f"import {module}\n" for module in preloaded)
    with subprocess.Popen(
        [sys.executable, "-P", "-c", imports + _KILLABLE],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        yield Killable(process, folder)


@contextmanager
def _inside(folder: Path | None) -> Iterator[None]:
    before = Path.cwd()
    if folder is not None:
        os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)

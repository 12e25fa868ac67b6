"""Running the command line, within this process or as a process of its own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
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
# counts the calls of a command, and kills itself outright at one if told which.
_KILLABLE = """
import contextlib, ctypes, json, os, signal, sys
import animtool.batch.run, animtool.cli.bake, animtool.cli.batch
import animtool.formats.bvh.read, animtool.scene.bake, animtool.usd.author
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
    for number in (1, 2):
        os.dup2(os.open(f"{said}.{number}", os.O_CREAT | os.O_WRONLY), number)
    sys.setprofile(count)
    code = run(arguments)
    sys.setprofile(None)
    print(calls, flush=True)
    return code

if sys.platform == "linux":
    ctypes.CDLL(None).prctl(36, 1)  # PR_SET_CHILD_SUBREAPER

for line in sys.stdin:
    last, *rest = json.loads(line)
    child = os.fork()
    if not child:
        os._exit(command(*rest))
    ended = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    # The processes that it began live a moment longer, and may write in it.
    with contextlib.suppress(ChildProcessError):
        while True:
            os.wait()
    print(ended, flush=True)
"""


class Killable:
    """Commands that are killed at one of their calls, each a process of its own."""

    def __init__(self, process: subprocess.Popen[str], folder: Path) -> None:
        self.process, self.folder = process, folder

    def __call__(self, last: int, *arguments: object, cwd: Path | None = None) -> Done:
        """Run a command.

        Args:
            last: The call that kills it; 0 lets it end, and how many there were is the
                last line that it says.
            arguments: Of the command.
            cwd: Where it runs.
        """
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        said = self.folder / "said"
        words = [str(argument) for argument in arguments]
        line = json.dumps([int(last), words, str(cwd or Path.cwd()), str(said)])
        self.process.stdin.write(f"{line}\n")
        self.process.stdin.flush()
        code = int(self.process.stdout.readline())
        texts = [Path(f"{said}.{number}") for number in (1, 2)]
        done = Done(code, *(path.read_text("utf-8") for path in texts))
        for path in texts:
            path.unlink()
        return done


@contextmanager
def killable(folder: Path) -> Iterator[Killable]:
    """Yield what runs commands that are killed; a folder has what they say."""
    with subprocess.Popen(
        [sys.executable, "-P", "-c", _KILLABLE],
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

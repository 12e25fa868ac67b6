"""System calls of writing that fail, or at which a process is killed, one in turn."""

from __future__ import annotations

import errno
import io
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

import pytest

__all__ = [
    "ERRORS",
    "Calls",
    "Children",
    "Files",
    "failing",
    "files_in",
    "in_child",
    "signalled",
    "small_children",
    "watched",
]

# Content and mode by name.
Files: TypeAlias = dict[str, tuple[bytes, int]]

ERRORS = (errno.ENOSPC, errno.EIO, errno.EACCES, errno.EDQUOT)
NAMES = (
    *("open", "fsync", "close", "replace", "rename", "link", "unlink", "mkdir"),
    *("fchmod", "fchown"),
)


@dataclass(slots=True)
class Calls:
    """The calls that a piece of work makes.

    Attributes:
        act: Called with the number of each, from 1, before it is made; what it raises
            is what the call raises.
        names: Of those that were made.
    """

    act: Callable[[int], None]
    names: list[str] = field(default_factory=list)

    def __call__(self, name: str) -> None:
        self.names.append(name)
        self.act(len(self.names))


@contextmanager
def watched(calls: Calls) -> Iterator[None]:
    """Tell of every call of writing inside the block."""
    with pytest.MonkeyPatch.context() as patch:
        for name in NAMES:
            patch.setattr(os, name, _told(calls, name, getattr(os, name)))
        patch.setattr(io, "open", _opened(calls, io.open))
        yield


def _told(calls: Calls, name: str, call: Callable[..., Any]) -> Callable[..., Any]:
    def told(*arguments: Any, **more: Any) -> Any:
        if name == "close":
            # A close that fails has closed all the same.
            call(*arguments, **more)
            return calls(name)
        calls(name)
        return call(*arguments, **more)

    return told


def _opened(calls: Calls, call: Callable[..., Any]) -> Callable[..., Any]:
    def opened(file: Any, mode: str = "r", *arguments: Any, **more: Any) -> Any:
        if set(mode) & set("wxa+"):
            calls("open to write")
        return call(file, mode, *arguments, **more)

    return opened


def failing(at: int) -> Calls:
    """Return calls of which one fails, each time with another error."""

    def act(number: int) -> None:
        if number == at:
            code = ERRORS[at % len(ERRORS)]
            raise OSError(code, os.strerror(code))

    return Calls(act)


def signalled(at: int, signum: int = signal.SIGKILL) -> Calls:
    """Return calls at one of which the process gets a signal; it is killed outright."""

    def act(number: int) -> None:
        if number == at:
            os.kill(os.getpid(), signum)

    return Calls(act)


def in_child(work: Callable[[], object]) -> int:
    """Do some work in a process of its own; return its exit code, 0 for the end."""
    child = os.fork()
    if not child:
        code = 70
        try:
            work()
            code = 0
        except SystemExit as error:
            code = int(error.code or 0)
        finally:
            os._exit(code)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


# Each line of its input is a function to call in a fork; a line of its output is how
# that ended. A fork of the process of the tests, which is large, takes ten times as
# long.
_FORKING = """
import json, sys
from importlib import import_module
from faults.calls import in_child

for line in sys.stdin:
    module, name, arguments = json.loads(line)
    call = getattr(import_module(module), name)
    print(in_child(lambda: call(*arguments)), flush=True)
"""


@dataclass(frozen=True, slots=True)
class Children:
    """Forks of a small process, one after another."""

    process: subprocess.Popen[str]

    def __call__(self, work: Callable[..., object], *arguments: object) -> int:
        """Do some work in a process of its own; return its exit code, 0 for the end."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        named = [f"faults.{work.__module__.rpartition('.')[2]}", work.__name__]
        self.process.stdin.write(f"{json.dumps([*named, arguments])}\n")
        self.process.stdin.flush()
        return int(self.process.stdout.readline())


@contextmanager
def small_children() -> Iterator[Children]:
    """Yield what does the work of tests in this folder in forks of a small process."""
    with subprocess.Popen(
        [sys.executable, "-P", "-c", _FORKING],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])},
    ) as process:
        yield Children(process)


def files_in(folder: Path) -> Files:
    """Return content and mode of each file that is there for a user."""
    return {
        path.name: (path.read_bytes(), path.stat().st_mode)
        for path in sorted(folder.iterdir())
        if not path.name.startswith(".animtool-") and path.is_file()
    }

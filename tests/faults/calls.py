"""System calls of writing that fail, or at which a process is killed, one in turn."""

from __future__ import annotations

import errno
import io
import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

import pytest

__all__ = [
    "ERRORS",
    "Calls",
    "Files",
    "failing",
    "files_in",
    "in_child",
    "killed",
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


def killed(at: int) -> Calls:
    """Return calls at one of which the process is killed outright."""

    def act(number: int) -> None:
        if number == at:
            os.kill(os.getpid(), signal.SIGKILL)

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


def files_in(folder: Path) -> Files:
    """Return content and mode of each file that is there for a user."""
    return {
        path.name: (path.read_bytes(), path.stat().st_mode)
        for path in sorted(folder.iterdir())
        if not path.name.startswith(".animtool-") and path.is_file()
    }

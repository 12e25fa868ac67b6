"""Which files a piece of work looked at: every reader says so here.

Nothing is noted unless somebody records. What was looked for and is not there counts
too: that it comes may change what the work makes.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path

from animtool.errors import Fault, FormatError


@dataclass(frozen=True, slots=True)
class FileState:
    """What tells, without reading it, that a file is not the one it was."""

    size: int  # in bytes
    changed: int  # when its content last changed, by the clock of its disk [ns]
    inode: int  # which file of its disk it is

    @classmethod
    def of(cls, path: Path) -> FileState | None:
        """Return the state of a file; None where there is none."""
        try:
            return cls.of_stat(path.stat())
        except (OSError, ValueError):
            return None

    @classmethod
    def of_stat(cls, found: os.stat_result) -> FileState:
        """Return the state that the system reports of a file, or of a descriptor."""
        return cls(found.st_size, found.st_mtime_ns, found.st_ino)


@dataclass(slots=True)
class Inputs:
    """What a piece of work looked at."""

    # By absolute path, what the file was when it was first looked at.
    states: dict[Path, FileState | None] = field(default_factory=dict)
    # Those of them that were not only brought in by a USD layer.
    opened: set[Path] = field(default_factory=set)
    # Those of them that were another file when they were looked at again.
    replaced: set[Path] = field(default_factory=set)

    def note(
        self, path: Path, state: FileState | None = None, *, composed: bool = False
    ) -> None:
        """Note a file that is about to be read; the arguments are `note_input`'s."""
        where = path.absolute()
        if not composed:
            self.opened.add(where)
        if where not in self.states:
            self.states[where] = FileState.of(where) if state is None else state
        elif state is not None and state != self.states[where]:
            self.replaced.add(where)

    def changed(self) -> list[Path]:
        """Return the files that are no longer what they were."""
        return [
            path
            for path, state in self.states.items()
            if path in self.replaced or FileState.of(path) != state
        ]

    def check(self) -> None:
        """Raise `FormatError` where files changed since they were looked at (IO004)."""
        changed = self.changed()
        if changed:
            raise changed_error(*changed)


def changed_error(*paths: Path) -> FormatError:
    """Return the error of files that changed while they were read (IO004)."""
    message = "changed while it was being read"
    hint = "run it again when nobody writes to it"
    return FormatError([Fault("IO004", message, str(path), (), hint) for path in paths])


_RECORDED: ContextVar[tuple[Inputs, ...]] = ContextVar("recorded_inputs", default=())


@contextmanager
def recorded_inputs() -> Iterator[Inputs]:
    """Give a record of the files that are looked at inside the block.

    Records of blocks around it have them too.

    >>> with recorded_inputs() as inputs:
    ...     note_input(Path("walk.bvh"))
    >>> [path.name for path in inputs.states]
    ['walk.bvh']
    """
    inputs = Inputs()
    token = _RECORDED.set((*_RECORDED.get(), inputs))
    try:
        yield inputs
    finally:
        _RECORDED.reset(token)


def note_input(
    path: Path, state: FileState | None = None, *, composed: bool = False
) -> None:
    """Note that a file is about to be read, or was looked for.

    Its state is that of the descriptor where it is open; None looks at the path. A
    composed file is one that a USD layer brings in; nobody named it.
    """
    for inputs in _RECORDED.get():
        inputs.note(path, state, composed=composed)


def check_inputs() -> None:
    """Raise `FormatError` where files changed since they were noted (IO004)."""
    for inputs in _RECORDED.get():
        inputs.check()

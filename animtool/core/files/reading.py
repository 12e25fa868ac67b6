"""Opening of input files, with a record of files and their states.

Nothing is noted unless somebody records. What was looked for and is not there counts
too: that it comes may change what the work makes.
"""

from __future__ import annotations

import io
import os
import re
import stat
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import field
from itertools import islice
from pathlib import Path
from typing import Any

from animtool.core.arguments import argument, clause
from animtool.core.errors import Fault, FormatError
from animtool.core.names import similar
from animtool.core.record import dataclass


@dataclass(frozen=True, slots=True)
class FileState:
    """State of a file that shows changes without reading it."""

    size: int  # in bytes
    changed: int  # when its content last changed, by the clock of its disk [ns]
    inode: int  # which file of its disk it is

    @classmethod
    def of(cls, path: Path) -> FileState | None:
        """Return the state of a file; None if it is missing."""
        try:
            return cls.of_stat(path.stat())
        except (OSError, ValueError):
            return None

    @classmethod
    def of_stat(cls, status: os.stat_result) -> FileState:
        """Return the state from a status of the system."""
        return cls(status.st_size, status.st_mtime_ns, status.st_ino)


@dataclass(slots=True)
class Inputs:
    """Files that a task has looked at."""

    # State of each file at its first access, by absolute path.
    states: dict[Path, FileState | None] = field(default_factory=dict)
    # Those of them that were not only brought in by a USD layer.
    opened: set[Path] = field(default_factory=set)
    # Those of them that were another file when they were looked at again.
    replaced: set[Path] = field(default_factory=set)

    def note(
        self, path: Path, state: FileState | None = None, *, composed: bool = False
    ) -> None:
        """Record a file that is about to be read; see `note_input`."""
        where = path.absolute()
        if not composed:
            self.opened.add(where)
        if where not in self.states:
            self.states[where] = FileState.of(where) if state is None else state
        elif state is not None and state != self.states[where]:
            self.replaced.add(where)

    def changed(self) -> list[Path]:
        """Return the files that have changed."""
        return [
            path
            for path, state in self.states.items()
            if path in self.replaced or FileState.of(path) != state
        ]

    def check(self) -> None:
        """Raise `FormatError` if files changed since they were recorded (IO004)."""
        changed = self.changed()
        if changed:
            raise changed_error(*changed)


def changed_error(*paths: Path) -> FormatError:
    """Return the error of files that changed while being read (IO004)."""
    message = "changed while it was being read"
    hint = "run it again when no process writes to it"
    return FormatError([Fault("IO004", message, str(path), (), hint) for path in paths])


_RECORDED: ContextVar[tuple[Inputs, ...]] = ContextVar("recorded_inputs", default=())


@contextmanager
def recorded_inputs() -> Iterator[Inputs]:
    """Give a record of the files that the block looks at.

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
    """Record a file that is about to be read, or was looked for.

    Its state is that of the descriptor where it is open; None looks at the path. A
    composed file is one that a USD layer brings in; nobody named it.
    """
    for inputs in _RECORDED.get():
        inputs.note(path, state, composed=composed)


def check_inputs() -> None:
    """Raise `FormatError` if recorded files have changed (IO004)."""
    for inputs in _RECORDED.get():
        inputs.check()


# More names than a person sees in a folder are not looked at.
MAX_NAMES = 10_000

_WILD = frozenset("*?[")

# No file is read into memory as a whole that is larger.
MAX_INPUT_BYTES = 1_000_000_000
# Text that a person writes: a rig of thousands of joints has a few MB.
MAX_TEXT_BYTES = 32_000_000
# A FIFO that nobody writes to must not stop whoever opens it, and no terminal may
# become the process's own.
_FLAGS = os.O_RDONLY | sum(
    getattr(os, name, 0) for name in ("O_BINARY", "O_CLOEXEC", "O_NONBLOCK", "O_NOCTTY")
)
_KINDS = {
    stat.S_IFDIR: "is a folder",
    stat.S_IFIFO: "is a pipe, not a file",
    stat.S_IFSOCK: "is a socket, not a file",
}


@dataclass(frozen=True, slots=True)
class MatchedFile:
    """A file that a name or pattern matched."""

    path: Path  # the file, spelled as its folder was
    base: Path  # the folder that was searched; of a named file its own


class PathResolver:
    """Resolves links of folders in paths, but not those of files.

    Each folder is looked up once.
    """

    def __init__(self) -> None:
        self._folders: dict[Path, Path] = {}

    def __call__(self, path: Path) -> Path:
        """Return one path for all spellings of it."""
        folder = path.parent
        if folder not in self._folders:
            self._folders[folder] = folder.resolve()
        return self._folders[folder] / path.name


def unreadable(path: Path, reason: OSError | str) -> FormatError:
    """Return the error of an unreadable file, named as the user did (IO001)."""
    if isinstance(reason, FileNotFoundError | NotADirectoryError):
        message = "does not exist"
    elif isinstance(reason, PermissionError):
        message = "cannot be read: you have no permission"
    else:
        if isinstance(reason, OSError):
            reason = reason.strerror or str(reason)
        it = "it " if reason.startswith("is a ") else ""
        message = f"cannot be read: {it}{reason}"
    hint = unexpanded_hint(str(path)) or nearest_file(path) or _folder_hint(path)
    return FormatError(Fault("IO001", message, str(path), (), hint))


# A variable of a shell, and the home folder, which only shells replace.
_SHELL = re.compile(r"\$(?!\{)(\w+)|%(\w+)%|^(~)/")


def unexpanded_hint(text: str) -> str | None:
    """Return a hint for a path with a variable of a shell; None for others.

    >>> unexpanded_hint("~/walk.bvh")
    '~ is not replaced: write the folder'
    """
    match = _SHELL.search(text)
    if match is None:
        return None
    if match[3]:
        return "~ is not replaced: write the folder"
    name = match[1] or match[2]
    hint = f"variables of a shell are not replaced: write ${{{name}}} and give it a "
    return hint + "value" + clause(f" with {argument('set', f'{name}=VALUE')}")


def _folder_hint(path: Path) -> str | None:
    """Return a hint at the first file in a folder; None for other paths."""
    try:
        entries = islice(path.iterdir(), MAX_NAMES)
        files = sorted(entry for entry in entries if entry.is_file())
    except (OSError, ValueError):
        return None
    return f"name a file in it, such as {files[0]}" if files else "name a file"


class InputFile(io.FileIO):
    """An open input whose length is fixed at opening.

    Attributes:
        path: As the user named it.
        state: What it was when it was opened.
    """

    def __init__(self, path: Path, handle: int, state: FileState) -> None:
        """Take a descriptor, closed with this file."""
        super().__init__(handle, "rb")
        self.path, self.state = path, state

    def read(self, size: int | None = -1, /) -> bytes:
        """Return at most ``size`` bytes; none at the end."""
        left = max(0, self.state.size - self.tell())
        size = left if size is None or size < 0 else min(size, left)
        return super().read(size) or b""

    def readall(self) -> bytes:
        """Return all remaining bytes."""
        parts = []
        while part := self.read():
            parts.append(part)
        return b"".join(parts)

    def readinto(self, buffer: Any, /) -> int:
        """Read into a buffer; return the number of bytes."""
        view = memoryview(buffer).cast("B")
        data = self.read(len(view))
        view[: len(data)] = data
        return len(data)

    def read_all(self) -> bytes:
        """Return all remaining bytes of a file that must not change.

        Raises:
            FormatError: It cannot be read (IO001), or changed (IO004).
        """
        try:
            data = self.readall()
        except OSError as error:
            raise unreadable(self.path, error) from error
        self.check()
        return data

    def check(self) -> None:
        """Raise `FormatError` if the file changed since it was opened (IO004)."""
        if FileState.of_stat(os.fstat(self.fileno())) != self.state:
            raise changed_error(self.path)


def open_input(
    path: Path, max_bytes: int | None = MAX_INPUT_BYTES, *, recorded: bool = True
) -> InputFile:
    """Open a file that a user or another file names.

    What is looked at is what is read: the descriptor, once it is open. What is not
    there, may not be read or is no file is IO001, what is too large IO010; without
    ``max_bytes`` any size is read, piece by piece. ``noted`` makes it an input of the
    work (`note_input`).
    """
    try:
        # To open a device may already do something.
        _check_regular(path, path.stat())
        handle = os.open(path, _FLAGS)
    except (OSError, ValueError) as error:
        if recorded:
            note_input(path)
        reason = error if isinstance(error, OSError) else str(error)
        raise unreadable(path, reason) from error
    try:
        status = os.fstat(handle)
        _check_regular(path, status)
        _check_size(path, status, max_bytes)
        file = InputFile(path, handle, FileState.of_stat(status))
    except BaseException:
        os.close(handle)
        raise
    if recorded:
        note_input(path, file.state)
    return file


def read_input(
    path: Path, max_bytes: int = MAX_INPUT_BYTES, *, recorded: bool = True
) -> bytes:
    """Return the content of a file, see `open_input`; if it changes: IO004."""
    with open_input(path, max_bytes, recorded=recorded) as file:
        return file.read_all()


def too_large(path: Path, size: int, limit: int) -> FormatError:
    """Return the error of a file above the size limit [bytes] (IO010)."""
    message = f"is {size / 1000000.0:,.6g} MB; the limit is {limit / 1000000.0:,.6g} MB"
    return FormatError(Fault("IO010", message, str(path)))


def _check_regular(path: Path, status: os.stat_result) -> None:
    if not stat.S_ISREG(status.st_mode):
        raise unreadable(path, _kind(status))


def _kind(status: os.stat_result) -> str:
    """Return the kind of a path that is not a file."""
    return _KINDS.get(stat.S_IFMT(status.st_mode), "is a device, not a file")


def not_a_file_reason(path: Path) -> str | None:
    """Return why a path is not a file, as text; None if it is one."""
    try:
        status = path.stat()
    except (FileNotFoundError, NotADirectoryError, ValueError):
        return "does not exist"
    except OSError as error:
        return error.strerror or "cannot be examined"
    return None if stat.S_ISREG(status.st_mode) else _kind(status)


def _check_size(path: Path, status: os.stat_result, limit: int | None) -> None:
    if limit is not None and status.st_size > limit:
        raise too_large(path, status.st_size, limit)


def exists(path: Path) -> bool:
    """Return whether a path exists; false for impossible names."""
    return FileState.of(path) is not None


def nearest_file(path: Path, folder: Path = Path()) -> str | None:
    """Return a hint at the nearest existing file name.

    It names the nearest name in the same folder, or the nearest of the folder that is
    missing; a relative path starts in ``folder``. None where the file exists, or no
    name is near.
    """
    around = [path, *path.parents]
    missing = next((p for p in reversed(around) if not exists(folder / p)), None)
    if missing is None or not missing.name:
        return None
    try:
        with os.scandir(folder / missing.parent) as entries:
            names = sorted(entry.name for entry in islice(entries, MAX_NAMES))
    except OSError:
        return None
    folded = {name.casefold(): name for name in reversed(names)}
    near = similar(missing.name.casefold(), sorted(folded), 0.7)
    if not near:
        return None
    meant = missing.with_name(folded[near]).as_posix()
    return f"did you mean {'' if missing is path else 'the folder '}{meant!r}?"


def is_pattern(text: str) -> bool:
    """Return whether a path has the wildcards of a glob."""
    return not _WILD.isdisjoint(text)


def matching_files(text: str, suffixes: Sequence[str]) -> Iterator[MatchedFile]:
    """Yield the files that a name, folder or glob matches, in order.

    Of a folder all files with one of the suffixes, lower case, those of folders in it
    too. Of a glob the files that it matches; ``**`` is any number of folders. Names
    that begin with a dot are left out where the glob has none. A name that is there is
    meant as it is, and so is one that is nowhere.
    """
    path = Path(text)
    if path.is_dir():
        known = tuple(suffixes)
        for file in sorted(path.rglob("*")):
            if file.name.lower().endswith(known) and _is_shown(file, path):
                yield MatchedFile(file, path)
    elif is_pattern(text) and not path.exists():
        # Folders without a wildcard stay as the user spells them.
        parts = path.parts
        first = next(i for i, part in enumerate(parts) if _WILD & set(part))
        base = Path(*parts[:first])
        named = any(part.startswith(".") for part in parts[first:])
        for file in sorted(base.glob("/".join(parts[first:]))):
            if file.is_file() if named else _is_shown(file, base):
                yield MatchedFile(file, base)
    else:
        yield MatchedFile(path, path.parent)


def _is_shown(file: Path, folder: Path) -> bool:
    parts = file.relative_to(folder).parts
    return not any(part.startswith(".") for part in parts) and file.is_file()


def path_from_folder(path: Path, folder: Path) -> str:
    """Return a path relative to a folder, where there is one.

    >>> path_from_folder(Path("/shots/rigs/hero.usda"), Path("/shots/sh010"))
    '../rigs/hero.usda'
    """
    path, folder = path.resolve(), folder.resolve()
    parents = (folder, *folder.parents)
    above = next((up for up in parents if path.is_relative_to(up)), None)
    if above is None:
        # Another drive.
        return path.as_posix()
    steps = [".."] * len(folder.relative_to(above).parts)
    return "/".join([*steps, *path.relative_to(above).parts])

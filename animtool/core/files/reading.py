"""Opens input files, and records the files that were accessed and their states.

Files are recorded only inside `recorded_inputs`. Missing files that were looked for are
recorded too, since creating one may change the result.
"""

from __future__ import annotations

import io
import os
import re
import stat
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import field
from itertools import islice
from pathlib import Path
from typing import Any

from animtool.core.arguments import argument, clause
from animtool.core.errors import Fault, FormatError
from animtool.core.names import FILE_KINDS, most_similar
from animtool.core.record import dataclass


@dataclass(frozen=True, slots=True)
class FileState:
    """State of a file by which changes are detected without reading it."""

    size: int  # in bytes
    changed_at: int  # time of the last change of its content [ns], by the disk's clock
    inode: int  # inode on its disk

    @classmethod
    def of(cls, path: Path) -> FileState | None:
        """Return the state of a file; None if it is missing."""
        try:
            return cls.of_stat(path.stat())
        except (OSError, ValueError):
            return None

    @classmethod
    def of_stat(cls, status: os.stat_result) -> FileState:
        """Return the file state in a result of ``os.stat``."""
        return cls(status.st_size, status.st_mtime_ns, status.st_ino)


@dataclass(slots=True)
class RecordedInputs:
    """Files that a task accessed, with their states."""

    # State of each file at its first access, by absolute path.
    states: dict[Path, FileState | None] = field(default_factory=dict)
    # Those that were opened directly, not only included by a USD layer.
    opened_paths: set[Path] = field(default_factory=set)
    # Those that had been replaced at a later access.
    replaced_paths: set[Path] = field(default_factory=set)

    def record(
        self, path: Path, state: FileState | None = None, *, is_composed: bool = False
    ) -> None:
        """Record a file before it is read; see `record_input`."""
        absolute_path = path.absolute()
        if not is_composed:
            self.opened_paths.add(absolute_path)
        if absolute_path not in self.states:
            self.states[absolute_path] = (
                FileState.of(absolute_path) if state is None else state
            )
        elif state is not None and state != self.states[absolute_path]:
            self.replaced_paths.add(absolute_path)

    def changed_paths(self) -> list[Path]:
        """Return the files that changed since they were recorded."""
        return [
            path
            for path, state in self.states.items()
            if path in self.replaced_paths or FileState.of(path) != state
        ]

    def check(self) -> None:
        """Raise `FormatError` if files changed since they were recorded (IO004)."""
        changed_paths = self.changed_paths()
        if changed_paths:
            raise changed_error(*changed_paths)


def changed_error(*paths: Path) -> FormatError:
    """Return the error for files that changed while being read (IO004)."""
    message = "changed while it was being read"
    hint = "run it again when no process writes to it"
    return FormatError([Fault("IO004", message, str(path), (), hint) for path in paths])


_ACTIVE_RECORDS: ContextVar[tuple[RecordedInputs, ...]] = ContextVar(
    "recorded_inputs", default=()
)


@contextmanager
def recorded_inputs() -> Iterator[RecordedInputs]:
    """Yield a record of the files that the block accesses.

    Records of enclosing blocks include them too.

    >>> with recorded_inputs() as inputs:
    ...     record_input(Path("walk.bvh"))
    >>> [path.name for path in inputs.states]
    ['walk.bvh']
    """
    inputs = RecordedInputs()
    token = _ACTIVE_RECORDS.set((*_ACTIVE_RECORDS.get(), inputs))
    try:
        yield inputs
    finally:
        _ACTIVE_RECORDS.reset(token)


def record_input(
    path: Path, state: FileState | None = None, *, is_composed: bool = False
) -> None:
    """Record a file before it is read or searched for.

    The state is that of the descriptor if the file is open; None queries the path. A
    composed file is one that a USD layer includes; the user did not name it.
    """
    for inputs in _ACTIVE_RECORDS.get():
        inputs.record(path, state, is_composed=is_composed)


def check_inputs() -> None:
    """Raise `FormatError` if any recorded file changed (IO004)."""
    for inputs in _ACTIVE_RECORDS.get():
        inputs.check()


# Largest number of names in a folder that are searched for a hint.
MAX_SEARCHED_NAMES = 10_000

_WILDCARDS = frozenset("*?[")

# Largest file that is read into memory as a whole.
MAX_INPUT_BYTES = 1_000_000_000
# Largest text file; a rig of thousands of joints has a few MB.
MAX_TEXT_BYTES = 32_000_000
# Opening a FIFO without a writer must not block, and a terminal must not become the
# process's controlling terminal.
_OPEN_FLAGS = os.O_RDONLY | sum(
    getattr(os, name, 0) for name in ("O_BINARY", "O_CLOEXEC", "O_NONBLOCK", "O_NOCTTY")
)
_NON_FILE_KINDS = {
    stat.S_IFDIR: "is a folder",
    stat.S_IFIFO: "is a pipe, not a file",
    stat.S_IFSOCK: "is a socket, not a file",
}


@dataclass(frozen=True, slots=True)
class MatchedFile:
    """A file found by its name or by a glob, and the folder that was searched."""

    path: Path  # the file, spelled like its folder
    search_folder: Path  # the searched folder; for a named file, its folder


class PathResolver:
    """Resolves links to folders in paths, but no links to files.

    Each folder is resolved only once.
    """

    def __init__(self) -> None:
        self._folders: dict[Path, Path] = {}

    def __call__(self, path: Path) -> Path:
        """Return one path for all spellings of it."""
        folder = path.parent
        if folder not in self._folders:
            self._folders[folder] = folder.resolve()
        return self._folders[folder] / path.name


# Why a path that does not exist is not read.
NO_FILE = "does not exist"


def unreadable_error(
    path: Path, reason: OSError | str, kind: str | None = None
) -> FormatError:
    """Return the error for an unreadable file, spelled as the user did (IO001).

    ``kind`` is the kind of file that is read, such as ``rig``, if only one is.
    """
    is_missing = isinstance(reason, FileNotFoundError | NotADirectoryError)
    if is_missing or reason == NO_FILE:
        message = NO_FILE
    elif isinstance(reason, PermissionError):
        message = "cannot be read: you have no permission"
    else:
        if isinstance(reason, OSError):
            reason = reason.strerror or str(reason)
        subject = "it " if reason.startswith("is a ") else ""
        message = f"cannot be read: {subject}{reason}"
    if isinstance(reason, PermissionError):
        hint: str | None = "allow reading it: chmod u+r"
    else:
        hint = unexpanded_hint(str(path)) or nearest_file(path)
        hint = hint or _folder_hint(path, kind)
    return FormatError(Fault("IO001", message, str(path), (), hint))


# A variable of a shell, and the home folder, which only shells replace.
_SHELL_VARIABLE = re.compile(r"\$(?!\{)(\w+)|%(\w+)%|^(~)/")


def unexpanded_hint(text: str) -> str | None:
    """Return a hint for a path with a shell variable in it; None for other paths.

    >>> unexpanded_hint("~/walk.bvh")
    '~ is not replaced: write the folder'
    """
    match = _SHELL_VARIABLE.search(text)
    if match is None:
        return None
    if match[3]:
        return "~ is not replaced: write the folder"
    name = match[1] or match[2]
    hint = f"variables of a shell are not replaced: write ${{{name}}} and give it a "
    return hint + "value" + clause(f" with {argument('set', f'{name}=VALUE')}")


# A URL; paths have one slash of those after the colon.
_URL = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+):/{1,3}(?=[^/])")


def url_hint(text: str) -> str | None:
    """Return a hint for a URL in place of a path; None for paths.

    >>> url_hint("file:///takes/walk.bvh"), url_hint("walk.bvh")
    ('write the path without file://: /takes/walk.bvh', None)
    """
    match = _URL.match(text)
    if match is None:
        return None
    if match[1].lower() == "file":
        path_text = text[match.end() :]
        is_drive = re.match("[A-Za-z]:", path_text) is not None
        slash = "" if is_drive else "/"
        return f"write the path without file://: {slash}{path_text}"
    return "only local files are read: download it, and write its path"


_UNLIKELY_SUFFIXES = {"", ".md", ".npz", ".png", ".py", ".sh", ".txt"}


def require_file(path: Path, kind: str) -> None:
    """Raise if the path of a file of a kind, such as ``rig``, is a folder (IO001)."""
    try:
        is_folder = path.is_dir()
    except (OSError, ValueError):
        return
    if is_folder:
        raise unreadable_error(path, _NON_FILE_KINDS[stat.S_IFDIR], kind)


# Kinds of files that are also read from formats of other programs.
_KINDS_WITH_FORMATS = {"rig", "cameras"}


def _is_of_no_kind(path: Path) -> bool:
    """Return whether the name of a file states no kind, and its suffix is a format."""
    words = path.name.lower().split(".")[1:]
    is_likely = path.suffix.lower() not in _UNLIKELY_SUFFIXES
    return is_likely and not set(words).intersection(FILE_KINDS)


def _folder_hint(path: Path, kind: str | None) -> str | None:
    """Return a hint to name a file in a folder; None if the path is not a folder."""
    try:
        entries = islice(path.iterdir(), MAX_SEARCHED_NAMES)
        files = sorted(entry for entry in entries if entry.is_file())
    except (OSError, ValueError):
        return None
    if kind is not None:
        # Rigs and cameras have other formats, too; those are no files of other kinds.
        files = [
            file
            for file in files
            if f".{kind}." in file.name.lower()
            or (kind in _KINDS_WITH_FORMATS and _is_of_no_kind(file))
        ]
        files.sort(key=lambda file: f".{kind}." not in file.name.lower())
        hint = f"name a {kind} file"
        return f"{hint} in it, such as {files[0]}" if files else hint
    # Texts, scripts and arrays are rarely what is meant; YAML files are rigs, clips and
    # scenes.
    files.sort(key=lambda file: file.suffix.lower() in _UNLIKELY_SUFFIXES)
    return f"name a file in it, such as {files[0]}" if files else "name a file"


class InputFile(io.FileIO):
    """An open input file whose length is fixed at opening.

    Attributes:
        path: Path as spelled by the user.
        state: State of the file when it was opened.
    """

    def __init__(self, path: Path, descriptor: int, state: FileState) -> None:
        """Take over an open descriptor, which is closed with this file."""
        super().__init__(descriptor, "rb")
        self.path, self.state = path, state

    def read(self, size: int | None = -1, /) -> bytes:
        """Return at most ``size`` bytes; empty at the end of the file."""
        remaining_size = max(0, self.state.size - self.tell())
        if size is None or size < 0:
            size = remaining_size
        return super().read(min(size, remaining_size)) or b""

    def readall(self) -> bytes:
        """Return all remaining bytes."""
        chunks = []
        while chunk := self.read():
            chunks.append(chunk)
        return b"".join(chunks)

    def readinto(self, buffer: Any, /) -> int:
        """Read into a buffer; return the number of bytes."""
        view = memoryview(buffer).cast("B")
        data = self.read(len(view))
        view[: len(data)] = data
        return len(data)

    def read_all(self) -> bytes:
        """Return all remaining bytes; raise if the file changed meanwhile (IO004)."""
        try:
            data = self.readall()
        except OSError as error:
            raise unreadable_error(self.path, error) from error
        self.check()
        return data

    def check(self) -> None:
        """Raise `FormatError` if the file changed since it was opened (IO004)."""
        if FileState.of_stat(os.fstat(self.fileno())) != self.state:
            raise changed_error(self.path)


def open_input(
    path: Path, max_bytes: int | None = MAX_INPUT_BYTES, *, is_recorded: bool = True
) -> InputFile:
    """Open a file that a user or another file names, after checking it.

    The checked file is the one that is read: the open descriptor. A missing,
    inaccessible or irregular file is IO001, a too large one IO010; without
    ``max_bytes`` any size is read, chunk by chunk. With ``is_recorded`` it becomes an
    input of the task (`record_input`).
    """
    try:
        # Opening a device may already have effects.
        _require_regular_file(path, path.stat())
        descriptor = os.open(path, _OPEN_FLAGS)
    except (OSError, ValueError) as error:
        if is_recorded:
            record_input(path)
        reason = error if isinstance(error, OSError) else str(error)
        raise unreadable_error(path, reason) from error
    try:
        status = os.fstat(descriptor)
        _require_regular_file(path, status)
        _check_size(path, status, max_bytes)
        file = InputFile(path, descriptor, FileState.of_stat(status))
    except BaseException:
        os.close(descriptor)
        raise
    if is_recorded:
        record_input(path, file.state)
    return file


def read_input(
    path: Path, max_bytes: int = MAX_INPUT_BYTES, *, is_recorded: bool = True
) -> bytes:
    """Return the content of a file; raise IO004 if it changes. See `open_input`."""
    with open_input(path, max_bytes, is_recorded=is_recorded) as file:
        return file.read_all()


def size_error(path: Path, size: int, limit: int) -> FormatError:
    """Return the error for a file that exceeds a size limit [bytes] (IO010)."""
    message = f"is {size / 1000000.0:,.6g} MB; the limit is {limit / 1000000.0:,.6g} MB"
    return FormatError(Fault("IO010", message, str(path)))


def _require_regular_file(path: Path, status: os.stat_result) -> None:
    if not stat.S_ISREG(status.st_mode):
        raise unreadable_error(path, _non_file_kind(status))


def _non_file_kind(status: os.stat_result) -> str:
    """Return a phrase for a path that is not a regular file, such as "is a folder"."""
    return _NON_FILE_KINDS.get(stat.S_IFMT(status.st_mode), "is a device, not a file")


def not_a_file_reason(path: Path) -> str | None:
    """Return why a path is not a file, as text; None if it is one."""
    try:
        status = path.stat()
    except (FileNotFoundError, NotADirectoryError, ValueError):
        return NO_FILE
    except OSError as error:
        return error.strerror or "cannot be examined"
    return None if stat.S_ISREG(status.st_mode) else _non_file_kind(status)


def _check_size(path: Path, status: os.stat_result, limit: int | None) -> None:
    if limit is not None and status.st_size > limit:
        raise size_error(path, status.st_size, limit)


def exists(path: Path) -> bool:
    """Return whether a path exists; False for impossible names."""
    return FileState.of(path) is not None


# Number of levels of folders that are searched for a file that was moved.
MAX_SEARCHED_DEPTH = 2


def nearest_file(path: Path, folder: Path = Path()) -> str | None:
    """Return a hint with the most similar name of an existing file.

    The hint names a file of the same name in a folder nearby, else the most similar
    file, or a folder similar to the first missing one; if there is none, it names the
    missing folder. Relative paths start in ``folder``. None if the file exists, or only
    the file is missing and no name is similar.
    """
    if not exists(folder / path) and (hint := url_hint(path.as_posix())):
        return hint
    outermost_first = reversed([path, *path.parents])
    missing_path = next((p for p in outermost_first if not exists(folder / p)), None)
    if missing_path is None or not missing_path.name:
        return None
    if moved_files := _files_nearby(missing_path.parent, path.name, folder):
        return f"did you mean {' or '.join(repr(file) for file in moved_files[:2])}?"
    return _similar_path_hint(missing_path, folder, is_file=missing_path is path)


def _similar_path_hint(
    missing_path: Path, folder: Path, *, is_file: bool
) -> str | None:
    """Return a hint with the path of the most similar name in the same folder."""
    try:
        with os.scandir(folder / missing_path.parent) as entries:
            names = [entry.name for entry in islice(entries, MAX_SEARCHED_NAMES)]
    except OSError:
        return None
    name_by_casefold = {name.casefold(): name for name in sorted(names, reverse=True)}
    similar_name = most_similar(
        missing_path.name.casefold(), sorted(name_by_casefold), 0.7
    )
    if not similar_name or not _equal_stems(missing_path.name, similar_name):
        if is_file or is_pattern(missing_path.name):
            return None
        return f"there is no folder {missing_path.as_posix()!r}"
    suggested_path = missing_path.with_name(name_by_casefold[similar_name]).as_posix()
    noun = "" if is_file else "the folder "
    return f"did you mean {noun}{suggested_path!r}?"


def _files_nearby(start: Path, name: str, folder: Path) -> list[str]:
    """Return files of a name in the folders below a folder, the nearest first.

    Those below its parent are next, if that is within ``folder``.
    """
    if is_pattern(name) or (start.anchor and not start.name):
        return []
    tops = [start]
    if start.name and not start.anchor and ".." not in start.parts:
        tops.append(start.parent)
    files: dict[str, None] = {}
    for top in tops:
        subfolders = [top]
        for _ in range(MAX_SEARCHED_DEPTH):
            subfolders = _subfolders(subfolders, folder)
            paths = [subfolder / name for subfolder in subfolders]
            files |= dict.fromkeys(p.as_posix() for p in paths if exists(folder / p))
    return list(files)


def _subfolders(folders: Iterable[Path], root: Path) -> list[Path]:
    """Return the visible folders in folders, as far as `MAX_SEARCHED_NAMES` go."""
    remaining_count = MAX_SEARCHED_NAMES
    subfolders: list[Path] = []
    for folder in folders:
        try:
            with os.scandir(root / folder) as scanned:
                entries = [*islice(scanned, remaining_count)]
        except OSError:
            continue
        remaining_count -= len(entries)
        names = sorted(entry.name for entry in entries if entry.is_dir())
        subfolders += [folder / name for name in names if not name.startswith(".")]
    return subfolders


def _equal_stems(name: str, other: str) -> bool:
    """Return whether names are similar without their suffixes.

    >>> _equal_stems("stride.clip.yaml", "sec.clip.yaml")
    False
    >>> _equal_stems("wlk.bvh", "walk.bvh")
    True
    """
    stems = [text.casefold().partition(".")[0] for text in (name, other)]
    return stems[0] == stems[1] or most_similar(stems[0], stems[1:], 0.6) is not None


def is_pattern(text: str) -> bool:
    """Return whether a path contains wildcards of a glob."""
    return not _WILDCARDS.isdisjoint(text)


def matching_files(text: str, suffixes: Sequence[str]) -> Iterator[MatchedFile]:
    """Yield the files that a name, folder or glob matches, in order.

    For a folder, all files with one of the suffixes (lower case), including subfolders.
    For a glob, the files it matches; ``**`` is any number of folders. Names that begin
    with a dot are skipped unless the glob has one. A name that exists is taken
    literally, and so is one that matches nothing.
    """
    path = Path(text)
    if path.is_dir():
        for file in sorted(path.rglob("*")):
            if file.name.lower().endswith(tuple(suffixes)) and _is_shown(file, path):
                yield MatchedFile(file, path)
    elif is_pattern(text) and not path.exists():
        # Folders without a wildcard stay as the user spells them.
        parts = path.parts
        base_length = next(i for i, part in enumerate(parts) if is_pattern(part))
        base_folder, pattern_parts = Path(*parts[:base_length]), parts[base_length:]
        _check_folder_wildcards(text, parts)
        shows_hidden = any(part.startswith(".") for part in pattern_parts)
        for file in sorted(base_folder.glob("/".join(pattern_parts))):
            if file.is_file() if shows_hidden else _is_shown(file, base_folder):
                yield MatchedFile(file, base_folder)
    else:
        yield MatchedFile(path, path.parent)


def _check_folder_wildcards(text: str, parts: Sequence[str]) -> None:
    """Raise IO001 if ``**`` is not a folder between slashes."""
    fixed_parts = []
    for part in parts:
        before, separator, after = part.partition("**")
        if separator and (before or after):
            fixed_parts += ["**", f"{before}*{after.lstrip('*')}"]
        else:
            fixed_parts.append(part)
    if fixed_parts != list(parts):
        message = "'**' stands for folders, and takes the place of a folder's name"
        hint = f"write {str(Path(*fixed_parts).as_posix())!r}"
        raise FormatError(Fault("IO001", message, text, hint=hint))


def _is_shown(file: Path, folder: Path) -> bool:
    parts = file.relative_to(folder).parts
    return not any(part.startswith(".") for part in parts) and file.is_file()


def path_from_folder(path: Path, folder: Path) -> str:
    """Return a path relative to a folder; absolute if they are on different drives.

    >>> path_from_folder(Path("/shots/rigs/hero.usda"), Path("/shots/sh010"))
    '../rigs/hero.usda'
    """
    path, folder = path.resolve(), folder.resolve()
    for common_parent in (folder, *folder.parents):
        if path.is_relative_to(common_parent):
            parent_steps = [".."] * len(folder.relative_to(common_parent).parts)
            return "/".join([*parent_steps, *path.relative_to(common_parent).parts])
    return path.as_posix()  # on another drive

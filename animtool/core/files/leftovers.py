"""Leftovers of killed processes in output folders, which are rolled back and removed.

A file being written has a temporary name in its folder, which identifies its process. A
set of files also has a journal in each of its folders while the files are renamed.
After a kill, the next process that writes there rolls back: replaced files are
restored, and new ones are removed.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import stat
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import field
from functools import cache
from pathlib import Path
from typing import Any
from uuid import uuid4

from animtool.core.errors import FormatError
from animtool.core.files.reading import FileState, open_input, read_input
from animtool.core.record import dataclass

_OWNER_PATTERN = re.compile(r"\.animtool-(?P<host>[0-9a-f]{8})-(?P<process>[0-9]+)-")
# Names created by `new_temporary_path`.
TEMPORARY_NAME = re.compile(rf"{_OWNER_PATTERN.pattern}[0-9a-f]{{12}}(\.\w+)?")
_JOURNAL_SUFFIX = ".set"
# Longer suffixes are no file type, and would make the temporary name too long.
_MAX_SUFFIX_BYTES = 16
# A journal has a few hundred bytes per file.
_MAX_JOURNAL_BYTES = 100_000_000


def temporary_prefix(process_id: int | None = None) -> str:
    """Return the prefix of a process's temporary files; by default this process's."""
    return f".animtool-{_host_digest()}-{process_id or os.getpid()}-"


def new_temporary_path(final_path: Path) -> Path:
    """Return an unused temporary name next to a file."""
    suffix = final_path.suffix
    if len(os.fsencode(suffix)) > _MAX_SUFFIX_BYTES:
        suffix = ""
    # Unique over threads, processes and hosts that share a folder.
    return final_path.with_name(f"{temporary_prefix()}{uuid4().hex[:12]}{suffix}")


@dataclass(frozen=True, slots=True)
class StagedFile:
    """One file of a set that is being committed."""

    final_path: Path  # its final path
    temporary_path: Path  # its temporary path
    state: FileState  # of the written file
    backup_path: Path  # backup of the replaced file; unused if there was none

    def roll_back(self) -> None:
        """Restore the replaced file, or remove the file if it is new.

        Does nothing if another process has replaced the file since. May be called
        again.
        """
        final_state = _state_of(self.final_path)
        if _state_of(self.backup_path) is None:
            if final_state == self.state:
                self.final_path.unlink()
        elif final_state is None or final_state == self.state:
            self.backup_path.replace(self.final_path)
        else:
            # The final path still has the old file, or a later one.
            self.backup_path.unlink()
        self.temporary_path.unlink(missing_ok=True)


@dataclass(frozen=True, slots=True)
class Journal:
    """Journal of a file set that is being committed, with a file in each folder.

    The set is complete as soon as one journal file is removed. Each journal file names
    only files of its folder, so a foreign journal cannot affect other folders.
    """

    name: str  # of the journal file in each folder
    folders: tuple[Path, ...]  # folders of the set
    _descriptors: list[int] = field(default_factory=list, compare=False, repr=False)

    @classmethod
    def begin(cls, files: Sequence[StagedFile]) -> Journal:
        """Write the journal of a file set before any of its files is renamed."""
        folders = tuple(dict.fromkeys(file.final_path.parent for file in files))
        journal = cls(
            f"{temporary_prefix()}{uuid4().hex[:12]}{_JOURNAL_SUFFIX}", folders
        )
        try:
            for folder in folders:
                folder_files = [f for f in files if f.final_path.parent == folder]
                content = {
                    "folders": [os.fspath(path) for path in folders],
                    "files": [_journal_entry(file) for file in folder_files],
                }
                journal._write_file(folder, json.dumps(content).encode())
        except BaseException:
            journal.remove()
            raise
        return journal

    def _write_file(self, folder: Path, content: bytes) -> None:
        flags = os.O_CREAT | os.O_EXCL | os.O_RDWR
        descriptor = os.open(folder / self.name, flags, 0o666)
        # Its lock shows that the process is alive, to other containers too.
        self._descriptors.append(descriptor)
        _try_lock(descriptor)
        with os.fdopen(os.dup(descriptor), "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(descriptor)

    def remove(self) -> None:
        """Remove the journal of a set that is complete or rolled back."""
        while self._descriptors:
            with contextlib.suppress(OSError):
                os.close(self._descriptors.pop())
        for folder in self.folders:
            with contextlib.suppress(OSError):
                (folder / self.name).unlink()

    def roll_back(self) -> None:
        """Roll back the file set of a process that died before completing it."""
        if all((folder / self.name).is_file() for folder in self.folders):
            for folder in dict.fromkeys(self.folders):
                for file in reversed(self._staged_files(folder)):
                    file.roll_back()
        self.remove()

    def _staged_files(self, folder: Path) -> list[StagedFile]:
        content = read_input(folder / self.name, _MAX_JOURNAL_BYTES, is_recorded=False)
        try:
            entries = json.loads(content)["files"]
            return [_staged_file(folder, entry) for entry in entries]
        except (ValueError, KeyError, TypeError, OverflowError, RecursionError):
            # It was incomplete, so that no file had been renamed.
            return []


def _staged_file(folder: Path, entry: Mapping[str, Any]) -> StagedFile:
    names = [entry[key] for key in ("final", "temporary", "old")]
    # Names in a journal must not lead out of its folder.
    final_path, *temporary_paths = (folder / Path(name).name for name in names)
    for path in temporary_paths:
        if not _OWNER_PATTERN.match(path.name):
            raise ValueError(f"{path.name!r} is not a temporary name")
    inode, size, changed_at = map(int, entry["state"])
    temporary_path, backup_path = temporary_paths
    state = FileState(size, changed_at, inode)
    return StagedFile(final_path, temporary_path, state, backup_path)


def _journal_entry(file: StagedFile) -> Mapping[str, Any]:
    return {
        "final": file.final_path.name,
        "temporary": file.temporary_path.name,
        "state": [file.state.inode, file.state.size, file.state.changed_at],
        "old": file.backup_path.name,
    }


def _state_of(path: Path) -> FileState | None:
    """Return the state of a path without following links; None if it is missing."""
    try:
        return FileState.of_stat(path.lstat())
    except FileNotFoundError:
        return None


def roll_back_folder(folder: Path) -> None:
    """Roll back the file sets of dead processes in a folder, once per process."""
    _roll_back_once(os.fspath(folder), os.getpid())


@cache
def _roll_back_once(folder: str, process_id: int) -> None:
    del process_id
    for path in _temporary_files(Path(folder)):
        if path.name.endswith(_JOURNAL_SUFFIX) and _is_orphan(path, None):
            _roll_back_journal(path)


def _roll_back_journal(path: Path) -> bool:
    """Roll back the file set of a journal; return whether all its files are gone."""
    try:
        if not stat.S_ISREG(path.lstat().st_mode):
            return True
        with open_input(path, _MAX_JOURNAL_BYTES, is_recorded=False) as file:
            if not _try_lock(file.fileno()):
                return False
            # Complete now: its writer is dead.
            content = read_input(path, _MAX_JOURNAL_BYTES, is_recorded=False)
            folders = _journal_folders(content)
            Journal(path.name, (*folders, path.parent)).roll_back()
    except (OSError, FormatError):
        return not path.exists()
    except ValueError:
        # A name with a NUL was not written by animtool.
        return True
    return True


def _journal_folders(content: bytes) -> list[Path]:
    try:
        return [Path(name) for name in json.loads(content)["folders"]]
    except (ValueError, KeyError, TypeError, RecursionError):
        return []


def _try_lock(descriptor: int) -> bool:
    """Try to lock a journal, so that only one process rolls it back."""
    if sys.platform == "win32":
        return False
    import fcntl

    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def remove_leftovers(
    folders: Iterable[Path], process_id: int | None = None
) -> list[Path]:
    """Remove and return the temporary files of dead processes of this host.

    Incomplete sets are rolled back first. Missing folders are skipped. ``process_id``
    is that of a dead process; None for all dead ones.
    """
    removed_paths = []
    for folder in dict.fromkeys(folders):
        orphans = [p for p in _temporary_files(folder) if _is_orphan(p, process_id)]
        journals = [path for path in orphans if path.name.endswith(_JOURNAL_SUFFIX)]
        # If it cannot be rolled back now, it can be later, as long as its files are
        # kept.
        if not all([_roll_back_journal(path) for path in journals]):
            continue
        for path in orphans:
            with contextlib.suppress(OSError):
                path.unlink()
                removed_paths.append(path)
    return removed_paths


def _is_orphan(path: Path, process_id: int | None) -> bool:
    """Return whether a file belongs to a dead process of this host."""
    match = _OWNER_PATTERN.match(path.name)
    if match is None or match["host"] != _host_digest():
        return False
    owner_id = int(match["process"])
    return owner_id == process_id or (process_id is None and not is_running(owner_id))


def _temporary_files(folder: Path) -> list[Path]:
    with contextlib.suppress(OSError), os.scandir(folder) as entries:
        return [
            Path(entry.path) for entry in entries if entry.name.startswith(".animtool-")
        ]
    return []


def is_running(process_id: int) -> bool:
    """Return whether a process of this host is running; True if unknown."""
    if os.name == "nt":
        # On Windows, signal 0 would end the process.
        return True
    try:
        os.kill(process_id, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:
        return True
    # An ended process stays in the table until its parent waits for it; in some
    # containers it never does.
    return _process_state(process_id) != "Z"


def _process_state(process_id: int) -> str:
    """Return the state letter of a process on Linux; "" if unknown."""
    try:
        status = Path(f"/proc/{process_id}/stat").read_text("utf-8", "replace")
    except OSError:
        return ""
    return status.rpartition(")")[2].split()[0]


@cache
def _host_digest() -> str:
    import platform
    from hashlib import sha256

    return sha256(platform.node().encode()).hexdigest()[:8]

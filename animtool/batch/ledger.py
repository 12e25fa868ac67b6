"""The ledger of a batch: locks of runs, finished items and failures.

A run of the full batch holds `batch-NAME.lock`. Runs of some items each hold a lock and
write their own files in `batch-NAME.d`, which the next full run merges. Locks are those
of the operating system and end with the process; `.owner` only names the owner to other
runs.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import field
from pathlib import Path
from typing import TYPE_CHECKING

from animtool.batch.manifest import (
    ItemRecord,
    Manifest,
    ManifestWriter,
    read_manifest,
    rewrite_manifest,
)
from animtool.batch.records import (
    LineReader,
    LineWriter,
    RecordError,
    integer_in,
    read_json,
    text_in,
)
from animtool.batch.spec import path_of_name
from animtool.core.errors import Fault, LockedError, OutputError, excerpt
from animtool.core.files.commit import output_error
from animtool.core.files.leftovers import is_running
from animtool.core.files.output import replacement_path
from animtool.core.files.reading import FileState
from animtool.core.record import dataclass

if TYPE_CHECKING:
    from filelock import FileLock


FAILURES_HEADER = {"failures": "animtool/1"}
# Maximum length of a failure message.
MAX_REASON_LENGTH = 10_000


@dataclass(frozen=True, slots=True)
class Failures:
    """The failed items of earlier runs."""

    # Failure of each item, by key.
    reasons: dict[str, str] = field(default_factory=dict)
    length: int = 0  # length of the readable part [bytes]
    damage_warnings: tuple[Fault, ...] = ()  # warnings about unusable lines


def read_failures(path: Path) -> Failures:
    """Return the failed items in a file; none if the file is missing."""
    reader, reasons_by_item = LineReader(path, FAILURES_HEADER), dict[str, str]()
    for line in reader.lines():
        try:
            reasons_by_item[text_in(line, "item")] = text_in(line, "why")
        except RecordError as error:
            reader.damaged_lines[reader.line_number] = str(error)
    return Failures(reasons_by_item, reader.length, tuple(reader.notices()))


def rewrite_failures(path: Path, failures: Mapping[str, str]) -> None:
    """Rewrite the file of failed items; remove it if there are none."""
    if not failures:
        path.unlink(missing_ok=True)
        return
    with (
        replacement_path(path) as temporary_path,
        LineWriter(temporary_path, FAILURES_HEADER) as writer,
    ):
        writer.write(_failure_line(key, why) for key, why in failures.items())


def _failure_line(key: str, reason: str) -> dict[str, str]:
    return {"item": key, "why": reason.replace("\0", "\\0")[:MAX_REASON_LENGTH]}


# A run of some items briefly takes the batch's lock to check that it is free.
LOCK_TIMEOUT = 5.0
# Item numbers that identify a part of a batch.
_PART_NAME = re.compile(r"([0-9]{1,9})-([0-9]{1,9})")
MAX_OWNER_BYTES = 4096


@dataclass(slots=True)
class History:
    """Built items and failures that earlier runs of a batch recorded."""

    manifest: Manifest = field(default_factory=Manifest)  # built by earlier runs
    # Failures of items that were not built since, by key.
    failure_reasons: dict[str, str] = field(default_factory=dict)
    # Warnings about unusable lines.
    damage_warnings: list[Fault] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class _RecordFiles:
    """Paths of the records of a batch, or of a run of some of its items."""

    folder: Path
    name: str
    part: str = ""

    @property
    def parts_folder(self) -> Path:
        return self.folder / f"batch-{self.name}.d"

    def record_path(self, suffix: str) -> Path:
        if self.part:
            return self.parts_folder / f"{self.part}{suffix}"
        return self.folder / f"batch-{self.name}{suffix}"

    def record_paths(self) -> tuple[Path, Path]:
        """Return the paths of the manifest and of the failures."""
        return self.record_path(".jsonl"), self.record_path(".failed.jsonl")

    def batch_files(self) -> _RecordFiles:
        return _RecordFiles(self.folder, self.name)

    def part_files(self) -> list[_RecordFiles]:
        """Return the record files of every run of some items, sorted by name."""
        stems = sorted(path.stem for path in self.parts_folder.glob("*.lock"))
        return [_RecordFiles(self.folder, self.name, part) for part in stems]

    def overlaps(self, other: _RecordFiles) -> bool:
        """Return whether the item ranges of two parts have a number in common."""
        ranges = [_PART_NAME.fullmatch(files.part) for files in (self, other)]
        if not all(ranges):
            return False
        (first, last), (other_first, other_last) = (
            map(int, bounds.groups()) for bounds in ranges if bounds
        )
        return first <= other_last and other_first <= last


def read_history(folder: Path, name: str) -> History:
    """Return what earlier runs of a batch, or of some of its items, recorded."""
    return _read_records(_RecordFiles(folder, name))[0]


def _read_records(files: _RecordFiles) -> tuple[History, Manifest, int]:
    """Return the history of a batch, and the state of the files to append to.

    The latter are the manifest in ``files``, and the length of their failures [bytes].
    """
    history, local_manifest, failures_length = History(), Manifest(), 0
    full_files = files.batch_files()
    for source in (full_files, *full_files.part_files()):
        manifest_path, failures_path = source.record_paths()
        manifest, failures = read_manifest(manifest_path), read_failures(failures_path)
        history.manifest.merge(manifest)
        history.failure_reasons |= failures.reasons
        history.damage_warnings += [
            *manifest.damage_warnings,
            *failures.damage_warnings,
        ]
        if source == files:
            local_manifest, failures_length = manifest, failures.length
    return history, local_manifest, failures_length


class Ledger:
    """The records of a batch, locked by a run.

    Attributes:
        history: Results of earlier runs.
        start_time_ns: Start of the run, by the disk's clock [ns].
    """

    def __init__(self, files: _RecordFiles, start_time_ns: int) -> None:
        self.start_time_ns, self._files = start_time_ns, files
        self.history, local_manifest, self._failures_length = _read_records(files)
        # Damaged lines are reported once.
        self._has_changes = bool(self.history.damage_warnings)
        self._exit_stack = ExitStack()
        writer = ManifestWriter(files.record_path(".jsonl"), local_manifest)
        self._writer = self._exit_stack.enter_context(writer)

    def add_names(self, names: Iterable[str]) -> None:
        """Record names of files that a run is about to write, and may replace later."""
        new_names = [
            name for name in names if name not in self.history.manifest.known_names
        ]
        if new_names:
            self._writer.add_names(new_names)
            self._has_changes = True
            self.history.manifest.known_names.update(new_names)

    def add(self, record: ItemRecord) -> None:
        """Record a built item."""
        self._writer.add(record)
        self._has_changes = True
        self.history.manifest.add(record)
        self.history.failure_reasons.pop(record.key, None)

    def add_failure(self, key: str, reason: str) -> None:
        """Record a failed item and the reason."""
        path = self._files.record_path(".failed.jsonl")
        self._has_changes = True
        with LineWriter(path, FAILURES_HEADER, self._failures_length) as writer:
            writer.write([_failure_line(key, reason)])
            self._failures_length = writer.length
        self.history.failure_reasons[key] = reason

    def close(self) -> None:
        """Close the files without rewriting them."""
        self._exit_stack.close()

    def merge_records(self, should_keep: Callable[[ItemRecord], bool]) -> None:
        """Merge the records of partial runs into those of the full batch."""
        self.close()
        if self._files.part:
            return
        part_paths = [
            path for f in self._files.part_files() for path in f.record_paths()
        ]
        if not (self._has_changes or any(path.exists() for path in part_paths)):
            return
        manifest = self.history.manifest
        kept_records = [item for item in manifest.items.values() if should_keep(item)]
        recorded_names = {
            output.path for item in kept_records for output in item.outputs
        }
        root = self._files.folder.parent
        known_names = [
            name
            for name in sorted(manifest.known_names | recorded_names)
            if name in recorded_names
            or FileState.of(path_of_name(name, root)) is not None
        ]
        manifest_path, failures_path = self._files.record_paths()
        rewrite_manifest(manifest_path, kept_records, known_names)
        rewrite_failures(failures_path, self.history.failure_reasons)
        for path in part_paths:
            path.unlink(missing_ok=True)


@contextmanager
def locked_ledger(folder: Path, name: str, part: str = "") -> Iterator[Ledger]:
    """Lock the records of a batch, or of a part of it, against other runs."""
    files = _RecordFiles(folder, name, part)
    with ExitStack() as locks:
        if part:
            # Released immediately: no run of the full batch is active, and of parts
            # with common items only one can proceed.
            with ExitStack() as temporary_locks:
                _lock(temporary_locks, files.batch_files(), LOCK_TIMEOUT)
                _lock(locks, files, 0.0)
                for part_file_set in files.part_files():
                    if part_file_set != files and files.overlaps(part_file_set):
                        _lock(temporary_locks, part_file_set, 0.0)
        else:
            _lock(locks, files, 0.0)
            for part_file_set in files.part_files():
                _lock(locks, part_file_set, 0.0)
        start_time_ns = _write_owner(files)
        ledger = Ledger(files, start_time_ns)
        try:
            yield ledger
        finally:
            ledger.close()


def _lock(locks: ExitStack, files: _RecordFiles, timeout: float) -> None:
    from filelock import FileLock, Timeout

    path = files.record_path(".lock")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        lock: FileLock = FileLock(path)
        locks.enter_context(lock.acquire(timeout=timeout))
    except Timeout as error:
        message = f"another run of this batch is in progress: {_owner_text(files)}"
        hint = "wait until it ends, or stop it"
        raise LockedError(Fault("BAT010", message, str(path), (), hint)) from error
    except (OSError, NotImplementedError) as error:
        # Disks without locks raise the second error.
        fault = output_error(path, error).faults[0]
        raise OutputError(Fault("BAT012", fault.message, str(path))) from error


def _write_owner(files: _RecordFiles) -> int:
    """Write the owner file of a run; return its time by the clock of the disk."""
    import platform

    path = files.record_path(".owner")
    owner = json.dumps({"process": os.getpid(), "host": platform.node()})
    # A link may lead to a foreign file, and a pipe to nothing.
    flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC
    for name in ("O_NOFOLLOW", "O_NONBLOCK"):
        flags |= getattr(os, name, 0)
    try:
        descriptor = os.open(path, flags, 0o666)
        try:
            os.write(descriptor, owner.encode())
            return os.fstat(descriptor).st_mtime_ns
        finally:
            os.close(descriptor)
    except OSError as error:
        fault = output_error(path, error).faults[0]
        raise OutputError(Fault("BAT012", fault.message, str(path))) from error


def _owner_text(files: _RecordFiles) -> str:
    """Return the process that owns a run as text, or "of an unknown process"."""
    import platform

    unknown_text = "of an unknown process"
    try:
        owner = read_json(files.record_path(".owner"), MAX_OWNER_BYTES)
        process, host = integer_in(owner, "process", 1, 2**31), text_in(owner, "host")
    except RecordError:
        return unknown_text
    if host == platform.node() and not is_running(process):
        # An earlier process, or one in another process namespace.
        return unknown_text
    return f"process {process} on {excerpt(host)}"

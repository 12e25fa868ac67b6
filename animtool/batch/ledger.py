"""The records of a batch: what was made and what failed, kept by one run at a time.

A run of the whole batch holds `batch-NAME.lock`. Runs of some of its items each hold a
lock and write files of their own, in `batch-NAME.d`, which the next whole run takes in.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from animtool.batch.failures import add_failure, read_failures, rewrite_failures
from animtool.batch.manifest import (
    Manifest,
    ManifestWriter,
    read_manifest,
    rewrite_manifest,
)
from animtool.batch.places import place_of
from animtool.batch.records import ItemRecord
from animtool.errors import Fault, OutputError
from animtool.output import output_error

if TYPE_CHECKING:
    from filelock import FileLock

__all__ = ["History", "Ledger", "held_ledger", "read_history"]

# A run of some items holds the lock of the whole for a moment, to see that it is free.
PATIENCE = 5.0


@dataclass(slots=True)
class History:
    """What earlier runs left.

    Attributes:
        made: By all of them.
        failed: Why items failed that were not made since, by key.
    """

    made: Manifest = field(default_factory=Manifest)
    failed: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class _Files:
    """Where records are: of the whole batch, or of some items of it."""

    folder: Path
    name: str
    part: str = ""

    @property
    def parts(self) -> Path:
        return self.folder / f"batch-{self.name}.d"

    def named(self, suffix: str) -> Path:
        if self.part:
            return self.parts / f"{self.part}{suffix}"
        return self.folder / f"batch-{self.name}{suffix}"

    def holds(self) -> bool:
        """Return whether something is recorded."""
        paths = self.named(".jsonl"), self.named(".failed.jsonl")
        return any(path.exists() for path in paths)

    def whole(self) -> _Files:
        return _Files(self.folder, self.name)

    def others(self) -> list[_Files]:
        """Return those of every part that left some."""
        found = sorted(path.stem for path in self.parts.glob("*.lock"))
        return [_Files(self.folder, self.name, part) for part in found]


def read_history(folder: Path, name: str) -> History:
    """Return what earlier runs of a batch left, of parts of it too.

    Args:
        folder: Of the records.
        name: Of the batch.

    Raises:
        FormatError: A file of it cannot be read (BAT011).
    """
    files = _Files(folder, name)
    history = History()
    for source in (files, *files.others()):
        history.made.join(read_manifest(source.named(".jsonl")))
        history.failed |= read_failures(source.named(".failed.jsonl"))[0]
    return history


class Ledger:
    """The records of a batch while a run holds them.

    Attributes:
        history: What earlier runs left.
        now: The clock of the disk when the run began [ns].
    """

    def __init__(self, files: _Files, now: int) -> None:
        self.now, self._files = now, files
        self._grown = False
        self.history = read_history(files.folder, files.name)
        own = read_manifest(files.named(".jsonl"))
        self._closing = ExitStack()
        writer = ManifestWriter(files.named(".jsonl"), own)
        self._writer = self._closing.enter_context(writer)
        self._failed_length = read_failures(files.named(".failed.jsonl"))[1]

    def claim(self, names: Iterable[str]) -> None:
        """Say which files are about to be written.

        Raises:
            OutputError: It cannot be written (BAT012).
        """
        new = [name for name in names if name not in self.history.made.known]
        if new:
            self._writer.claim(new)
            self._grown = True
            self.history.made.known.update(new)

    def made(self, made: ItemRecord) -> None:
        """Note an item that was made.

        Raises:
            OutputError: It cannot be written (BAT012).
        """
        self._writer.add(made)
        self._grown = True
        self.history.made.add(made)
        self.history.failed.pop(made.key, None)

    def failed(self, key: str, why: str) -> None:
        """Note an item that failed.

        Raises:
            OutputError: It cannot be written (BAT012).
        """
        path = self._files.named(".failed.jsonl")
        self._grown = True
        self._failed_length = add_failure(path, key, why, self._failed_length)
        self.history.failed[key] = why

    def close(self) -> None:
        """Close the files, as they are."""
        self._closing.close()

    def settle(self, wanted: Callable[[ItemRecord], bool]) -> None:
        """Write records of the whole anew, those of its parts taken in.

        Args:
            wanted: Whether an item is still of interest.

        Raises:
            OutputError: They cannot be written (OUT002, BAT012).
        """
        self.close()
        others = [] if self._files.part else self._files.others()
        if self._files.part or not (self._grown or any(o.holds() for o in others)):
            return
        made = self.history.made
        kept = [item for item in made.items.values() if wanted(item)]
        recorded = {output.path for item in kept for output in item.outputs}
        begun = [
            name
            for name in sorted(made.known - recorded)
            if place_of(name, self._files.folder.parent).exists()
        ]
        rewrite_manifest(self._files.named(".jsonl"), kept, begun)
        rewrite_failures(self._files.named(".failed.jsonl"), self.history.failed)
        for part in others:
            part.named(".jsonl").unlink(missing_ok=True)
            part.named(".failed.jsonl").unlink(missing_ok=True)


@contextmanager
def held_ledger(folder: Path, name: str, part: str = "") -> Iterator[Ledger]:
    """Give the records of a batch, which no other run may use at the same time.

    Args:
        folder: Of the records.
        name: Of the batch.
        part: Which of its items are run, such as ``1-20``; empty is all.

    Raises:
        FormatError: A file of it cannot be read (BAT011).
        OutputError: Another run holds them (BAT010), or they cannot be written
            (BAT012).
    """
    files = _Files(folder, name, part)
    with ExitStack() as held:
        _lock(held, files, 0.0)
        if part:
            # Released at once: it says only that no run of the whole goes on.
            with ExitStack() as moment:
                _lock(moment, files.whole(), PATIENCE)
        else:
            for other in files.others():
                _lock(held, other, 0.0)
        ledger = Ledger(files, _sign(files))
        try:
            yield ledger
        finally:
            ledger.close()


def _lock(held: ExitStack, files: _Files, patience: float) -> None:
    from filelock import FileLock, Timeout

    path = files.named(".lock")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        lock: FileLock = FileLock(path)
        held.enter_context(lock.acquire(timeout=patience))
    except Timeout as error:
        message = f"another run of this batch goes on: {_owner(files)}"
        hint = "wait for it to end, or end it"
        raise OutputError(Fault("BAT010", message, str(path), (), hint)) from error
    except OSError as error:
        fault = output_error(path, error).faults[0]
        raise OutputError(Fault("BAT012", fault.message, str(path))) from error


def _sign(files: _Files) -> int:
    """Write down whose run it is; return when that was, by the clock of the disk."""
    import platform

    path = files.named(".owner")
    try:
        path.write_text(json.dumps({"process": os.getpid(), "host": platform.node()}))
        return path.stat().st_mtime_ns
    except OSError as error:
        fault = output_error(path, error).faults[0]
        raise OutputError(Fault("BAT012", fault.message, str(path))) from error


def _owner(files: _Files) -> str:
    try:
        found = json.loads(files.named(".owner").read_text())
        return f"process {found['process']} on {found['host']}"
    except (OSError, ValueError, KeyError, TypeError):
        return "of a process that has not said which"

"""What became of an item that was to be made."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from animtool.batch.records import FileRecord
from animtool.errors import Fault


class Status(StrEnum):
    """What became of an item."""

    DONE = "done"
    SKIPPED = "skipped"
    FAILED = "failed"
    NOT_RUN = "not run"


@dataclass(frozen=True, slots=True)
class Measured:
    """What a bake measured.

    Attributes:
        samples: Written.
        error: Largest distance between a joint and where its file has it [m].
        joint: Which joint's.
    """

    samples: int
    error: float
    joint: str


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of an item that was to be made.

    Attributes:
        number: The item's.
        status: Done or failed.
        seconds: Wall time of making it.
        faults: Why it failed.
        notices: Warnings and notes.
        measured: What the bake measured.
        inputs: The files that were looked at.
        outputs: The files that were written.
        at: When, by the clock of the disk that it was written to [ns].
        retired: Whether the process that made it had better make no other.
    """

    number: int
    status: Status
    seconds: float
    faults: tuple[Fault, ...] = ()
    notices: tuple[Fault, ...] = ()
    measured: Measured | None = None
    inputs: tuple[FileRecord, ...] = ()
    outputs: tuple[FileRecord, ...] = ()
    at: int = 0
    retired: bool = False

"""What is known of a file and of an item that was made, and how it is written down."""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from animtool.batch.checked import (
    RecordError,
    list_in,
    object_of,
    text_in,
    whole_in,
)
from animtool.files import open_input
from animtool.inputs import FileState

# What names, digests and clocks can be.
MAX_DIGEST = 200
CLOCK = 2**63


@dataclass(frozen=True, slots=True)
class FileRecord:
    """A file as it was.

    Attributes:
        path: Where it is, from the folder of all outputs if below it.
        state: None where there was none.
        sha256: Of its content; empty where there was none, or it is a folder.
    """

    path: str
    state: FileState | None
    sha256: str = ""

    def as_dict(self) -> dict[str, object]:
        """Return it as JSON has it."""
        if self.state is None:
            return {"path": self.path, "absent": True}
        return {
            "path": self.path,
            "size": self.state.size,
            "changed": self.state.changed,
            "inode": self.state.inode,
            "sha256": self.sha256,
        }

    @classmethod
    def from_dict(cls, plain: Mapping[str, Any]) -> FileRecord:
        """Return what `as_dict` wrote.

        Raises:
            RecordError: It is something else.
        """
        path = text_in(plain, "path")
        if "absent" in plain:
            if plain["absent"] is not True or "size" in plain:
                raise RecordError("'absent' is not all there is")
            return cls(path, None)
        state = FileState(
            whole_in(plain, "size"),
            whole_in(plain, "changed", -CLOCK, CLOCK),
            whole_in(plain, "inode"),
        )
        return cls(path, state, text_in(plain, "sha256", MAX_DIGEST))


@dataclass(frozen=True, slots=True)
class ItemRecord:
    """An item that was made.

    Attributes:
        key: Its output, named as files are.
        how: Digest of everything but files that decided how.
        versions: Digest of the versions of what made it.
        inputs: The files that were looked at.
        outputs: The files that were written.
        at: When, by the clock of the disk that it was written to [ns]. Files that are
            as young may have changed since without a sign.
    """

    key: str
    how: str
    versions: str
    inputs: tuple[FileRecord, ...]
    outputs: tuple[FileRecord, ...]
    at: int

    def as_dict(self, numbers: Mapping[FileRecord, int]) -> dict[str, object]:
        """Return it as JSON has it.

        Args:
            numbers: Of the inputs.
        """
        return {
            "item": self.key,
            "how": self.how,
            "versions": self.versions,
            "inputs": [numbers[record] for record in self.inputs],
            "outputs": [record.as_dict() for record in self.outputs],
            "at": self.at,
        }

    @classmethod
    def from_dict(
        cls, plain: Mapping[str, Any], files: Mapping[int, FileRecord]
    ) -> ItemRecord:
        """Return what `as_dict` wrote.

        Args:
            plain: What it wrote.
            files: The inputs, by number.

        Raises:
            RecordError: It is something else, or an input has no record.
        """
        outputs = list_in(plain, "outputs")
        if not outputs:
            raise RecordError("'outputs' is empty")
        return cls(
            text_in(plain, "item"),
            text_in(plain, "how", MAX_DIGEST),
            # Few are distinct, and every item has one.
            sys.intern(text_in(plain, "versions", MAX_DIGEST)),
            tuple(_numbered(list_in(plain, "inputs"), files)),
            tuple(FileRecord.from_dict(object_of(output)) for output in outputs),
            whole_in(plain, "at", -CLOCK, CLOCK),
        )


def _numbered(
    numbers: Sequence[object], files: Mapping[int, FileRecord]
) -> Iterator[FileRecord]:
    """Yield the files of numbers."""
    if not numbers:
        raise RecordError("'inputs' is empty")
    for number in numbers:
        # A truth value, and a float, can be equal to an int.
        found = files.get(number) if type(number) is int else None
        if found is None:
            raise RecordError("an input has no record")
        yield found


def digest_of(value: object) -> str:
    """Return a digest of plain values, the same for the same values.

    >>> digest_of({"a": 1, "b": None}) == digest_of({"b": None, "a": 1})
    True
    """
    text = json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def file_digest(path: Path) -> str:
    """Return the SHA-256 of a file's content; empty of a folder, a device or a pipe.

    Raises:
        FormatError: It cannot be read, or changed meanwhile.
    """
    if path.exists() and not path.is_file():
        return ""
    with open_input(path, None, noted=False) as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
        file.check()
    return digest


def record_of(path: Path, name: str, state: FileState | None) -> FileRecord:
    """Return the record of a file whose state is known, its content read.

    Raises:
        FormatError: It cannot be read, or changed meanwhile.
    """
    return FileRecord(name, state, "" if state is None else file_digest(path))

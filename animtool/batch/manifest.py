"""Records of built items and their files: the manifest of a batch.

It has one line for each accessed file, for outputs that are about to be written, and
for each built item. An item refers to files by number, and is written together with
those that have no number yet.
"""

from __future__ import annotations

import hashlib
import json
import math
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import field
from pathlib import Path
from typing import Any

from animtool.batch.records import (
    LineReader,
    LineWriter,
    RecordError,
    checked_object,
    integer_in,
    list_in,
    number_in,
    text_in,
    texts_in,
)
from animtool.core.errors import Fault
from animtool.core.files.output import replacement_path
from animtool.core.files.reading import FileState, open_input
from animtool.core.record import dataclass
from animtool.core.values import template_values
from animtool.motion.scores import PassScores, Score, ScoreUnit

# Limits of digests and clock values.
MAX_DIGEST_LENGTH = 200
MAX_CLOCK_NS = 2**63


@dataclass(frozen=True, slots=True)
class FileRecord:
    """Size, time, inode and digest of a file when an item was built."""

    path: str  # relative to the folder of all outputs if inside it
    state: FileState | None  # None if the file was missing
    sha256: str = ""  # digest of its content; empty if missing or a folder

    def as_dict(self) -> dict[str, object]:
        """Return the record as JSON values, the input of `from_dict`."""
        if self.state is None:
            return {"path": self.path, "absent": True}
        return {
            "path": self.path,
            "size": self.state.size,
            "changed": self.state.changed_at,
            "inode": self.state.inode,
            "sha256": self.sha256,
        }

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> FileRecord:
        """Return the record from the values of `as_dict`."""
        path = text_in(values, "path")
        if "absent" in values:
            if values["absent"] is not True or "size" in values:
                raise RecordError("'absent' is incomplete")
            return cls(path, None)
        state = FileState(
            integer_in(values, "size"),
            integer_in(values, "changed", -MAX_CLOCK_NS, MAX_CLOCK_NS),
            integer_in(values, "inode"),
        )
        return cls(path, state, text_in(values, "sha256", MAX_DIGEST_LENGTH))


@dataclass(frozen=True, slots=True)
class ItemRecord:
    """What an item was built from and wrote, to decide whether it is up to date."""

    key: str  # its output, relative like file paths
    settings_digest: str  # digest of all settings except files
    versions: str  # digest of the versions of its builders
    inputs: tuple[FileRecord, ...]  # accessed files
    outputs: tuple[FileRecord, ...]  # written files
    # Time by the clock of the output's disk [ns]. Files that are as young may have
    # changed since without a different state.
    written_at: int
    scores: tuple[PassScores, ...] = ()  # scores of its passes

    def as_dict(self, file_numbers: Mapping[FileRecord, int]) -> dict[str, object]:
        """Return the record as JSON values that refer to files by number."""
        return {
            "item": self.key,
            "how": self.settings_digest,
            "versions": self.versions,
            "inputs": [file_numbers[record] for record in self.inputs],
            "outputs": [record.as_dict() for record in self.outputs],
            "at": self.written_at,
            **template_values(self, "scores+"),
        }

    @classmethod
    def from_dict(
        cls, values: Mapping[str, Any], files_by_number: Mapping[int, FileRecord]
    ) -> ItemRecord:
        """Return the record from the values of `as_dict`."""
        outputs = _nonempty_list(values, "outputs")
        scores = list_in(values, "scores") if "scores" in values else ()
        return cls(
            text_in(values, "item"),
            text_in(values, "how", MAX_DIGEST_LENGTH),
            # Few are distinct, and every item has one.
            sys.intern(text_in(values, "versions", MAX_DIGEST_LENGTH)),
            tuple(_referenced_files(_nonempty_list(values, "inputs"), files_by_number)),
            tuple(FileRecord.from_dict(checked_object(output)) for output in outputs),
            integer_in(values, "at", -MAX_CLOCK_NS, MAX_CLOCK_NS),
            tuple(_parse_pass_scores(checked_object(entry)) for entry in scores),
        )


def _referenced_files(
    file_numbers: Sequence[object], files_by_number: Mapping[int, FileRecord]
) -> Iterator[FileRecord]:
    """Yield the file records that numbers refer to."""
    for number in file_numbers:
        # Booleans and floats may equal an int.
        file = files_by_number.get(number) if type(number) is int else None
        if file is None:
            raise RecordError("an input has no record")
        yield file


def _nonempty_list(data: Mapping[str, Any], key: str) -> Sequence[Any]:
    entries = list_in(data, key)
    if not entries:
        raise RecordError(f"{key!r} is empty")
    return entries


def digest_of(value: object) -> str:
    """Return a digest of plain values; equal for equal values.

    >>> digest_of({"a": 1, "b": None}) == digest_of({"b": None, "a": 1})
    True
    """
    text = json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def file_digest(path: Path) -> str:
    """Return the SHA-256 of a file; empty for a folder, device or pipe."""
    if path.exists() and not path.is_file():
        return ""
    with open_input(path, None, is_recorded=False) as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
        file.check()
    return digest


def record_file(path: Path, name: str, state: FileState | None) -> FileRecord:
    """Return the record of a file: its state and, if it exists, its digest."""
    return FileRecord(name, state, "" if state is None else file_digest(path))


MANIFEST_HEADER = {"manifest": "animtool/1"}
MAX_FILE_NUMBER = 10**9
# Number of names per line, so that a damaged line loses few.
NAMES_PER_LINE = 100


@dataclass(slots=True)
class Manifest:
    """Records of built items, and names of every file that runs wrote."""

    items: dict[str, ItemRecord] = field(default_factory=dict)  # by key
    # Names of files that a run of the batch wrote or started to write.
    known_names: set[str] = field(default_factory=set)
    # Distinct files that items refer to, with their numbers.
    file_numbers: dict[FileRecord, int] = field(default_factory=dict)
    next_number: int = 0  # next file number
    length: int = 0  # length of the readable part [bytes]
    # Warnings about unusable lines.
    damage_warnings: list[Fault] = field(default_factory=list)

    def add(self, record: ItemRecord) -> None:
        """Add a built item, replacing an older one with the same key."""
        previous_record = self.items.get(record.key)
        if previous_record is None or previous_record.written_at <= record.written_at:
            self.items[record.key] = record
        self.known_names.update(output.path for output in record.outputs)

    def merge(self, other: Manifest) -> None:
        """Add the records of another manifest; for equal keys, keep the newer one."""
        for record in other.items.values():
            self.add(record)
        self.known_names |= other.known_names
        self.damage_warnings += other.damage_warnings


def read_manifest(path: Path) -> Manifest:
    """Return a manifest; an empty one if the file is missing.

    Unusable lines are skipped and listed in `Manifest.damage_warnings`.
    """
    manifest, reader = Manifest(), LineReader(path, MANIFEST_HEADER)
    files_by_number: dict[int, FileRecord] = {}
    for line in reader.lines():
        try:
            _add_line(manifest, files_by_number, line)
        except RecordError as error:
            reader.damaged_lines[reader.line_number] = str(error)
    manifest.length = reader.length
    manifest.damage_warnings += reader.notices()
    return manifest


def _add_line(
    manifest: Manifest, files_by_number: dict[int, FileRecord], line: Mapping[str, Any]
) -> None:
    """Add the record of a line to a manifest; add a file to ``files_by_number`` too."""
    if "known" in line:
        manifest.known_names.update(texts_in(line, "known"))
    elif "file" in line:
        number = integer_in(line, "file", 0, MAX_FILE_NUMBER)
        record = FileRecord.from_dict(line)
        manifest.next_number = max(manifest.next_number, number + 1)
        if files_by_number.setdefault(number, record) != record:
            # It is unknown which of the two an item means.
            manifest.file_numbers.pop(files_by_number.pop(number), None)
            raise RecordError("has the number of another file")
        manifest.file_numbers[record] = number
    elif "item" in line:
        manifest.add(ItemRecord.from_dict(line, files_by_number))
    else:
        raise RecordError("is not part of a manifest")


class ManifestWriter(LineWriter):
    """Appends items to a manifest file."""

    def __init__(self, path: Path, manifest: Manifest) -> None:
        """Open a manifest file for appending."""
        self._file_numbers = dict(manifest.file_numbers)
        self._next_number = manifest.next_number
        super().__init__(path, MANIFEST_HEADER, manifest.length)

    def add_names(self, names: Iterable[str]) -> None:
        """Append the names of files that are about to be written."""
        listed_names = list(names)
        first_indices = range(0, len(listed_names), NAMES_PER_LINE)
        self.write(
            {"known": listed_names[i : i + NAMES_PER_LINE]} for i in first_indices
        )

    def add(self, record: ItemRecord) -> None:
        """Append an item, after a line for each file that has no number yet."""
        lines: list[dict[str, object]] = []
        for file in record.inputs:
            if file not in self._file_numbers:
                number = self._file_numbers[file] = self._next_number
                self._next_number += 1
                lines.append({"file": number, **file.as_dict()})
        self.write([*lines, record.as_dict(self._file_numbers)])


def rewrite_manifest(
    path: Path, items: Iterable[ItemRecord], known_names: Iterable[str]
) -> None:
    """Replace a manifest atomically with one of the given items and names."""
    with (
        replacement_path(path) as temporary_path,
        ManifestWriter(temporary_path, Manifest()) as writer,
    ):
        writer.add_names(known_names)
        for record in items:
            writer.add(record)


def _parse_pass_scores(data: Mapping[str, Any]) -> PassScores:
    names = checked_object(data.get("names"))
    return PassScores(
        tuple(
            _parse_score(checked_object(entry))
            for entry in _nonempty_list(data, "scores")
        ),
        {score_name: tuple(texts_in(names, score_name)) for score_name in names},
        text_in(data, "pass"),
        text_in(data, "where"),
    )


def _parse_score(data: Mapping[str, Any]) -> Score:
    unit = text_in(data, "unit")
    if unit not in {*ScoreUnit}:
        raise RecordError(f"unknown unit of a score: {unit!r}")
    value, typical_value, ideal_value = (
        number_in(data, key, -math.inf) for key in ("value", "usual", "ideal")
    )
    if typical_value <= ideal_value:
        raise RecordError("'usual' is not above 'ideal'")
    return Score(
        text_in(data, "name"), value, ScoreUnit(unit), typical_value, ideal_value
    )

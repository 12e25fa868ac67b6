"""What a batch has made: a file of lines that grows while it runs.

A line each for a file that was looked at, for outputs that are about to be written, and
for an item that was made. An item refers to files by number, and is written together
with those that have none yet.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from animtool.batch.checked import RecordError, texts_in, whole_in
from animtool.batch.lines import LineReader, LineWriter
from animtool.batch.records import FileRecord, ItemRecord
from animtool.errors import Fault
from animtool.output import replacing

HEAD = {"manifest": "animtool/1"}
MAX_FILES = 10**9
# Names a line: one that is damaged takes few with it.
CLAIMED = 100


@dataclass(slots=True)
class Manifest:
    """What has been made.

    Attributes:
        items: By key.
        known: Names of files that were made, or begun, by a run of the batch.
        files: The distinct files that items refer to, with their numbers.
        next: The number of the next of them.
        length: Of what could be read [bytes].
        damaged: Warnings of lines that cannot be used.
    """

    items: dict[str, ItemRecord] = field(default_factory=dict)
    known: set[str] = field(default_factory=set)
    files: dict[FileRecord, int] = field(default_factory=dict)
    next: int = 0
    length: int = 0
    damaged: list[Fault] = field(default_factory=list)

    def add(self, made: ItemRecord) -> None:
        """Note an item that was made; of two of one key the younger counts."""
        before = self.items.get(made.key)
        if before is None or before.at <= made.at:
            self.items[made.key] = made
        self.known.update(output.path for output in made.outputs)

    def join(self, other: Manifest) -> None:
        """Note what another manifest says."""
        for made in other.items.values():
            self.add(made)
        self.known |= other.known
        self.damaged += other.damaged


def read_manifest(path: Path) -> Manifest:
    """Return what a manifest says; an empty one where there is none.

    A line that cannot be used is left out, and `Manifest.damaged` says so.

    Raises:
        FormatError: It cannot be read, or is of another kind or version (BAT011).
    """
    manifest, reader = Manifest(), LineReader(path, HEAD)
    lines = _Lines(manifest)
    for line in reader.lines():
        try:
            lines.take(line)
        except RecordError as error:
            reader.damaged[reader.number] = str(error)
    manifest.length = reader.length
    notice = reader.notice()
    manifest.damaged += [] if notice is None else [notice]
    return manifest


class _Lines:
    """Takes the lines of a manifest, one after another."""

    def __init__(self, manifest: Manifest) -> None:
        self.manifest = manifest
        self.files: dict[int, FileRecord] = {}

    def take(self, line: Mapping[str, Any]) -> None:
        """Note what a line says.

        Raises:
            RecordError: It is none of a manifest.
        """
        if "known" in line:
            self.manifest.known.update(texts_in(line, "known"))
        elif "file" in line:
            self._file(whole_in(line, "file", 0, MAX_FILES), FileRecord.from_dict(line))
        elif "item" in line:
            self.manifest.add(ItemRecord.from_dict(line, self.files))
        else:
            raise RecordError("is none of a manifest")

    def _file(self, number: int, record: FileRecord) -> None:
        manifest = self.manifest
        manifest.next = max(manifest.next, number + 1)
        if self.files.setdefault(number, record) != record:
            # Which of the two an item means is not known.
            manifest.files.pop(self.files.pop(number), None)
            raise RecordError("has the number of another file")
        manifest.files[record] = number


class ManifestWriter(LineWriter):
    """A manifest that items are added to."""

    def __init__(self, path: Path, manifest: Manifest) -> None:
        """Open a manifest.

        Args:
            path: The file.
            manifest: What `read_manifest` found there.

        Raises:
            OutputError: It cannot be written (BAT012).
        """
        self._files, self._next = dict(manifest.files), manifest.next
        super().__init__(path, HEAD, manifest.length)

    def claim(self, names: Iterable[str]) -> None:
        """Say which files are about to be written.

        Raises:
            OutputError: It cannot be written (BAT012).
        """
        known = list(names)
        some = (known[i : i + CLAIMED] for i in range(0, len(known), CLAIMED))
        self.write({"known": part} for part in some)

    def add(self, made: ItemRecord) -> None:
        """Add an item.

        Raises:
            OutputError: It cannot be written (BAT012).
        """
        new = list(self._numbered(made.inputs))
        self.write([*new, made.as_dict(self._files)])

    def _numbered(self, records: Iterable[FileRecord]) -> Iterator[dict[str, object]]:
        """Give files numbers, and yield the lines of those that had none."""
        for record in records:
            if record not in self._files:
                number = self._files[record] = self._next
                self._next += 1
                yield {"file": number, **record.as_dict()}


def rewrite_manifest(
    path: Path, items: Iterable[ItemRecord], known: Iterable[str]
) -> None:
    """Write a manifest anew, whole or not at all.

    Args:
        path: The file.
        items: All that it is to hold.
        known: Names of the files that runs of the batch wrote, those of items too:
            they may be replaced where the line of their item is damaged.

    Raises:
        OutputError: It cannot be written (OUT002, BAT012).
    """
    with (
        replacing(path) as temporary,
        ManifestWriter(temporary, Manifest()) as writer,
    ):
        writer.claim(known)
        for made in items:
            writer.add(made)

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

from animtool.batch.lines import LineReader, LineWriter
from animtool.batch.records import FileRecord, ItemRecord
from animtool.errors import Fault, FormatError
from animtool.output import replacing

__all__ = ["Manifest", "ManifestWriter", "read_manifest", "rewrite_manifest"]

HEAD = {"manifest": "animtool/1"}


@dataclass(slots=True)
class Manifest:
    """What has been made.

    Attributes:
        items: By key.
        known: Names of files that were made, or begun, by a run of the batch.
        files: The distinct files that items refer to, with their numbers.
        length: Of what could be read [bytes].
    """

    items: dict[str, ItemRecord] = field(default_factory=dict)
    known: set[str] = field(default_factory=set)
    files: dict[FileRecord, int] = field(default_factory=dict)
    length: int = 0

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


def read_manifest(path: Path) -> Manifest:
    """Return what a manifest says; an empty one where there is none.

    Raises:
        FormatError: It cannot be read, or is of another kind or version (BAT011).
    """
    manifest, files = Manifest(), list[FileRecord]()
    # Few are distinct, and every item has one.
    texts: dict[str, str] = {}
    reader = LineReader(path, HEAD)
    for line in reader.lines():
        try:
            if "known" in line:
                manifest.known.update(line["known"])
            elif "file" in line:
                files.append(FileRecord.from_dict(line))
            else:
                manifest.add(_item(line, files, texts))
        except (KeyError, IndexError, TypeError) as error:
            message = f"has a line that is none of a manifest: {error!r}"
            hint = "remove it, and everything is made anew"
            raise FormatError(Fault("BAT011", message, str(path), (), hint)) from error
    manifest.files = {record: i for i, record in enumerate(files)}
    manifest.length = reader.length
    return manifest


def _item(
    line: Mapping[str, Any], files: list[FileRecord], texts: dict[str, str]
) -> ItemRecord:
    return ItemRecord(
        line["item"],
        line["how"],
        texts.setdefault(line["versions"], line["versions"]),
        tuple(files[i] for i in line["inputs"]),
        tuple(FileRecord.from_dict(output) for output in line["outputs"]),
        line["at"],
    )


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
        self._files = dict(manifest.files)
        super().__init__(path, HEAD, manifest.length)

    def claim(self, names: Iterable[str]) -> None:
        """Say which files are about to be written.

        Raises:
            OutputError: It cannot be written (BAT012).
        """
        known = list(names)
        if known:
            self.write([{"known": known}])

    def add(self, made: ItemRecord) -> None:
        """Add an item.

        Raises:
            OutputError: It cannot be written (BAT012).
        """
        new = list(self._numbered(made.inputs))
        line = {
            "item": made.key,
            "how": made.how,
            "versions": made.versions,
            "inputs": [self._files[record] for record in made.inputs],
            "outputs": [record.as_dict() for record in made.outputs],
            "at": made.at,
        }
        self.write([*new, line])

    def _numbered(self, records: Iterable[FileRecord]) -> Iterator[dict[str, object]]:
        """Give files numbers, and yield the lines of those that had none."""
        for record in records:
            if record not in self._files:
                number = self._files[record] = len(self._files)
                yield {"file": number, **record.as_dict()}


def rewrite_manifest(
    path: Path, items: Iterable[ItemRecord], begun: Iterable[str]
) -> None:
    """Write a manifest anew, whole or not at all.

    Args:
        path: The file.
        items: All that it is to hold.
        begun: Names of other files that runs of the batch wrote.

    Raises:
        OutputError: It cannot be written (OUT002, BAT012).
    """
    with (
        replacing(path) as temporary,
        ManifestWriter(temporary, Manifest()) as writer,
    ):
        writer.claim(begun)
        for made in items:
            writer.add(made)

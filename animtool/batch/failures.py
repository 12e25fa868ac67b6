"""Which items failed when they were made last."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from animtool.batch.checked import RecordError, text_in
from animtool.batch.lines import LineReader, LineWriter
from animtool.errors import Fault
from animtool.output import replacing

HEAD = {"failures": "animtool/1"}
# More than a line says to anybody.
MAX_WHY = 10_000


@dataclass(frozen=True, slots=True)
class Failures:
    """Which items failed.

    Attributes:
        why: Of each, by key.
        length: Of what could be read [bytes].
        damaged: Warnings of lines that cannot be used.
    """

    why: dict[str, str] = field(default_factory=dict)
    length: int = 0
    damaged: tuple[Fault, ...] = ()


def read_failures(path: Path) -> Failures:
    """Return which items failed; none where there is no file.

    Raises:
        FormatError: It cannot be read, or is of another kind or version (BAT011).
    """
    reader, found = LineReader(path, HEAD), dict[str, str]()
    for line in reader.lines():
        try:
            found[text_in(line, "item")] = text_in(line, "why")
        except RecordError as error:
            reader.damaged[reader.number] = str(error)
    notice = reader.notice()
    return Failures(found, reader.length, () if notice is None else (notice,))


def add_failure(path: Path, key: str, why: str, length: int) -> int:
    """Add an item that failed; return how long the file is then [bytes].

    Args:
        path: The file.
        key: Of the item.
        why: In a line.
        length: Of what could be read of the file [bytes].

    Raises:
        OutputError: It cannot be written (BAT012).
    """
    with LineWriter(path, HEAD, length) as writer:
        writer.write([_line(key, why)])
        return writer.length


def rewrite_failures(path: Path, failures: Mapping[str, str]) -> None:
    """Write the file anew; without failures it goes.

    Raises:
        OutputError: It cannot be written (OUT002, BAT012).
    """
    if not failures:
        path.unlink(missing_ok=True)
        return
    with replacing(path) as temporary, LineWriter(temporary, HEAD) as writer:
        writer.write(_line(key, why) for key, why in failures.items())


def _line(key: str, why: str) -> dict[str, str]:
    return {"item": key, "why": why.replace("\0", "\\0")[:MAX_WHY]}

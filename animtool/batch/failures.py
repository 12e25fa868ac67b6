"""Which items failed when they were made last."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from animtool.batch.lines import LineReader, LineWriter
from animtool.output import replacing

__all__ = ["add_failure", "read_failures", "rewrite_failures"]

HEAD = {"failures": "animtool/1"}


def read_failures(path: Path) -> tuple[dict[str, str], int]:
    """Return why each item failed, by key, and how much of the file could be read.

    Raises:
        FormatError: It cannot be read, or is of another kind or version (BAT011).
    """
    reader = LineReader(path, HEAD)
    found = {str(line.get("item")): str(line.get("why")) for line in reader.lines()}
    return found, reader.length


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
        writer.write([{"item": key, "why": why}])
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
        writer.write({"item": key, "why": why} for key, why in failures.items())

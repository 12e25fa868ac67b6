"""Files of JSON lines that only grow, and survive that their writer is killed."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from animtool.errors import Fault, FormatError, OutputError
from animtool.output import output_error

__all__ = ["LineReader", "LineWriter"]

Line = Mapping[str, Any]


class LineReader:
    """Reads such a file.

    Attributes:
        length: Of what could be read so far [bytes].
    """

    def __init__(self, path: Path, head: Line) -> None:
        """Take a file that need not be there.

        Args:
            path: The file.
            head: Its first line, which says what it is.
        """
        self.path, self.head, self.length = path, head, 0

    def lines(self) -> Iterator[dict[str, Any]]:
        """Yield every line but the first, up to one that a crash tore.

        Raises:
            FormatError: It cannot be read, or is of another kind or version (BAT011).
        """
        try:
            with self.path.open("rb") as file:
                for line in file:
                    found = _parsed(line)
                    if found is None:
                        return
                    if self.length:
                        yield found
                    elif found != self.head:
                        raise self._foreign(found)
                    self.length += len(line)
        except FileNotFoundError:
            return
        except OSError as error:
            message = f"cannot be read: {error.strerror or error}"
            raise FormatError(Fault("BAT011", message, str(self.path))) from error

    def _foreign(self, found: Line) -> FormatError:
        (kind, version), *_ = self.head.items()
        message = f"is no {kind} file of {version}"
        if kind in found:
            message = f"is of version {found[kind]!r}, and {version} is known"
        hint = "remove it, and everything is made anew"
        return FormatError(Fault("BAT011", message, str(self.path), (1,), hint))


def _parsed(line: bytes) -> dict[str, Any] | None:
    if not line.endswith(b"\n"):
        return None
    try:
        found = json.loads(line)
    except ValueError:
        return None
    return found if isinstance(found, dict) else None


class LineWriter:
    """Adds lines to such a file, those of a call at once or not at all.

    Attributes:
        path: The file.
        length: Of the file [bytes].
    """

    def __init__(self, path: Path, head: Line, length: int = 0) -> None:
        """Open a file, making it and its folder where need be.

        Args:
            path: The file.
            head: Its first line.
            length: Of what could be read of it [bytes]; the rest goes.

        Raises:
            OutputError: It cannot be written (BAT012).
        """
        self.path, self.length = path, length
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND | getattr(os, "O_BINARY", 0)
            self._handle = os.open(path, flags, 0o666)
            os.ftruncate(self._handle, length)
        except OSError as error:
            raise self._unwritable(error) from error
        if not length:
            self.write([head])

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the file."""
        os.close(self._handle)

    def write(self, lines: Iterable[Line]) -> None:
        """Add lines.

        Raises:
            OutputError: They cannot be written (BAT012).
        """
        texts = [json.dumps(line, separators=(",", ":")) + "\n" for line in lines]
        data = "".join(texts).encode()
        try:
            written = os.write(self._handle, data)
        except OSError as error:
            raise self._unwritable(error) from error
        if written < len(data):
            os.ftruncate(self._handle, self.length)
            raise self._unwritable("there is no room left")
        self.length += written

    def _unwritable(self, error: OSError | str) -> OutputError:
        fault = output_error(self.path, error).faults[0]
        hint = fault.hint or "what was made so far is recorded"
        return OutputError(Fault("BAT012", fault.message, fault.path, (), hint))

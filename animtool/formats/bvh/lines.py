"""The lines of a BVH header, read from a file that may hold anything."""

from __future__ import annotations

import re
from pathlib import Path
from typing import BinaryIO, NoReturn

from animtool.errors import Fault, FormatError

CHUNK_BYTES = 1 << 19
# A header line names one joint or its channels; a longer one is not a BVH's.
LONGEST_LINE_BYTES = 1 << 16
# A joint has five or six of them.
MAX_LINES = 1_000_000

_LINE_END = re.compile(rb"\r\n?|\n")


class HeaderLines:
    """Lines of a file with their numbers; CR, LF and CR LF each end one.

    Attributes:
        number: 1-based number of the line last returned.
    """

    def __init__(self, file: BinaryIO, path: Path) -> None:
        self.number = 0
        self._file = file
        self._path = path
        self._data = file.read(CHUNK_BYTES)
        self._at = 0
        self._check_text()

    @property
    def rest(self) -> bytes:
        """Bytes read from the file and not yet returned as lines."""
        return self._data[self._at :]

    def _check_text(self) -> None:
        if not self._data:
            self.fail("BVH002", "the file is empty", line=False)
        if self._data.startswith((b"\xff\xfe", b"\xfe\xff")):
            self.fail(
                "BVH001", "the file is UTF-16 text", "save it as UTF-8", line=False
            )
        self._data = self._data.removeprefix(b"\xef\xbb\xbf")
        if b"\0" in self._data:
            message = "the file is binary, not the text of a BVH"
            self.fail("BVH001", message, line=False)

    def next(self) -> str | None:
        """Return the next line without its end, None after the last."""
        while True:
            match = _LINE_END.search(self._data, self._at)
            at_end = match is not None and match.end() == len(self._data)
            # A CR that ends the chunk may be half of a CR LF.
            if match is not None and not (at_end and match.group() == b"\r"):
                break
            if len(self._data) - self._at > LONGEST_LINE_BYTES and match is None:
                self._fail_long()
            more = self._file.read(CHUNK_BYTES)
            if not more:
                break
            self._data, self._at = self.rest + more, 0
        if self._at == len(self._data):
            return None
        stop, after = match.span() if match else (len(self._data), len(self._data))
        if stop - self._at > LONGEST_LINE_BYTES:
            self._fail_long()
        line, self._at = self._data[self._at : stop], after
        self.number += 1
        if self.number > MAX_LINES:
            message = f"more than {MAX_LINES} lines before the rows of numbers"
            self.fail("BVH013", message, "is this a BVH file?")
        try:
            return line.decode("utf-8")
        except UnicodeDecodeError:
            # Of Windows: it has letters where Latin-1 has control characters.
            return line.decode("cp1252", "replace")

    def _fail_long(self) -> NoReturn:
        self.number += 1
        self.fail(
            "BVH013",
            f"the line is longer than {LONGEST_LINE_BYTES} bytes",
            "is this a BVH file?",
        )

    def fail(
        self, code: str, message: str, hint: str | None = None, *, line: bool = True
    ) -> NoReturn:
        """Raise a `FormatError` at the current line, or at the file."""
        lines = (max(1, self.number),) if line else ()
        raise FormatError(Fault(code, message, str(self._path), lines, hint))

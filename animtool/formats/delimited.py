"""Delimited text: lines of cells separated by tabs, semicolons, commas or blanks."""

from __future__ import annotations

import codecs
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from animtool import _kernels
from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import AnimtoolError, excerpt
from animtool.core.files.reading import MAX_INPUT_BYTES, read_input
from animtool.core.record import dataclass

SEPARATORS = (b"\t", b";", b",")
BLANK = b" \t,;"
ROWS_AT_ONCE = 4096
# Number of rows checked for decimal commas.
COMMA_ROWS = 100
# Bytes of a number in which decimals are counted.
MAX_CELL = 40
# Maximum ratio of padded to actual values.
MAX_PADDING = 20
# Tables up to this many values may be padded freely.
SMALL_TABLE = 5_000_000


def read_lines(path: Path) -> list[bytes]:
    """Return the lines of a UTF-8 file without BOM; any line ending."""
    data = read_input(path, MAX_INPUT_BYTES)
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        # Spreadsheets save "Unicode text" as UTF-16.
        data = data.decode("utf-16", "replace").encode()
    data = data.removeprefix(codecs.BOM_UTF8)
    return data.replace(b"\r\n", b"\n").replace(b"\r", b"\n").split(b"\n")


def decoded(text: bytes) -> str:
    """Return bytes decoded as UTF-8, else Latin-1."""
    try:
        return text.decode()
    except UnicodeDecodeError:
        return text.decode("latin-1")


def separator_of(line: bytes, default: bytes = b" ") -> bytes:
    """Return the cell separator of a line: the default, else the first it contains.

    >>> separator_of(b"a;b c"), separator_of(b"a b,c", b","), separator_of(b"a b")
    (b';', b',', b' ')
    """
    if default != b" " and default in line:
        return default
    return next((separator for separator in SEPARATORS if separator in line), b" ")


def row_separator(line: bytes, default: bytes) -> bytes:
    """Return the separator of a row of numbers, whose commas may be decimal.

    >>> row_separator(b"1 0,5 2,5", b" "), row_separator(b"1, 0.5, 2.5", b" ")
    (b' ', b',')
    """
    separator = separator_of(line, default)
    if separator == b"," and default != b",":
        cells = [cell.strip() for cell in line.strip().split(b",")]
        return b" " if any(b" " in cell for cell in cells) else b","
    return separator


def split_cells(line: bytes, separator: bytes) -> list[str]:
    """Return the cells of a line, stripped of blanks and quotes."""
    cells = line.split() if separator == b" " else line.split(separator)
    return [decoded(cell).strip().strip('"').strip() for cell in cells]


def number_of(text: str | None) -> float | None:
    """Return a finite number with decimal point or comma; else None.

    >>> number_of("59,94"), number_of("1e3"), number_of("x")
    (59.94, 1000.0, None)
    """
    text = text or ""
    try:
        value = float(text if "." in text else text.replace(",", "."))
    except ValueError:
        return None
    return value if np.isfinite(value) else None


@dataclass(frozen=True, slots=True)
class TextRows:
    """Rows of numbers as text.

    Attributes:
        texts: The R rows that are not blank: cells between blanks or tabs, ``nan`` for
            empty cells, without trailing empty cells.
        lines: 1-based line number of each row ``(R,)``.
        filled: Number of cells of each row up to the last nonempty one ``(R,)``.
        cells: Number of cells of each row, trailing empty ones included ``(R,)``.
        decimal_commas: Whether decimal commas were replaced by points.
    """

    texts: list[bytes]
    lines: IntArray
    filled: IntArray
    cells: IntArray
    decimal_commas: bool = False

    def without_last(self) -> TextRows:
        """Return all rows but the last."""
        return replace(
            self, texts=self.texts[:-1], lines=self.lines[:-1],
            filled=self.filled[:-1], cells=self.cells[:-1],
        )  # fmt: skip

    def decimals(self, column: int) -> int:
        """Return the maximum number of decimals in a column; 15 for exponents."""
        max_decimals = 0
        for text in self.texts:
            begin = text[: MAX_CELL * (column + 1)]
            cell = begin.split(None, column + 1)[column : column + 1] or [b""]
            exact = b"e" in cell[0].lower()
            max_decimals = max(
                max_decimals, 15 if exact else len(cell[0].partition(b".")[2])
            )
        return max_decimals

    def values(
        self, width: int, error: Callable[[str, int], AnimtoolError]
    ) -> FloatArray:
        """Parse the numbers ``(R, width)``; NaN where a row is too short.

        ``error`` returns, from a message and a line number, the error to raise for a
        cell that is not a number, or a row with more than ``width`` numbers.
        """
        size = width * len(self.texts)
        if size > max(SMALL_TABLE, MAX_PADDING * int(self.filled.sum())):
            line = int(self.lines[np.argmax(self.filled)])
            raise error(f"has {width} values, but most rows have far fewer", line)
        blocks = [np.empty((0, width))]
        for begin in range(0, len(self.texts), ROWS_AT_ONCE):
            texts = self.texts[begin : begin + ROWS_AT_ONCE]
            cell_counts = self.filled[begin : begin + ROWS_AT_ONCE]
            for row in np.flatnonzero(cell_counts < width).tolist():
                texts[row] += b" nan" * (width - int(cell_counts[row]))
            text = b"\n".join(texts) + b"\n"
            block, _, _, _, _, count, token = _kernels.parse_bvh_rows(
                text, width, len(texts), True
            )
            if len(block) < len(texts):
                message = f"has {count} values instead of {width}"
                if token:
                    message = f"{excerpt(decoded(token))} is not a number"
                raise error(message, int(self.lines[begin + len(block)]))
            blocks.append(block)
        return blocks[1] if len(blocks) == 2 else np.concatenate(blocks)


def gather_rows(lines: list[bytes], begin: int, separator: bytes) -> TextRows:
    """Collect the lines from ``begin`` on as rows of numbers.

    A line without the separator is split at blanks. Commas are decimal if they are not
    the separator and no line has a point.
    """
    texts, numbers, cell_counts, cells = [], [], [], []
    double_separator, filled_gap = separator * 2, separator + b"nan" + separator
    for i in range(begin, len(lines)):
        line = lines[i]
        if separator not in line or separator == b" ":
            if not line.strip(BLANK):
                continue
            line = line.strip()
            cell_count = used_count = len(line.split())
        else:
            cell_count = used_count = line.count(separator) + 1
            if b" " in line:
                line = separator.join([c.strip() for c in line.split(separator)])
            if line[-1:] == separator:
                line = line.rstrip(separator)
                if not line:
                    continue
                used_count = line.count(separator) + 1
            length = len(line)
            line = line.replace(double_separator, filled_gap)
            if len(line) > length:
                # Replaced twice: the first pass skips every second gap of three
                # separators.
                line = line.replace(double_separator, filled_gap)
            if line[:1] == separator:
                line = b"nan" + line
            if separator != b"\t":
                line = line.replace(separator, b" ")
        texts.append(line)
        numbers.append(i + 1)
        cell_counts.append(used_count)
        cells.append(cell_count)
    commas = separator != b"," and any(b"," in text for text in texts[:COMMA_ROWS])
    commas = commas and not any(b"." in text for text in texts)
    if commas:
        texts = [text.replace(b",", b".") for text in texts]
    decimals, counts = np.array(numbers, np.int64), np.array(cell_counts, np.int64)
    return TextRows(texts, decimals, counts, np.array(cells, np.int64), commas)

"""Reads delimited text: cells between tabs, semicolons, commas or blanks."""

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
BLANK_CHARACTERS = b" \t,;"
BLOCK_ROWS = 4096
# Number of rows that are checked for decimal commas.
COMMA_CHECK_ROWS = 100
# Bytes of a cell in which decimals are counted.
MAX_CELL_BYTES = 40
# Maximum ratio of padded to actual values.
MAX_PADDING_RATIO = 20
# Tables up to this many values may be padded at any ratio.
FREE_PADDING_VALUES = 5_000_000


def read_lines(path: Path) -> list[bytes]:
    """Return the lines of a text file without line ends and byte order mark."""
    data = read_input(path, MAX_INPUT_BYTES)
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        # Spreadsheets save "Unicode text" as UTF-16.
        data = data.decode("utf-16", "replace").encode()
    data = data.removeprefix(codecs.BOM_UTF8)
    return data.replace(b"\r\n", b"\n").replace(b"\r", b"\n").split(b"\n")


def decode_text(text: bytes) -> str:
    """Return bytes decoded as UTF-8, else Latin-1."""
    try:
        return text.decode()
    except UnicodeDecodeError:
        return text.decode("latin-1")


def find_separator(line: bytes, default: bytes = b" ") -> bytes:
    """Return the separator of cells in a line: the default if the line contains it.

    >>> find_separator(b"a;b c"), find_separator(b"a b,c", b",")
    (b';', b',')
    """
    if default != b" " and default in line:
        return default
    return next((separator for separator in SEPARATORS if separator in line), b" ")


def find_row_separator(line: bytes, default: bytes) -> bytes:
    """Return the separator of a row of numbers; commas may be decimal commas.

    >>> find_row_separator(b"1 0,5 2,5", b" ")
    b' '
    """
    separator = find_separator(line, default)
    if separator == b"," and default != b",":
        cells = [cell.strip() for cell in line.strip().split(b",")]
        return b" " if any(b" " in cell for cell in cells) else b","
    return separator


def split_cells(line: bytes, separator: bytes) -> list[str]:
    """Return the cells of a line, stripped of blanks and quotes."""
    cells = line.split() if separator == b" " else line.split(separator)
    return [decode_text(cell).strip().strip('"').strip() for cell in cells]


def parse_number(text: str | None) -> float | None:
    """Return a finite number with decimal point or comma; else None.

    >>> parse_number("59,94"), parse_number("1e3"), parse_number("x")
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
    """The rows of a table as text, before their numbers are parsed."""

    # The R rows that are not blank: cells between blanks or tabs, ``nan`` for empty
    # cells, without trailing empty cells.
    texts: list[bytes]
    line_numbers: IntArray  # 1-based line number of each row ``(R,)``
    # Number of cells of each row up to the last nonempty one ``(R,)``.
    value_counts: IntArray
    # Number of cells of each row, trailing empty ones included ``(R,)``.
    cell_counts: IntArray
    has_decimal_commas: bool = False  # whether decimal commas were replaced by points

    def without_last(self) -> TextRows:
        """Return all rows except the last one."""
        return replace(
            self, texts=self.texts[:-1], line_numbers=self.line_numbers[:-1],
            value_counts=self.value_counts[:-1], cell_counts=self.cell_counts[:-1],
        )  # fmt: skip

    def decimals(self, column: int) -> int:
        """Return the largest number of decimals in a column; 15 with an exponent."""
        max_decimals = 0
        for text in self.texts:
            prefix = text[: MAX_CELL_BYTES * (column + 1)]
            cell = prefix.split(None, column + 1)[column : column + 1] or [b""]
            has_exponent = b"e" in cell[0].lower()
            max_decimals = max(
                max_decimals, 15 if has_exponent else len(cell[0].partition(b".")[2])
            )
        return max_decimals

    def values(
        self, column_count: int, build_error: Callable[[str, int], AnimtoolError]
    ) -> FloatArray:
        """Parse the numbers ``(R, column_count)``; short rows are padded with NaN.

        ``build_error`` builds an error from a message and a line number, for a cell
        that is not a number, or a row with more than ``column_count`` numbers.
        """
        value_count = column_count * len(self.texts)
        if value_count > max(
            FREE_PADDING_VALUES, MAX_PADDING_RATIO * int(self.value_counts.sum())
        ):
            line = int(self.line_numbers[np.argmax(self.value_counts)])
            raise build_error(
                f"has {column_count} values, but most rows have far fewer", line
            )
        blocks = [np.empty((0, column_count))]
        for begin in range(0, len(self.texts), BLOCK_ROWS):
            block_texts = self.texts[begin : begin + BLOCK_ROWS]
            block_counts = self.value_counts[begin : begin + BLOCK_ROWS]
            for row in np.flatnonzero(block_counts < column_count).tolist():
                block_texts[row] += b" nan" * (column_count - int(block_counts[row]))
            text = b"\n".join(block_texts) + b"\n"
            block, _, _, _, _, number_count, token = _kernels.parse_bvh_rows(
                text, column_count, len(block_texts), True
            )
            if len(block) < len(block_texts):
                message = f"has {number_count} values instead of {column_count}"
                if token:
                    message = f"{excerpt(decode_text(token))} is not a number"
                raise build_error(message, int(self.line_numbers[begin + len(block)]))
            blocks.append(block)
        return blocks[1] if len(blocks) == 2 else np.concatenate(blocks)


def gather_rows(lines: list[bytes], start: int, separator: bytes) -> TextRows:
    """Return the rows of numbers in the lines, starting at index ``start``.

    A line without the separator is split at blanks. Commas are decimal if they are not
    the separator and no line has a point.
    """
    texts, line_numbers, value_counts, cell_counts = [], [], [], []
    empty_cell, nan_cell = separator * 2, separator + b"nan" + separator
    for i in range(start, len(lines)):
        line = lines[i]
        if separator not in line or separator == b" ":
            if not line.strip(BLANK_CHARACTERS):
                continue
            line = line.strip()
            cell_count = value_count = len(line.split())
        else:
            cell_count = value_count = line.count(separator) + 1
            if b" " in line:
                line = separator.join([cell.strip() for cell in line.split(separator)])
            if line[-1:] == separator:
                line = line.rstrip(separator)
                if not line:
                    continue
                value_count = line.count(separator) + 1
            length_before = len(line)
            line = line.replace(empty_cell, nan_cell)
            if len(line) > length_before:
                # The first pass skips every second gap of consecutive empty cells.
                line = line.replace(empty_cell, nan_cell)
            if line[:1] == separator:
                line = b"nan" + line
            if separator != b"\t":
                line = line.replace(separator, b" ")
        texts.append(line)
        line_numbers.append(i + 1)
        value_counts.append(value_count)
        cell_counts.append(cell_count)
    has_decimal_commas = separator != b"," and any(
        b"," in text for text in texts[:COMMA_CHECK_ROWS]
    )
    has_decimal_commas = has_decimal_commas and not any(b"." in text for text in texts)
    if has_decimal_commas:
        texts = [text.replace(b",", b".") for text in texts]
    return TextRows(
        texts,
        np.array(line_numbers, np.int64),
        np.array(value_counts, np.int64),
        np.array(cell_counts, np.int64),
        has_decimal_commas,
    )

"""The head of an array in numpy's own format, read without trust in what it claims.

References:
    numpy, ``numpy.lib.format``, NEP 1: "A Simple File Format for NumPy Arrays".
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np

MAGIC = b"\x93NUMPY"
# What numpy.load itself takes.
MAX_HEAD_BYTES = 10_000
MAX_DIMENSIONS = 8
# Bytes of the number that says how long the head is, by the format's version.
_WIDTHS = {(1, 0): 2, (2, 0): 4, (3, 0): 4}
_ENTRY = re.compile(
    r"""\s*(?P<quote>['"])(?P<key>descr|fortran_order|shape)(?P=quote)\s*:\s*
    (?: (?P<mark>['"])(?P<descr>[<>|=]?[A-Za-z]\d{0,6}(?:\[\w{1,9}\])?)(?P=mark)
      | (?P<fortran_order>True|False)
      | \((?P<shape>[\dL,\ ]*)\) )\s*(?:,|$)""",
    re.ASCII | re.VERBOSE,
)
# An object, or a structure, which is a list.
_OBJECTS = re.compile(r"""['"]descr['"]\s*:\s*['"]\|?O\d*['"]""")
_STRUCTURE = re.compile(r"""['"]descr['"]\s*:\s*\[""")


class ArrayError(ValueError):
    """An array or its archive cannot be read; the text says why."""


class Source(Protocol):
    """What arrays are read from."""

    def read(self, size: int, /) -> bytes:
        """Return the next bytes."""


@dataclass(frozen=True, slots=True)
class StoredArray:
    """How an array stands in a file.

    Attributes:
        shape: Of it.
        dtype: Of its values.
        order: How they follow each other, ``C`` or ``F``.
        begin: Where they do [bytes].
    """

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    order: Literal["C", "F"]
    begin: int

    @property
    def count(self) -> int:
        """How many values there are."""
        return math.prod(self.shape)

    @property
    def size(self) -> int:
        """Bytes that the values take."""
        return self.count * self.dtype.itemsize


def read_head(file: Source, where: str) -> StoredArray:
    """Return the head of an array; nothing behind it is read.

    Args:
        file: At its beginning.
        where: What to call it in messages.

    Raises:
        ArrayError: It is none of an array of numbers or of a text.
    """
    start = file.read(len(MAGIC) + 2)
    version = tuple(start[len(MAGIC) :])
    width = _WIDTHS.get(version)  # type: ignore[arg-type]
    if not start.startswith(MAGIC) or width is None:
        raise ArrayError(f"{where} is no array as numpy.savez writes them")
    length = int.from_bytes(file.read(width), "little")
    if length > MAX_HEAD_BYTES:
        raise ArrayError(f"{where} has a head of {length} bytes, no array's")
    text = file.read(length)
    if len(text) < length:
        raise ArrayError(f"{where} breaks off in its head")
    return _parsed(text.decode("latin-1"), where, len(start) + width + length)


def _parsed(text: str, where: str, begin: int) -> StoredArray:
    if _OBJECTS.search(text):
        raise ArrayError(f"{where} holds pickled Python objects")
    if _STRUCTURE.search(text):
        raise ArrayError(f"{where} holds structures, not numbers")
    text = text.strip()
    found: dict[str, str] = {}
    if text.startswith("{") and text.endswith("}"):
        rest = text[1:-1].strip()
        while rest and (match := _ENTRY.match(rest)):
            value = match[match["key"]]
            if value is None or match["key"] in found:
                break
            found[match["key"]] = value
            rest = rest[match.end() :].strip()
        if rest:
            found.clear()
    if len(found) < 3:
        raise ArrayError(f"{where} has a head that is no array's")
    try:
        dtype = np.dtype(found["descr"])
    except (TypeError, ValueError) as error:
        raise ArrayError(f"{where} holds {found['descr']}, not numbers") from error
    shape = _shape(found["shape"], where)
    order: Literal["C", "F"] = "F" if found["fortran_order"] == "True" else "C"
    return StoredArray(shape, dtype, order, begin)


def _shape(text: str, where: str) -> tuple[int, ...]:
    # Python 2 wrote whole numbers with an L.
    parts = [part.strip().removesuffix("L") for part in text.split(",")]
    if parts[-1] == "":
        parts.pop()
    wrong = len(parts) > MAX_DIMENSIONS or (len(parts) == 1 and "," not in text)
    if wrong or not all(part.isdecimal() and len(part) < 20 for part in parts):
        raise ArrayError(f"{where} has a shape that is no array's")
    return tuple(map(int, parts))

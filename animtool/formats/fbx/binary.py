"""Binary FBX records, with 32-bit offsets, or 64-bit ones from version 7500."""

from __future__ import annotations

import struct
import zlib
from typing import Any, NoReturn

import numpy as np

from animtool.core.errors import excerpt
from animtool.formats.fbx.elements import (
    MAX_ARRAY_BYTES,
    MAX_DEPTH,
    MAX_ELEMENTS,
    Element,
)
from animtool.formats.file_notices import FileNotices

MAGIC = b"Kaydara FBX Binary  \x00"
HEADER_BYTES = 27
_SCALARS = {
    "Y": struct.Struct("<h"),
    "I": struct.Struct("<i"),
    "F": struct.Struct("<f"),
    "D": struct.Struct("<d"),
    "L": struct.Struct("<q"),
    "C": struct.Struct("<B"),
    "B": struct.Struct("<B"),
}
_ARRAYS = {"f": "<f4", "d": "<f8", "l": "<i8", "i": "<i4", "b": "u1", "c": "u1"}
_BATCH_TYPES = {"I": "<i4", "F": "<f4", "D": "<f8", "L": "<i8"}
# The maximum ratio of deflate compression.
MAX_INFLATION_RATIO = 1032
# Lists of at least this many single values are read at once.
MIN_BATCH_VALUES = 12


def read_binary(content: bytes, notes: FileNotices) -> tuple[int, Element]:
    """Return the version and the root of a binary FBX."""
    if len(content) < HEADER_BYTES:
        _raise_fault(
            notes,
            len(content),
            f"the file has {len(content)} bytes: the header is cut off",
        )
    if content[22]:
        message = "the file has big-endian numbers, which are not supported"
        notes.fail("FBX003", "byte 22", message, "export the file again")
    (version,) = struct.unpack_from("<I", content, 23)
    return version, _RecordReader(content, version, notes).root()


def _raise_fault(notes: FileNotices, where: int, message: str) -> NoReturn:
    notes.fail("FBX002", f"byte {where}", message, "export the file again")


class _RecordReader:
    """The records of a file; lengths are checked before reading."""

    def __init__(self, content: bytes, version: int, notes: FileNotices) -> None:
        self.content, self.notes = content, notes
        has_64_bit_offsets = version >= 7500
        self.head = struct.Struct("<QQQB" if has_64_bit_offsets else "<IIIB")
        self.count = 0
        self.array_bytes = 0

    def root(self) -> Element:
        root = Element("", [], "byte 0")
        self._children(root, HEADER_BYTES, len(self.content), 0)
        return root

    def _children(self, parent: Element, at: int, end: int, depth: int) -> None:
        while at + self.head.size <= end:
            record_end, count, length, name_length = self.head.unpack_from(
                self.content, at
            )
            if not record_end:
                return
            at = self._record(
                parent, at, (record_end, count, length, name_length), end, depth
            )
        if depth == 0 or at > end:
            _raise_fault(self.notes, at, "the records of the file have no end")

    def _record(
        self,
        parent: Element,
        at: int,
        header: tuple[int, int, int, int],
        end: int,
        depth: int,
    ) -> int:
        """Read one record; return the offset of the next."""
        record_end, count, length, name_length = header
        values_start = at + self.head.size + name_length
        if not values_start <= record_end <= end:
            message = f"a record ends at byte {record_end}, outside its parent"
            if record_end > len(self.content):
                message = f"the file ends at byte {len(self.content)}, but a record "
                message += f"goes on to byte {record_end}: it is cut off or damaged"
            _raise_fault(self.notes, at, message)
        if length > record_end - values_start or count > length:
            message = f"{count} values of {length} bytes do not fit in their record"
            _raise_fault(self.notes, at, message)
        self.count += 1
        if self.count > MAX_ELEMENTS or depth > MAX_DEPTH:
            message = f"more than {MAX_ELEMENTS} elements, or {MAX_DEPTH} levels"
            self.notes.fail("FBX013", f"byte {at}", message)
        name = self.content[values_start - name_length : values_start].decode(
            "utf-8", "replace"
        )
        values = self._values(values_start, count, values_start + length)
        element = Element(name, values, f"byte {at}")
        parent.children.append(element)
        if values_start + length < record_end:
            self._children(element, values_start + length, record_end, depth + 1)
        return record_end

    def _values(self, at: int, count: int, end: int) -> list[Any]:
        array = self._value_batch(at, count, end)
        if array is not None:
            return [array]
        values: list[Any] = []
        for _ in range(count):
            if at >= end:
                _raise_fault(self.notes, at, "values are missing")
            kind = chr(self.content[at])
            scalar = _SCALARS.get(kind)
            if scalar is not None:
                if at + 1 + scalar.size > end:
                    _raise_fault(self.notes, at, "a value is cut off")
                values.append(scalar.unpack_from(self.content, at + 1)[0])
                at += 1 + scalar.size
            elif kind in "SR":
                size = self._number(at + 1, end)
                if size > end - at - 5:
                    _raise_fault(self.notes, at, f"text of {size} bytes is cut off")
                raw = self.content[at + 5 : at + 5 + size]
                values.append(raw.decode("utf-8", "replace") if kind == "S" else raw)
                at += 5 + size
            elif kind in _ARRAYS:
                value, at = self._array(kind, at, end)
                values.append(value)
            else:
                _raise_fault(
                    self.notes, at, f"unknown value type {excerpt(repr(kind))}"
                )
        return values

    def _value_batch(self, at: int, count: int, end: int) -> Any:
        """Return a long list of single numbers of one type; else None."""
        kind = chr(self.content[at]) if count >= MIN_BATCH_VALUES and at < end else ""
        if kind not in _BATCH_TYPES:
            return None
        rows = np.dtype([("kind", "u1"), ("value", _BATCH_TYPES[kind])])
        if end - at != count * rows.itemsize:
            return None
        records = np.frombuffer(self.content, rows, count, at)
        return records["value"].copy() if (records["kind"] == ord(kind)).all() else None

    def _number(self, at: int, end: int) -> int:
        if at + 4 > end:
            _raise_fault(self.notes, at, "a length is cut off")
        return int(struct.unpack_from("<I", self.content, at)[0])

    def _array(self, kind: str, at: int, end: int) -> tuple[Any, int]:
        count, compression, size = (self._number(at + 1 + 4 * k, end) for k in range(3))
        first, dtype = at + 13, np.dtype(_ARRAYS[kind])
        byte_count = count * dtype.itemsize
        if compression not in {0, 1}:
            _raise_fault(self.notes, at, f"unknown array encoding {compression}")
        stored_size = size if compression else byte_count
        if stored_size > end - first:
            _raise_fault(self.notes, at, f"an array of {stored_size} bytes is cut off")
        if compression and byte_count > size * MAX_INFLATION_RATIO:
            message = f"{size} bytes cannot hold an array of {byte_count} bytes"
            _raise_fault(self.notes, at, message)
        self.array_bytes += byte_count
        if self.array_bytes > MAX_ARRAY_BYTES:
            message = f"arrays of more than {MAX_ARRAY_BYTES / 1e6:.0f} MB"
            self.notes.fail("FBX013", f"byte {at}", message)
        data: Any = memoryview(self.content)[first : first + stored_size]
        if compression:
            data = self._inflate(data, byte_count, at)
        return np.frombuffer(data, dtype, count), first + stored_size

    def _inflate(self, data: memoryview, size: int, at: int) -> bytes:
        """Return an array inflated to exactly its stated size."""
        engine = zlib.decompressobj()
        try:
            array_bytes = engine.decompress(data, size) if size else b""
        except zlib.error as error:
            _raise_fault(self.notes, at, f"an array cannot be inflated: {error}")
        if len(array_bytes) != size:
            message = (
                f"an array inflates to {len(array_bytes)} bytes, but states {size}"
            )
            _raise_fault(self.notes, at, message)
        return array_bytes

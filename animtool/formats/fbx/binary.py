"""Reads binary FBX records; offsets have 64 bits from version 7500 on, else 32."""

from __future__ import annotations

import struct
import zlib
from typing import Any, NoReturn

import numpy as np

from animtool.core.errors import value_excerpt
from animtool.formats.fbx.elements import (
    MAX_ARRAY_BYTES,
    MAX_ELEMENTS,
    MAX_NESTING,
    Element,
)
from animtool.formats.file_diagnostics import FileDiagnostics

BINARY_MAGIC = b"Kaydara FBX Binary  \x00"
HEADER_BYTES = 27
_SCALAR_TYPES = {
    "Y": struct.Struct("<h"),
    "I": struct.Struct("<i"),
    "F": struct.Struct("<f"),
    "D": struct.Struct("<d"),
    "L": struct.Struct("<q"),
    "C": struct.Struct("<B"),
    "B": struct.Struct("<B"),
}
_ARRAY_TYPES = {"f": "<f4", "d": "<f8", "l": "<i8", "i": "<i4", "b": "u1", "c": "u1"}
_BATCH_TYPES = {"I": "<i4", "F": "<f4", "D": "<f8", "L": "<i8"}
# The maximum ratio of deflate compression.
MAX_INFLATION_RATIO = 1032
# Minimum number of single values that are read as one array.
MIN_BATCH_VALUES = 12


def read_binary(content: bytes, diagnostics: FileDiagnostics) -> tuple[int, Element]:
    """Return the version and the root of a binary FBX."""
    if len(content) < HEADER_BYTES:
        message = f"the file has {len(content)} bytes, so the header is cut off"
        diagnostics.fail(
            "FBX002", f"byte {len(content)}", message, "export the file again"
        )
    if content[22]:
        message = "the file has big-endian numbers, which are not supported"
        diagnostics.fail("FBX003", "byte 22", message, "export the file again")
    (version,) = struct.unpack_from("<I", content, 23)
    return version, _RecordReader(content, version, diagnostics).read_root()


class _RecordReader:
    """Reads records, and checks every length before it reads."""

    def __init__(
        self, content: bytes, version: int, diagnostics: FileDiagnostics
    ) -> None:
        self.content, self.diagnostics = content, diagnostics
        has_64_bit_offsets = version >= 7500
        self.record_header = struct.Struct("<QQQB" if has_64_bit_offsets else "<IIIB")
        self.element_count = 0
        self.array_bytes = 0

    def _fail(self, offset: int, message: str) -> NoReturn:
        hint = "export the file again"
        self.diagnostics.fail("FBX002", f"byte {offset}", message, hint)

    def read_root(self) -> Element:
        root = Element("", [], "byte 0")
        self._read_children(root, HEADER_BYTES, len(self.content), 0)
        return root

    def _read_children(
        self, parent: Element, offset: int, end: int, depth: int
    ) -> None:
        while offset + self.record_header.size <= end:
            header = self.record_header.unpack_from(self.content, offset)
            if not header[0]:
                return
            offset = self._read_record(parent, offset, header, end, depth)
        if depth == 0 or offset > end:
            self._fail(offset, "the records of the file have no end")

    def _read_record(
        self,
        parent: Element,
        offset: int,
        header: tuple[int, ...],
        end: int,
        depth: int,
    ) -> int:
        """Add one record to its parent element; return the offset of the next."""
        record_end, value_count, values_bytes, name_length = header
        values_start = offset + self.record_header.size + name_length
        if not values_start <= record_end <= end:
            message = f"a record ends at byte {record_end}, outside its parent"
            if record_end > len(self.content):
                message = f"the file ends at byte {len(self.content)}, but a record "
                message += f"goes on to byte {record_end}; it is cut off or damaged"
            self._fail(offset, message)
        if values_bytes > record_end - values_start or value_count > values_bytes:
            message = f"{value_count} values of {values_bytes} bytes do not fit in "
            message += "their record"
            self._fail(offset, message)
        self.element_count += 1
        if self.element_count > MAX_ELEMENTS or depth > MAX_NESTING:
            message = f"more than {MAX_ELEMENTS} elements, or {MAX_NESTING} levels"
            self.diagnostics.fail("FBX013", f"byte {offset}", message)
        raw_name = self.content[values_start - name_length : values_start]
        name = raw_name.decode("utf-8", "replace")
        values_end = values_start + values_bytes
        values = self._read_values(values_start, value_count, values_end)
        element = Element(name, values, f"byte {offset}")
        parent.children.append(element)
        if values_end < record_end:
            self._read_children(element, values_end, record_end, depth + 1)
        return record_end

    def _read_values(self, offset: int, count: int, end: int) -> list[Any]:
        array = self._read_value_batch(offset, count, end)
        if array is not None:
            return [array]
        values: list[Any] = []
        for _ in range(count):
            if offset >= end:
                self._fail(offset, "values are missing")
            type_code = chr(self.content[offset])
            scalar_type = _SCALAR_TYPES.get(type_code)
            if scalar_type is not None:
                if offset + 1 + scalar_type.size > end:
                    self._fail(offset, "a value is cut off")
                values.append(scalar_type.unpack_from(self.content, offset + 1)[0])
                offset += 1 + scalar_type.size
            elif type_code in "SR":
                byte_count = self._read_length(offset + 1, end)
                if byte_count > end - offset - 5:
                    self._fail(offset, f"text of {byte_count} bytes is cut off")
                data = self.content[offset + 5 : offset + 5 + byte_count]
                is_text = type_code == "S"
                values.append(data.decode("utf-8", "replace") if is_text else data)
                offset += 5 + byte_count
            elif type_code in _ARRAY_TYPES:
                value, offset = self._read_array(type_code, offset, end)
                values.append(value)
            else:
                self._fail(offset, f"unknown value type {value_excerpt(type_code)}")
        return values

    def _read_value_batch(self, offset: int, count: int, end: int) -> Any:
        """Return many numbers of one type as an array; None for other values."""
        is_batch = count >= MIN_BATCH_VALUES and offset < end
        type_code = chr(self.content[offset]) if is_batch else ""
        if type_code not in _BATCH_TYPES:
            return None
        row_type = np.dtype([("kind", "u1"), ("value", _BATCH_TYPES[type_code])])
        if end - offset != count * row_type.itemsize:
            return None
        records = np.frombuffer(self.content, row_type, count, offset)
        is_uniform = (records["kind"] == ord(type_code)).all()
        return records["value"].copy() if is_uniform else None

    def _read_length(self, offset: int, end: int) -> int:
        if offset + 4 > end:
            self._fail(offset, "a length is cut off")
        return int(struct.unpack_from("<I", self.content, offset)[0])

    def _read_array(self, type_code: str, offset: int, end: int) -> tuple[Any, int]:
        value_count, compression, compressed_size = (
            self._read_length(offset + 1 + 4 * k, end) for k in range(3)
        )
        data_offset, dtype = offset + 13, np.dtype(_ARRAY_TYPES[type_code])
        byte_count = value_count * dtype.itemsize
        if compression not in {0, 1}:
            self._fail(offset, f"unknown array encoding {compression}")
        stored_size = compressed_size if compression else byte_count
        if stored_size > end - data_offset:
            self._fail(offset, f"an array of {stored_size} bytes is cut off")
        if compression and byte_count > compressed_size * MAX_INFLATION_RATIO:
            message = f"{compressed_size} bytes cannot hold an array of {byte_count} "
            message += "bytes"
            self._fail(offset, message)
        self.array_bytes += byte_count
        if self.array_bytes > MAX_ARRAY_BYTES:
            message = f"arrays of more than {MAX_ARRAY_BYTES / 1e6:.0f} MB"
            self.diagnostics.fail("FBX013", f"byte {offset}", message)
        data: Any = memoryview(self.content)[data_offset : data_offset + stored_size]
        if compression:
            data = self._inflate(data, byte_count, offset)
        return np.frombuffer(data, dtype, value_count), data_offset + stored_size

    def _inflate(self, data: memoryview, size: int, offset: int) -> bytes:
        """Inflate an array; raise unless the result has its stated size."""
        decompressor = zlib.decompressobj()
        try:
            array_bytes = decompressor.decompress(data, size) if size else b""
        except zlib.error as error:
            self._fail(offset, f"an array cannot be inflated: {error}")
        if len(array_bytes) != size:
            message = f"an array inflates to {len(array_bytes)} bytes, but states "
            message += f"{size}"
            self._fail(offset, message)
        return array_bytes

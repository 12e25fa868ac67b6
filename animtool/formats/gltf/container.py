"""Reads the JSON and binary chunk of a .gltf or .glb file."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any, NoReturn

from animtool.core.errors import excerpt
from animtool.core.files.reading import read_input
from animtool.core.record import dataclass
from animtool.formats.file_notices import FileNotices
from animtool.formats.gltf.json_items import JsonItem

MAGIC = b"glTF"
JSON_CHUNK, BIN_CHUNK = 0x4E4F534A, 0x004E4942
HEADER_BYTES, CHUNK_HEADER_BYTES = 12, 8
_BOM = b"\xef\xbb\xbf"
# Limit of JSON; larger files take minutes to parse.
MAX_JSON_BYTES = 200_000_000


@dataclass(frozen=True, slots=True)
class Container:
    """The JSON of a file, and the binary chunk of a GLB."""

    root: JsonItem
    binary: memoryview | None  # None for a .gltf, and a GLB without it
    is_glb: bool
    bytes: int  # size of the file [byte]
    may_have_extensions: bool  # whether any object may have extensions


def read_container(path: Path, notes: FileNotices) -> Container:
    """Read a .gltf or .glb, distinguished by suffix and first bytes."""
    content = memoryview(read_input(path))
    is_glb = path.suffix.lower() != ".gltf" or bytes(content[:4]) == MAGIC
    if not is_glb:
        text, binary = bytes(content), None
    else:
        json_chunk, binary = _read_chunks(content, notes)
        text = bytes(json_chunk)
    root = _parse_json(text, notes)
    # Escaped names are not found, but no supported extension has one.
    may_have_extensions = b'"extensions"' in text
    return Container(root, binary, is_glb, len(content), may_have_extensions)


def _byte_label(offset: int) -> str:
    return f"byte {offset}"


def _raise_fault(notes: FileNotices, offset: int, message: str) -> NoReturn:
    notes.fail("GLT002", _byte_label(offset), message, "export the file again")


def _check_header(content: memoryview, notes: FileNotices) -> int:
    """Check the header of a GLB; return its stated length."""
    if len(content) < HEADER_BYTES:
        message = f"the file has {len(content)} bytes; a GLB has at least 12"
        _raise_fault(notes, len(content), message)
    if bytes(content[:4]) != MAGIC:
        is_json = bytes(content[:1]) == b"{"
        hint = "rename it to .gltf" if is_json else "export the file again"
        notes.fail("GLT002", _byte_label(0), "a GLB starts with the letters glTF", hint)
    version, length = struct.unpack_from("<II", content, 4)
    if version != 2:
        message = f"version {version} of GLB is not supported, only 2"
        notes.fail("GLT003", _byte_label(4), message, "export glTF 2.0")
    if length < HEADER_BYTES + CHUNK_HEADER_BYTES:
        message = f"the length {length} is shorter than the header and one chunk"
        _raise_fault(notes, 8, message)
    if length > len(content):
        message = f"the header states {length} bytes, but the file has {len(content)}"
        _raise_fault(notes, 8, message)
    if length < len(content):
        message = f"{len(content) - length} bytes after the end are ignored"
        notes.warn("GLT101", _byte_label(length), message)
    return int(length)


def _read_chunks(
    content: memoryview, notes: FileNotices
) -> tuple[memoryview, memoryview | None]:
    """Return JSON and binary chunk of a GLB."""
    length = _check_header(content, notes)
    chunks: dict[int, memoryview] = {}
    offset = HEADER_BYTES
    while offset < length:
        if offset + CHUNK_HEADER_BYTES > length:
            end = length if length == len(content) else offset
            _raise_fault(notes, end, "the file ends in the header of a chunk")
        chunk_bytes, chunk_type = struct.unpack_from("<II", content, offset)
        if offset + CHUNK_HEADER_BYTES + chunk_bytes > length:
            _raise_fault(
                notes, offset, f"a chunk of {chunk_bytes} bytes ends after the file"
            )
        if offset == HEADER_BYTES and (chunk_type != JSON_CHUNK or not chunk_bytes):
            state = "empty" if chunk_type == JSON_CHUNK else "not the JSON"
            _raise_fault(notes, offset, f"the first chunk is {state}")
        if chunk_type in chunks:
            _raise_fault(notes, offset, "two chunks of a type that may occur once")
        if chunk_bytes % 4:
            message = f"a chunk has {chunk_bytes} bytes, not a multiple of 4"
            notes.warn("GLT101", _byte_label(offset), message)
        start = offset + CHUNK_HEADER_BYTES
        if (
            chunk_type == BIN_CHUNK
            and offset != HEADER_BYTES + CHUNK_HEADER_BYTES + len(chunks[JSON_CHUNK])
        ):
            message = "the binary chunk is not the second one: it is read all the same"
            notes.warn("GLT101", _byte_label(offset), message)
        if chunk_type in {JSON_CHUNK, BIN_CHUNK}:
            chunks[chunk_type] = content[start : start + chunk_bytes]
        offset = start + chunk_bytes
    return chunks[JSON_CHUNK], chunks.get(BIN_CHUNK)


def _parse_json(text: bytes, notes: FileNotices) -> JsonItem:
    """Return the parsed JSON, which must be an object."""
    if len(text) > MAX_JSON_BYTES:
        notes.fail(
            "GLT013",
            "",
            f"the JSON has {len(text) / 1000000.0:.0f} MB; the limit is 200",
        )
    if text.startswith(_BOM):
        notes.warn("GLT101", "", "a byte order mark before the JSON is ignored")
        text = text[len(_BOM) :]
    try:
        value = json.loads(text.decode("utf-8"), parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        notes.fail("GLT001", "", f"the JSON cannot be read: {_json_reason(error)}")
    if not isinstance(value, dict):
        notes.fail("GLT001", "", "the JSON must be an object")
    return JsonItem(value, "", notes)


def _json_reason(error: Exception) -> str:
    """Return why a JSON text is invalid, and a hint."""
    if isinstance(error, RecursionError):
        return "it is nested too deeply"
    if not isinstance(error, json.JSONDecodeError):
        return f"{error}; export the file again"
    location = f"line {error.lineno}, column {error.colno}"
    if not error.doc[error.pos :].strip():
        return f"it ends too early, at {location}; copy or export the file again"
    unexpected_text = excerpt(error.doc[error.pos :].split("\n")[0], 20)
    return f"{unexpected_text} is unexpected at {location}; export the file again"


def _refuse_constant(name: str) -> Any:
    raise ValueError(f"{name} is no JSON")

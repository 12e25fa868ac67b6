"""JSON and binary chunk of a .gltf or .glb file."""

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
# Limit of JSON: a character has a few thousand nodes, and more JSON takes minutes to
# read.
MAX_JSON_BYTES = 200_000_000


@dataclass(frozen=True, slots=True)
class Container:
    """The JSON of a file, and the binary chunk of a GLB."""

    root: JsonItem
    binary: memoryview | None  # None for a .gltf, and a GLB without it
    is_glb: bool
    bytes: int  # size of the file
    may_have_extensions: bool  # whether any object may have extensions


def read_container(path: Path, notes: FileNotices) -> Container:
    """Read a .gltf or .glb; the first bytes decide which it is."""
    content = memoryview(read_input(path))
    glb = path.suffix.lower() != ".gltf" or bytes(content[:4]) == MAGIC
    if not glb:
        text, binary = bytes(content), None
    else:
        chunk, binary = _read_chunks(content, notes)
        text = bytes(chunk)
    root = _parse_json(text, notes)
    # Names with escapes are not found; none that is read has any.
    may_have_extensions = b'"extensions"' in text
    return Container(root, binary, glb, len(content), may_have_extensions)


def _byte_pointer(where: int) -> str:
    return f"byte {where}"


def _raise_fault(notes: FileNotices, where: int, message: str) -> NoReturn:
    notes.fail("GLT002", _byte_pointer(where), message, "export the file again")


def _check_header(content: memoryview, notes: FileNotices) -> int:
    """Return the length in the header of a GLB, checked against the file."""
    if len(content) < HEADER_BYTES:
        message = f"the file has {len(content)} bytes; a GLB has at least 12"
        _raise_fault(notes, len(content), message)
    if bytes(content[:4]) != MAGIC:
        is_json = bytes(content[:1]) == b"{"
        hint = "rename it to .gltf" if is_json else "export the file again"
        notes.fail(
            "GLT002", _byte_pointer(0), "a GLB starts with the letters glTF", hint
        )
    version, length = struct.unpack_from("<II", content, 4)
    if version != 2:
        message = f"version {version} of GLB is not supported, only 2"
        notes.fail("GLT003", _byte_pointer(4), message, "export glTF 2.0")
    if length < HEADER_BYTES + CHUNK_HEADER_BYTES:
        message = f"the length {length} is shorter than the header and one chunk"
        _raise_fault(notes, 8, message)
    if length > len(content):
        message = f"the header states {length} bytes, but the file has {len(content)}"
        _raise_fault(notes, 8, message)
    if length < len(content):
        message = f"{len(content) - length} bytes after the end are ignored"
        notes.warn("GLT101", _byte_pointer(length), message)
    return int(length)


def _read_chunks(
    content: memoryview, notes: FileNotices
) -> tuple[memoryview, memoryview | None]:
    """Return JSON and binary chunk of a GLB."""
    length = _check_header(content, notes)
    chunks: dict[int, memoryview] = {}
    at = HEADER_BYTES
    while at < length:
        if at + CHUNK_HEADER_BYTES > length:
            end = length if length == len(content) else at
            _raise_fault(notes, end, "the file ends in the header of a chunk")
        size, kind = struct.unpack_from("<II", content, at)
        if at + CHUNK_HEADER_BYTES + size > length:
            _raise_fault(notes, at, f"a chunk of {size} bytes ends after the file")
        if at == HEADER_BYTES and (kind != JSON_CHUNK or not size):
            state = "empty" if kind == JSON_CHUNK else "not the JSON"
            _raise_fault(notes, at, f"the first chunk is {state}")
        if kind in chunks:
            _raise_fault(notes, at, "two chunks of a type that may occur once")
        if size % 4:
            message = f"a chunk has {size} bytes, not a multiple of 4"
            notes.warn("GLT101", _byte_pointer(at), message)
        start = at + CHUNK_HEADER_BYTES
        if kind == BIN_CHUNK and at != HEADER_BYTES + CHUNK_HEADER_BYTES + len(
            chunks[JSON_CHUNK]
        ):
            message = "the binary chunk is not the second one: it is read all the same"
            notes.warn("GLT101", _byte_pointer(at), message)
        if kind in {JSON_CHUNK, BIN_CHUNK}:
            chunks[kind] = content[start : start + size]
        at = start + size
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
    """Return what is wrong with a JSON text, and what to do."""
    if isinstance(error, RecursionError):
        return "it is nested too deeply"
    if not isinstance(error, json.JSONDecodeError):
        return f"{error}; export the file again"
    location = f"line {error.lineno}, column {error.colno}"
    if not error.doc[error.pos :].strip():
        return f"it ends too early, at {location}; copy or export the file again"
    there = excerpt(error.doc[error.pos :].split("\n")[0], 20)
    return f"{there} is unexpected at {location}; export the file again"


def _refuse_constant(name: str) -> Any:
    raise ValueError(f"{name} is no JSON")

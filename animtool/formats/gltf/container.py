"""Reads the JSON of a .gltf or .glb file, its binary chunk and its buffers."""

from __future__ import annotations

import binascii
import json
import re
import struct
from pathlib import Path
from typing import Any, NoReturn
from urllib.parse import unquote_to_bytes, urlsplit

from animtool.core.errors import Fault, FormatError, excerpt
from animtool.core.files.reading import not_a_file_reason, read_input
from animtool.core.json_problems import json_problem
from animtool.core.record import dataclass
from animtool.formats.file_diagnostics import FileDiagnostics
from animtool.formats.gltf.json_items import JsonItem

GLB_MAGIC = b"glTF"
JSON_CHUNK, BIN_CHUNK = 0x4E4F534A, 0x004E4942
HEADER_BYTES, CHUNK_HEADER_BYTES = 12, 8
_BOM = b"\xef\xbb\xbf"
# Limit of JSON; larger files take minutes to parse.
MAX_JSON_BYTES = 200_000_000
_SURPLUS_HINT = "if data is missing, export the file again"
_DATA_URI_PATTERN = re.compile(
    r"data:(?:[\w.+-]+/[\w.+-]+)?(?:;[\w-]+=[^;,]+)*(?:;base64)?"
)


@dataclass(frozen=True, slots=True)
class Container:
    """The JSON of a file, and the binary chunk of a GLB."""

    json_root: JsonItem
    binary: memoryview | None  # None for a .gltf, and a GLB without it
    is_glb: bool
    byte_count: int  # size of the file [byte]
    may_have_extensions: bool  # whether any object may have extensions


def read_container(path: Path, diagnostics: FileDiagnostics) -> Container:
    """Return the contents of a .gltf or .glb, recognised by suffix and first bytes."""
    content = memoryview(read_input(path))
    is_glb = path.suffix.lower() != ".gltf" or bytes(content[:4]) == GLB_MAGIC
    if not is_glb:
        text, binary = bytes(content), None
    else:
        json_chunk, binary = _read_chunks(content, diagnostics)
        text = bytes(json_chunk)
    json_root = _parse_json(text, diagnostics, is_glb=is_glb)
    # Escaped names are not found, but no supported extension has one.
    may_have_extensions = b'"extensions"' in text
    return Container(json_root, binary, is_glb, len(content), may_have_extensions)


def _fail_malformed(
    diagnostics: FileDiagnostics, offset: int, message: str
) -> NoReturn:
    diagnostics.fail("GLT002", f"byte {offset}", message, "export the file again")


def _check_header(content: memoryview, diagnostics: FileDiagnostics) -> int:
    """Check the header of a GLB; return its stated length."""
    if len(content) < HEADER_BYTES:
        message = f"the file has {len(content)} bytes; a GLB has at least 12"
        _fail_malformed(diagnostics, len(content), message)
    if bytes(content[:4]) != GLB_MAGIC:
        is_json = bytes(content[:1]) == b"{"
        hint = "rename it to .gltf" if is_json else "export the file again"
        diagnostics.fail("GLT002", "byte 0", "a GLB starts with the letters glTF", hint)
    version, length = struct.unpack_from("<II", content, 4)
    if version != 2:
        message = f"version {version} of GLB is not supported, only 2"
        diagnostics.fail("GLT003", "byte 4", message, "export glTF 2.0")
    if length < HEADER_BYTES + CHUNK_HEADER_BYTES:
        message = f"the length {length} is shorter than the header and one chunk"
        _fail_malformed(diagnostics, 8, message)
    if length > len(content):
        message = f"the header states {length} bytes, but the file has {len(content)}"
        _fail_malformed(diagnostics, 8, message)
    if length < len(content):
        message = f"{len(content) - length} bytes after the end are ignored"
        diagnostics.warn("GLT101", f"byte {length}", message, _SURPLUS_HINT)
    return int(length)


def _read_chunks(
    content: memoryview, diagnostics: FileDiagnostics
) -> tuple[memoryview, memoryview | None]:
    """Return JSON and binary chunk of a GLB."""
    length = _check_header(content, diagnostics)
    chunks: dict[int, memoryview] = {}
    offset = HEADER_BYTES
    while offset < length:
        if offset + CHUNK_HEADER_BYTES > length:
            end = length if length == len(content) else offset
            _fail_malformed(diagnostics, end, "the file ends in the header of a chunk")
        chunk_bytes, chunk_type = struct.unpack_from("<II", content, offset)
        if offset + CHUNK_HEADER_BYTES + chunk_bytes > length:
            _fail_malformed(
                diagnostics,
                offset,
                f"a chunk of {chunk_bytes} bytes runs past the end of the file",
            )
        if offset == HEADER_BYTES and (chunk_type != JSON_CHUNK or not chunk_bytes):
            problem = "empty" if chunk_type == JSON_CHUNK else "not the JSON"
            _fail_malformed(diagnostics, offset, f"the first chunk is {problem}")
        if chunk_type in chunks:
            _fail_malformed(
                diagnostics, offset, "two chunks of a type that may occur once"
            )
        if chunk_bytes % 4:
            message = f"a chunk has {chunk_bytes} bytes, not a multiple of 4"
            diagnostics.warn("GLT101", f"byte {offset}", message)
        start = offset + CHUNK_HEADER_BYTES
        if (
            chunk_type == BIN_CHUNK
            and offset != HEADER_BYTES + CHUNK_HEADER_BYTES + len(chunks[JSON_CHUNK])
        ):
            message = "the binary chunk is not the second chunk; it is read anyway"
            diagnostics.warn("GLT101", f"byte {offset}", message)
        if chunk_type in {JSON_CHUNK, BIN_CHUNK}:
            chunks[chunk_type] = content[start : start + chunk_bytes]
        offset = start + chunk_bytes
    return chunks[JSON_CHUNK], chunks.get(BIN_CHUNK)


def _parse_json(text: bytes, diagnostics: FileDiagnostics, *, is_glb: bool) -> JsonItem:
    """Return the parsed JSON, which must be an object."""
    if len(text) > MAX_JSON_BYTES:
        message = f"the JSON has {len(text) / 1e6:.0f} MB; the limit is 200"
        diagnostics.fail("GLT013", "", message, "export less in one file")
    if text.startswith(_BOM):
        diagnostics.warn("GLT101", "", "a byte order mark before the JSON is ignored")
        text = text[len(_BOM) :]
    try:
        value = json.loads(text.decode("utf-8"), parse_constant=_refuse_constant)
    except json.JSONDecodeError as error:
        raise FormatError(
            _syntax_fault(error, diagnostics.path, is_glb=is_glb)
        ) from None
    except (ValueError, RecursionError) as error:
        is_nested = isinstance(error, RecursionError)
        reason = "it is nested too deeply" if is_nested else str(error)
        diagnostics.fail("GLT001", "", f"the JSON cannot be read: {reason}")
    if not isinstance(value, dict):
        diagnostics.fail("GLT001", "", "the JSON must be an object")
    return JsonItem(value, "", diagnostics)


def _syntax_fault(error: json.JSONDecodeError, path: str, *, is_glb: bool) -> Fault:
    """Return the fault of a JSON syntax error: with its line in a .gltf."""
    problem = json_problem(error)
    hint = problem.repair or "copy or export the file again"
    if not is_glb:
        line = problem.line
        return Fault(
            "GLT001", problem.message, path, (line,), hint, column=problem.column
        )
    message = f"the JSON chunk cannot be read: {problem.message}, at line "
    message += f"{problem.line}, column {problem.column} of the chunk"
    return Fault("GLT001", message, path, (), "export the file again")


def _refuse_constant(name: str) -> Any:
    raise ValueError(f"{name} is not valid JSON")


class Buffers:
    """The buffers of a file; bytes are read on demand."""

    def __init__(self, container: Container, folder: Path) -> None:
        self.container, self.folder = container, folder
        self.diagnostics = container.json_root.diagnostics
        self.items = container.json_root.children("buffers")
        self._opened_buffers: dict[int, memoryview] = {}

    def __len__(self) -> int:
        """Return the number of buffers."""
        return len(self.items)

    @property
    def opened_bytes(self) -> int:
        """Total size of the opened buffers [bytes]."""
        return sum(map(len, self._opened_buffers.values()))

    def size(self, index: int) -> int:
        """Return the stated length of a buffer [bytes]."""
        return self.items[index].size("byteLength", minimum=1)

    def has_data(self, index: int) -> bool:
        """Return whether the file has the bytes of a buffer."""
        is_glb_chunk = index == 0 and self.container.binary is not None
        return "uri" in self.items[index].values or is_glb_chunk

    def buffer_bytes(self, index: int) -> memoryview:
        """Return the bytes of a buffer, opened on first use."""
        if index not in self._opened_buffers:
            self._opened_buffers[index] = self._open_buffer(index)
        return self._opened_buffers[index]

    def _open_buffer(self, index: int) -> memoryview:
        buffer, length = self.items[index], self.size(index)
        uri = buffer.text("uri")
        if uri is None:
            binary = self.container.binary
            if index or binary is None:
                message = "the buffer has no uri, and no GLB chunk holds it"
                self.diagnostics.fail("GLT007", buffer.pointer, message)
            content = binary
        elif uri.startswith("data:"):
            content = memoryview(_decode_data(uri, buffer))
        else:
            path = self._find_file(uri, buffer)
            try:
                content = memoryview(read_input(path))
            except FormatError as error:
                message = str(error.faults[0].message)
                self.diagnostics.fail("GLT007", buffer.pointer_to("uri"), message)
        if len(content) < length:
            message = f"byteLength is {length}, but there are {len(content)} bytes"
            self.diagnostics.fail("GLT007", buffer.pointer, message)
        return content[:length]

    def _find_file(self, uri: str, buffer: JsonItem) -> Path:
        """Return the path of a URI's file; raise if it is not a file."""
        path = self._resolve_uri(uri, buffer)
        reason = not_a_file_reason(path)
        if reason is not None:
            message = f"the file {uri!r} {reason}"
            hint = "put the file next to the glTF, or correct the uri"
            self.diagnostics.fail("GLT007", buffer.pointer_to("uri"), message, hint)
        return path

    def _resolve_uri(self, uri: str, buffer: JsonItem) -> Path:
        """Return the path of a URI, inside the folder of the glTF."""
        pointer = buffer.pointer_to("uri")
        try:
            url = urlsplit(uri)
            name = unquote_to_bytes(url.path).decode("utf-8")
        except ValueError:
            self.diagnostics.fail("GLT007", pointer, f"{excerpt(uri)} is not a URI")
        if url.scheme or url.netloc:
            message = f"{excerpt(uri)} is on another machine or uses another scheme"
            hint = "animtool downloads nothing; put the file next to the glTF"
            self.diagnostics.fail("GLT007", pointer, message, hint)
        if not name or "\0" in name or "\\" in name or url.query or url.fragment:
            self.diagnostics.fail(
                "GLT007", pointer, f"{excerpt(uri)} does not name a file"
            )
        folder = self.folder.resolve()
        try:
            path = (folder / name).resolve()
        except (OSError, RuntimeError, ValueError):
            self.diagnostics.fail(
                "GLT007", pointer, f"{excerpt(uri)} does not name a file"
            )
        if not path.is_relative_to(folder):
            message = f"{excerpt(uri)} is outside the folder of the glTF"
            hint = "put the buffer file next to the glTF, and correct the uri"
            self.diagnostics.fail("GLT007", pointer, message, hint)
        return path

    def check_available(self, index: int) -> None:
        """Raise if a buffer's bytes are missing or too few, without opening a file."""
        buffer, length = self.items[index], self.size(index)
        uri = buffer.text("uri")
        binary = self.container.binary
        if uri is None:
            if index == 0 and self.container.is_glb:
                if binary is None:
                    message = "the buffer has no uri, and the GLB has no binary chunk"
                    self.diagnostics.fail("GLT007", buffer.pointer, message)
                if len(binary) < length:
                    message = f"byteLength is {length}, but the chunk has {len(binary)}"
                    self.diagnostics.fail("GLT007", buffer.pointer, message)
                if len(binary) > length + 3:
                    message = f"{len(binary) - length} bytes after the buffer are "
                    message += "ignored"
                    self.diagnostics.warn(
                        "GLT101", buffer.pointer, message, _SURPLUS_HINT
                    )
        elif uri.startswith("data:"):
            self.buffer_bytes(index)
        else:
            self._find_file(uri, buffer)


def _decode_data(uri: str, item: JsonItem) -> bytes:
    """Return the bytes of a data URI of any media type."""
    media_type, comma, text = uri.partition(",")
    pointer = item.pointer_to("uri")
    if not comma or not _DATA_URI_PATTERN.fullmatch(media_type):
        item.diagnostics.fail("GLT007", pointer, f"{excerpt(uri)} is not a data URI")
    if not media_type.endswith(";base64"):
        return unquote_to_bytes(text)
    try:
        return binascii.a2b_base64(unquote_to_bytes(text), strict_mode=True)
    except (binascii.Error, ValueError) as error:
        item.diagnostics.fail(
            "GLT007", pointer, f"the data URI is not valid base64: {error}"
        )

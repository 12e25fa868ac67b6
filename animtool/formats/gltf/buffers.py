"""Opens glTF buffers: the GLB chunk, data URIs and files next to the glTF."""

from __future__ import annotations

import binascii
import re
from pathlib import Path
from urllib.parse import unquote_to_bytes, urlsplit

from animtool.core.errors import FormatError, excerpt
from animtool.core.files.reading import not_a_file_reason, read_input
from animtool.formats.file_notices import FileNotices
from animtool.formats.gltf.container import Container
from animtool.formats.gltf.json_items import JsonItem

_DATA_URI = re.compile(r"data:(?:[\w.+-]+/[\w.+-]+)?(?:;[\w-]+=[^;,]+)*(?:;base64)?")


class Buffers:
    """The buffers of a file; bytes are read on demand."""

    def __init__(self, container: Container, folder: Path, notes: FileNotices) -> None:
        self.container, self.folder, self.notes = container, folder, notes
        self.items = container.root.children("buffers")
        self._opened: dict[int, memoryview] = {}

    def __len__(self) -> int:
        """Return the number of buffers."""
        return len(self.items)

    @property
    def opened_bytes(self) -> int:
        """Total size of the opened buffers [bytes]."""
        return sum(map(len, self._opened.values()))

    def size(self, index: int) -> int:
        """Return the stated length of a buffer [bytes]."""
        return self.items[index].size("byteLength", minimum=1)

    def has_data(self, index: int) -> bool:
        """Return whether the file has the bytes of a buffer."""
        is_glb_chunk = index == 0 and self.container.binary is not None
        return "uri" in self.items[index].values or is_glb_chunk

    def buffer_bytes(self, index: int) -> memoryview:
        """Return the bytes of a buffer, opened on first use."""
        if index not in self._opened:
            self._opened[index] = self._open_buffer(index)
        return self._opened[index]

    def _open_buffer(self, index: int) -> memoryview:
        buffer, length = self.items[index], self.size(index)
        uri = buffer.text("uri")
        if uri is None:
            binary = self.container.binary
            if index or binary is None:
                message = "the buffer has no uri, and no GLB chunk holds it"
                self.notes.fail("GLT007", buffer.pointer, message)
            content = binary
        elif uri.startswith("data:"):
            content = memoryview(decode_data(uri, buffer))
        else:
            content = memoryview(self._read_file(uri, buffer))
        if len(content) < length:
            message = f"byteLength is {length}, but there are {len(content)} bytes"
            self.notes.fail("GLT007", buffer.pointer, message)
        return content[:length]

    def _read_file(self, uri: str, buffer: JsonItem) -> bytes:
        path = self._find_file(uri, buffer)
        try:
            return read_input(path)
        except FormatError as error:
            self.notes.fail(
                "GLT007", buffer.pointer_to("uri"), str(error.faults[0].message)
            )

    def _find_file(self, uri: str, buffer: JsonItem) -> Path:
        """Return the path of a URI's file; raise if it is not a file."""
        path = self._resolve_uri(uri, buffer)
        reason = not_a_file_reason(path)
        if reason is not None:
            message = f"the file {uri!r} {reason}"
            self.notes.fail("GLT007", buffer.pointer_to("uri"), message)
        return path

    def _resolve_uri(self, uri: str, buffer: JsonItem) -> Path:
        """Return the path of a URI, inside the folder of the glTF."""
        where = buffer.pointer_to("uri")
        try:
            url = urlsplit(uri)
            name = unquote_to_bytes(url.path).decode("utf-8")
        except ValueError:
            self.notes.fail("GLT007", where, f"{excerpt(uri)} is no URI")
        if url.scheme or url.netloc:
            message = f"{excerpt(uri)} is on another machine or uses another scheme"
            hint = "animtool downloads nothing: put the file next to the glTF"
            self.notes.fail("GLT007", where, message, hint)
        if not name or "\0" in name or "\\" in name or url.query or url.fragment:
            self.notes.fail("GLT007", where, f"{excerpt(uri)} does not name a file")
        folder = self.folder.resolve()
        try:
            path = (folder / name).resolve()
        except (OSError, RuntimeError, ValueError):
            self.notes.fail("GLT007", where, f"{excerpt(uri)} does not name a file")
        if not path.is_relative_to(folder):
            message = f"{excerpt(uri)} leads outside the folder of the file"
            self.notes.fail("GLT007", where, message, "put the file next to the glTF")
        return path

    def check(self, index: int) -> None:
        """Check a buffer without opening its file."""
        buffer, length = self.items[index], self.size(index)
        uri = buffer.text("uri")
        binary = self.container.binary
        if uri is None:
            if index == 0 and self.container.is_glb:
                if binary is None:
                    message = "the buffer has no uri, and the GLB has no binary chunk"
                    self.notes.fail("GLT007", buffer.pointer, message)
                if len(binary) < length:
                    message = f"byteLength is {length}, but the chunk has {len(binary)}"
                    self.notes.fail("GLT007", buffer.pointer, message)
                if len(binary) > length + 3:
                    message = f"{len(binary) - length} bytes after the buffer are "
                    message += "unused"
                    self.notes.warn("GLT101", buffer.pointer, message)
        elif uri.startswith("data:"):
            self.buffer_bytes(index)
        else:
            self._find_file(uri, buffer)


def decode_data(uri: str, item: JsonItem) -> bytes:
    """Return the bytes of a data URI of any media type."""
    media_type, comma, text = uri.partition(",")
    where = item.pointer_to("uri")
    if not comma or not _DATA_URI.fullmatch(media_type):
        item.notes.fail("GLT007", where, f"{excerpt(uri)} is not a data URI")
    if not media_type.endswith(";base64"):
        return unquote_to_bytes(text)
    try:
        return binascii.a2b_base64(unquote_to_bytes(text), strict_mode=True)
    except (binascii.Error, ValueError) as error:
        item.notes.fail("GLT007", where, f"the data URI is not valid base64: {error}")

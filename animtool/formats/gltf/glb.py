"""Builds the JSON and binary data of a .glb or .gltf file."""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Iterator
from dataclasses import field
from typing import Any

import numpy as np
import numpy.typing as npt

from animtool.core.errors import Fault, OutputError
from animtool.core.record import dataclass
from animtool.formats.gltf.container import BIN_CHUNK, JSON_CHUNK

ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963
_COMPONENT_CODES = {"u1": 5121, "u2": 5123, "u4": 5125, "f4": 5126}
_TYPE_BY_SIZE = {1: "SCALAR", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
MAX_GLB_BYTES = 2**32 - 1


@dataclass(slots=True)
class GlbBuilder:
    """Collects the JSON and binary data of a glTF file to write."""

    json: dict[str, Any]
    _chunks: list[bytes | memoryview] = field(default_factory=list)
    _binary_bytes: int = 0
    _accessors_by_content: dict[tuple[str, int, bytes], int] = field(
        default_factory=dict
    )

    def add(self, key: str, value: dict[str, Any]) -> int:
        """Append an entry to a list of the JSON; return its index."""
        entries = self.json.setdefault(key, [])
        entries.append(value)
        return len(entries) - 1

    def add_accessor(
        self,
        values: npt.NDArray[Any],
        *,
        target: int | None = None,
        has_bounds: bool = False,
    ) -> int:
        """Store numbers ``(count, width)``; return the index of their accessor.

        Equal short arrays are stored once.

        Args:
            values: The numbers.
            target: GPU buffer target; None for data that the GPU does not use.
            has_bounds: Whether to write min and max.
        """
        data = np.ascontiguousarray(values)
        type_name = data.dtype.str[1:]
        byte_count = data.nbytes
        content_key = None
        if byte_count <= _MAX_SHARED_BYTES:
            layout = f"{type_name}/{data.shape[1]}/{target}/{has_bounds}"
            content_key = (layout, len(data), data.tobytes())
            if content_key in self._accessors_by_content:
                return self._accessors_by_content[content_key]
        view: dict[str, Any] = {"buffer": 0, "byteOffset": self._binary_bytes}
        view["byteLength"] = byte_count
        if target is not None:
            view["target"] = target
        accessor: dict[str, Any] = {
            "bufferView": self.add("bufferViews", view),
            "componentType": _COMPONENT_CODES[type_name],
            "count": len(data),
            "type": _TYPE_BY_SIZE[data.shape[1]],
        }
        if has_bounds:
            accessor["min"] = data.min(axis=0).tolist()
            accessor["max"] = data.max(axis=0).tolist()
        padding = b"\0" * (-byte_count % 4)
        self._chunks += [data.reshape(-1).view(np.uint8).data, padding]
        self._binary_bytes += byte_count + len(padding)
        index = self.add("accessors", accessor)
        if content_key is not None:
            self._accessors_by_content[content_key] = index
        return index

    def glb_chunks(self) -> Iterator[bytes | memoryview]:
        """Return the bytes of the GLB in chunks."""
        if self._binary_bytes:
            self.json["buffers"] = [{"byteLength": self._binary_bytes}]
        text = json.dumps(
            self.json, separators=(",", ":"), ensure_ascii=False, allow_nan=False
        ).encode()
        text += b" " * (-len(text) % 4)
        file_bytes = (
            12 + 8 + len(text) + (8 + self._binary_bytes if self._binary_bytes else 0)
        )
        if file_bytes > MAX_GLB_BYTES:
            message = "a GLB can have 4.29 GB, but this one needs "
            message += f"{file_bytes / 1000000000.0:.2f}"
            raise OutputError(Fault("OUT002", message))
        return self._yield_binary(text, file_bytes)

    def gltf_chunks(self) -> Iterator[bytes]:
        """Return the bytes of a .gltf in chunks, with the numbers as a data URI."""
        if self._binary_bytes:
            data = base64.b64encode(b"".join(self._chunks)).decode()
            uri = f"data:application/octet-stream;base64,{data}"
            self.json["buffers"] = [{"byteLength": self._binary_bytes, "uri": uri}]
        text = json.dumps(self.json, indent=1, ensure_ascii=False, allow_nan=False)
        return iter([text.encode(), b"\n"])

    def _yield_binary(
        self, text: bytes, file_bytes: int
    ) -> Iterator[bytes | memoryview]:
        yield struct.pack("<4sII", b"glTF", 2, file_bytes)
        yield struct.pack("<II", len(text), JSON_CHUNK) + text
        if self._binary_bytes:
            yield struct.pack("<II", self._binary_bytes, BIN_CHUNK)
            yield from self._chunks


# Larger arrays are not deduplicated [byte].
_MAX_SHARED_BYTES = 1 << 14

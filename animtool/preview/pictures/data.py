"""Reads the streams of a page, decoding blocks on demand."""

from __future__ import annotations

import base64
import zlib
from collections import OrderedDict
from collections.abc import Sequence
from typing import Any

import numpy as np

from animtool.core.array_types import Float32Array
from animtool.preview.streams import DTYPES, STORED_NAN, Array

# Size of the cache of decoded blocks [byte].
CACHE_BYTES = 64_000_000


class StreamReader:
    """Reads the values of a page's streams by stream index and sample."""

    def __init__(self, entries: Sequence[dict[str, Any]], blocks: Sequence[str]):
        self._entry_by_id = {entry["id"]: entry for entry in entries}
        self._block_texts = blocks
        self._streams_by_block: dict[int, list[tuple[dict[str, Any], int]]] = {}
        for entry in sorted(entries, key=lambda entry_: int(entry_["id"])):
            for block, _, samples in entry["block"]:
                self._streams_by_block.setdefault(block, []).append((entry, samples))
        self._decoded_by_block: OrderedDict[int, dict[int, Array]] = OrderedDict()
        self._static_values_by_stream: dict[int, Array] = {}
        self._cached_bytes = 0

    def width(self, stream: int) -> int:
        """Return the number of values per sample of a stream."""
        return int(self._entry_by_id[stream]["width"])

    def static_values(self, stream: int | None) -> Array:
        """Return the values of a one-sample stream; empty if there is no stream."""
        return (
            np.zeros(0, np.float32) if stream is None else self.sample_values(stream, 0)
        )

    def sample_values(self, stream: int, sample: int) -> Array:
        """Return the values of a stream at a sample, clamped to the last sample."""
        if stream in self._static_values_by_stream:
            return self._static_values_by_stream[stream]
        block_spans = self._entry_by_id[stream]["block"]
        if not block_spans:
            return np.zeros(0, np.float32)
        later_spans = (span for span in block_spans if sample < span[1] + span[2])
        block, first, sample_count = next(later_spans, block_spans[-1])
        values = self._decoded_block(block)[stream]
        value: Array = values[min(max(sample - first, 0), sample_count - 1)]
        return value

    def _decoded_block(self, block: int) -> dict[int, Array]:
        """Return the decoded streams of a block by index; cached."""
        if block in self._decoded_by_block:
            self._decoded_by_block.move_to_end(block)
            return self._decoded_by_block[block]
        block_bytes = zlib.decompress(base64.b64decode(self._block_texts[block]), -15)
        values_by_stream, begin = {}, 0
        for entry, sample_count in self._streams_by_block[block]:
            item_bytes = np.dtype(DTYPES[entry["kind"]]).itemsize
            end = begin + entry["width"] * sample_count * item_bytes
            stream_values = _unpack_stream(block_bytes[begin:end], entry, sample_count)
            begin = end
            values_by_stream[entry["id"]] = stream_values
            if sum(span[2] for span in entry["block"]) == 1:
                self._static_values_by_stream[entry["id"]] = stream_values[0]
        self._decoded_by_block[block] = values_by_stream
        self._cached_bytes += _total_bytes(values_by_stream)
        while self._cached_bytes > CACHE_BYTES and len(self._decoded_by_block) > 1:
            self._cached_bytes -= _total_bytes(
                self._decoded_by_block.popitem(last=False)[1]
            )
        return values_by_stream


def _total_bytes(values_by_stream: dict[int, Array]) -> int:
    """Return the total size of arrays [byte]."""
    return sum(array.nbytes for array in values_by_stream.values())


def _unpack_stream(
    stream_bytes: bytes, entry: dict[str, Any], sample_count: int
) -> Array:
    """Return the values of one stream of a block ``(samples, width)``."""
    dtype, width = np.dtype(DTYPES[entry["kind"]]), entry["width"]
    columns, rows = (1, width) if sample_count == 1 else (width, sample_count)
    byte_planes = np.frombuffer(stream_bytes, np.uint8)
    byte_planes = byte_planes.reshape(columns, dtype.itemsize, rows)
    integers = np.ascontiguousarray(byte_planes.swapaxes(1, 2)).view(dtype)[..., 0]
    if entry["coding"] == "delta":
        deltas = integers.view(f"<u{dtype.itemsize}")
        integers = np.cumsum(deltas, axis=1, dtype=deltas.dtype).view(dtype)
    stored_values = integers.reshape(1, -1) if sample_count == 1 else integers.T
    scale, offset = entry["scale"], entry["offset"]
    if scale == 1 and offset == 0 and entry["kind"] != "i16":
        return np.ascontiguousarray(stored_values)
    values = np.resize(np.atleast_1d(offset), width) + stored_values * np.resize(
        np.atleast_1d(scale), width
    )
    if entry.get("gaps"):
        values[stored_values == STORED_NAN] = np.nan
    decoded_values: Float32Array = values.astype(np.float32)
    return decoded_values

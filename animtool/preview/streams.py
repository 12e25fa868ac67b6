"""Quantizes arrays and packs them into compressed blocks, the streams of a page."""

from __future__ import annotations

import base64
import hashlib
import zlib
from collections.abc import Sequence
from dataclasses import field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from animtool.core.array_types import FloatArray
from animtool.core.record import dataclass

# Maximum samples of a block, and its maximum decoded size [byte], which decodes within
# one display frame.
BLOCK_SAMPLES = 256
BLOCK_BYTES = 1 << 20
# Static arrays share blocks up to this size [bytes].
STATIC_BLOCK_BYTES = 1 << 22
DEFLATE_LEVEL = 6
# Range of quantized values on either side of the offset.
MAX_QUANTIZED = 32767
# Stands for NaN in streams with gaps.
STORED_NAN = -32768
# Coarser than this, positions are stored as float32 [m].
POSITION_TOLERANCE = 1e-4

Array = npt.NDArray[Any]
DTYPES = {"u8": "<u1", "i16": "<i2", "u16": "<u2", "f32": "<f4", "u32": "<u4"}


@dataclass(frozen=True, slots=True)
class QuantizedValues:
    """Quantized values with their scale, offset and largest error.

    Attributes:
        stored_values: Integers or floats ``(F, width)`` of the type ``kind``.
        kind: ``i16``, ``u16``, ``u8``, ``f32`` or ``u32``.
        scale: One number, or several that repeat along the width.
        offset: Likewise; a value is ``offset + scale * stored_values``.
        has_gaps: Whether -32768 stands for NaN.
        error: Largest quantization error, in the unit of the values.
    """

    stored_values: Array
    kind: str
    scale: float | list[float] = 1.0
    offset: float | list[float] = 0.0
    has_gaps: bool = False
    error: float = 0.0


def json_numbers(values: FloatArray, digits: int = 6) -> list[Any]:
    """Return numbers for JSON, rounded, without negative zeros.

    >>> json_numbers(np.array([-0.0, 0.1234567891]))
    [0.0, 0.123457]
    """
    rounded_values = np.round(np.asarray(values, np.float64), digits) + 0.0
    return list(rounded_values.tolist())


def quantize_units(values: FloatArray) -> QuantizedValues:
    """Quantize numbers from -1 to 1, such as unit quaternions."""
    integers = np.rint(np.clip(values, -1.0, 1.0) * MAX_QUANTIZED).astype("<i2")
    error = np.abs(integers / MAX_QUANTIZED - values).max(initial=0.0)
    return QuantizedValues(integers, "i16", 1.0 / MAX_QUANTIZED, error=float(error))


def quantize_range(
    values: Array, tolerance: float = POSITION_TOLERANCE, *, column_period: int = 0
) -> QuantizedValues:
    """Quantize columns over their range; use float32 if that is too coarse.

    Args:
        values: ``(F, width)``; non-finite values are gaps.
        tolerance: Largest error allowed for integers.
        column_period: Columns this far apart share a range, such as 3 for the x of all
            points; 0 gives each column its own.
    """
    width = values.shape[1]
    float32_values = np.asarray(values, np.float32).astype(np.float64)
    float32_values = np.where(np.isfinite(float32_values), float32_values, np.nan)
    rows = (
        float32_values.reshape(-1, column_period) if column_period else float32_values
    )
    if not rows.size:
        return QuantizedValues(np.zeros(values.shape, "<f4"), "f32")
    has_gaps = bool(np.isnan(rows).any())
    is_finite = np.isfinite(rows)
    low = np.where(is_finite, rows, np.inf).min(axis=0)
    high = np.where(is_finite, rows, -np.inf).max(axis=0)
    low, high = (np.where(low <= high, bound, 0.0) for bound in (low, high))
    scale = (high - low) / (2 * MAX_QUANTIZED)
    if scale.max(initial=0.0) / 2 > tolerance or not np.isfinite(scale).all():
        floats = np.asarray(values, np.float32)
        return QuantizedValues(
            floats, "f32", error=_largest_difference(floats - values)
        )
    offset = (high + low) / 2
    divisor = np.where(scale > 0, scale, 1.0)
    quantized_rows = np.rint((rows - offset) / divisor)
    integers = np.where(np.isnan(quantized_rows), STORED_NAN, quantized_rows).astype(
        "<i2"
    )
    error = _largest_difference(
        offset + scale * quantized_rows - values.reshape(rows.shape)
    )
    if width > 1 and not column_period and not np.ptp(scale) and not np.ptp(offset):
        scale, offset = scale[:1], offset[:1]
    integers = integers.reshape(values.shape)
    scale_and_offset = _single_or_list(scale), _single_or_list(offset)
    return QuantizedValues(integers, "i16", *scale_and_offset, has_gaps, error)


def _single_or_list(values: FloatArray) -> float | list[float]:
    """Return values as a list, or the number itself if there is only one."""
    numbers: list[float] = values.tolist()
    return numbers[0] if len(numbers) == 1 else numbers


def _largest_difference(differences: Array) -> float:
    """Return the largest absolute finite difference; 0 if there is none."""
    return float(np.nanmax(np.abs(differences), initial=0.0))


@dataclass(slots=True)
class _PageStream:
    """Quantized samples of one animated quantity, and the blocks that store them."""

    id: int
    quantized: QuantizedValues
    # Index, first sample and number of samples of each block of the page.
    blocks: list[list[int]] = field(default_factory=list)

    @property
    def is_delta_coded(self) -> bool:
        """Whether samples are stored as differences from the previous sample."""
        return self.quantized.kind != "f32"

    @property
    def sample_bytes(self) -> int:
        """Size of one sample [bytes]."""
        item_bytes = np.dtype(DTYPES[self.quantized.kind]).itemsize
        return int(self.quantized.stored_values.shape[1]) * item_bytes

    def manifest_entry(self) -> dict[str, Any]:
        """Return the stream's entry in the page manifest."""
        quantized = self.quantized
        entry: dict[str, Any] = {
            "id": self.id,
            "block": self.blocks,
            "kind": quantized.kind,
            "width": int(quantized.stored_values.shape[1]),
            "scale": quantized.scale,
            "offset": quantized.offset,
            "coding": "delta" if self.is_delta_coded else "raw",
        }
        return entry | ({"gaps": True} if quantized.has_gaps else {})


class StreamPacker:
    """Collects the streams of a page, and packs them into blocks."""

    def __init__(self) -> None:
        self._streams: list[_PageStream] = []
        self._static_indices: dict[tuple[object, ...], int] = {}

    def add(self, quantized: QuantizedValues) -> int:
        """Add a stream and return its index; equal one-sample streams share one."""
        index = len(self._streams)
        if len(quantized.stored_values) == 1:
            digest = hashlib.blake2b(quantized.stored_values.tobytes()).digest()
            static_key = (
                digest,
                quantized.kind,
                str(quantized.scale),
                str(quantized.offset),
                quantized.has_gaps,
            )
            index = self._static_indices.setdefault(static_key, index)
            if index < len(self._streams):
                return index
        self._streams.append(_PageStream(index, quantized))
        return index

    def add_static(self, values: npt.ArrayLike, kind: str) -> int:
        """Add a one-sample stream without quantization; return its index."""
        row = np.asarray(values).reshape(1, -1).astype(DTYPES[kind])
        return self.add(QuantizedValues(row, kind))

    def add_static_range(self, values: FloatArray) -> int:
        """Add a one-sample stream of positions or offsets [m]; return its index."""
        quantized = quantize_range(np.reshape(values, (-1, 3)), column_period=3)
        return self.add(
            replace(quantized, stored_values=quantized.stored_values.reshape(1, -1))
        )

    @property
    def total_bytes(self) -> int:
        """Size of all streams before compression [bytes]."""
        return sum(stream.quantized.stored_values.nbytes for stream in self._streams)

    def finish(self) -> tuple[list[dict[str, Any]], list[str]]:
        """Return the manifest entries of the streams, and the blocks as text."""
        blocks: list[str] = []
        for group, samples_per_block in self._groups():
            count = len(group[0].quantized.stored_values)
            for first in range(0, count, samples_per_block):
                sample_slice = slice(first, min(first + samples_per_block, count))
                encoded_streams = [
                    _encoded_samples(
                        s.quantized.stored_values[sample_slice], s.quantized.kind
                    )
                    for s in group
                ]
                for stream in group:
                    stream.blocks.append(
                        [len(blocks), first, sample_slice.stop - first]
                    )
                blocks.append(deflate_base64(encoded_streams))
        return [stream.manifest_entry() for stream in self._streams], blocks

    def _groups(self) -> list[tuple[list[_PageStream], int]]:
        """Return groups of streams that share blocks, and the samples per block."""
        groups: list[tuple[list[_PageStream], int]] = []
        static_streams: list[_PageStream] = []
        streams_by_length: dict[int, list[_PageStream]] = {}
        for stream in self._streams:
            sample_count = len(stream.quantized.stored_values)
            if sample_count == 1:
                static_streams.append(stream)
            elif stream.sample_bytes * BLOCK_SAMPLES > BLOCK_BYTES:
                samples_per_block = max(1, BLOCK_BYTES // stream.sample_bytes)
                groups.append(([stream], samples_per_block))
            elif sample_count:
                streams_by_length.setdefault(sample_count, []).append(stream)
        groups += [
            (group, BLOCK_SAMPLES)
            for streams in streams_by_length.values()
            for group in _split_by_size(streams, BLOCK_BYTES, BLOCK_SAMPLES)
        ]
        groups += [
            (group, 1)
            for group in _split_by_size(static_streams, STATIC_BLOCK_BYTES, 1)
        ]
        return groups


def _split_by_size(
    streams: Sequence[_PageStream], max_bytes: int, samples_per_block: int
) -> list[list[_PageStream]]:
    """Group streams up to a total size; a larger stream forms its own group."""
    groups: list[list[_PageStream]] = []
    group_bytes = 0
    for stream in streams:
        stream_bytes = stream.sample_bytes * samples_per_block
        if not groups or group_bytes + stream_bytes > max_bytes:
            groups.append([])
            group_bytes = 0
        groups[-1].append(stream)
        group_bytes += stream_bytes
    return groups


def _encoded_samples(stored_values: Array, kind: str) -> bytes:
    """Return samples as bytes: column-major, delta-coded, split into byte planes."""
    item_bytes = np.dtype(DTYPES[kind]).itemsize
    columns = (
        stored_values.reshape(1, -1) if len(stored_values) == 1 else stored_values.T
    )
    columns = np.ascontiguousarray(columns, DTYPES[kind])
    if kind != "f32":
        unsigned_columns = columns.view(f"<u{item_bytes}")
        columns = unsigned_columns.copy()
        columns[:, 1:] -= unsigned_columns[:, :-1]
    byte_planes = columns.view(np.uint8).reshape(*columns.shape, item_bytes)
    return np.ascontiguousarray(byte_planes.swapaxes(1, 2)).tobytes()


def deflate_base64(chunks: Sequence[bytes]) -> str:
    """Compress bytes with raw deflate and encode them as base64."""
    deflate = zlib.compressobj(DEFLATE_LEVEL, zlib.DEFLATED, -15)
    compressed_bytes = b"".join([*map(deflate.compress, chunks), deflate.flush()])
    return base64.b64encode(compressed_bytes).decode("ascii")

"""C3D files built and read byte by byte, apart from the library that animtool uses.

After the C3D file format user guide (Motion Lab Systems, 2021): blocks of 512 bytes,
a header of 16-bit words, parameters by group, then frames of points.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from typing import Any

import numpy as np

INTEL, DEC, SGI = 84, 85, 86


def floats(values: Any, processor: int = INTEL) -> bytes:
    """Return float32 as a processor stores them."""
    numbers = np.asarray(values, np.float64)
    if processor == SGI:
        return numbers.astype(">f4").tobytes()
    if processor == DEC:
        words = (numbers * 4).astype("<f4").view("<u2").reshape(-1, 2)
        return words[:, ::-1].tobytes()
    return numbers.astype("<f4").tobytes()


def read_floats(data: bytes, processor: int = INTEL) -> Any:
    """Return the inverse of `floats`."""
    if processor == SGI:
        return np.frombuffer(data, ">f4").astype(float)
    if processor == DEC:
        words = np.frombuffer(data, "<u2").reshape(-1, 2)[:, ::-1]
        return np.ascontiguousarray(words).view("<f4").ravel().astype(float) / 4
    return np.frombuffer(data, "<f4").astype(float)


def words(values: Any, processor: int = INTEL) -> bytes:
    """Return 16-bit integers as a processor stores them."""
    kind = ">u2" if processor == SGI else "<u2"
    return (np.asarray(values, np.int64) & 0xFFFF).astype(kind).tobytes()


@dataclass
class C3dFile:
    """What to put into a C3D file; `build` gives its bytes."""

    points: Any  # (F, M, 3), NaN where not seen
    labels: list[str]
    rate: float = 120.0
    header_rate: float | None = None
    units: str | None = "mm"
    scale: float = -1.0
    processor: int = INTEL
    first: int = 1
    residuals: Any = None  # (F, M) in units of the scale
    masks: Any = None  # (F, M) bits
    declared: int | None = None  # frames that the header claims
    used: int | None = None  # points that the header claims
    groups: dict[str, dict[str, Any]] = field(default_factory=dict)
    analog: Any = None  # (F, A) numbers behind the points of a frame
    samples: int = 0  # analogue samples of a channel in a frame
    words: dict[int, int] = field(default_factory=dict)  # header words, from 1
    header_scale: float | None = None
    padded: bool = False  # zeros up to a full block
    section: str = "whole"  # "empty" has a head alone, "none" not even that
    gap: int = 0  # blocks between parameters and data

    def parameters(self) -> dict[str, dict[str, Any]]:
        """Return groups of parameters: texts, float32 or 16-bit integers."""
        frames, count = np.shape(self.points)[:2]
        point: dict[str, Any] = {
            "USED": np.array([count if self.used is None else self.used], np.int64),
            "SCALE": np.array([self.scale], np.float32),
            "RATE": np.array([self.rate], np.float32),
            "DATA_START": np.array([0], np.int64),
            "FRAMES": np.array([min(frames, 32767)], np.int64),
        }
        for k in range(0, max(len(self.labels), 1), 255):
            suffix = "" if k == 0 else str(k // 255 + 1)
            point[f"LABELS{suffix}"] = self.labels[k : k + 255]
        if self.units is not None:
            point["UNITS"] = [self.units]
        channels = (
            0 if self.analog is None else np.shape(self.analog)[1] // self.samples
        )
        analog: dict[str, Any] = {"USED": np.array([channels], np.int64)}
        if channels:
            analog["RATE"] = np.array([self.rate * self.samples], np.float32)
            analog["LABELS"] = [f"A{i}" for i in range(channels)]
        groups = {"POINT": point, "ANALOG": analog}
        for name, entries in self.groups.items():
            groups[name] = {**groups.get(name, {}), **entries}
        return {
            name: {k: v for k, v in entries.items() if v is not None}
            for name, entries in groups.items()
        }

    def build(self) -> bytes:
        """Return the bytes of the file."""
        body = self._parameter_section(0)
        blocks = {"none": 0, "empty": 1}.get(self.section, -(-(len(body) + 4) // 512))
        start = 2 + blocks + self.gap
        body = self._parameter_section(start) if self.section == "whole" else b""
        head = bytes([1, 80, blocks, self.processor]) if blocks else b""
        section = (head + body).ljust(512 * (blocks + self.gap), b"\0")
        data = self._header(start) + section + self._data()
        return data + b"\0" * (-len(data) % 512 if self.padded else 0)

    def _header(self, start: int) -> bytes:
        frames, count = np.shape(self.points)[:2]
        last = self.first + (frames if self.declared is None else self.declared) - 1
        used = count if self.used is None else self.used
        p = self.processor
        analog = 0 if self.analog is None else np.shape(self.analog)[1]
        pointer = 0 if self.section == "none" else 2
        out = bytes([pointer, 80]) + words([used, analog, self.first, last, 10], p)
        scale = self.scale if self.header_scale is None else self.header_scale
        out += floats([scale], p) + words([start, self.samples], p)
        rate = self.rate if self.header_rate is None else self.header_rate
        head = bytearray((out + floats([rate], p)).ljust(512, b"\0"))
        for number, value in self.words.items():
            head[2 * number - 2 : 2 * number] = words([value], p)
        return bytes(head)

    def _parameter_section(self, start: int) -> bytes:
        out = b""
        p = self.processor
        groups = self.parameters()
        if "DATA_START" not in self.groups.get("POINT", {}):
            groups["POINT"]["DATA_START"] = np.array([start], np.int64)
        for number, (name, entries) in enumerate(groups.items(), 1):
            raw = name.encode()
            out += struct.pack("bb", len(raw), -number) + raw + words([3], p) + b"\0"
            for key, value in entries.items():
                raw = key.encode()
                body = self._value(value)
                out += struct.pack("bb", len(raw), number) + raw
                out += words([2 + len(body) + 1], p) + body + b"\0"
        return out + b"\0\0"

    def _value(self, value: Any) -> bytes:
        if isinstance(value, list):
            width = max((len(text) for text in value), default=0)
            text = "".join(text.ljust(width) for text in value)
            return struct.pack("bBBB", -1, 2, width, len(value)) + text.encode()
        array = np.asarray(value)
        head = bytes([array.ndim, *array.shape[::-1]])
        if array.dtype.kind == "f":
            return b"\x04" + head + floats(array.ravel(), self.processor)
        return b"\x02" + head + words(array.ravel(), self.processor)

    def _data(self) -> bytes:
        points = np.asarray(self.points, np.float64)
        seen = np.isfinite(points).all(axis=-1)
        zero = np.zeros(seen.shape)
        residual = zero if self.residuals is None else np.asarray(self.residuals)
        masks = zero if self.masks is None else np.asarray(self.masks)
        word = np.where(seen, masks.astype(np.int64) * 256 + residual, -1)
        rows = np.where(seen[..., None], points, 0.0)
        whole = self.scale > 0
        if whole:
            rows = np.round(rows / self.scale)
        table = np.concatenate([rows, word[..., None]], -1)
        table = table.reshape(len(points), 4 * points.shape[1])
        if self.analog is not None:
            table = np.concatenate([table, self.analog], 1)
        return (words if whole else floats)(table, self.processor)


def read_points(data: bytes) -> tuple[Any, float]:
    """Return points ``(F, M, 3)`` with NaN where missing, and the rate, of a file.

    Only of files without analogue samples, and without a look at parameters.
    """
    p = data[512 * (data[0] - 1) + 3]
    order = ">" if p == SGI else "<"
    used, analog, first, last = struct.unpack_from(f"{order}4H", data, 2)
    assert analog == 0
    scale = read_floats(data[12:16], p)[0]
    (start,) = struct.unpack_from(f"{order}H", data, 16)
    rate = read_floats(data[20:24], p)[0]
    count = (last - first + 1) * used * 4
    begin = 512 * (start - 1)
    if scale < 0:
        values = read_floats(data[begin : begin + 4 * count], p)
    else:
        values = np.frombuffer(data[begin : begin + 2 * count], f"{order}i2") * 1.0
    rows = values.reshape(-1, used, 4)
    points = rows[..., :3] * (scale if scale > 0 else 1.0)
    points[rows[..., 3] < 0] = np.nan
    return points, float(rate)

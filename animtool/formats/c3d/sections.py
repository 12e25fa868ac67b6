"""Reads C3D header and parameters without trusting any count in the file.

References:
    Motion Lab Systems, "The C3D File Format: A Technical User Guide", 2021.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import field
from enum import IntEnum
from typing import Any

import numpy as np
import numpy.typing as npt

from animtool.core.array_types import FloatArray
from animtool.core.record import dataclass
from animtool.formats.delimited import decode_text

BLOCK_BYTES = 512
MAGIC = 80
# Limit of groups and parameters per file; the format allows 127 groups.
MAX_PARAMETERS = 20_000
# Range of plausible scales and rates [1/s] of captures; values in the wrong byte order
# are outside it.
MIN_POINT_SCALE, MAX_POINT_SCALE = 1e-8, 1e5
MIN_FRAME_RATE, MAX_FRAME_RATE = 0.5, 1e5


class MalformedError(ValueError):
    """Raised for bytes that are not a C3D file; the message explains why."""


class Processor(IntEnum):
    """The processor of a file, which determines byte order and float format."""

    INTEL = 84
    DEC = 85
    SGI = 86

    @property
    def order(self) -> str:
        """Byte order of integers as a numpy prefix."""
        return ">" if self is Processor.SGI else "<"

    def integers(self, data: bytes) -> npt.NDArray[Any]:
        """Return signed 16-bit integers as int64."""
        return np.frombuffer(data, f"{self.order}i2").astype(np.int64)

    def floats(self, data: bytes) -> FloatArray:
        """Return 32-bit floats as float64; DEC's are in VAX F format."""
        if self is not Processor.DEC:
            # Invalid bytes become NaN, signalling or quiet.
            with np.errstate(invalid="ignore"):
                return np.frombuffer(data, f"{self.order}f4").astype(np.float64)
        words = np.frombuffer(data, "<u2").reshape(-1, 2)[:, ::-1]
        bits = np.ascontiguousarray(words).view("<u4").ravel()
        mantissa = (bits & 0x7FFFFF) | 0x800000
        exponent = ((bits >> 23) & 0xFF).astype(np.int64)
        # An exponent of 0 means zero, and there is no infinity.
        magnitude = np.where(exponent == 0, 0.0, np.ldexp(mantissa, exponent - 152))
        return np.where(bits >> 31, -magnitude, magnitude)

    def rows(
        self, data: bytes, number_bytes: int, numbers_per_row: int, column_count: int
    ) -> FloatArray:
        """Return the first numbers of each row as floats ``(F, column_count)``."""
        if number_bytes == 4 and self is Processor.DEC:
            words = np.frombuffer(data, "<u2").reshape(-1, 2 * numbers_per_row)
            first_words = words[:, : 2 * column_count]
            return self.floats(first_words.tobytes()).reshape(-1, column_count)
        dtype = f"{self.order}{'f4' if number_bytes == 4 else 'i2'}"
        numbers = np.frombuffer(data, dtype).reshape(-1, numbers_per_row)
        # Arbitrary bytes may be signalling NaNs.
        with np.errstate(invalid="ignore"):
            return numbers[:, :column_count].astype(np.float64)


@dataclass(frozen=True, slots=True)
class Header:
    """Counts, frame range, scale and rates that the header block of a file states."""

    point_count: int
    analog_count: int  # analogue values per frame, all samples
    first_frame: int
    last_frame: int
    scale: float  # of integers; negative means floats
    data_block: int  # block of the first frame, from 1
    samples_per_frame: int  # analogue samples per channel and frame
    rate: float


@dataclass(slots=True)
class Sections:
    """Header and parameters of a C3D file."""

    header: Header
    processor: Processor
    # Block after the parameters, as stated by them; 2 without parameters.
    end_block: int = 2
    # Parameter values by group and name in capitals: arrays or lists of texts.
    groups: dict[str, dict[str, Any]] = field(default_factory=dict)

    def number(self, group: str, name: str) -> float | None:
        """Return the first number of a parameter; None if it has none."""
        value = self.groups.get(group, {}).get(name)
        if isinstance(value, np.ndarray) and value.size:
            return float(value.ravel()[0])
        return None

    def numbers(self, group: str, name: str) -> list[float]:
        """Return all numbers of a parameter; empty if it has none."""
        value = self.groups.get(group, {}).get(name)
        return value.ravel().tolist() if isinstance(value, np.ndarray) else []

    def texts(self, group: str, name: str) -> list[str]:
        """Return the texts of a parameter and its continuations."""
        texts: list[str] = []
        for value in self.continued_values(group, name):
            if not isinstance(value, list):
                break
            texts += value
        return texts

    def continued_values(self, group: str, name: str) -> Iterator[Any]:
        """Yield the values of a parameter and its continuations.

        Labels after the first 255 are in ``LABELS2``, ``LABELS3`` and so on.
        """
        parameters = self.groups.get(group, {})
        key, number = name, 1
        while key in parameters:
            yield parameters[key]
            number += 1
            key = f"{name}{number}"


def read_sections(data: bytes) -> Sections:
    """Return header and parameters, up to the first broken parameter.

    A file without parameters is read from its header alone.
    """
    if len(data) < BLOCK_BYTES or data[1] != MAGIC:
        problem = "does not start like a C3D file" if data else "is empty"
        raise MalformedError(f"{problem}; copy or export it again")
    parameters_start = BLOCK_BYTES * (data[0] - 1)
    has_parameters = data[0] >= 2 and parameters_start + 4 <= len(data)
    processor_code = data[parameters_start + 3] if has_parameters else 0
    is_known_processor = processor_code in {int(p) for p in Processor}
    if is_known_processor:
        processor = Processor(processor_code)
        sections = Sections(_read_header(data, processor), processor)
    else:
        sections = Sections(*_guess_processor(data, processor_code))
    if has_parameters:
        _read_parameters(sections, data, parameters_start + 4)
    if not sections.groups:
        sections = Sections(*_guess_processor(data, processor_code))
    if is_known_processor or sections.groups:
        sections.end_block = data[0] + data[parameters_start + 2]
    return sections


def _read_header(data: bytes, processor: Processor) -> Header:
    words = (processor.integers(data[:BLOCK_BYTES]) & 0xFFFF).tolist()
    scale, rate = (
        float(processor.floats(data[offset : offset + 4])[0]) for offset in (12, 20)
    )
    points, analog, first, last = words[1:5]
    data_block, samples = words[8:10]
    return Header(points, analog, first, last, scale, data_block, samples, rate)


def _guess_processor(data: bytes, stated_code: int) -> tuple[Header, Processor]:
    """Return the first plausible header of a file, and its processor."""
    for processor in sorted(Processor, key=lambda p: (p != stated_code, p)):
        header = _read_header(data, processor)
        if _is_plausible_header(header, len(data)):
            return header, processor
    raise MalformedError("has no parameters where its header points")


def _is_plausible_header(header: Header, size: int) -> bool:
    """Return whether a header's values are possible for a capture."""
    scale, rate = header.scale, header.rate
    return (
        header.point_count > 0
        and header.last_frame >= header.first_frame
        and header.data_block <= max(255, 1 + size // BLOCK_BYTES)
        and MIN_POINT_SCALE < abs(scale) < MAX_POINT_SCALE
        and MIN_FRAME_RATE < rate < MAX_FRAME_RATE
    )


def _read_parameters(sections: Sections, data: bytes, offset: int) -> None:
    """Read groups and parameters until their chain ends or is broken."""
    names: dict[int, str] = {}
    parameters: list[tuple[int, str, Any]] = []
    for _ in range(MAX_PARAMETERS):
        if offset + 2 > len(data):
            break
        name_length = abs(_signed_byte(data[offset]))  # negative if locked
        group_id = _signed_byte(data[offset + 1])
        body_offset = offset + 2 + name_length
        if name_length == 0 or group_id == 0 or body_offset + 2 > len(data):
            break
        name = _decode_text(data[offset + 2 : body_offset]).upper()
        size_word = sections.processor.integers(data[body_offset : body_offset + 2])
        body_bytes = int(size_word[0]) & 0xFFFF
        if group_id < 0:
            names[-group_id] = name
        else:
            value = _parse_parameter(sections.processor, data, body_offset + 2)
            if value is not None:
                parameters.append((group_id, name, value))
        if body_bytes == 0:
            break
        offset = body_offset + body_bytes
    # A group may be defined after its parameters.
    for name in names.values():
        sections.groups.setdefault(name, {})
    for group_id, name, value in parameters:
        if group_id in names:
            sections.groups[names[group_id]][name] = value


def _parse_parameter(processor: Processor, data: bytes, offset: int) -> Any:
    """Return a parameter's array or texts; None if it is broken."""
    if offset + 2 > len(data):
        return None
    type_code, dimensions = _signed_byte(data[offset]), data[offset + 1]
    sizes = list(data[offset + 2 : offset + 2 + dimensions])
    values_offset = offset + 2 + dimensions
    value_bytes = {-1: 1, 1: 1, 2: 2, 4: 4}.get(type_code)
    if value_bytes is None or dimensions > 7 or len(sizes) < dimensions:
        return None
    count = math.prod(sizes)
    value_data = data[values_offset : values_offset + count * value_bytes]
    if len(value_data) < count * value_bytes:
        return None
    if type_code == -1:
        return _split_texts(value_data, sizes)
    if type_code == 1:
        return np.frombuffer(value_data, np.int8).astype(np.int64).reshape(sizes[::-1])
    convert = processor.integers if type_code == 2 else processor.floats
    return convert(value_data).reshape(sizes[::-1])


def _split_texts(data: bytes, sizes: Sequence[int]) -> list[str]:
    if len(sizes) < 2:
        return [_decode_text(data)]
    text_bytes = sizes[0]
    count = math.prod(sizes[1:])
    return [
        _decode_text(data[i * text_bytes : (i + 1) * text_bytes]) for i in range(count)
    ]


def _decode_text(data: bytes) -> str:
    """Return the text before the first zero byte, without blanks around it."""
    return decode_text(data.partition(b"\0")[0].strip())


def _signed_byte(byte: int) -> int:
    return byte - 256 if byte > 127 else byte

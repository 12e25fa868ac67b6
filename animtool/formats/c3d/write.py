"""Writes marker trajectories as a C3D file."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.clock import Clock
from animtool.core.errors import Fault, OptionError, Severity, counted
from animtool.core.units import LengthUnit
from animtool.formats import FLOAT32_MAX
from animtool.formats.c3d.read import ANIMTOOL_GROUP
from animtool.formats.c3d.sections import BLOCK_BYTES, MAGIC, Processor
from animtool.maths.runs import runs
from animtool.motion.markers import Markers

# Maximum entries of a parameter, whose dimensions are single bytes.
MAX_PARAMETER_ENTRIES = 255
MAX_NAME_BYTES = 255
# Largest count in header and parameters, which are 16-bit.
MAX_STORED_COUNT = 65535
MAX_CAMERAS_PER_POINT = 7
# Bytes before the parameters: first block, number of blocks, and processor.
_PARAMETER_HEADER_BYTES = 4
# Maximum parameter blocks, counted in a byte.
MAX_PARAMETER_BLOCKS = 255
# Steps of a residual, which is a byte; 0 means that a point was not measured.
RESIDUAL_STEPS = 255
# Integer range from which readers expect the scale of floats to be derived.
MAX_STORED_INTEGER = 32000
BLOCK_FRAMES = 4096
# Analogue samples per channel and frame. There are no channels, but readers compare
# this number with the rates.
ANALOG_SAMPLES = 1


def write_c3d(
    markers: Markers, path: Path | str, *, overwrite: bool = False
) -> list[Fault]:
    """Write markers as a C3D file of Intel floats, in millimetres.

    Residuals are stored to 1/255 of the largest, and camera counts up to seven. Filled
    positions have residual 0, as the format requires, and are listed in the group
    ``ANIMTOOL``, so that reading the file restores them. Takes longer than 65535 frames
    have their length in ``TRIAL:ACTUAL_END_FIELD`` and ``POINT:LONG_FRAMES``, as is
    common.

    Args:
        markers: The markers.
        path: Path of the file, ``.c3d``.
        overwrite: Replace an existing file.

    Returns:
        Warnings about data that C3D cannot store.
    """
    from animtool.core.files.output import check_outputs, write_parts

    path = Path(path)
    check_outputs([path], [], overwrite=overwrite)
    header_bytes = _build_header(markers, path)
    write_parts(path, _file_chunks(markers, header_bytes))
    return _data_loss_notice(markers, str(path))


def _build_header(markers: Markers, path: Path) -> bytes:
    """Return the bytes of header and parameters."""
    frame_count, marker_count = markers.positions.shape[:2]
    block_count = 1
    # The parameters contain the start of the data, so their size is needed first.
    parameters = _build_parameters(markers, 2 + block_count)
    block_count = -(-(_PARAMETER_HEADER_BYTES + len(parameters)) // BLOCK_BYTES)
    if (
        not 0 < marker_count <= MAX_STORED_COUNT
        or block_count > MAX_PARAMETER_BLOCKS
        or frame_count == 0
    ):
        message = (
            f"a C3D holds 1 to {MAX_STORED_COUNT} markers with 130000 bytes of names, "
        )
        message += f"and at least one frame, not {marker_count} in {frame_count} frames"
        raise OptionError(Fault("C3D010", message, str(path), (), "write .npz"))
    parameters = _build_parameters(markers, 2 + block_count)
    first, last = _header_frame_range(markers.clock)
    scale = _residual_scale(markers)
    header = bytes([2, MAGIC]) + struct.pack("<5H", marker_count, 0, first, last, 0)
    rate = float(markers.clock.rate)
    header += struct.pack("<fHHf", scale, 2 + block_count, ANALOG_SAMPLES, rate)
    parameter_blocks = bytes([1, MAGIC, block_count, int(Processor.INTEL)]) + parameters
    return header.ljust(BLOCK_BYTES, b"\0") + parameter_blocks.ljust(
        BLOCK_BYTES * block_count, b"\0"
    )


def _header_frame_range(clock: Clock) -> tuple[int, int]:
    """Return the first and last frame number, clamped to the header's range."""
    first, last = _frame_range(clock)
    if last <= MAX_STORED_COUNT:
        return first, last
    return 1, min(clock.count, MAX_STORED_COUNT)


def _frame_range(clock: Clock) -> tuple[int, int]:
    first = int(clock.start) if clock.start.denominator == 1 else 1
    first = first if 0 <= first < 2**31 else 1
    return first, first + clock.count - 1


def _residual_scale(markers: Markers) -> float:
    """Return POINT:SCALE, the unit of residuals [mm]; its minus sign means floats."""
    residuals = markers.residuals
    if residuals is not None and np.nanmax(residuals, initial=0.0) > 0:
        return -float(np.nanmax(residuals)) * 1000.0 / RESIDUAL_STEPS
    magnitudes = np.abs(markers.positions) * 1000.0
    magnitudes = np.where(magnitudes <= FLOAT32_MAX, magnitudes, 0.0)
    return -max(float(np.nanmax(magnitudes, initial=0.0)), 1.0) / MAX_STORED_INTEGER


def _build_parameters(markers: Markers, data_block: int) -> bytes:
    """Return the bytes of the parameter section after its first four bytes."""
    frame_count, marker_count = markers.positions.shape[:2]
    first, last = _frame_range(markers.clock)
    clamped_count = min(frame_count, MAX_STORED_COUNT)
    point_group: dict[str, bytes] = {
        "USED": _integer_parameter([marker_count]),
        "SCALE": _float_parameter([_residual_scale(markers)]),
        "RATE": _float_parameter([float(markers.clock.rate)]),
        "DATA_START": _integer_parameter([data_block]),
        "FRAMES": _integer_parameter([clamped_count]),
        "UNITS": _text_parameter([LengthUnit.MM.value]),
        "X_SCREEN": _text_parameter(["+X"]),
        "Y_SCREEN": _text_parameter([f"+{markers.up}"]),
    }
    if frame_count > MAX_STORED_COUNT:
        point_group["LONG_FRAMES"] = _float_parameter([frame_count])
    point_group |= _continued_parameter("LABELS", markers.names, _text_parameter)
    blanks = [""] * marker_count
    point_group |= _continued_parameter("DESCRIPTIONS", blanks, _text_parameter)
    groups = {
        "POINT": point_group,
        "ANALOG": {
            "USED": _integer_parameter([0]),
            "LABELS": _text_parameter([]),
            "GEN_SCALE": _float_parameter([1.0]),
            "RATE": _float_parameter([float(markers.clock.rate)]),
        },
        "TRIAL": {
            f"ACTUAL_{name}_FIELD": _integer_parameter([frame & 0xFFFF, frame >> 16])
            for name, frame in (("START", first), ("END", last))
        },
    }
    spans = _filled_spans(markers)
    if spans:
        groups[ANIMTOOL_GROUP] = _continued_parameter(
            "FILLED", np.array(spans), _float_parameter
        )
    section_bytes = b""
    for group_id, (name, parameters) in enumerate(groups.items(), 1):
        encoded_name = name.encode()
        section_bytes += struct.pack("<bb", len(encoded_name), -group_id) + encoded_name
        section_bytes += struct.pack("<HB", 3, 0)
        for key, body in parameters.items():
            encoded_name = key.encode()
            section_bytes += (
                struct.pack("<bb", len(encoded_name), group_id) + encoded_name
            )
            section_bytes += struct.pack("<H", len(body) + 3) + body + b"\0"
    return section_bytes + b"\0\0"


def _continued_parameter(
    name: str, entries: Any, encode: Callable[[Any], bytes]
) -> dict[str, bytes]:
    """Return the entries of a parameter and its continuations: NAME, NAME2, NAME3."""
    parameters = {}
    for number, begin in enumerate(range(0, len(entries), MAX_PARAMETER_ENTRIES), 1):
        key = name if number == 1 else f"{name}{number}"
        parameters[key] = encode(entries[begin : begin + MAX_PARAMETER_ENTRIES])
    return parameters


def _text_parameter(texts: Sequence[str]) -> bytes:
    encoded_texts = [text.encode("utf-8")[:MAX_NAME_BYTES] for text in texts]
    width = max((len(text) for text in encoded_texts), default=0)
    body = b"".join(text.ljust(width) for text in encoded_texts)
    return struct.pack("<bBBB", -1, 2, width, len(encoded_texts)) + body


def _integer_parameter(values: Sequence[int]) -> bytes:
    size = bytes([1, len(values)]) if len(values) > 1 else bytes([0])
    return b"\x02" + size + struct.pack(f"<{len(values)}H", *values)


def _float_parameter(values: Sequence[float] | FloatArray) -> bytes:
    array = np.asarray(values, "<f4")
    sizes = array.shape[::-1] if array.size > 1 else ()
    return b"\x04" + bytes([len(sizes), *sizes]) + array.tobytes()


def _filled_spans(markers: Markers) -> list[tuple[int, int, int]]:
    """Return marker index, first and last frame of every filled span, from 0."""
    if markers.filled is None:
        return []
    spans = []
    for marker in np.flatnonzero(markers.filled.any(axis=0)).tolist():
        marker_spans = runs(markers.filled[:, marker])
        spans += [(marker, first, stop - 1) for first, stop in marker_spans]
    return spans


def _file_chunks(markers: Markers, header_bytes: bytes) -> Iterator[bytes]:
    yield header_bytes
    written_bytes = len(header_bytes)
    for begin in range(0, len(markers), BLOCK_FRAMES):
        frame_bytes = _frame_rows(markers, slice(begin, begin + BLOCK_FRAMES))
        written_bytes += len(frame_bytes)
        yield frame_bytes
    # If the header cannot store the number of frames, readers derive it from the file
    # size; zeros up to a full block would become frames.
    if len(markers) < MAX_STORED_COUNT:
        yield b"\0" * (-written_bytes % BLOCK_BYTES)


def _frame_rows(markers: Markers, frames: slice) -> bytes:
    positions = markers.positions[frames] * 1000.0
    is_visible = np.asarray((np.abs(positions) <= FLOAT32_MAX).all(axis=-1))
    words = np.zeros(is_visible.shape, np.int64)
    if markers.residuals is not None:
        steps = markers.residuals[frames] * 1000.0 / abs(_residual_scale(markers))
        is_finite = np.isfinite(steps)
        residual_steps = np.rint(np.where(is_finite, steps, 0.0)).astype(np.int64)
        words += np.where(is_finite, np.clip(residual_steps, 1, RESIDUAL_STEPS), 0)
    if markers.cameras is not None:
        camera_counts = np.clip(markers.cameras[frames], 0, MAX_CAMERAS_PER_POINT)
        words += ((1 << camera_counts.astype(np.int64)) - 1) << 8
    if markers.filled is not None:
        words[markers.filled[frames]] = 0
    words[~is_visible] = -1
    values = np.where(is_visible[..., None], positions, 0.0)
    return np.concatenate([values, words[..., None]], -1).astype("<f4").tobytes()


def _data_loss_notice(markers: Markers, path: str) -> list[Fault]:
    """Return warnings about data that C3D cannot store."""
    lost_contents = []
    if markers.cameras is not None and (markers.cameras > MAX_CAMERAS_PER_POINT).any():
        max_camera_count = int(markers.cameras.max())
        lost_contents.append(
            f"more than {MAX_CAMERAS_PER_POINT} cameras per point, here up to "
            f"{max_camera_count}"
        )
    if markers.clock.start.denominator != 1 or markers.clock.start < 0:
        lost_contents.append(f"the first frame {markers.clock.start}")
    is_out_of_range = (np.abs(markers.positions) * 1000.0 > FLOAT32_MAX).any(axis=-1)
    if is_out_of_range.any():
        count = counted(int(is_out_of_range.sum()), "position")
        lost_contents.append(f"{count} beyond float32 in mm, written as not seen")
    if not lost_contents:
        return []
    message = f"a C3D cannot hold {' and '.join(lost_contents)}"
    hint = "write .npz to keep it"
    return [Fault("C3D104", message, path, (), hint, Severity.WARNING)]

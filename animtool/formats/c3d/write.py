"""C3D writer: marker trajectories to a file."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.clock import Clock
from animtool.core.errors import Fault, OptionError, Severity, counted
from animtool.core.units import LengthUnit
from animtool.formats.c3d.read import ANIMTOOL_GROUP
from animtool.formats.c3d.sections import BLOCK, MAGIC, Processor
from animtool.formats.trajectories import FLOAT32_MAX
from animtool.maths.runs import runs
from animtool.motion.markers import Markers

# Entries of a parameter: its dimensions are single bytes.
MAX_ENTRIES = 255
MAX_NAME = 255
# Header and parameters count in 16 bits.
MAX_COUNT = 65535
MAX_CAMERAS = 7
# Bytes before the parameters: which block they begin in, blocks and the processor.
_HEAD = 4
# Blocks of parameters are counted in a byte.
MAX_BLOCKS = 255
# Steps of a residual, which is a byte; 0 says that a point was not measured.
RESIDUAL_STEPS = 255
# What integers of the format could hold: the scale that readers expect of floats.
INTEGER_RANGE = 32000
FRAMES_AT_ONCE = 4096
# Samples of an analogue channel in a frame, of which there are none: readers hold this
# number against the rates.
ANALOG_SAMPLES = 1


def write_c3d(
    markers: Markers, path: Path | str, *, overwrite: bool = False
) -> list[Fault]:
    """Write markers as a C3D file of Intel floats, in millimetres.

    Residuals are kept to a 255th of the largest, cameras as their number up to seven.
    Filled positions have a residual of 0, as the format says, and are listed in the
    group ``ANIMTOOL``, so that reading the file gives them back. Longer takes than
    65535 frames have their length in ``TRIAL:ACTUAL_END_FIELD`` and
    ``POINT:LONG_FRAMES``, as usual.

    Args:
        markers: What to write.
        path: ``.c3d``.
        overwrite: Replace a file that exists.

    Returns:
        What the format cannot hold.

    Raises:
        OptionError: The file exists (OUT001), or the format cannot hold so many
            markers or such names (C3D010).
        OutputError: The file cannot be written (OUT002).
    """
    from animtool.core.files.output import check_outputs, write_parts

    path = Path(path)
    check_outputs([path], [], overwrite=overwrite)
    head = _head(markers, path)
    write_parts(path, _parts(markers, head))
    return _lost(markers, str(path))


def _head(markers: Markers, path: Path) -> bytes:
    """Return header and parameters."""
    frames, count = markers.positions.shape[:2]
    blocks = 1
    # Where the data begin is a parameter itself.
    section = _parameters(markers, 2 + blocks)
    blocks = -(-(_HEAD + len(section)) // BLOCK)
    if count > MAX_COUNT or blocks > MAX_BLOCKS or frames == 0 or count == 0:
        message = f"a C3D holds 1 to {MAX_COUNT} markers with 130000 bytes of names, "
        message += f"and at least one frame, not {count} in {frames} frames"
        raise OptionError(Fault("C3D010", message, str(path), (), "write .npz"))
    section = _parameters(markers, 2 + blocks)
    first, last = _shown(markers.clock)
    scale = _scale(markers)
    header = bytes([2, MAGIC]) + struct.pack("<5H", count, 0, first, last, 0)
    rate = float(markers.clock.rate)
    header += struct.pack("<fHHf", scale, 2 + blocks, ANALOG_SAMPLES, rate)
    text = bytes([1, MAGIC, blocks, int(Processor.INTEL)]) + section
    return header.ljust(BLOCK, b"\0") + text.ljust(BLOCK * blocks, b"\0")


def _shown(clock: Clock) -> tuple[int, int]:
    """Return the first and last frame number, clamped to the header's range."""
    first, last = _fields(clock)
    if last <= MAX_COUNT:
        return first, last
    return 1, min(clock.count, MAX_COUNT)


def _fields(clock: Clock) -> tuple[int, int]:
    first = int(clock.start) if clock.start.denominator == 1 else 1
    first = first if 0 <= first < 2**31 else 1
    return first, first + clock.count - 1


def _scale(markers: Markers) -> float:
    """Return the scale [mm], negative for floats: the unit of residuals."""
    residuals = markers.residuals
    if residuals is not None and np.nanmax(residuals, initial=0.0) > 0:
        return -float(np.nanmax(residuals)) * 1000.0 / RESIDUAL_STEPS
    sizes = np.abs(markers.positions) * 1000.0
    largest = np.nanmax(np.where(sizes <= FLOAT32_MAX, sizes, 0.0), initial=0.0)
    return -max(float(largest), 1.0) / INTEGER_RANGE


def _parameters(markers: Markers, data_block: int) -> bytes:
    """Return the parameter section without its first four bytes."""
    frames, count = markers.positions.shape[:2]
    first, last = _fields(markers.clock)
    shown = min(frames, MAX_COUNT)
    right, up = ("+X", f"+{markers.up}")
    point: dict[str, bytes] = {
        "USED": _integers([count]),
        "SCALE": _floats([_scale(markers)]),
        "RATE": _floats([float(markers.clock.rate)]),
        "DATA_START": _integers([data_block]),
        "FRAMES": _integers([shown]),
        "UNITS": _texts([LengthUnit.MM.value]),
        "X_SCREEN": _texts([right]),
        "Y_SCREEN": _texts([up]),
    }
    if frames > MAX_COUNT:
        point["LONG_FRAMES"] = _floats([frames])
    point.update(_numbered("LABELS", [_texts(n) for n in _chunks(markers.names)]))
    blank = [""] * count
    point.update(_numbered("DESCRIPTIONS", [_texts(n) for n in _chunks(blank)]))
    groups = {
        "POINT": point,
        "ANALOG": {
            "USED": _integers([0]),
            "LABELS": _texts([]),
            "GEN_SCALE": _floats([1.0]),
            "RATE": _floats([float(markers.clock.rate)]),
        },
        "TRIAL": {
            f"ACTUAL_{name}_FIELD": _integers([field & 0xFFFF, field >> 16])
            for name, field in (("START", first), ("END", last))
        },
    }
    spans = filled_spans(markers)
    if spans:
        rows = [
            _floats(np.array(spans[i : i + MAX_ENTRIES]))
            for i in range(0, len(spans), MAX_ENTRIES)
        ]
        groups[ANIMTOOL_GROUP] = _numbered("FILLED", rows)
    out = b""
    for number, (name, entries) in enumerate(groups.items(), 1):
        raw = name.encode()
        out += struct.pack("<bb", len(raw), -number) + raw + struct.pack("<HB", 3, 0)
        for key, body in entries.items():
            raw = key.encode()
            out += struct.pack("<bb", len(raw), number) + raw
            out += struct.pack("<H", len(body) + 3) + body + b"\0"
    return out + b"\0\0"


def _numbered(name: str, values: Sequence[bytes]) -> dict[str, bytes]:
    """Return a parameter and its continuations: NAME, NAME2, NAME3."""
    return {
        name if i == 0 else f"{name}{i + 1}": value for i, value in enumerate(values)
    }


def _chunks(texts: Sequence[str]) -> list[Sequence[str]]:
    return [texts[i : i + MAX_ENTRIES] for i in range(0, len(texts), MAX_ENTRIES)]


def _texts(texts: Sequence[str]) -> bytes:
    raw = [text.encode("utf-8")[:MAX_NAME] for text in texts]
    width = max((len(text) for text in raw), default=0)
    body = b"".join(text.ljust(width) for text in raw)
    return struct.pack("<bBBB", -1, 2, width, len(raw)) + body


def _integers(values: Sequence[int]) -> bytes:
    size = bytes([1, len(values)]) if len(values) > 1 else bytes([0])
    return b"\x02" + size + struct.pack(f"<{len(values)}H", *values)


def _floats(values: Sequence[float] | FloatArray) -> bytes:
    array = np.asarray(values, "<f4")
    sizes = array.shape[::-1] if array.size > 1 else ()
    return b"\x04" + bytes([len(sizes), *sizes]) + array.tobytes()


def filled_spans(markers: Markers) -> list[tuple[int, int, int]]:
    """Return marker, first and last frame of every filled span, from 0."""
    if markers.filled is None:
        return []
    spans = []
    for marker in np.flatnonzero(markers.filled.any(axis=0)).tolist():
        spans_of_marker = runs(markers.filled[:, marker])
        spans += [(marker, first, end - 1) for first, end in spans_of_marker]
    return spans


def _parts(markers: Markers, head: bytes) -> Iterator[bytes]:
    yield head
    size = len(head)
    for begin in range(0, len(markers), FRAMES_AT_ONCE):
        part = _rows(markers, slice(begin, begin + FRAMES_AT_ONCE))
        size += len(part)
        yield part
    # Readers take the size for the number of frames where the header has no room for
    # it: zeros up to a full block would be frames.
    if len(markers) < MAX_COUNT:
        yield b"\0" * (-size % BLOCK)


def _rows(markers: Markers, frames: slice) -> bytes:
    positions = markers.positions[frames] * 1000.0
    visible = np.asarray((np.abs(positions) <= FLOAT32_MAX).all(axis=-1))
    words = np.zeros(visible.shape, np.int64)
    if markers.residuals is not None:
        steps = markers.residuals[frames] * 1000.0 / abs(_scale(markers))
        known = np.isfinite(steps)
        low = np.rint(np.where(known, steps, 0.0)).astype(np.int64)
        words += np.where(known, np.clip(low, 1, RESIDUAL_STEPS), 0)
    if markers.cameras is not None:
        some = np.clip(markers.cameras[frames], 0, MAX_CAMERAS).astype(np.int64)
        words += ((1 << some) - 1) << 8
    if markers.filled is not None:
        words[markers.filled[frames]] = 0
    words[~visible] = -1
    values = np.where(visible[..., None], positions, 0.0)
    return np.concatenate([values, words[..., None]], -1).astype("<f4").tobytes()


def _lost(markers: Markers, path: str) -> list[Fault]:
    """Return warnings about data that C3D cannot hold."""
    lost = []
    if markers.cameras is not None and (markers.cameras > MAX_CAMERAS).any():
        lost.append(f"a point has more than {MAX_CAMERAS} cameras")
    if markers.clock.start.denominator != 1 or markers.clock.start < 0:
        lost.append(f"the first frame {markers.clock.start}")
    beyond = (np.abs(markers.positions) * 1000.0 > FLOAT32_MAX).any(axis=-1)
    if beyond.any():
        count = counted(int(beyond.sum()), "position")
        lost.append(f"{count} beyond float32 in mm, written as not seen")
    if not lost:
        return []
    message = f"a C3D cannot hold {' and '.join(lost)}"
    return [Fault("C3D104", message, path, (), "write .npz", Severity.WARNING)]

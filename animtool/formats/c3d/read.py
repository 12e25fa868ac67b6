"""A C3D file as marker trajectories."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np

from animtool._types import BoolArray, FloatArray, IntArray
from animtool.clock import Clock
from animtool.errors import counted, listed
from animtool.files import MAX_INPUT_BYTES, open_input
from animtool.formats.c3d.sections import (
    BLOCK,
    MalformedError,
    Sections,
    read_sections,
)
from animtool.formats.trajectories import MAX_POSITIONS, MarkerFile
from animtool.markers import Markers
from animtool.rates import FractionLike
from animtool.units import LengthUnit, UpAxis

# Counts in 16 bits: a take may be longer where one of these is stated.
FULL_COUNTS = (32767, 65535)
# Groups of labels under which models write angles and forces as if they were points.
MODELLED = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS", "REACTIONS")
# The group in which `write_c3d` keeps which positions were filled.
OWN_GROUP = "ANIMTOOL"


def read_c3d(
    path: Path | str,
    *,
    unit: LengthUnit | None = None,
    up: UpAxis | None = None,
    fps: FractionLike | None = None,
    subject: str | None = None,
) -> Markers:
    """Return the markers of a C3D file.

    Integer and float files of Intel, DEC and SGI processors are read, and more than 255
    labels. Results of models (angles, forces) are left out. A point with a negative
    residual, at exactly the origin or with a NaN was not seen.

    Args:
        path: The file.
        unit: What its numbers are in; None is what it states, millimetres without.
        up: Which of its axes points up; None is what it states, Y without.
        fps: The frame rate, where the file states a wrong one or none.
        subject: Whose prefix, as in ``Anna:LFHD``, is left out of names; None is the
            only one, where there is only one.

    Raises:
        FormatError: It cannot be read, is no C3D (C3D001), is cut short (C3D002),
            states no rate (MKR010) or an unknown unit (MKR011), or has no points
            (MKR013).
        OptionError: fps is no rate (SCN022).
    """
    path = Path(path)
    file = MarkerFile(str(path))
    with open_input(path, MAX_INPUT_BYTES) as opened:
        data = opened.whole()
    try:
        sections = read_sections(data)
    except MalformedError as error:
        raise file.error("C3D001", str(error)) from None
    layout = _layout(file, sections, len(data))
    length = file.unit(_unit(sections), unit, LengthUnit.MM)
    rate = file.rate(_rate(file, sections, fps), fps)
    axis = file.up(_up(sections), up)
    positions, words = _points(sections, layout, data)
    names, kept = _names(file, sections, layout.points, subject)
    positions, words = positions[:, kept], words[:, kept]
    positions[words < 0] = np.nan
    positions = file.cleaned(positions, length.meters)
    seen = np.isfinite(positions[..., 0])
    scale = abs(_scale(sections)) * length.meters
    clock = Clock(rate, Fraction(layout.first), Fraction(1), layout.frames)
    return Markers(
        names,
        clock,
        positions,
        axis,
        _cameras(words, seen),
        _residuals(words, seen, scale),
        _filled(sections, words, seen, kept),
        tuple(file.notices),
    )


@dataclass(frozen=True, slots=True)
class _Layout:
    """Where the points of a file are."""

    begin: int  # byte of the first frame
    frames: int
    points: int
    analog: int  # numbers behind the points of a frame
    first: int  # number of the first frame
    width: int  # bytes of a number

    @property
    def row(self) -> int:
        """Numbers of a frame."""
        return 4 * self.points + self.analog


def _layout(file: MarkerFile, sections: Sections, size: int) -> _Layout:
    """Return the layout, held against the size of the file [byte]."""
    header = sections.header
    points = header.points
    used = sections.number("POINT", "USED")
    if used is not None and int(used) & 0xFFFF != points:
        message = f"its header has {points} points, its parameters {int(used)}"
        file.warn("C3D101", f"{message}; those of the parameters are read")
        points = int(used) & 0xFFFF
    frames, first = _frames(file, sections)
    if points == 0 or frames <= 0:
        what = "points" if points == 0 else "frames"
        raise file.error("MKR013", f"has no {what}")
    if points * frames > MAX_POSITIONS:
        message = f"claims {points} points in {frames} frames, more than are read"
        raise file.error("C3D001", message)
    width = 4 if _scale(sections) < 0 else 2
    block = header.data_block
    if block < 2:
        block = int(sections.number("POINT", "DATA_START") or 0) & 0xFFFF
    begin = BLOCK * (block - 1)
    row = width * (4 * points + header.analog)
    held = max(0, size - begin) // row if block >= 2 else 0
    if held < frames:
        message = f"is cut short: it claims {counted(frames, 'frame')} of "
        message += f"{counted(points, 'point')} and holds {held}"
        raise file.error("C3D002", message, "copy or export it again")
    return _Layout(begin, frames, points, header.analog, first, width)


def _frames(file: MarkerFile, sections: Sections) -> tuple[int, int]:
    """Return the number of frames, and the number of the first one."""
    header = sections.header
    first, count = header.first, header.last - header.first + 1
    start, end = (
        _long(sections.numbers("TRIAL", f"ACTUAL_{name}_FIELD"))
        for name in ("START", "END")
    )
    stated = sections.number("POINT", "FRAMES")
    longer = sections.number("POINT", "LONG_FRAMES")
    if start is not None and end is not None and end - start + 1 > count:
        return end - start + 1, start
    if longer is not None and np.isfinite(longer) and longer > count:
        return int(longer), first
    if stated is not None and np.isfinite(stated):
        in_parameters = int(stated) if stated > 65535 else int(stated) & 0xFFFF
        if in_parameters > 65535:
            return in_parameters, first
        if in_parameters != count and in_parameters not in (0, *FULL_COUNTS):
            message = f"its header has {count} frames, its parameters {in_parameters}"
            file.warn("C3D101", f"{message}; those of the header are read")
    return count, first


def _long(words: list[float]) -> int | None:
    """Return a number that is stored as two 16-bit words, the low one first."""
    if not words or not all(np.isfinite(words)):
        return None
    low, high = ([*words, 0.0])[:2]
    return (int(low) & 0xFFFF) + ((int(high) & 0xFFFF) << 16)


def _scale(sections: Sections) -> float:
    """Return the scale of integers; below 0 numbers are floats."""
    stated = sections.number("POINT", "SCALE")
    found = sections.header.scale if stated is None else stated
    return found if np.isfinite(found) and found != 0 else -1.0


def _rate(
    file: MarkerFile, sections: Sections, fps: FractionLike | None
) -> float | None:
    """Return the stated rate; that of the parameters comes before the header's."""
    header, stated = sections.header.rate, sections.number("POINT", "RATE")
    if not stated or not np.isfinite(stated):
        return header
    if fps is None and header > 0 and not np.isclose(header, stated, rtol=1e-4):
        message = f"its header has {header:g} fps, its parameters {stated:g}"
        file.warn("C3D101", f"{message}; those of the parameters are taken")
    return stated


def _unit(sections: Sections) -> str | None:
    found = sections.texts("POINT", "UNITS")
    return found[0] if found else None


def _up(sections: Sections) -> UpAxis | None:
    """Return the axis that points up on a screen."""
    found = sections.texts("POINT", "Y_SCREEN")
    axis = found[0].upper().lstrip("+") if found else ""
    return UpAxis(axis) if axis in {"Y", "Z"} else None


def _points(
    sections: Sections, layout: _Layout, data: bytes
) -> tuple[FloatArray, IntArray]:
    """Return positions ``(F, M, 3)`` in the file's unit, and the fourth words."""
    size = layout.width * layout.row * layout.frames
    raw = data[layout.begin : layout.begin + size]
    processor = sections.processor
    numbers: FloatArray | IntArray
    numbers = processor.floats(raw) if layout.width == 4 else processor.integers(raw)
    rows = numbers.reshape(layout.frames, layout.row)[:, : 4 * layout.points]
    rows = rows.reshape(layout.frames, layout.points, 4)
    positions = np.array(rows[..., :3], np.float64)
    if layout.width == 2:
        positions *= _scale(sections)
    last = rows[..., 3].astype(np.float64)
    usable = np.isfinite(last) & (np.abs(last) < 2**31)
    # A sign in the last word alone says that a point was not seen.
    words = np.where(usable, last, np.where(last < 0, -1.0, 0.0)).astype(np.int64)
    words[last < 0] = -1
    return positions, words


def _names(
    file: MarkerFile, sections: Sections, points: int, subject: str | None
) -> tuple[tuple[str, ...], IntArray]:
    """Return names of markers, and which points they are: models' are left out."""
    labels = sections.texts("POINT", "LABELS")
    if len(labels) < points:
        message = f"names {len(labels)} of {counted(points, 'point')}"
        file.warn("C3D102", f"{message}; the others are points without label")
    labels = [*labels[:points], *[""] * (points - len(labels))]
    modelled = {
        label for group in MODELLED for label in sections.texts("POINT", group) if label
    }
    kept = np.array([i for i, name in enumerate(labels) if name not in modelled])
    if len(kept) < points:
        left_out = [name for name in labels if name in modelled]
        message = f"{counted(len(left_out), 'result')} of models left out: "
        file.note("C3D103", message + listed(left_out))
    if not len(kept):
        raise file.error("MKR013", "has no points that are markers")
    return file.names([labels[i] for i in kept.tolist()], subject), kept


def _cameras(words: IntArray, seen: BoolArray) -> IntArray | None:
    """Return from how many of seven cameras each position is, where that is stated."""
    mask = np.where(seen, (words >> 8) & 0x7F, 0)
    if not mask.any():
        return None
    return sum(((mask >> bit) & 1 for bit in range(7)), np.zeros_like(mask))


def _residuals(words: IntArray, seen: BoolArray, scale: float) -> FloatArray | None:
    """Return residuals [m]; one of 0 says that the position was not measured."""
    low = words & 0xFF
    measured = seen & (low > 0)
    return np.where(measured, low * scale, np.nan) if measured.any() else None


def _filled(
    sections: Sections, words: IntArray, seen: BoolArray, kept: IntArray
) -> BoolArray | None:
    """Return which positions were not measured.

    Our own group says it; else the format does, with a residual and cameras of 0 in
    a file that has others.
    """
    own = sections.groups.get(OWN_GROUP)
    if own is not None:
        return _own_filled(sections, seen, kept)
    if not (seen & (words > 0)).any():
        return None
    filled = seen & (words == 0)
    return filled if filled.any() else None


def _own_filled(
    sections: Sections, seen: BoolArray, kept: IntArray
) -> BoolArray | None:
    filled = np.zeros(seen.shape, bool)
    columns = {point: column for column, point in enumerate(kept.tolist())}
    number = 1
    while True:
        key = "FILLED" if number == 1 else f"FILLED{number}"
        rows = np.array(sections.numbers(OWN_GROUP, key))
        if not len(rows):
            break
        for marker, first, last in rows[: len(rows) // 3 * 3].reshape(-1, 3):
            if np.isfinite([marker, first, last]).all() and marker in columns:
                begin = int(min(max(first, 0), len(seen)))
                end = int(min(max(last + 1, 0), len(seen)))
                filled[begin:end, columns[int(marker)]] = True
        number += 1
    filled &= seen
    return filled if filled.any() else None

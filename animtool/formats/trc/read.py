"""A TRC file as marker trajectories."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np

from animtool.core.clock import Clock
from animtool.core.errors import Fault, FormatError, counted
from animtool.core.rates import FractionLike
from animtool.core.units import LengthUnit, UpAxis
from animtool.formats.delimited import Rows, gather_rows, read_lines
from animtool.formats.trajectories import MAX_POSITIONS, MarkerFile
from animtool.formats.trc.header import (
    MAX_MARKERS,
    TrcHeader,
    columns_of,
    read_header,
)
from animtool.formats.trc.timing import frames_of_rows
from animtool.motion.markers import Markers


def read_trc(
    path: Path | str,
    *,
    unit: LengthUnit | None = None,
    up: UpAxis | None = None,
    fps: FractionLike | None = None,
    subject: str | None = None,
) -> Markers:
    """Return the markers of a TRC file; an empty cell or NaN was not seen.

    Cells are separated by tabs, semicolons, commas or blanks. Columns beyond those with
    names are points without label. The Time of rows decides when they are, where
    DataRate or Frame# say otherwise; frames without a row have no position. Rows at
    uneven times become even by straight lines between them.

    Args:
        path: The file.
        unit: What its numbers are in; None is what it states, millimetres without.
        up: Which of its axes points up; None is Y, as OpenSim takes it.
        fps: The frame rate, where the file has a wrong one or none: rows are then at
            the frames of Frame#, and Time is not read.
        subject: Whose prefix is left out of names, as `read_c3d` does.

    Raises:
        FormatError: It cannot be read, is no TRC (TRC001), has a row that is none
            (TRC002) or times that do not grow (TRC003), states no rate (MKR010) or an
            unknown unit (MKR011), or has no markers or frames (MKR013).
        OptionError: fps is no rate (SCN022).
    """
    path = Path(path)
    file = MarkerFile(str(path))
    lines = read_lines(path)
    header = read_header(file, lines)
    rows = gather_rows(lines, header.begin, header.separator)
    names = _names(file, header, rows)
    rows = _whole_rows(file, rows, len(lines) if lines[-1] else 0, 2 + 3 * len(names))

    def fault(message: str, line: int) -> FormatError:
        return FormatError(Fault("TRC002", message, file.path, (line,)))

    if len(rows.texts) * len(names) > MAX_POSITIONS:
        raise file.error("TRC001", "has more positions than are read")
    decimals = rows.decimals(1)
    values = rows.values(2 + 3 * len(names), fault)
    if rows.decimal_commas:
        message = "numbers have commas in place of points: read as decimal"
        file.note("TRC108", message, "export it with points, as other programs read it")
    length = file.unit(header.unit, unit, LengthUnit.MM)
    axis = file.up(None, up)
    if header.frames not in (None, len(values)):
        message = f"states {header.frames:g} frames and has {len(values)}"
        file.warn("TRC101", f"{message}; all that it has are read")
    positions = values[:, 2:].reshape(len(values), -1, 3).copy()
    labels = file.names(names, subject)
    positions = file.cleaned(positions, length.meters)
    frames = frames_of_rows(
        file, values[:, :2], rows.lines, decimals, header.rate, fps, len(names)
    )
    positions = frames.placed(positions)
    clock = Clock(frames.rate, Fraction(frames.start), Fraction(1), len(positions))
    notices = tuple(file.notices)
    return Markers(labels, clock, positions, axis, notices=notices, begin=frames.begin)


def _names(file: MarkerFile, header: TrcHeader, rows: Rows) -> list[str]:
    """Return the names of the markers that rows have, empty where one has none."""
    if not rows.texts:
        if not header.names:
            raise file.error("MKR013", "has no markers")
        raise file.error("MKR013", "has no frames")
    most = int(rows.filled.max())
    names, unnamed = columns_of(file, header, most)
    if not names:
        raise file.error("MKR013", "has no markers")
    wide = rows.filled > 2 + 3 * len(header.names)
    # A cell at the end may be closed by a separator.
    ragged = ((rows.filled - 2) % 3 != 0) & ((rows.cells - 2) % 3 != 0)
    ragged &= (rows.cells == rows.filled) | ((rows.cells - 3) % 3 != 0)
    wrong = np.flatnonzero(wide & ragged)
    if len(wrong) or len(names) > MAX_MARKERS:
        row = int(wrong[0]) if len(wrong) else int(rows.filled.argmax())
        message = f"has {int(rows.filled[row])} values and not {2 + 3 * len(names)}"
        if len(wrong):
            message = f"has {int(rows.filled[row])} values, and "
            message += f"{counted(len(header.names), 'marker')} with a name have "
            message += str(2 + 3 * len(header.names))
        hint = None
        if header.separator == b"," and not any(b"." in text for text in rows.texts):
            hint = "decimal commas between commas: export with tabs or with points"
        at = (int(rows.lines[row]),)
        raise FormatError(Fault("TRC002", message, file.path, at, hint))
    if unnamed:
        first = next(i for i, name in enumerate(names) if not name)
        message = (
            f"{unnamed} of {counted(len(names), 'marker')} without a name, the first "
            f"in column {3 + 3 * first}"
        )
        if wide.any() and not wide.all():
            lines = rows.lines[wide]
            message += f", in {counted(len(lines), 'row')} from line {lines[0]}"
        hint = "mocap label gives points the names of markers"
        file.warn("TRC103", f"{message}: points without label", hint)
    return names


def _whole_rows(file: MarkerFile, rows: Rows, unended: int, width: int) -> Rows:
    """Return rows without one that the file's end cuts; warn of those cut (TRC109).

    unended: The line that the file ends in without an end of line, 0 without.
    """
    short = (rows.cells < width) & (rows.filled > 1)
    cut = np.flatnonzero(short & (rows.cells == rows.filled) & (rows.cells % 3 != 2))
    last = len(rows.texts) - 1
    # Where others are short too, a row that ends behind a marker is no cut one.
    within = len(cut) > 0 and int(cut[-1]) == last
    alone = bool(short[last]) and int(short.sum()) == 1
    dropped = last > 0 and rows.lines[last] == unended and (within or alone)
    if not len(cut) and not dropped:
        return rows
    row = last if dropped else int(cut[0])
    message = f"has {int(rows.cells[row])} values of {width}"
    if dropped:
        message += ", as the file ends there: the row is left out"
    else:
        more = counted(len(cut) - 1, "other row")
        message += f", and ends within a marker, which is not seen there; {more} alike"
    file.warn("TRC109", message, "copy or export it again", int(rows.lines[row]))
    return rows.without_last() if dropped else rows

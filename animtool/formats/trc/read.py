"""Reads marker trajectories from TRC files."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from animtool.core.errors import counted, excerpt
from animtool.core.files.signatures import expects_format
from animtool.core.rates import FractionLike
from animtool.core.record import dataclass
from animtool.core.units import LengthUnit, UpAxis
from animtool.formats.delimited import (
    BLANK_CHARACTERS,
    TextRows,
    decode_text,
    find_row_separator,
    find_separator,
    gather_rows,
    parse_number,
    read_lines,
    split_cells,
)
from animtool.formats.trajectories import MAX_POSITIONS, CaptureFile
from animtool.formats.trc.timing import find_row_frames
from animtool.motion.markers import Markers

MAX_MARKERS = 10_000
# Maximum header lines before the marker names.
MAX_HEADER_LINES = 12
_NAMES_PATTERN = re.compile(rb"[\s\"]*frame\s?#[\s\"]*?([\t;,]| )", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class TrcHeader:
    """Values and marker names that the header lines of a TRC file state."""

    data_rate: float | None  # DataRate [1/s]; None if it is not a number
    unit: str | None  # Units; None if missing
    frame_count: float | None  # NumFrames; None if it is not a number
    marker_count: float | None  # NumMarkers; None if it is not a number
    names: list[str]  # marker names in column order, empty for unnamed markers
    # Number of markers in the line of axes, X1 Y1 Z1; 0 if it is missing.
    axis_marker_count: int
    first_row_index: int  # line index of the first row
    separator: bytes  # separator of cells in rows


def read_header(file: CaptureFile, lines: list[bytes]) -> TrcHeader:
    """Return the header of a TRC file; raise without its required lines (TRC001)."""
    first_words = re.split(rb"[\s,;]+", lines[0].strip(BLANK_CHARACTERS + b'"'))
    if first_words[0].strip(b'"').lower() != b"pathfiletype":
        raise file.error("TRC001", "the first line does not start with PathFileType")
    name_matches = [_NAMES_PATTERN.match(line) for line in lines[:MAX_HEADER_LINES]]
    names_index = next((i for i, n in enumerate(name_matches) if n), 0)
    indices_above = [
        i for i in range(1, names_index) if lines[i].strip(BLANK_CHARACTERS)
    ]
    if len(indices_above) < 2:
        missing_line = (
            "DataRate line" if names_index else "line that starts with Frame#"
        )
        message = f"no {missing_line} in the first {MAX_HEADER_LINES} lines"
        raise file.error("TRC001", message)
    header_values = _header_values(lines[indices_above[-2]], lines[indices_above[-1]])
    name_match = name_matches[names_index]
    assert name_match is not None
    names = _read_marker_names(file, lines[names_index], name_match[1], names_index + 1)
    first_row_index, axis_marker_count = names_index + 1, 0
    # X1 Y1 Z1 follows the names, and sometimes an empty line.
    while first_row_index < len(lines) and _is_axis_heading(lines[first_row_index]):
        cells = lines[first_row_index].replace(b",", b" ").replace(b";", b" ").split()
        line_marker_count = sum(cell[:1] in b"Xx" for cell in cells)
        axis_marker_count = max(axis_marker_count, line_marker_count)
        first_row_index += 1
    first_row = lines[first_row_index] if first_row_index < len(lines) else b""
    return TrcHeader(
        parse_number(header_values.get("datarate")),
        header_values.get("units"),
        parse_number(header_values.get("numframes")),
        parse_number(header_values.get("nummarkers")),
        names,
        axis_marker_count,
        first_row_index,
        find_row_separator(first_row, name_match[1]),
    )


def _header_values(keys_line: bytes, values_line: bytes) -> dict[str, str]:
    """Return the header values by key in lower case."""
    separator = find_separator(keys_line)
    keys = [k for c in split_cells(keys_line, separator) for k in c.split() or [""]]
    values = split_cells(values_line, find_row_separator(values_line, separator))
    if len(values) < len(keys):
        cells = [text for value in values for text in value.split() or [""]]
        values = cells if len(cells) <= len(keys) else values
    lowercase_keys = [key.lower() for key in keys]
    units_index = (
        lowercase_keys.index("units") if "units" in lowercase_keys else len(values)
    )
    if (
        units_index < len(values) == len(keys) - 1
        and parse_number(values[units_index]) is not None
    ):
        values.insert(units_index, "")  # an empty unit between blanks has no cell
    return dict(zip(lowercase_keys, values, strict=False))


def _read_marker_names(
    file: CaptureFile, line: bytes, separator: bytes, line_number: int
) -> list[str]:
    """Return the marker names of a header line, each for one or three columns."""
    if separator == b" " and (line_separator := find_separator(line)) != b" ":
        separator = line_separator
    if separator == b" ":
        names = [decode_text(cell) for cell in line.split()[2:]]
    else:
        cells = split_cells(line.rstrip(b" " + separator), separator)
        names = cells[2::3]
        if any(cell for i, cell in enumerate(cells[2:]) if i % 3):
            names = [cell for cell in cells[2:] if cell]  # one column per name
            names = _strip_axis_suffixes(names) or names
    while names and not names[-1]:
        names.pop()
    if len(names) > MAX_MARKERS:
        message = f"the header names {len(names)} markers; the limit is {MAX_MARKERS}"
        raise file.error("TRC001", message, line=line_number)
    return names


def _strip_axis_suffixes(cells: list[str]) -> list[str]:
    """Return marker names of columns such as ``head_X``; else empty.

    >>> _strip_axis_suffixes(["Hip_X", "Hip_Y", "Hip_Z", "kneeX", "kneeY", "kneeZ"])
    ['Hip', 'knee']
    """
    names = [cell[:-1].rstrip("_-. :") for cell in cells]
    axes = [cell[-1:].upper() for cell in cells]
    is_triples = len(cells) % 3 == 0 and axes == list("XYZ") * (len(cells) // 3)
    if not is_triples or names[::3] != names[1::3] or names[::3] != names[2::3]:
        return []
    return names[::3]


def _is_axis_heading(line: bytes) -> bool:
    """Return whether a line is blank or names the axes, ``X1 Y1 Z1``."""
    text = line.strip(BLANK_CHARACTERS)
    return not text or text[:1].upper() in {b"X", b"Y", b"Z"}


def _match_columns(file: CaptureFile, header: TrcHeader, cell_count: int) -> list[str]:
    """Return marker names for the columns of the rows, empty for unnamed markers.

    Warns if the header states another count (TRC101). ``cell_count`` is the number of
    cells of the longest row, up to the last nonempty one.
    """
    names, stated_count = header.names, header.marker_count
    column_marker_count = max(0, -(-(cell_count - 2) // 3))
    if header.axis_marker_count == stated_count:
        column_marker_count = max(column_marker_count, header.axis_marker_count)
    if len(names) > column_marker_count > 0 and column_marker_count == stated_count:
        if header.separator == b" ":
            message = f"the header has {len(names)} names, but rows have columns of "
            message += counted(column_marker_count, "marker")
            hint = "separate columns by tabs if names contain blanks: "
            raise file.error("TRC001", message, hint + excerpt(" ".join(names)))
        message = f"the header names {len(names)} markers, but rows have columns of "
        message += f"{column_marker_count}; the last names are ignored"
        file.warn("TRC101", message)
        names = names[:column_marker_count]
    count = max(len(names), column_marker_count)
    if stated_count is not None and stated_count not in (count, len(header.names)):
        message = f"the header states {stated_count:g} markers, but there are {count}"
        file.warn("TRC101", f"{message}; all are read")
    return [*names, *[""] * (count - len(names))]


@expects_format("TRC001", "a TRC file")
def read_trc(
    path: Path | str,
    *,
    unit: LengthUnit | None = None,
    up: UpAxis | None = None,
    fps: FractionLike | None = None,
    subject: str | None = None,
) -> Markers:
    """Return the markers of a TRC file; an empty cell or NaN is not visible.

    Cells are separated by tabs, semicolons, commas or blanks. Columns beyond those with
    names are unlabelled points. If DataRate or Frame# contradict the Time of rows, Time
    is used; frames without a row have no position. Rows at irregular times are
    resampled linearly.

    Args:
        path: The file.
        unit: Unit of the lengths; None is the stated unit, or millimetres.
        up: The up axis; None is Y, as in OpenSim.
        fps: The frame rate, if the file has a wrong one or none: rows are then at the
            frames of Frame#, and Time is ignored.
        subject: Subject whose prefix is removed from names, as in `read_c3d`.
    """
    path = Path(path)
    file = CaptureFile(str(path))
    lines = read_lines(path)
    header = read_header(file, lines)
    rows = gather_rows(lines, header.first_row_index, header.separator)
    names = _marker_names(file, header, rows)
    column_count = 2 + 3 * len(names)
    rows = _without_truncated_row(
        file, rows, len(lines) if lines[-1] else 0, column_count
    )
    if len(rows.texts) * len(names) > MAX_POSITIONS:
        raise file.error("TRC001", f"more than {MAX_POSITIONS:,} positions")
    decimals = rows.decimals(1)
    values = rows.values(
        column_count, lambda message, line: file.error("TRC002", message, line=line)
    )
    if rows.has_decimal_commas:
        hint = "export it with decimal points, which other programs need"
        file.note("TRC108", "commas are read as decimal points", hint)
    length_unit = file.choose_unit(header.unit, unit, LengthUnit.MM)
    up_axis = file.choose_up(None, up)
    if header.frame_count not in (None, len(values)):
        message = f"the header states {header.frame_count:g} frames, but there are "
        file.warn("TRC101", f"{message}{len(values)}; all are read")
    positions = values[:, 2:].reshape(len(values), -1, 3).copy()
    labels = file.unique_names(names, subject)
    positions = file.clean_positions(positions, length_unit.meters)
    row_frames = find_row_frames(
        file,
        values[:, :2],
        rows.line_numbers,
        decimals,
        header.data_rate,
        fps,
        len(names),
    )
    return row_frames.build_markers(file, labels, positions, up_axis)


def _marker_names(file: CaptureFile, header: TrcHeader, rows: TextRows) -> list[str]:
    """Return the marker names of the rows; warn about unnamed markers (TRC103)."""
    if not rows.texts:
        missing_noun = "frames" if header.names else "markers"
        raise file.error("MKR013", f"the file has no {missing_noun}")
    max_value_count = int(rows.value_counts.max())
    names = _match_columns(file, header, max_value_count)
    if not names:
        raise file.error("MKR013", "the file has no markers")
    is_too_wide = rows.value_counts > 2 + 3 * len(header.names)
    # The last cell may be followed by a separator.
    is_ragged = ((rows.value_counts - 2) % 3 != 0) & ((rows.cell_counts - 2) % 3 != 0)
    is_ragged &= (rows.cell_counts == rows.value_counts) | (rows.cell_counts % 3 != 0)
    ragged_rows = np.flatnonzero(is_too_wide & is_ragged)
    if len(ragged_rows) or len(names) > MAX_MARKERS:
        row = int(ragged_rows[0] if len(ragged_rows) else rows.value_counts.argmax())
        message = f"the row has {int(rows.value_counts[row])} values, not "
        message += str(2 + 3 * len(names))
        if len(ragged_rows):
            message = f"the row has {int(rows.value_counts[row])} values, but frame, "
            message += f"time and {counted(len(header.names), 'named marker')} take "
            message += str(2 + 3 * len(header.names))
        hint = None
        if header.separator == b"," and not any(b"." in text for text in rows.texts):
            hint = "commas separate both cells and decimals; export with tabs or points"
        raise file.error("TRC002", message, hint, int(rows.line_numbers[row]))
    unnamed_count = names.count("")
    if unnamed_count:
        first_index = names.index("")
        message = (
            f"{unnamed_count} of {counted(len(names), 'marker')} "
            f"{'has' if unnamed_count == 1 else 'have'} no name, the first in column "
            f"{3 + 3 * first_index}"
        )
        if is_too_wide.any() and not is_too_wide.all():
            lines = rows.line_numbers[is_too_wide]
            message += f", in {counted(len(lines), 'row')} from line {lines[0]}"
        hint = "name the points with mocap label"
        file.warn("TRC103", f"{message}; read as unlabelled points", hint)
    return names


def _without_truncated_row(
    file: CaptureFile, rows: TextRows, unterminated_line: int, column_count: int
) -> TextRows:
    """Return rows without a truncated last row, which is reported (TRC109).

    ``unterminated_line`` is the last line if it has no line end; otherwise 0.
    """
    is_short = (rows.cell_counts < column_count) & (rows.value_counts > 1)
    ends_in_marker = is_short & (rows.cell_counts == rows.value_counts)
    ends_in_marker &= rows.cell_counts % 3 != 2
    partial_indices = np.flatnonzero(ends_in_marker)
    last_index = len(rows.texts) - 1
    # A row that ends after a complete marker is not truncated if others are short too.
    is_incomplete = ends_in_marker[last_index] or (
        is_short[last_index] and is_short.sum() == 1
    )
    is_unterminated = rows.line_numbers[last_index] == unterminated_line
    is_truncated = last_index > 0 and is_unterminated and is_incomplete
    if not len(partial_indices) and not is_truncated:
        return rows
    row = last_index if is_truncated else int(partial_indices[0])
    count_text = f"{int(rows.cell_counts[row])} of {column_count} values"
    message = f"the last row is truncated ({count_text}) and is skipped"
    if not is_truncated:
        message = f"the row ends within a marker ({count_text}), which is missing there"
        if len(partial_indices) > 1:
            message += ", and so do "
            message += f"{counted(len(partial_indices) - 1, 'other row')}"
    file.warn("TRC109", message, "copy or export it again", int(rows.line_numbers[row]))
    return rows.without_last() if is_truncated else rows

"""The first lines of a TRC file: what they state, and the names of markers."""

from __future__ import annotations

import re
from dataclasses import dataclass

from animtool.core.errors import Fault, FormatError, excerpt
from animtool.formats.delimited import (
    BLANK,
    decoded,
    number_of,
    row_separator,
    separator_of,
    split_cells,
)
from animtool.formats.trajectories import MarkerFile

MAX_MARKERS = 10_000
# Lines within which the names of markers stand.
MAX_LINES = 12
_NAMES = re.compile(rb"[\s\"]*frame\s?#[\s\"]*?([\t;,]| )", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class TrcHeader:
    """What the first lines state.

    Attributes:
        rate: DataRate, None without a number [1/s].
        unit: Units, None where the key is missing.
        frames: NumFrames, None without a number.
        markers: NumMarkers, None without a number.
        names: Of markers in the order of their columns, empty where one has none.
        axes: Markers that the line of axes, X1 Y1 Z1, has; 0 where it is missing.
        begin: Index of the first line of numbers.
        separator: Between the cells of rows.
    """

    rate: float | None
    unit: str | None
    frames: float | None
    markers: float | None
    names: list[str]
    axes: int
    begin: int
    separator: bytes


def read_header(file: MarkerFile, lines: list[bytes]) -> TrcHeader:
    """Return what the first lines of a file state.

    Raises:
        FormatError: They are not those of a TRC (TRC001).
    """
    first = re.split(rb"[\s,;]+", lines[0].strip(BLANK + b'"'))[0].strip(b'"')
    if first.lower() != b"pathfiletype":
        raise file.error("TRC001", "does not begin with PathFileType")
    starts = [_NAMES.match(line) for line in lines[:MAX_LINES]]
    at = next((i for i, start in enumerate(starts) if start), 0)
    above = [i for i in range(1, at) if lines[i].strip(BLANK)]
    if len(above) < 2:
        what = "no line that begins with Frame#" if not at else "no line of DataRate"
        raise file.error("TRC001", f"has {what} in its first {MAX_LINES} lines")
    stated = _stated(lines[above[-2]], lines[above[-1]])
    start = starts[at]
    assert start is not None
    names = _names(file, lines[at], start[1], at + 1)
    begin, axes = at + 1, 0
    # Below the names stands X1 Y1 Z1, and sometimes an empty line.
    while begin < len(lines) and _is_heading(lines[begin]):
        cells = lines[begin].replace(b",", b" ").replace(b";", b" ").split()
        axes = max(axes, sum(cell[:1] in b"Xx" for cell in cells))
        begin += 1
    row = lines[begin] if begin < len(lines) else b""
    return TrcHeader(
        number_of(stated.get("datarate")),
        stated.get("units"),
        number_of(stated.get("numframes")),
        number_of(stated.get("nummarkers")),
        names,
        axes,
        begin,
        row_separator(row, start[1]),
    )


def _stated(above: bytes, below: bytes) -> dict[str, str]:
    """Return the values below keys, which have no blanks in them."""
    separator = separator_of(above)
    keys = [
        key for cell in split_cells(above, separator) for key in cell.split() or [""]
    ]
    values = split_cells(below, row_separator(below, separator))
    if len(values) < len(keys):
        apart = [each for value in values for each in value.split() or [""]]
        values = apart if len(apart) <= len(keys) else values
    lowered = [key.lower() for key in keys]
    unit = lowered.index("units") if "units" in lowered else len(values)
    if unit < len(values) == len(keys) - 1 and number_of(values[unit]) is not None:
        values.insert(unit, "")  # between blanks an empty unit is not seen
    return dict(zip(lowered, values, strict=False))


def _names(file: MarkerFile, line: bytes, separator: bytes, number: int) -> list[str]:
    """Return the names of markers, each over three columns or over one."""
    if separator == b" " and (other := separator_of(line)) != b" ":
        separator = other
    if separator == b" ":
        names = [decoded(cell) for cell in line.split()[2:]]
    else:
        cells = split_cells(line.rstrip(b" " + separator), separator)
        names = cells[2::3]
        if any(cell for i, cell in enumerate(cells[2:]) if i % 3):
            names = [cell for cell in cells[2:] if cell]  # one column a name
            names = _stems(names) or names
    while names and not names[-1]:
        names.pop()
    if len(names) > MAX_MARKERS:
        message = f"names {len(names)} markers, and {MAX_MARKERS} are read"
        raise FormatError(Fault("TRC001", message, file.path, (number,)))
    return names


def _stems(cells: list[str]) -> list[str]:
    """Return the names of columns called as their axis too; empty where they are not.

    >>> _stems(["Hip_X", "Hip_Y", "Hip_Z", "kneeX", "kneeY", "kneeZ"])
    ['Hip', 'knee']
    """
    names = [cell[:-1].rstrip("_-. :") for cell in cells]
    axes = [cell[-1:].upper() for cell in cells]
    whole = len(cells) % 3 == 0 and axes == list("XYZ") * (len(cells) // 3)
    if not whole or names[::3] != names[1::3] or names[::3] != names[2::3]:
        return []
    return names[::3]


def _is_heading(line: bytes) -> bool:
    """Return whether a line is not one of numbers."""
    word = line.strip(BLANK)
    return not word or word[:1].upper() in {b"X", b"Y", b"Z"}


def columns_of(
    file: MarkerFile, header: TrcHeader, filled: int
) -> tuple[list[str], int]:
    """Return the names of the markers that rows have, and how many had none.

    A count in the header that says otherwise is a warning (TRC101).

    filled: Cells of the longest row, up to the last that is not empty.
    """
    rows = max(0, -(-(filled - 2) // 3))
    names, stated = header.names, header.markers
    held = max(rows, header.axes if header.axes == stated else 0)
    if header.separator == b" " and len(names) > held > 0 and held == stated:
        message = f"names {len(names)} markers over the columns of {held}"
        hint = f"names between blanks have no blanks: {excerpt(' '.join(names))}"
        raise file.error("TRC001", message, hint)
    if len(names) > held > 0 and held == stated:
        message = f"names {len(names)} markers and has columns of {held}"
        file.warn("TRC101", f"{message}; the last names are left out")
        names = names[:held]
    count = max(len(names), held)
    if stated is not None and stated not in (count, len(header.names)):
        message = f"states {stated:g} markers and has {count}"
        file.warn("TRC101", f"{message}; all that it has are read")
    names = [*names, *[""] * (count - len(names))]
    return names, sum(not name for name in names)

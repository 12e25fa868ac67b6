"""TRC: marker trajectories as rows of text, as OpenSim and others read them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np

from animtool import _kernels
from animtool._types import FloatArray
from animtool.clock import Clock
from animtool.errors import Fault, FormatError, OptionError, Severity, excerpt
from animtool.files import MAX_INPUT_BYTES, read_input
from animtool.formats.trajectories import MAX_POSITIONS, MarkerFile
from animtool.markers import Markers
from animtool.rates import FractionLike
from animtool.units import LengthUnit, UpAxis

MAX_MARKERS = 10_000
# A micrometre in a thousand: below what any camera sees.
DECIMALS = 6
ROWS_AT_ONCE = 4096


def read_trc(
    path: Path | str,
    *,
    unit: LengthUnit | None = None,
    up: UpAxis | None = None,
    fps: FractionLike | None = None,
    subject: str | None = None,
) -> Markers:
    """Return the markers of a TRC file; an empty cell or NaN was not seen.

    Args:
        path: The file.
        unit: What its numbers are in; None is what it states, millimetres without.
        up: Which of its axes points up; None is Y, as OpenSim takes it.
        fps: The frame rate, where the file states a wrong one or none.
        subject: Whose prefix is left out of names, as `read_c3d` does.

    Raises:
        FormatError: It cannot be read, is no TRC (TRC001), has a row that is none
            (TRC002), states no rate (MKR010) or an unknown unit (MKR011), or has no
            markers or frames (MKR013).
        OptionError: fps is no rate (SCN022).
    """
    path = Path(path)
    file = MarkerFile(str(path))
    text = read_input(path, MAX_INPUT_BYTES).removeprefix(b"\xef\xbb\xbf")
    lines = text.replace(b"\r\n", b"\n").replace(b"\r", b"\n").split(b"\n")
    head = _head(file, lines)
    values = _rows(file, lines[head.rows :], head)
    rate = file.rate(head.rate, fps)
    length = file.unit(head.unit, unit, LengthUnit.MM)
    axis = file.up(None, up)
    if head.frames not in (None, len(values)):
        message = f"states {head.frames} frames and has {len(values)}"
        file.warn("TRC101", f"{message}; all that it has are read")
    positions = values[:, 2:].reshape(len(values), -1, 3).copy()
    names = file.names(head.names, subject)
    positions = file.cleaned(positions, length.meters)
    start = values[0, 0]
    first = int(start) if np.isfinite(start) and start == np.floor(start) else 1
    clock = Clock(rate, Fraction(first), Fraction(1), len(values))
    return Markers(names, clock, positions, axis, notices=tuple(file.notices))


@dataclass(frozen=True, slots=True)
class _Head:
    """What the first lines of a file state."""

    rate: float | None
    unit: str | None
    frames: int | None
    names: list[str]
    rows: int  # index of the first line of numbers


def _head(file: MarkerFile, lines: list[bytes]) -> _Head:
    texts = [_decoded(line) for line in lines[:12]]
    first = texts[0].split() if texts else []
    if not first or first[0].lower() != "pathfiletype":
        raise file.error("TRC001", "does not begin with PathFileType")
    at = next(
        (i for i, t in enumerate(texts) if t.lower().lstrip().startswith("frame#")), 0
    )
    if at < 2:
        message = "has no line that begins with Frame#"
        raise file.error("TRC001", message)
    keys, values = texts[at - 2].split("\t"), texts[at - 1].split("\t")
    stated = {
        key.strip().lower(): value.strip()
        for key, value in zip(keys, values, strict=False)
    }
    names = _named(file, texts[at], at + 1, stated)
    rate, frames = _number(stated.get("datarate")), _number(stated.get("numframes"))
    rows = at + 1
    # Below the names stands X1 Y1 Z1, and sometimes an empty line.
    while rows < len(lines) and _is_heading(lines[rows]):
        rows += 1
    whole = None if frames is None else int(frames)
    return _Head(rate, stated.get("units"), whole, names, rows)


def _named(file: MarkerFile, text: str, line: int, stated: dict[str, str]) -> list[str]:
    """Return the names of the markers, each over three columns."""
    cells = [cell.strip() for cell in text.rstrip("\t ").split("\t")]
    if len(cells) > 2 and cells[1].lower() == "time":
        names = cells[2::3]
        between = [cell for i, cell in enumerate(cells[2:]) if i % 3 and cell]
        if between:
            # Some write one column a name.
            names = [cell for cell in cells[2:] if cell]
    else:
        names = text.split()[2:]
    count = _number(stated.get("nummarkers"))
    if count is not None and 0 < count <= MAX_MARKERS and int(count) != len(names):
        message = f"states {int(count)} markers and names {len(names)}"
        file.warn("TRC101", message)
        names = [*names[: int(count)], *[""] * (int(count) - len(names))]
    if not names:
        raise file.error("MKR013", "has no markers")
    if len(names) > MAX_MARKERS:
        message = f"names {len(names)} markers, and {MAX_MARKERS} are read"
        raise FormatError(Fault("TRC001", message, file.path, (line,)))
    return names


def _is_heading(line: bytes) -> bool:
    """Return whether a line is not one of numbers."""
    word = line.split(None, 1)[:1]
    if not word:
        return True
    return word[0][:1].upper() in {b"X", b"Y", b"Z"}


def _rows(file: MarkerFile, lines: list[bytes], head: _Head) -> FloatArray:
    """Return the rows: frame, time and coordinates ``(F, 2 + 3 M)``, NaN if empty."""
    width = 2 + 3 * len(head.names)
    blocks = []
    count = 0
    for begin in range(0, len(lines), ROWS_AT_ONCE):
        part = lines[begin : begin + ROWS_AT_ONCE]
        filled = [_filled(file, t, width, head.rows + begin + i + 1)
                  for i, t in enumerate(part) if t.strip()]  # fmt: skip
        if not filled:
            continue
        text = b"\n".join(filled) + b"\n"
        rows, _, _, _, fault, _, token = _kernels.parse_bvh_rows(
            text, width, len(filled), True
        )
        if fault or len(rows) < len(filled):
            full = [i for i, t in enumerate(part) if t.strip()]
            line = head.rows + begin + full[min(len(rows), len(full) - 1)] + 1
            message = f"{excerpt(_decoded(token))} is no number"
            raise FormatError(Fault("TRC002", message, file.path, (line,)))
        blocks.append(rows)
        count += len(rows)
        if count * len(head.names) > MAX_POSITIONS:
            raise file.error("TRC001", "has more positions than are read")
    if not blocks:
        raise file.error("MKR013", "has no frames")
    return np.concatenate(blocks)


def _filled(file: MarkerFile, line: bytes, width: int, number: int) -> bytes:
    """Return a row in which empty cells are NaN."""
    if b"\t" not in line:
        return line  # separated by blanks, which have no empty cells
    line = line.rstrip()
    missing = width - 1 - line.count(b"\t")
    if missing < 0:
        message = f"has {width - missing} values and not {width}"
        raise FormatError(Fault("TRC002", message, file.path, (number,)))
    line += b"\t" * missing
    if b"\t\t" in line or line[-1:] == b"\t" or b"\t " in line:
        cells = [cell.strip() or b"nan" for cell in line.split(b"\t")]
        return b"\t".join(cells)
    return line


def _decoded(line: bytes) -> str:
    return line.decode("utf-8", "replace")


def _number(text: str | None) -> float | None:
    try:
        value = float(text or "")
    except ValueError:
        return None
    return value if np.isfinite(value) else None


def write_trc(
    markers: Markers, path: Path | str, *, overwrite: bool = False
) -> list[Fault]:
    """Write markers as a TRC file in millimetres; what was not seen is an empty cell.

    Args:
        markers: What to write.
        path: ``.trc``.
        overwrite: Replace a file that exists.

    Returns:
        What the format cannot hold.

    Raises:
        OptionError: The file exists (OUT001), or there are no markers or frames
            (TRC010).
        OutputError: The file cannot be written (OUT002).
    """
    from animtool.output import check_outputs, write_parts

    path = Path(path)
    check_outputs([path], [], overwrite=overwrite)
    if not markers.names or not len(markers):
        message = "a TRC holds at least one marker and one frame"
        raise OptionError(Fault("TRC010", message, str(path)))
    write_parts(path, _parts(markers, path.name))
    lost = []
    if markers.filled is not None and markers.filled.any():
        lost.append("which positions were filled")
    if markers.up is not UpAxis.Y:
        lost.append(f"that {markers.up} is up")
    if markers.residuals is not None:
        lost.append("residuals")
    if not lost:
        return []
    message = f"a TRC has no place for {' and '.join(lost)}"
    return [Fault("TRC102", message, str(path), (), "write .npz", Severity.NOTE)]


def _parts(markers: Markers, name: str) -> Iterator[bytes]:
    count, frames = len(markers.names), len(markers)
    rate, start = f"{float(markers.clock.rate):.10g}", int(markers.clock.start)
    names = [" ".join(name.split()) for name in markers.names]
    axes = [f"{axis}{i + 1}" for i in range(count) for axis in "XYZ"]
    head = [
        f"PathFileType\t4\t(X/Y/Z)\t{name}",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\t"
        "OrigDataStartFrame\tOrigNumFrames",
        f"{rate}\t{rate}\t{frames}\t{count}\tmm\t{rate}\t{start}\t{frames}",
        "Frame#\tTime\t" + "\t\t\t".join(names) + "\t\t",
        "\t\t" + "\t".join(axes),
        "",
    ]
    yield ("\n".join(head) + "\n").encode()
    seconds = np.arange(frames) / float(markers.clock.rate)
    places = np.array([0, 9, *[DECIMALS] * (3 * count)], np.int64)
    for begin in range(0, frames, ROWS_AT_ONCE):
        part = slice(begin, begin + ROWS_AT_ONCE)
        block = markers.positions[part].reshape(-1, 3 * count) * 1000.0
        missing = np.isnan(block)
        numbers = np.arange(begin, begin + len(block)) + start
        rows = np.column_stack([numbers, seconds[part], np.where(missing, 0.0, block)])
        text = _kernels.format_bvh_rows(np.ascontiguousarray(rows), places)
        yield _emptied(text, missing)


def _emptied(text: bytes, missing: np.ndarray) -> bytes:
    """Return rows with tabs between cells, those that are missing empty."""
    lines = text.replace(b" ", b"\t").split(b"\n")
    for row in np.flatnonzero(missing.any(axis=1)).tolist():
        cells = lines[row].split(b"\t")
        for column in np.flatnonzero(missing[row]).tolist():
            cells[2 + column] = b""
        lines[row] = b"\t".join(cells)
    return b"\n".join(lines)

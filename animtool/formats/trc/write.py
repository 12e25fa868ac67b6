"""Writes marker trajectories as TRC files."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from animtool import _kernels
from animtool.core.array_types import BoolArray
from animtool.core.errors import Fault, OptionError, Severity
from animtool.core.units import UpAxis
from animtool.motion.markers import Markers

# Decimals of positions [mm], finer than any camera resolves.
POSITION_DECIMALS = 6
CHUNK_ROWS = 4096


def write_trc(
    markers: Markers, path: Path | str, *, overwrite: bool = False
) -> list[Fault]:
    """Write markers as TRC in millimetres; empty cells are not visible.

    Args:
        markers: The markers.
        path: Path of the file, ``.trc``.
        overwrite: Replace an existing file.

    Returns:
        Warnings about data that the format cannot store.
    """
    from animtool.core.files.output import check_outputs, write_parts

    path = Path(path)
    check_outputs([path], [], overwrite=overwrite)
    if not markers.names or not len(markers):
        message = "a TRC needs at least one marker and one frame"
        raise OptionError(Fault("TRC010", message, str(path)))
    write_parts(path, _file_chunks(markers, path.name))
    lost_contents = []
    if markers.filled is not None and markers.filled.any():
        lost_contents.append("which positions were filled")
    if markers.up is not UpAxis.Y:
        lost_contents.append(f"that {markers.up} is up")
    if markers.residuals is not None:
        lost_contents.append("residuals")
    if not lost_contents:
        return []
    message = f"a TRC cannot store {' and '.join(lost_contents)}"
    return [Fault("TRC102", message, str(path), (), "write .npz", Severity.NOTE)]


def _file_chunks(markers: Markers, name: str) -> Iterator[bytes]:
    marker_count, frame_count = len(markers.names), len(markers)
    rate, first_frame = f"{float(markers.clock.rate):.10g}", int(markers.clock.start)
    names = [" ".join(name.split()) for name in markers.names]
    axis_labels = [f"{axis}{i + 1}" for i in range(marker_count) for axis in "XYZ"]
    header = [
        f"PathFileType\t4\t(X/Y/Z)\t{name}",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"{rate}\t{rate}\t{frame_count}\t{marker_count}\tmm\t{rate}\t{first_frame}\t{frame_count}",
        "Frame#\tTime\t" + "\t\t\t".join(names) + "\t\t",
        "\t\t" + "\t".join(axis_labels),
        "",
    ]
    yield ("\n".join(header) + "\n").encode()
    # Frame 1 is time 0, as in motion files, so that both match.
    times = (np.arange(frame_count) + first_frame - 1) / float(markers.clock.rate)
    if markers.begin is not None:
        times = markers.begin + np.arange(frame_count) / float(markers.clock.rate)
    decimal_counts = np.array(
        [0, 9, *[POSITION_DECIMALS] * (3 * marker_count)], np.int64
    )
    for begin in range(0, frame_count, CHUNK_ROWS):
        frames = slice(begin, begin + CHUNK_ROWS)
        positions = markers.positions[frames].reshape(-1, 3 * marker_count) * 1000.0
        is_missing = np.isnan(positions)
        frame_numbers = np.arange(begin, begin + len(positions)) + first_frame
        rows = np.column_stack(
            [frame_numbers, times[frames], np.where(is_missing, 0.0, positions)]
        )
        text = _kernels.format_bvh_rows(np.ascontiguousarray(rows), decimal_counts)
        yield _blank_missing(text, is_missing)


def _blank_missing(text: bytes, is_missing: BoolArray) -> bytes:
    """Return tab-separated rows in which cells of missing positions are empty.

    A tab follows the last cell if it is empty, as OpenSim requires.
    """
    lines = text.replace(b" ", b"\t").split(b"\n")
    for row in np.flatnonzero(is_missing.any(axis=1)).tolist():
        cells = lines[row].split(b"\t")
        for column in np.flatnonzero(is_missing[row]).tolist():
            cells[2 + column] = b""
        lines[row] = b"\t".join(cells) + (b"" if cells[-1] else b"\t")
    return b"\n".join(lines)

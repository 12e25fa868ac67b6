"""Opens and writes marker files of all formats, by suffix."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import cast

from animtool.core.errors import Fault
from animtool.core.plugins import load_object
from animtool.core.rates import FractionLike
from animtool.core.readers import READERS, find_reader
from animtool.core.units import LengthUnit, UpAxis
from animtool.core.writers import marker_writer
from animtool.documents.references import split_reference
from animtool.motion.markers import Markers


def is_marker_file(path: Path) -> bool:
    """Return whether a path is a file of markers, by its suffix or contents.

    >>> is_marker_file(Path("take.npz#unlabelled_mm")), is_marker_file(Path("a.bvh"))
    (True, False)
    """
    path = marker_file_path(path)
    reader = READERS.get(path.suffix.lower())
    if reader is None or not reader.has_markers:
        return reader is not None and bool(reader.markers)
    has_markers = cast(Callable[[Path], bool], load_object(reader.has_markers))
    return has_markers(path)


def marker_file_path(path: Path) -> Path:
    """Return a path without its optional ``#array`` suffix."""
    return Path(split_reference(str(path), "")[0])


def open_markers(
    path: Path | str,
    *,
    unit: LengthUnit | None = None,
    up: UpAxis | None = None,
    fps: FractionLike | None = None,
    subject: str | None = None,
) -> Markers:
    """Return the markers of a file; ``take.npz#array`` selects an array.

    Args:
        path: The file.
        unit: Unit of the lengths; None is the stated unit.
        up: The up axis; None is the stated axis, or Y.
        fps: The frame rate, if the file states a wrong one or none.
        subject: Subject whose prefix, as in ``Anna:LFHD``, is removed from names.
    """
    path = Path(path)
    open_file = find_reader(marker_file_path(path)).markers_opener(path)
    return cast(Markers, open_file(path, unit=unit, up=up, fps=fps, subject=subject))


def write_markers(
    markers: Markers, output: Path | str, *, overwrite: bool = False
) -> list[Fault]:
    """Write markers in the format of a suffix; return notices about lost data."""
    output = Path(output)
    return marker_writer(output)(markers, output, overwrite=overwrite)

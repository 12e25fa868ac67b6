"""What writes marker trajectories, by the suffix of the file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

from animtool.errors import Fault, OptionError
from animtool.plugins import load_object

MARKER_WRITERS = {
    ".c3d": "animtool.formats.c3d.write:write_c3d",
    ".npz": "animtool.formats.marker_arrays:write_marker_arrays",
    ".trc": "animtool.formats.trc:write_trc",
}


def marker_writer(path: Path) -> Callable[..., Any]:
    """Return what writes markers to a path, and returns what the format cannot hold.

    Raises:
        OptionError: No format of markers has its suffix (IO002).
    """
    place = MARKER_WRITERS.get(path.suffix.lower())
    if place is None:
        message = f"markers are not written to {path.suffix or 'such'} files"
        hint = f"allowed: {', '.join(MARKER_WRITERS)}"
        raise OptionError(Fault("IO002", message, str(path), (), hint))
    return cast(Callable[..., Any], load_object(place))

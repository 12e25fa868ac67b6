"""Reads and writes marker trajectories in .npz files."""

from __future__ import annotations

import re
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from animtool.core.arguments import flag
from animtool.core.clock import Clock, time_fraction
from animtool.core.errors import Fault, counted, faults_in, listed
from animtool.core.files.signatures import expects_format
from animtool.core.rates import FractionLike
from animtool.core.units import LengthUnit, UpAxis
from animtool.documents.arrays import Archives, open_arrays
from animtool.documents.references import split_reference
from animtool.formats.trajectories import MAX_POSITIONS, CaptureFile
from animtool.motion.markers import Markers

_UNIT_PATTERN = re.compile(r"_(mm|cm|m|in)")
# Prefix of the default array of positions.
DEFAULT_PREFIX = "markers"
# The array of marker names, and names that others give it.
NAMES_ARRAY = "marker_names"
NAMES_ARRAY_ALIASES = frozenset(
    {"names", "labels", "marker_labels", "markers_names", "point_names", "point_labels"}
)
# Arrays of the pixels of cameras.
PIXEL_ARRAYS = frozenset({"uv", "uv8"})


@expects_format("MKR012", "an archive of arrays")
def read_markers(
    path: Path | str,
    *,
    array: str | None = None,
    unit: LengthUnit | None = None,
    up: UpAxis | None = None,
    fps: FractionLike | None = None,
    subject: str | None = None,
) -> Markers:
    """Return the markers of an .npz file.

    The file has the texts ``marker_names``, the number ``fs`` (frames per second), and
    positions ``(F, M, 3)`` in an array whose name ends in its unit: ``_mm``, ``_cm``,
    ``_m`` or ``_in``. What `write_marker_arrays` adds is read too. If the number of
    points differs from that of the names, the points are unlabelled: ``*0``, ``*1`` and
    so on.

    Args:
        path: The file; ``take.npz#unlabelled_mm`` also selects the array.
        array: The array of positions; None is the one that starts with ``markers``.
        unit: Unit of the lengths; None is that in the array's name.
        up: The up axis; None is that in the text ``up``, or Y.
        fps: The frame rate, if the file has a wrong one or none.
        subject: Subject whose prefix is removed from names, as in `read_c3d`.
    """
    path_text, array_name = split_reference(str(path), "")
    path = Path(path_text)
    file = CaptureFile(str(path))
    array = array or array_name or None
    with open_arrays(path, partial(file.error, "MKR012")) as archives:
        return _read_arrays(file, archives, path, array, unit, up, fps, subject)


def _read_arrays(
    file: CaptureFile,
    archives: Archives,
    path: Path,
    array: str | None,
    unit: LengthUnit | None,
    up: UpAxis | None,
    fps: FractionLike | None,
    subject: str | None,
) -> Markers:
    array_names = archives.names(path)
    positions_name = _find_positions_array(file, archives, path, array_names, array)
    header = archives.header(path, positions_name)
    if len(header.shape) != 3 or header.shape[2] != 3 or header.kind not in "fiu":
        message = f"{positions_name!r} has shape {header.shape}, "
        raise file.error("MKR012", f"{message}not (frames, markers, 3)")
    frame_count, point_count, _ = header.shape
    counts_text = f"{positions_name!r} has {frame_count} frames of {point_count} points"
    if frame_count == 0 or point_count == 0:
        raise file.error("MKR013", counts_text)
    if frame_count * point_count > MAX_POSITIONS:
        raise file.error("MKR012", f"{counts_text}, above the limit")
    _, underscore, suffix_text = positions_name.rpartition("_")
    suffix = _UNIT_PATTERN.fullmatch(underscore + suffix_text)
    if suffix and unit is None:
        file.unit_source = f" (the array is called {positions_name!r})"
    length_unit = file.choose_unit(suffix[1] if suffix else None, unit, LengthUnit.MM)

    has_default_prefix = positions_name.partition("_")[0] == DEFAULT_PREFIX

    def read_number(name: str) -> float | None:
        if name not in array_names:
            return None
        return float(archives.load_stored(path, name).ravel()[0])

    def read_point_array(name: str) -> npt.NDArray[Any] | None:
        if name not in array_names or not has_default_prefix:
            return None
        return archives.load_stored(path, name)

    rate = file.choose_rate(read_number("fs"), fps)
    up_text = archives.text(path, "up") if "up" in array_names else None
    up_axis = file.choose_up(UpAxis(up_text) if up_text in {"Y", "Z"} else None, up)
    frame_and_point_count = (frame_count, point_count)
    names = _marker_names(
        file, archives, path, array_names, positions_name, frame_and_point_count
    )
    labels = names if len(names) == point_count else [""] * point_count
    positions = np.array(archives.load_stored(path, positions_name), np.float64)
    residuals, cameras = read_point_array("residuals_m"), read_point_array("cameras")
    is_filled, start_frame = read_point_array("filled"), read_number("start")
    with faults_in(path):
        return Markers(
            file.unique_names(labels, subject),
            Clock(rate, _start_frame(start_frame), Fraction(1), frame_count),
            file.clean_positions(positions, length_unit.meters),
            up_axis,
            None if cameras is None else cameras.astype(np.int64),
            None if residuals is None else residuals.astype(np.float64),
            None if is_filled is None else is_filled.astype(bool),
            tuple(file.notices),
        )


def _marker_names(
    file: CaptureFile,
    archives: Archives,
    path: Path,
    array_names: list[str],
    positions_name: str,
    shape: tuple[int, int],
) -> list[str]:
    """Return the marker names that apply to an array of positions, or none.

    ``shape`` is the number of frames and points. Raises if they are swapped (MKR012);
    warns about names that do not match the points (MKR106).
    """
    frame_count, point_count = shape
    has_default_prefix = positions_name.partition("_")[0] == DEFAULT_PREFIX
    if NAMES_ARRAY in array_names:
        names = archives.texts(path, NAMES_ARRAY)
        if not has_default_prefix or not names or len(names) == point_count:
            return names
        message = (
            f"{positions_name!r} has {counted(frame_count, 'frame')} of "
            f"{counted(point_count, 'point')}, "
            f"but {NAMES_ARRAY!r} has {counted(len(names), 'name')}"
        )
        if len(names) == frame_count:
            hint = "transpose it to (frames, markers, 3)"
            raise file.error("MKR012", message, hint)
        hint = f"the points are unlabelled: write one name for each in {NAMES_ARRAY!r}"
        file.warn("MKR106", message, hint)
        return names
    for name in array_names:
        if not has_default_prefix or name not in NAMES_ARRAY_ALIASES:
            continue
        try:
            texts = archives.texts(path, name)
        except ValueError:
            continue
        if len(texts) == point_count:
            message = f"there is no array {NAMES_ARRAY!r}: the points are unlabelled"
            hint = f"{name!r} has a text for each: rename it to {NAMES_ARRAY!r}"
            file.warn("MKR106", message, hint)
            break
    return []


def _find_positions_array(
    file: CaptureFile,
    archives: Archives,
    path: Path,
    array_names: list[str],
    requested_array: str | None,
) -> str:
    """Return the name of the array of positions: the requested or the default one."""
    if requested_array is not None:
        # The archive reports a missing array and lists those it has.
        archives.header(path, requested_array)
        return requested_array
    candidates = [
        name for name in array_names if name.partition("_")[0] == DEFAULT_PREFIX
    ]
    if not candidates:
        names_with_unit = [name for name in array_names if _UNIT_PATTERN.search(name)]
        if not PIXEL_ARRAYS.isdisjoint(array_names):
            message = "holds pixels of cameras, not positions"
            pixels_hint = (
                f"run first: animtool mocap triangulate {path} "
                f"{flag('cameras', 'FILE')} -o markers.npz; or animtool bake {path} "
                f"{flag('cameras', 'FILE')} {flag('template', 'FILE')}"
            )
            raise file.error("MKR012", message, pixels_hint)
        message = f"has no array of positions whose name starts with {DEFAULT_PREFIX!r}"
        message += f"; its arrays are {listed(array_names)}"
        hint = (
            f"name one: {path.name}#{names_with_unit[0]}" if names_with_unit else None
        )
        raise file.error("MKR012", message, hint)
    if len(candidates) > 1:
        # The array of marker names has the same prefix.
        candidates = [k for k in candidates if _UNIT_PATTERN.search(k)] or candidates
    return candidates[0]


def _start_frame(start: float | None) -> Fraction:
    if start is None or not np.isfinite(start):
        return Fraction(1)
    return time_fraction(start)


def write_marker_arrays(
    markers: Markers, path: Path | str, *, overwrite: bool = False
) -> list[Fault]:
    """Write markers losslessly as arrays in an .npz file.

    Args:
        markers: The markers.
        path: Path of the file, ``.npz``.
        overwrite: Replace an existing file.

    Returns:
        Warnings about data that the format cannot store: none.
    """
    from animtool.core.files.output import check_outputs, write_arrays

    path = Path(path)
    check_outputs([path], [], overwrite=overwrite)
    arrays: dict[str, npt.NDArray[Any]] = {
        NAMES_ARRAY: np.array(markers.names, dtype=np.str_),
        "fs": np.array(float(markers.clock.rate)),
        "start": np.array(float(markers.clock.start)),
        "up": np.array(str(markers.up)),
        "markers_m": markers.positions,
    }
    optional_arrays = {
        "cameras": markers.cameras,
        "residuals_m": markers.residuals,
        "filled": markers.filled,
    }
    arrays |= {k: values for k, values in optional_arrays.items() if values is not None}
    write_arrays(path, arrays)
    return []

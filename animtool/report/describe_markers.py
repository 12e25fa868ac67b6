"""Describes a marker file."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import ClassVar

import numpy as np

from animtool.capture.markers.plausible import plausibility_warnings
from animtool.capture.markers.spikes import find_spikes
from animtool.core.errors import Fault
from animtool.core.readers import find_reader
from animtool.core.record import dataclass
from animtool.formats.marker_files import marker_file_path
from animtool.motion.markers import Markers


@dataclass(frozen=True, slots=True)
class MarkersDescription:
    """Facts about a marker file, as `animtool info` prints them."""

    path: str  # path of the file
    format: str  # name of the file format
    markers: int  # number of markers and points
    unlabelled: int  # points without a label
    frames: int  # number of frames
    fps: Fraction  # frames a second, exact
    start: Fraction  # number of the first frame
    duration: Fraction  # from the first frame to the last [s]
    up: str  # up axis
    gaps: int  # gaps of labelled markers
    missing: float  # fraction of missing positions
    longest_gap: float  # the longest gap [s]
    spikes: int  # positions that jump away for a few frames
    filled: int  # positions interpolated over a gap
    # Lowest and highest position over all frames [m]; None if no marker is visible.
    bounds: tuple[list[float], list[float]] | None
    names: list[str]  # names of the labelled markers
    notices: list[Fault]  # warnings and notes
    json_keys: ClassVar[str] = "* rate=fps#"

    @property
    def labelled(self) -> int:
        """Number of markers with a label."""
        return self.markers - self.unlabelled


def describe_markers(path: Path, markers: Markers) -> MarkersDescription:
    """Measure gaps, spikes and bounds of markers, and add plausibility warnings."""
    is_labelled = np.array([not name.startswith("*") for name in markers.names], bool)
    is_visible = markers.visible
    is_missing = np.pad(~is_visible[:, is_labelled], ((1, 1), (0, 0))).astype(np.int8)
    gap_edges = np.diff(is_missing, axis=0)
    gap_starts = np.argwhere(gap_edges.T == 1)[:, 1]
    gap_ends = np.argwhere(gap_edges.T == -1)[:, 1]
    longest_gap = int((gap_ends - gap_starts).max(initial=0))
    visible_positions = markers.positions[is_visible]
    bounds = None
    if len(visible_positions):
        bounds = (
            visible_positions.min(axis=0).tolist(),
            visible_positions.max(axis=0).tolist(),
        )
    clock = markers.clock
    return MarkersDescription(
        str(path),
        find_reader(marker_file_path(path)).about,
        len(markers.names),
        int((~is_labelled).sum()),
        clock.count,
        clock.rate,
        clock.start,
        clock.duration,
        markers.up.value,
        len(gap_starts),
        float((~is_visible[:, is_labelled]).mean()) if is_labelled.any() else 0.0,
        longest_gap / float(clock.rate),
        len(find_spikes(markers)),
        0 if markers.filled is None else int(markers.filled.sum()),
        bounds,
        [name for name in markers.names if not name.startswith("*")],
        [
            notice.in_file(path)
            for notice in (*markers.notices, *plausibility_warnings(markers))
        ],
    )

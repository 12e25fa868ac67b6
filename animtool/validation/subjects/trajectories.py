"""Marker and joint coordinate files as subjects."""

from __future__ import annotations

from pathlib import Path

from animtool.core.errors import Fault
from animtool.core.record import dataclass
from animtool.core.rules import Kind
from animtool.motion.markers import Markers
from animtool.validation.subjects.subject import CheckedFile


@dataclass(frozen=True, eq=False)
class MarkersSubject:
    """Markers and their file."""

    path: Path  # the file
    markers: Markers  # all markers

    def fault(
        self, code: str, message: str, hint: str | None = None, where: str | None = None
    ) -> Fault:
        """Return a fault of the file, or of a marker."""
        return Fault(code, message, str(self.path), (), hint, where=where)


def open_trajectories(path: Path) -> CheckedFile:
    """Return the subject of a C3D, TRC or npz marker file, with every frame read."""
    from animtool.formats.marker_files import open_markers

    markers = open_markers(path)
    faults = [notice.in_file(path) for notice in markers.notices]
    return CheckedFile(Kind.TRAJECTORIES, faults, MarkersSubject(path, markers))


def open_coordinates(path: Path) -> CheckedFile:
    """Open a MOT or STO file for checking, as trajectories if it has markers."""
    from animtool.formats.marker_files import is_marker_file
    from animtool.scene.sources.open import open_source

    if is_marker_file(path):
        return open_trajectories(path)
    return CheckedFile(Kind.COORDINATES, list(open_source(path).notices))

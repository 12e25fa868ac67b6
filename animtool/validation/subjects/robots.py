"""Robot files as subjects: reader faults."""

from __future__ import annotations

from pathlib import Path

from animtool.core.files.reading import note_input
from animtool.core.rules import Kind
from animtool.rig.skeleton import Rig
from animtool.validation.subjects.subject import CheckedFile


def open_urdf(path: Path) -> CheckedFile:
    """Return the faults of a URDF file."""
    return _read_faults(Kind.URDF, path)


def open_mjcf(path: Path) -> CheckedFile:
    """Return the faults of an MJCF file."""
    return _read_faults(Kind.MJCF, path)


def _read_faults(kind: Kind, path: Path) -> CheckedFile:
    note_input(path)
    return CheckedFile(kind, list(Rig.load(path).notices))

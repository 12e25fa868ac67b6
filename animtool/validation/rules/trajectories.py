"""Marker files as subjects, and rules on their gaps, spikes, names and sizes."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from animtool.capture.markers.spikes import find_spikes
from animtool.core.arguments import argument
from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.errors import Fault, counted, listed, percent_text
from animtool.core.quantities import length_text
from animtool.core.record import dataclass
from animtool.core.rules import Kind
from animtool.core.units import confused_units
from animtool.motion.markers import Markers
from animtool.validation.subjects.subject import CheckedFile

# Fraction of its frames in which a marker may be missing.
MAX_MISSING_FRACTION = 0.1
# Fraction of all points that may be unlabelled.
MAX_UNLABELLED_FRACTION = 0.1
# Plausible extents of the markers in a frame [m]: larger than any stage, and smaller
# than a face. A person in a wrong unit is 10 or 1000 times as large or small.
MAX_EXTENT, MIN_EXTENT = 30.0, 0.03
# Diagonal of a person's markers [m]: typical, and from a face to spread arms.
TYPICAL_EXTENT, PERSON_EXTENTS = 1.9, (0.15, 3.5)
# Two markers that are nearer than this in most frames are the same point [m].
MAX_SAME_DISTANCE = 1e-4
MIN_SAME_FRACTION = 0.5
MAX_LISTED_MARKERS = 12
# Frames per block of the comparison of all marker pairs.
BLOCK_FRAMES = 64


@dataclass(frozen=True, eq=False)
class MarkersSubject:
    """Subject of the marker rules: the markers of a file."""

    path: Path  # the file
    markers: Markers  # all markers

    def fault(
        self, code: str, message: str, hint: str | None = None, where: str | None = None
    ) -> Fault:
        """Return a fault of the file, or of the marker named by ``where``."""
        return Fault(code, message, str(self.path), (), hint, where=where)


def open_trajectories(path: Path) -> CheckedFile:
    """Read all frames of a C3D, TRC or npz marker file for the rules."""
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


def missing_markers(subject: MarkersSubject) -> Iterator[Fault]:
    """Report labelled markers that are missing from a large part of frames (MKR201)."""
    markers = subject.markers
    missing_fractions = (1.0 - markers.visible.mean(axis=0)).tolist()
    missing_texts = [
        f"{name} {percent_text(fraction)}"
        for name, fraction in zip(markers.names, missing_fractions, strict=True)
        if not name.startswith("*") and MAX_MISSING_FRACTION < fraction < 1.0
    ]
    if missing_texts:
        message = (
            f"{counted(len(missing_texts), 'marker')} "
            f"{'is' if len(missing_texts) == 1 else 'are'} missing from more than "
            f"{percent_text(MAX_MISSING_FRACTION)} of frames: "
            f"{listed(missing_texts, MAX_LISTED_MARKERS)}"
        )
        hint = "fill the gaps with animtool mocap fill, or solve on a rig, which "
        hint += "tolerates missing markers"
        yield subject.fault("MKR201", message, hint)


def marker_spikes(subject: MarkersSubject) -> Iterator[Fault]:
    """Report markers with spikes of a few frames (MKR202)."""
    spikes = find_spikes(subject.markers)
    if spikes:
        largest_spike = max(spikes, key=lambda spike: spike.size)
        # Frame numbers of the file.
        frame = int(subject.markers.clock.start) + largest_spike.first
        marker_names = list(dict.fromkeys(spike.marker for spike in spikes))
        message = (
            f"{listed(marker_names, MAX_LISTED_MARKERS)} "
            f"{'has' if len(marker_names) == 1 else 'have'} "
            f"{counted(len(spikes), 'spike')}; the largest is "
            f"{1000 * largest_spike.size:.3g} mm, of {largest_spike.marker} in frame "
            f"{frame}"
        )
        hint = "remove spikes with animtool mocap fill"
        yield replace(subject.fault("MKR202", message, hint), frame=float(frame))


def unlabelled_points(subject: MarkersSubject) -> Iterator[Fault]:
    """Yield a fault if a large part of the points has no label (MKR203)."""
    names, is_visible = subject.markers.names, subject.markers.visible
    is_unlabelled = np.array([name.startswith("*") for name in names], np.bool_)
    fraction = int(is_visible[:, is_unlabelled].sum()) / max(int(is_visible.sum()), 1)
    if fraction > MAX_UNLABELLED_FRACTION:
        message = f"{percent_text(fraction)} of all points have no label"
        hint = "animtool mocap label names them"
        yield subject.fault("MKR203", message, hint)


def implausible_extent(subject: MarkersSubject) -> Iterator[Fault]:
    """Yield a fault if markers are too far apart or too close (MKR204)."""
    extents = _frame_extents(subject.markers.positions, subject.markers.visible)
    if not len(extents):
        return
    median_extent = float(np.median(extents))
    if median_extent > MAX_EXTENT:
        extent_text = f"{length_text(median_extent)} apart: too far for a capture "
        extent_text += "volume"
    elif median_extent < MIN_EXTENT:
        extent_text = f"{length_text(median_extent)} apart: too close"
    else:
        return
    # The file's own unit is unknown: the numbers fit a person in another one.
    written_unit, read_unit = confused_units(median_extent / TYPICAL_EXTENT)
    likely_extent = median_extent * written_unit.meters / read_unit.meters
    hint = f"set the unit of its lengths with {argument('source.unit')}"
    if PERSON_EXTENTS[0] <= likely_extent <= PERSON_EXTENTS[1]:
        hint = f"if it is in {written_unit}, read as {read_unit}, set "
        hint += f"{argument('source.unit', str(written_unit))}: they are then "
        hint += f"{length_text(likely_extent)} apart"
    yield subject.fault("MKR204", f"markers of a frame are {extent_text}", hint)


def _frame_extents(positions: FloatArray, is_visible: BoolArray) -> FloatArray:
    """Return the bounds diagonals of frames with three or more points ``(N,)`` [m]."""
    has_extent = is_visible.sum(axis=1) >= 3
    if not has_extent.any():
        return np.zeros(0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        lowest = np.nanmin(positions[has_extent], axis=1)
        highest = np.nanmax(positions[has_extent], axis=1)
    return np.asarray(np.linalg.norm(highest - lowest, axis=-1))


def coincident_markers(subject: MarkersSubject) -> Iterator[Fault]:
    """Report markers at equal positions in most frames (MKR205)."""
    markers = subject.markers
    labelled_indices = [
        i for i, name in enumerate(markers.names) if not name.startswith("*")
    ]
    marker_count = len(labelled_indices)
    near_counts = np.zeros((marker_count, marker_count), np.int64)
    shared_counts = np.zeros((marker_count, marker_count), np.int64)
    for block_start in range(0, len(markers), BLOCK_FRAMES):
        block = slice(block_start, block_start + BLOCK_FRAMES)
        positions = markers.positions[block, labelled_indices]
        is_visible = np.isfinite(positions[..., 0]).astype(np.int64)
        shared_counts += np.einsum("fi,fj->ij", is_visible, is_visible)
        is_near = np.ones((len(positions), marker_count, marker_count), np.bool_)
        with np.errstate(invalid="ignore"):
            for axis in range(3):
                coordinates = positions[..., axis]
                offsets = coordinates[:, :, None] - coordinates[:, None, :]
                is_near &= np.abs(offsets) < MAX_SAME_DISTANCE
        near_counts += is_near.sum(axis=0)
    is_same = (near_counts > MIN_SAME_FRACTION * shared_counts) & (shared_counts > 0)
    pairs = np.argwhere(np.triu(is_same, 1))
    if len(pairs):
        labelled_names = [markers.names[i] for i in labelled_indices]
        pair_names = [
            f"{labelled_names[i]} and {labelled_names[k]}" for i, k in pairs.tolist()
        ]
        pairs_text = listed(pair_names, MAX_LISTED_MARKERS)
        hint = "remove one of them, or label them again"
        message = f"markers at the same position: {pairs_text}"
        yield subject.fault("MKR205", message, hint)


def invisible_markers(subject: MarkersSubject) -> Iterator[Fault]:
    """Report markers without any frame (MKR206)."""
    markers = subject.markers
    visible_counts = markers.visible.sum(axis=0).tolist()
    invisible_names = [
        name
        for name, count in zip(markers.names, visible_counts, strict=True)
        if not count and not name.startswith("*")
    ]
    if invisible_names:
        names_text = listed(invisible_names, MAX_LISTED_MARKERS)
        message = f"markers that no frame has: {names_text}"
        yield subject.fault("MKR206", message, "remove them")

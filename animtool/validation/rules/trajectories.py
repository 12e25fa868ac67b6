"""Rules on marker files: gaps, spikes, names and sizes."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from animtool.capture.markers.spikes import find_spikes
from animtool.core.arguments import argument
from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.errors import Fault, counted, listed, percent
from animtool.validation.subjects.trajectories import MarkersSubject

# Share of its frames that a marker may be missing from.
MISSING_FRACTION = 0.1
# Share of all points that may be without a label.
UNLABELLED_FRACTION = 0.1
# How far apart the markers of a frame usually are [m]: more than any stage, and less
# than a face. A person in a wrong unit is 10 or 1000 times as large or small.
LARGEST, SMALLEST = 30.0, 0.03
# Two markers are nearer in most frames than any that have a size [m].
SAME = 1e-4
SAME_FRACTION = 0.5
MAX_NAMED = 12
# Frames whose distances between all markers are in memory at once.
FRAMES_COMPARED = 64


def gaps(subject: MarkersSubject) -> Iterator[Fault]:
    """Yield labelled markers missing from many frames (MKR201)."""
    markers = subject.markers
    shares = 1.0 - markers.visible.mean(axis=0)
    often = [
        f"{name} {percent(fraction)}"
        for name, fraction in zip(markers.names, shares.tolist(), strict=True)
        if not name.startswith("*") and MISSING_FRACTION < fraction < 1.0
    ]
    if often:
        message = (
            f"{counted(len(often), 'marker')} missing from more than "
            f"{percent(MISSING_FRACTION)} of frames: {listed(often, MAX_NAMED)}"
        )
        hint = "animtool mocap fill fills gaps; a solve on a rig needs fewer markers"
        yield subject.fault("MKR201", message, hint)


def spikes(subject: MarkersSubject) -> Iterator[Fault]:
    """Yield markers with spikes of a few frames (MKR202)."""
    outliers = find_spikes(subject.markers)
    if outliers:
        worst = max(outliers, key=lambda spike: spike.size)
        # Frames as the file numbers them.
        frame = int(subject.markers.clock.start) + worst.first
        names = list(dict.fromkeys(spike.marker for spike in outliers))
        message = (
            f"{counted(len(outliers), 'spike')} of {listed(names, MAX_NAMED)}; the "
            f"largest, {1000 * worst.size:.3g} mm, of {worst.marker} at frame {frame}"
        )
        hint = "animtool mocap fill removes them"
        yield replace(subject.fault("MKR202", message, hint), frame=float(frame))


def unlabelled(subject: MarkersSubject) -> Iterator[Fault]:
    """Yield a fault if many points have no label (MKR203)."""
    names, visible = subject.markers.names, subject.markers.visible
    nameless = np.array([name.startswith("*") for name in names], np.bool_)
    total = int(visible.sum())
    fraction = float(visible[:, nameless].sum()) / total if total else 0.0
    if fraction > UNLABELLED_FRACTION:
        message = f"{percent(fraction)} of all points have no label"
        hint = "animtool mocap label names them"
        yield subject.fault("MKR203", message, hint)


def sizes(subject: MarkersSubject) -> Iterator[Fault]:
    """Yield a fault if markers are too far apart or too close (MKR204)."""
    extents = _extents(subject.markers.positions, subject.markers.visible)
    if not len(extents):
        return
    median = float(np.median(extents))
    if median > LARGEST:
        message = (
            f"markers of a frame are {median:.3g} m apart: too far for a capture volume"
        )
    elif median < SMALLEST:
        message = f"markers of a frame are {1000 * median:.3g} mm apart: too close"
    else:
        return
    yield subject.fault(
        "MKR204", message, f"set the unit of its lengths with {argument('source.unit')}"
    )


def _extents(positions: FloatArray, visible: BoolArray) -> FloatArray:
    """Return the bounds diagonals of frames with three points or more."""
    several = visible.sum(axis=1) >= 3
    if not several.any():
        return np.zeros(0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        low = np.nanmin(positions[several], axis=1)
        high = np.nanmax(positions[several], axis=1)
    return np.asarray(np.linalg.norm(high - low, axis=-1))


def same_points(subject: MarkersSubject) -> Iterator[Fault]:
    """Yield markers at equal positions in most frames (MKR205)."""
    markers = subject.markers
    labelled = [i for i, name in enumerate(markers.names) if not name.startswith("*")]
    count = len(labelled)
    together = np.zeros((count, count), np.int64)
    both = np.zeros((count, count), np.int64)
    for begin in range(0, len(markers), FRAMES_COMPARED):
        part = markers.positions[begin : begin + FRAMES_COMPARED, labelled]
        there = np.isfinite(part[..., 0])
        both += np.einsum("fi,fj->ij", there.astype(np.int64), there.astype(np.int64))
        near = np.ones((len(part), count, count), np.bool_)
        with np.errstate(invalid="ignore"):
            for axis in range(3):
                along = part[..., axis]
                near &= np.abs(along[:, :, None] - along[:, None, :]) < SAME
        together += near.sum(axis=0)
    pairs = np.argwhere(np.triu((together > SAME_FRACTION * both) & (both > 0), 1))
    if len(pairs):
        names = [markers.names[i] for i in labelled]
        shown = [f"{names[a]} and {names[b]}" for a, b in pairs.tolist()]
        message = f"markers at the same position: {listed(shown, MAX_NAMED)}"
        hint = "remove one of them, or label them again"
        yield subject.fault("MKR205", message, hint)


def unseen(subject: MarkersSubject) -> Iterator[Fault]:
    """Yield markers without any frame (MKR206)."""
    markers = subject.markers
    counts = markers.visible.sum(axis=0).tolist()
    never = [
        name
        for name, count in zip(markers.names, counts, strict=True)
        if not count and not name.startswith("*")
    ]
    if never:
        message = f"markers that no frame has: {listed(never, MAX_NAMED)}"
        yield subject.fault("MKR206", message, "remove them")

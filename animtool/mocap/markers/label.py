"""Points without names given the names of markers, by a trial at rest and by motion."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from itertools import combinations
from typing import Any

import numpy as np

from animtool._types import FloatArray, IntArray
from animtool.errors import Fault, OptionError, Severity
from animtool.markers import Markers
from animtool.mocap.markers.evidence import explained
from animtool.mocap.markers.geometry import distances, fitted
from animtool.mocap.markers.identify import identify
from animtool.mocap.markers.runs import RunLabels
from animtool.mocap.markers.tracklets import Tracklets, follow

# Runs that are named first are as long [frame], in a part of a take as long [s].
MIN_RUN = 30
BASE = 10.0
MAX_EXCHANGES = 12
# Markers so near may be taken for each other [m].
NEAR = 0.16
# Markers around those in question that give them a frame.
AROUND = 3
# Frames looked at, and those of them that are nearest to the pose of the trial [1].
SAMPLES, BEST = 240, 0.1
MIN_SAMPLES = 8
# An exchange has to bring shapes nearer by this share, and by this much [m].
SHARE, LEAST = 0.8, 0.001
# What all distances may speak against an exchange [nat]: those of twins are as good.
AGAINST = 3.0


def better_names(positions: FloatArray, shape: FloatArray) -> IntArray | None:
    """Return which name each marker should have ``(M,)``, where some are exchanged.

    Looks at pairs of near markers, and at two pairs at once. The measure is how far the
    shape at rest is off the points in the frames in which it is least so, turned but
    not mirrored.

    positions: ``(F, M, 3)``. shape: ``(M, 3)`` at rest.

    Returns:
        None where no exchange is clearly better.
    """
    apart = np.linalg.norm(shape[:, None] - shape[None], axis=-1)
    pairs = [
        (i, j) for i, j in combinations(range(len(shape)), 2) if apart[i, j] < NEAR
    ]
    moves = [(pair,) for pair in pairs]
    for one, other in combinations(pairs, 2):
        if not set(one) & set(other) and _near(apart, one, other):
            moves.append((one, other))  # type: ignore[arg-type]
    moving = distances(positions)
    least = explained(moving, apart) - AGAINST
    best, gain = None, 0.0
    for move in moves:
        changed = [marker for pair in move for marker in pair]
        group = np.array([*changed, *_around(apart, changed)])
        points = _samples(positions[:, group])
        if points is None:
            continue
        names = np.arange(len(group))
        for k in range(0, len(changed), 2):
            names[k], names[k + 1] = k + 1, k
        now = _off(points, shape[group])
        then = _off(points, shape[group[names]])
        if then < SHARE * now and now - then > max(LEAST, gain):
            new = np.arange(len(shape))
            new[group] = group[names]
            if explained(moving, apart[np.ix_(new, new)]) >= least:
                gain, best = now - then, new
    return best


def _near(apart: FloatArray, one: tuple[int, int], other: tuple[int, int]) -> bool:
    return bool(apart[np.ix_(one, other)].min() < NEAR)


def _around(apart: FloatArray, markers: list[int]) -> list[int]:
    """Return the markers nearest to some, beside them."""
    distance = apart[markers].min(axis=0)
    distance[markers] = np.inf
    return [int(i) for i in np.argsort(distance, kind="stable")[:AROUND]]


def _samples(points: FloatArray) -> FloatArray | None:
    """Return frames in which all of some markers are seen; None where they are few."""
    whole = np.flatnonzero(np.isfinite(points).all(axis=(1, 2)))
    if len(whole) < MIN_SAMPLES:
        return None
    step = max(1, len(whole) // SAMPLES)
    return np.asarray(points[whole[::step]])


def _off(points: FloatArray, shape: FloatArray) -> float:
    """Return how far a shape is off points in the frames that fit it best [m]."""
    rotation, shift = fitted(points, shape)
    fit = np.einsum("fij,kj->fki", rotation, shape) + shift[:, None]
    off = np.sqrt(((fit - points) ** 2).sum(axis=-1).mean(axis=1))
    count = max(1, int(BEST * len(off)))
    return float(np.partition(off, count - 1)[:count].mean())


@dataclass(frozen=True, slots=True)
class LabelReport:
    """What labelling did.

    Attributes:
        frames: Number of frames.
        markers: Number of names.
        points: Points seen, all frames together.
        labelled: Those that got a name.
        rejected: Those that are none of the markers.
        runs: Points joined to runs without a gap.
        missing: Names that no point got in any frame.
        coverage: Share of frames in which each name has a point.
        notices: Warnings.
    """

    frames: int
    markers: int
    points: int
    labelled: int
    rejected: int
    runs: int
    missing: list[str]
    coverage: dict[str, float]
    notices: list[Fault] = field(default_factory=list)

    def as_dict(self) -> dict[str, Any]:
        """Return the report as plain values."""
        found = {f.name: getattr(self, f.name) for f in fields(self)}
        return {**found, "notices": [notice.as_dict() for notice in self.notices]}


def label(cloud: Markers, static: Markers) -> tuple[Markers, LabelReport]:
    """Return a cloud with the names of a trial at rest.

    Points are joined to runs by how they move. Runs whose distance does not change are
    on one segment: groups of them are found in the trial by their distances and their
    handedness, and then, run by run, what is known best is added. Runs after a gap get
    the name whose place, by the distances to those that have one, they are at. What is
    at no marker's place gets none.

    Args:
        cloud: Points in any order, which may change from frame to frame.
        static: The subject's labelled trial at rest; its frames are averaged.

    Raises:
        OptionError: The trial has fewer than four markers (MKR020), or nothing in the
            cloud fits it (MKR021).
    """
    names, rest = _template(static)
    rate = float(cloud.clock.rate)
    tracklets = follow(cloud.positions, rate)
    given = _first_names(cloud, tracklets, rest)
    if given is None:
        message = "no group of points moves like one of the trial's segments"
        hint = "is it of the same subject, with the same markers and unit?"
        raise OptionError(Fault("MKR021", message, hint=hint))
    apart = np.linalg.norm(rest[:, None] - rest[None], axis=-1)
    work = RunLabels(cloud.positions, tracklets, rate, given, apart)
    _exchange(work, rest)
    work.settle()
    return _labelled(cloud, names, tracklets, work.given)


def _template(static: Markers) -> tuple[tuple[str, ...], FloatArray]:
    """Return names and mean positions ``(M, 3)`` of the markers of a trial at rest."""
    known = np.flatnonzero(static.seen.any(axis=0))
    known = np.array([i for i in known.tolist() if not static.names[i].startswith("*")])
    if len(known) < 4:
        message = f"the trial has {len(known)} labelled markers; labelling takes 4"
        raise OptionError(Fault("MKR020", message))
    rest = np.nanmedian(static.positions[:, known], axis=0)
    return tuple(static.names[i] for i in known.tolist()), rest


def _labelled(
    cloud: Markers, names: tuple[str, ...], tracklets: Tracklets, given: IntArray
) -> tuple[Markers, LabelReport]:
    """Return a cloud by name."""
    frames = len(cloud)
    slots = np.full((frames, len(names)), -1)
    ids = tracklets.ids
    marker = np.where(ids >= 0, given[ids], -1)
    frame, slot = np.nonzero(marker >= 0)
    slots[frame, marker[frame, slot]] = slot

    def chosen(values: Any, empty: float) -> Any:
        if values is None:
            return None
        where = slots.reshape(slots.shape + (1,) * (values.ndim - 2))
        picked = np.take_along_axis(values, np.maximum(where, 0), 1)
        return np.where(where < 0, np.asarray(empty, values.dtype), picked)

    labelled = replace(
        cloud,
        names=names,
        positions=chosen(cloud.positions, np.nan),
        cameras=chosen(cloud.cameras, 0),
        residuals=chosen(cloud.residuals, np.nan),
        filled=chosen(cloud.filled, 0),
    )
    coverage = (slots >= 0).mean(axis=0)
    points, got = int((ids >= 0).sum()), int((slots >= 0).sum())
    shares = dict(zip(names, coverage.tolist(), strict=True))
    missing = [name for name, share in shares.items() if not share]
    notices = []
    if missing:
        message = f"no points were found for {', '.join(missing)}"
        notices.append(Fault("MKR110", message, severity=Severity.WARNING))
    report = LabelReport(
        frames, len(names), points, got, points - got, len(tracklets.first), missing,
        shares, notices,
    )  # fmt: skip
    return labelled, report


def _first_names(
    cloud: Markers, tracklets: Tracklets, rest: FloatArray
) -> IntArray | None:
    """Return the markers of the longer runs of a part of a take; None where none fits.

    -1 for the other runs.
    """
    frames, runs = _base(tracklets, len(cloud), float(cloud.clock.rate))
    apart = np.linalg.norm(rest[:, None] - rest[None], axis=-1)
    points = _window(cloud.positions, tracklets, runs, frames)
    found = identify(points, rest, apart)
    if found is None:
        return None
    given = np.full(len(tracklets.first), -1)
    given[runs] = found
    return given


def _base(tracklets: Tracklets, frames: int, rate: float) -> tuple[slice, IntArray]:
    """Return the frames that are looked at first, and their longer runs."""
    first, last = tracklets.first, tracklets.last
    length = min(frames, max(MIN_RUN, int(BASE * rate)))
    best, count = 0, -1
    for start in range(0, frames - length + 1, max(1, length // 4)):
        shared = np.minimum(last, start + length - 1) - np.maximum(first, start) + 1
        score = int(shared[shared > MIN_RUN].sum())
        if score > count:
            best, count = start, score
    end = best + length
    shared = np.minimum(last, end - 1) - np.maximum(first, best) + 1
    return slice(best, end), np.flatnonzero(shared >= min(MIN_RUN, length))


def _window(
    positions: FloatArray, tracklets: Tracklets, runs: IntArray, frames: slice
) -> FloatArray:
    """Return the positions of some runs in some frames ``(F, R, 3)``."""
    ids = tracklets.ids[frames]
    column = np.full(len(tracklets.first) + 1, -1)
    column[runs] = np.arange(len(runs))
    where = np.where(ids >= 0, column[ids], -1)
    points = np.full((len(ids), len(runs), 3), np.nan)
    frame, slot = np.nonzero(where >= 0)
    points[frame, where[frame, slot]] = positions[frames][frame, slot]
    return points


def _exchange(work: RunLabels, rest: FloatArray) -> None:
    """Exchange names of markers that are near where the shapes then fit better.

    Distances alone do not tell two pairs from their mirror image, handedness does.
    """
    for _ in range(MAX_EXCHANGES):
        new = better_names(work.by_marker(), rest)
        if new is None:
            return
        work.given = np.where(work.given >= 0, new[work.given], -1)

"""Points without names given the names of markers, by a trial at rest and by motion."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any

import numpy as np

from animtool.capture.markers.identify import identify
from animtool.capture.markers.runs import RunLabels
from animtool.capture.markers.tracklets import Tracklets, follow
from animtool.capture.markers.twins import Exchange, exchanged_in, told_apart
from animtool.core.array_types import FloatArray, IntArray
from animtool.core.clock import span_label
from animtool.core.errors import Fault, OptionError, Severity
from animtool.motion.markers import Markers

# Runs that are named first are as long [frame], in a part of a take as long [s].
MIN_RUN = 30
BASE = 10.0


@dataclass(frozen=True, slots=True)
class Doubt:
    """Markers whose names could as well be exchanged.

    Attributes:
        markers: Their names.
        first: First frame in which all of them are seen, from 0.
        last: Last such frame.
        score: How much speaks for the exchange [nat]: 0 where as much as for the names
            that were given, below 0 less.
    """

    markers: tuple[str, ...]
    first: int
    last: int
    score: float


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
        doubts: Markers that neither distances nor shapes tell apart.
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
    doubts: list[Doubt]
    notices: list[Fault] = field(default_factory=list)

    def as_dict(self) -> dict[str, Any]:
        """Return the report as plain values."""
        found = {f.name: getattr(self, f.name) for f in fields(self)}
        found["doubts"] = [asdict(doubt) for doubt in self.doubts]
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
    names_of, exchanges, pairs = told_apart(work.by_marker(), rest)
    work.given = np.where(work.given >= 0, names_of[work.given], -1)
    for pair in pairs:
        _exchange_parts(work, rest, pair)
    work.settle()
    return _labelled(cloud, names, tracklets, work.given, exchanges)


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
    cloud: Markers,
    names: tuple[str, ...],
    tracklets: Tracklets,
    given: IntArray,
    exchanges: list[Exchange],
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
    doubts = _doubts(labelled, exchanges)
    if doubts:
        notices.append(_doubted(doubts, cloud))
    report = LabelReport(
        frames, len(names), points, got, points - got, len(tracklets.first), missing,
        shares, doubts, notices,
    )  # fmt: skip
    return labelled, report


def _doubts(labelled: Markers, exchanges: list[Exchange]) -> list[Doubt]:
    """Return exchanges by name, with the frames in which they would be seen."""
    found = []
    for exchange in exchanges:
        markers = list(exchange.markers)
        seen = np.flatnonzero(labelled.seen[:, markers].all(axis=1))
        if len(seen):
            names = tuple(labelled.names[marker] for marker in markers)
            score = round(exchange.score, 3)
            found.append(Doubt(names, int(seen[0]), int(seen[-1]), score))
    return found


def _doubted(doubts: list[Doubt], cloud: Markers) -> Fault:
    """Return the warning that some markers are not told apart."""
    parts = []
    for doubt in doubts:
        first, last = cloud.clock.times[[doubt.first, doubt.last]]
        parts.append(f"{', '.join(doubt.markers)} (frames {span_label(first, last)})")
    message = (
        "the names given could as well be exchanged, by distances and shapes: "
        + "; ".join(parts)
    )
    hint = "look at a frame; a trial whose pose is nearer to the take tells them apart"
    return Fault("MKR116", message, hint=hint, severity=Severity.WARNING)


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


def _exchange_parts(work: RunLabels, rest: FloatArray, pair: tuple[int, int]) -> None:
    """Exchange two names in the parts of a take in which shapes say so.

    A part ends where a gap of both markers lets nothing tell whose runs go on.
    """
    runs = np.flatnonzero(np.isin(work.given, pair))
    first, last = work.tracklets.first, work.tracklets.last
    runs = runs[np.argsort(first[runs], kind="stable")]
    ends = np.maximum.accumulate(last[runs])
    parts = np.split(runs, np.flatnonzero(first[runs][1:] > ends[:-1]) + 1)
    if len(parts) < 2:
        return
    marked = work.by_marker()
    for part in parts:
        frames = slice(int(first[part].min()), int(last[part].max()) + 1)
        if exchanged_in(marked[frames], rest, pair):
            work.given[part] = sum(pair) - work.given[part]

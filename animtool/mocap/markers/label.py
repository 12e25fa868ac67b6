"""Points without names given the names of markers, by a trial at rest and by motion."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from animtool._types import BoolArray, FloatArray, IntArray
from animtool.errors import Fault, OptionError, Severity
from animtool.markers import Markers
from animtool.mocap.markers.exchange import better_names
from animtool.mocap.markers.geometry import Distances, distances, fitted
from animtool.mocap.markers.tracklets import Tracklets, follow

# Between two runs that are seen together: fewer frames say little of their distance.
MIN_COMMON = 20
# Runs that are named first are as long [frame], in a part of a take as long [s].
MIN_RUN = 30
BASE = 10.0
# A distance that varies less is one within a segment [m].
RIGID = 0.006
# By so much a distance may be off that of the trial: noise, and skin over bone [m].
TOLERANCE = 0.006
# The same of a group of four that is named first.
SEED = 0.003
# How far markers that are not on one segment may be off, of how much they vary.
SPREADS = 1.5
# What a pair may count at most, so that one that is wrong does not decide.
WORST = 9.0
# Weight of a distance falls with how much it varies [m].
WEIGHT_SPREAD = 0.02
# Points apart say less of which marker each is [m].
WEIGHT_FAR = 0.25
# A joint between two markers changes their distance by such a share of it, and [m]; a
# pair that has to bend for its distance counts as much as this off.
PLAY, PLAY_LEAST, ARTICULATED = 0.35, 0.03, 1.5
# Frames of a run that are looked at.
SAMPLES = 24
# Mean cost above which a run is no marker.
GHOST = 4.0
# Between the best name and the second best one, for a run that is named early.
MARGIN = 1.5
# A run is joined to one before or after it over this long a gap [s].
BRIDGE = 0.3
MAX_CLIQUES = 400
MAX_EXCHANGES = 12
# How often what was learnt of distances is learnt anew.
ROUNDS = 2
# How a marker moves over a gap [m], [m/s^2], [m/s], and what that counts at most.
NOISE, ACCELERATION, DRIFT, MAX_JUMP = 0.004, 60.0, 0.3, 2.0
# Weights of distances to what is known, all together: fewer name nothing, and more
# than this are no better.
LEAST_SHARE, FULL_SHARE = 0.05, 3.0


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
    tracklets = follow(cloud.positions, float(cloud.clock.rate))
    work = _Work(cloud.positions, tracklets, rest, float(cloud.clock.rate))
    given = work.solve()
    if given is None:
        message = "no group of points moves like one of the trial's segments"
        hint = "is it of the same subject, with the same markers and unit?"
        raise OptionError(Fault("MKR021", message, hint=hint))
    return _labelled(cloud, names, tracklets, given)


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

    def chosen(
        values: FloatArray | IntArray | BoolArray | None, empty: float
    ) -> object:
        if values is None:
            return None
        picked = np.take_along_axis(
            values,
            np.maximum(slots, 0).reshape(slots.shape + (1,) * (values.ndim - 2)),
            1,
        )
        gone = (slots < 0).reshape(slots.shape + (1,) * (values.ndim - 2))
        return np.where(gone, np.asarray(empty, values.dtype), picked)

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
    missing = [
        n for n, share in zip(names, coverage.tolist(), strict=True) if not share
    ]
    notices = []
    if missing:
        message = f"no points were found for {', '.join(missing)}"
        notices.append(Fault("MKR110", message, severity=Severity.WARNING))
    report = LabelReport(
        frames, len(names), points, got, points - got, len(tracklets.first), missing,
        dict(zip(names, coverage.tolist(), strict=True)), notices,
    )  # fmt: skip
    return labelled, report


class _Work:
    """Runs of a cloud, and which marker each is."""

    def __init__(
        self, positions: FloatArray, tracklets: Tracklets, rest: FloatArray, rate: float
    ) -> None:
        self.positions, self.tracklets, self.rate = positions, tracklets, rate
        apart = np.linalg.norm(rest[:, None] - rest[None], axis=-1)
        self.shape = rest
        # Before motion was seen, a distance is that of the trial, and may vary.
        self.rest = Distances(apart, np.full(apart.shape, np.nan))
        self.runs = len(tracklets.first)
        self.given = np.full(self.runs, -1)

    def solve(self) -> IntArray | None:
        """Return which marker each run is, -1 for none; None where nothing fits."""
        begin, runs = self._base()
        points = self._window(runs, begin)
        found = _identify(points, self.shape, self.rest.mean)
        if found is None:
            return None
        self.given[runs] = found
        self._exchange()
        self._extend()
        return self.given

    def _base(self) -> tuple[slice, IntArray]:
        """Return the frames that are looked at first, and their longer runs."""
        first, last = self.tracklets.first, self.tracklets.last
        frames = len(self.positions)
        length = min(frames, max(MIN_COMMON, int(BASE * self.rate)))
        best, count = 0, -1
        for start in range(0, frames - length + 1, max(1, length // 4)):
            shared = np.minimum(last, start + length - 1) - np.maximum(first, start) + 1
            score = int(shared[shared > MIN_COMMON].sum())
            if score > count:
                best, count = start, score
        end = best + length
        shared = np.minimum(last, end - 1) - np.maximum(first, best) + 1
        return slice(best, end), np.flatnonzero(shared >= min(MIN_RUN, length))

    def _window(self, runs: IntArray, frames: slice) -> FloatArray:
        """Return the positions of some runs in some frames ``(F, R, 3)``."""
        ids = self.tracklets.ids[frames]
        column = np.full(self.runs + 1, -1)
        column[runs] = np.arange(len(runs))
        where = np.where(ids >= 0, column[ids], -1)
        points = np.full((len(ids), len(runs), 3), np.nan)
        frame, slot = np.nonzero(where >= 0)
        points[frame, where[frame, slot]] = self.positions[frames][frame, slot]
        return points

    def _by_marker(self) -> FloatArray:
        """Return the positions that have a name ``(F, M, 3)``."""
        ids = self.tracklets.ids
        marker = np.where(ids >= 0, self.given[ids], -1)
        points = np.full((len(ids), len(self.shape), 3), np.nan)
        frame, slot = np.nonzero(marker >= 0)
        points[frame, marker[frame, slot]] = self.positions[frame, slot]
        return points

    def _exchange(self) -> None:
        """Exchange names of markers that are near where the shapes then fit better.

        Distances alone do not tell two pairs from their mirror image, handedness does.
        """
        for _ in range(MAX_EXCHANGES):
            new = better_names(self._by_marker(), self.shape)
            if new is None:
                return
            self.given = np.where(self.given >= 0, new[self.given], -1)

    def _extend(self) -> None:
        """Name the other runs, those that are clearest first."""
        for _ in range(ROUNDS):
            self._relearn()
            self._reject()
            while self._step(forced=False) or self._step(forced=True):
                pass
        self._relearn()
        self._reject()

    def _relearn(self) -> None:
        """Take what the runs that have a name say of distances, and forget costs."""
        self.marked = self._by_marker()
        self.learnt = _learnt(self.rest, distances(self.marked))
        self.costs = np.full((self.runs, len(self.shape)), np.inf)
        self.stale = np.ones(self.runs, bool)

    def _reject(self) -> None:
        """Take the name from runs that are not where their marker would be."""
        for run in np.flatnonzero(self.given >= 0).tolist():
            marker = int(self.given[run])
            begin, end, path = self._span(run)
            cost = self._shape_costs(path, begin, end)[marker]
            if cost > GHOST:
                self.given[run] = -1
                self.marked[begin:end, marker] = np.nan

    def _step(self, *, forced: bool) -> bool:
        """Name runs by those that have a name; return whether there were any."""
        for run in np.flatnonzero(self.stale & (self.given < 0)).tolist():
            self.costs[run] = self._costs(run)
        self.stale[:] = False
        runs = np.flatnonzero(self.given < 0)
        if not len(runs):
            return False
        order = np.partition(self.costs[runs], 1, axis=1)
        best, rival = order[:, 0], order[:, 1]
        clear = best < GHOST
        if not forced:
            clear &= rival > np.where(clear, best, 0.0) + MARGIN
        named = np.zeros((0, 2), np.int64)
        first, last = self.tracklets.first, self.tracklets.last
        reach = int(BRIDGE * self.rate)
        for row in np.argsort(best, kind="stable").tolist():
            if not clear[row]:
                continue
            run = int(runs[row])
            marker = int(self.costs[run].argmin())
            touched = (named[:, 0] <= last[run]) & (named[:, 1] >= first[run])
            if touched.any() if forced else not self._is_free(run, marker):
                continue
            self.given[run] = marker
            begin, end, path = self._span(run)
            self.marked[begin:end, marker] = path
            named = np.vstack([named, (begin - reach, end + reach)])
        for begin, end in named.tolist():
            self.stale |= (first <= end) & (last >= begin)
        return len(named) > 0

    def _is_free(self, run: int, marker: int) -> bool:
        begin, end = int(self.tracklets.first[run]), int(self.tracklets.last[run]) + 1
        return not np.isfinite(self.marked[begin:end, marker, 0]).any()

    def _span(self, run: int) -> tuple[int, int, FloatArray]:
        """Return the frames of a run, and its positions."""
        begin, end = int(self.tracklets.first[run]), int(self.tracklets.last[run]) + 1
        return begin, end, self.tracklets.trajectory(self.positions, run)

    def _costs(self, run: int) -> FloatArray:
        """Return how badly a run fits each marker; infinite where it is taken."""
        begin, end, path = self._span(run)
        cost = self._shape_costs(path, begin, end) + self._jumps(path, begin, end)
        cost[np.isfinite(self.marked[begin:end, :, 0]).any(axis=0)] = np.inf
        return cost

    def _shape_costs(self, path: FloatArray, begin: int, end: int) -> FloatArray:
        """Return how far a run is from where each marker would be, by distances."""
        sample = np.unique(np.linspace(0, end - begin - 1, SAMPLES).astype(np.int64))
        others = self.marked[begin + sample]
        apart = np.linalg.norm(others - path[sample][:, None], axis=-1)  # (S, M)
        # The run itself may have a name already.
        known = np.isfinite(apart) & (apart > 0.0)
        spread = self.learnt.spread
        weight = np.nan_to_num(1.0 / (1.0 + (spread / WEIGHT_SPREAD) ** 2))
        np.fill_diagonal(weight, 0.0)
        allowed = TOLERANCE + SPREADS * spread
        off = (np.nan_to_num(apart)[:, None] - self.learnt.mean[None]) / allowed[None]
        worth = np.minimum(np.nan_to_num(off) ** 2, WORST)
        weights = weight[None] * known[:, None]
        share = weights.sum(axis=(0, 2))
        total = (worth * weights).sum(axis=(0, 2))
        return np.where(share > 0, total / np.maximum(share, 1e-9), np.inf)

    def _jumps(self, path: FloatArray, begin: int, end: int) -> FloatArray:
        """Return how far a run is from where each marker was before and will be."""
        reach = int(BRIDGE * self.rate)
        before = self.marked[max(begin - reach, 0) : begin][::-1]
        after = self.marked[end : end + reach]
        cost = np.zeros(len(self.shape))
        for window, point in ((before, path[0]), (after, path[-1])):
            seen = np.isfinite(window[..., 0])
            for marker in np.flatnonzero(seen.any(axis=0)).tolist():
                gap = int(seen[:, marker].argmax())
                at, speed = window[gap, marker], np.zeros(3)
                if gap + 3 < len(window) and seen[gap + 3, marker]:
                    speed = (at - window[gap + 3, marker]) / 3.0
                off = np.linalg.norm(point - at - speed * (gap + 1))
                time = (gap + 1) / self.rate
                allowed = NOISE + 0.5 * ACCELERATION * time**2 + DRIFT * time
                cost[marker] += (off / allowed) ** 2
        return np.minimum(cost, MAX_JUMP)


def _learnt(rest: Distances, moving: Distances) -> Distances:
    """Return distances of the take, and where it shows none, those of the trial."""
    known = np.isfinite(moving.mean)
    # Of what was not seen together, only that near markers stay near is known.
    usual = 0.25 * rest.mean
    mean = np.where(known, moving.mean, rest.mean)
    return Distances(mean, np.where(known, moving.spread, usual))


def _identify(
    points: FloatArray, shape: FloatArray, rest: FloatArray
) -> IntArray | None:
    """Return which marker each run of a window is ``(R,)``; None where nothing fits."""
    moving = distances(points)
    seen = np.isfinite(points[..., 0]).astype(np.float64)
    together = seen.T @ seen > 0
    seeds = _seeds(points, moving, shape, rest)
    given = _agreeing(seeds, together)
    return _grown(given, moving, rest, together) if given else None


def _agreeing(
    seeds: list[list[tuple[int, int]]], together: BoolArray
) -> dict[int, int]:
    """Return the markers of groups that do not contradict each other, best first."""
    given: dict[int, int] = {}
    for pairs in seeds:
        merged = dict(pairs)
        known = [(run, given[run]) for run, _ in pairs if run in given]
        if any(merged[run] != marker for run, marker in known):
            continue
        both = given | merged
        runs = np.array(list(both))
        markers = np.array(list(both.values()))
        clash = together[np.ix_(runs, runs)] & (markers[:, None] == markers)
        np.fill_diagonal(clash, False)
        if not clash.any():
            given = both
    return given


def _seeds(
    points: FloatArray, moving: Distances, shape: FloatArray, rest: FloatArray
) -> list[list[tuple[int, int]]]:
    """Return groups of rigid runs with the markers that they may be, best first."""
    count = len(moving.mean)
    rigid = (moving.spread < RIGID) & np.isfinite(moving.mean)
    np.fill_diagonal(rigid, False)
    groups = []
    for group in combinations(range(count), 4):
        i, j, k, m = group
        if not (rigid[i, j] and rigid[i, k] and rigid[j, k]):
            continue
        if rigid[i, m] and rigid[j, m] and rigid[k, m]:
            groups.append(group)
        if len(groups) >= MAX_CLIQUES:
            break
    found = []
    for group in groups:
        for markers in _matches(group, moving.mean, rest):
            off = _misfit(points[:, group], shape[list(markers)])
            if off < SEED:
                pairs = list(zip(group, markers, strict=True))
                found.append((off, pairs))
    found.sort(key=lambda entry: entry[0])
    return [pairs for _, pairs in found]


def _matches(
    group: tuple[int, ...], apart: FloatArray, rest: FloatArray
) -> list[tuple[int, ...]]:
    """Return the markers whose distances at rest are those of a group of runs."""
    partial = [(marker,) for marker in range(len(rest))]
    for k in range(1, len(group)):
        longer = []
        for markers in partial:
            off = np.zeros(len(rest))
            for earlier, marker in enumerate(markers):
                distance = apart[group[k], group[earlier]]
                off = np.maximum(off, np.abs(rest[:, marker] - distance))
            off[list(markers)] = np.inf
            fitting = np.flatnonzero(off < TOLERANCE)
            longer += [(*markers, marker) for marker in fitting.tolist()]
        partial = longer
    return partial


def _misfit(points: FloatArray, shape: FloatArray) -> float:
    """Return how far a shape is off points, mirrored ones included [m]."""
    whole = points[np.isfinite(points).all(axis=(1, 2))][::8]
    if not len(whole):
        return np.inf
    rotation, shift = fitted(whole, shape)
    fit = np.einsum("fij,kj->fki", rotation, shape) + shift[:, None]
    return float(np.sqrt(np.median(((fit - whole) ** 2).sum(axis=-1).mean(axis=1))))


def _grown(
    given: dict[int, int], moving: Distances, rest: FloatArray, together: BoolArray
) -> IntArray:
    """Return markers of all runs that fit, found one by one from a few that are known.

    The run that fits one marker best, and by far, comes first. Runs that are seen
    together are not the same marker.
    """
    count, markers = len(moving.mean), len(rest)
    weight = 1.0 / (1.0 + (moving.spread / WEIGHT_SPREAD) ** 2)
    weight = np.nan_to_num(weight / (1.0 + (moving.mean / WEIGHT_FAR) ** 2))
    allowed = TOLERANCE + SPREADS * moving.spread
    total = np.zeros((count, markers))
    share = np.zeros(count)
    barred = np.zeros((count, markers), bool)
    found = np.full(count, -1)
    waiting = list(given.items())
    while True:
        for run, marker in waiting:
            found[run] = marker
            off = np.nan_to_num(rest[marker][None] - moving.mean[run][:, None])
            loose = ARTICULATED + (off / (PLAY * rest[marker] + PLAY_LEAST)) ** 2
            cost = np.minimum((off / allowed[run][:, None]) ** 2, loose)
            cost = np.minimum(np.nan_to_num(cost), WORST)
            total += weight[run][:, None] * cost
            share += weight[run]
            barred[together[run], marker] = True
        mean = total / np.maximum(share, 1e-9)[:, None]
        mean[barred] = np.inf
        mean[(found >= 0) | (share <= LEAST_SHARE)] = np.inf
        order = np.sort(mean, axis=1)
        finite = np.isfinite(order[:, 0])
        rival = np.minimum(order[:, 1], order[:, 0] + WORST, where=finite,
                           out=np.zeros(count))  # fmt: skip
        margin = np.where(finite, rival - np.where(finite, order[:, 0], 0.0), -1.0)
        worth = np.where(
            order[:, 0] < GHOST, margin * np.minimum(share, FULL_SHARE), -1
        )
        run = int(worth.argmax())
        if worth[run] <= 0.0:
            return found
        waiting = [(run, int(mean[run].argmin()))]

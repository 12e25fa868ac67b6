"""Repair of temporarily exchanged marker names."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from animtool.capture.markers.geometry import MarkerDistances, distances
from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.maths.runs import merge_runs, runs
from animtool.motion.markers import Markers

# Least frames of an exchange; a shorter one is a spike.
MIN_SWAP = 4
# Tolerance of an extrapolated position: noise [m], acceleration of a marker without a
# history [m/s^2], and its speed [m/s]. Otherwise the acceleration is a multiple of the
# marker's median, at least the minimum [m/s^2].
NOISE, DEFAULT_ACCELERATION, SPEED = 0.003, 100.0, 3.0
MIN_ACCELERATION, ACCELERATION_FACTOR = 20.0, 6.0
# A marker on a throwing hand: candidates within reach are tested [m/s^2].
MAX_ACCELERATION = 500.0
# Longest gap over which a marker's position is predicted [s].
BRIDGE = 0.1
# Samples that give the speed.
PAST = 3
# A jump goes to another marker's position if it is this many times nearer.
NEARER = 2.5
# Cost of a position that is anywhere, of a change of names, and of a frame that is
# exchanged: where nothing else tells, the shorter part is.
ANYWHERE, CHANGE, FRAME = 16.0, 5.0, 0.002
# Distances to the other markers say less than positions from frame to frame: what they
# say of a span counts at most, and how many frames of it are looked at.
SHAPE, SAMPLES = 4.0, 24
# By so much a distance may be off, noise and skin [m], and of how much it varies.
TOLERANCE, SPREADS = 0.006, 1.5
# How much likelier an exchange has to be than none, as a logarithm.
CLEAR = 2.0


@dataclass(frozen=True, slots=True)
class Swap:
    """A span of frames in which two markers had each other's names.

    Attributes:
        markers: The two, in the order of the file.
        first: First frame, from 0.
        last: Last frame.
    """

    markers: tuple[str, str]
    first: int
    last: int


def repair_swaps(markers: Markers) -> tuple[Markers, list[Swap]]:
    """Return markers with exchanged spans repaired, and the swaps.

    A pair of markers, one of which jumps to the other's expected position, is tested
    over the full take: of all ways to exchange them in spans of frames, the one is
    chosen in which both move most smoothly and keep their typical distances to the
    others.
    """
    swaps: list[Swap] = []
    count = len(markers.names)
    if count < 2 or not markers.visible.any():
        return markers, swaps
    rate = float(markers.clock.rate)
    positions = markers.positions.copy()
    source = np.tile(np.arange(count), (len(markers), 1))
    lengths: MarkerDistances | None = None
    crossings: dict[tuple[int, int], tuple[float, BoolArray]] = {}
    done: set[tuple[int, int]] = set()
    while True:
        for a, b in _pairs(positions, rate):
            if (a, b) not in crossings and (a, b) not in done:
                lengths = lengths or distances(positions)
                crossings[a, b] = _crossed(positions, a, b, rate, lengths)
        # The clearest first: among three markers it decides the others.
        best = max(crossings, key=lambda pair: (crossings[pair][0], pair), default=None)
        if best is None or crossings[best][0] < CLEAR:
            break
        pair = list(best)
        for first, last in _spans(crossings[best][1], positions[:, pair]):
            swaps.append(
                Swap((markers.names[pair[0]], markers.names[pair[1]]), first, last)
            )
            span = slice(first, last + 1)
            positions[span, pair] = positions[span, pair[::-1]]
            source[span, pair] = source[span, pair[::-1]]
        done.add(best)
        crossings = {
            other: of for other, of in crossings.items() if not set(other) & set(best)
        }
    swaps.sort(key=lambda swap: (swap.first, swap.markers))
    return (_taken(markers, source) if swaps else markers), swaps


def _expected(
    positions: FloatArray, rate: float, acceleration: float = DEFAULT_ACCELERATION
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return each marker's expected position, its tolerance [m], and validity.

    It is extrapolated linearly from the last visible frames.
    """
    frames, count, _ = positions.shape
    visible = np.isfinite(positions[..., 0])
    rows = np.arange(frames)[:, None]
    last = np.maximum.accumulate(np.where(visible, rows, -1), axis=0)
    last = np.vstack([np.full((1, count), -1), last[:-1]])
    columns = np.arange(count)
    age = rows - last
    known = (last >= 0) & (age <= BRIDGE * rate + 1)
    at = positions[np.maximum(last, 0), columns]
    speed = np.zeros_like(at)
    has = np.zeros(visible.shape, bool)
    for back in range(1, PAST):
        earlier = positions[np.maximum(last - back, 0), columns]
        # The farthest sample of a gapless run gives the speed.
        ok = (last >= back) & np.isfinite(earlier[..., 0]) & (has | (back == 1))
        speed[ok] = (at[ok] - earlier[ok]) / back
        has = ok if back == 1 else has
    time = age / rate
    allowed = NOISE + 0.5 * acceleration * time**2 + np.where(has, 0.0, SPEED * time)
    return at + speed * age[..., None], allowed, known


def _pairs(positions: FloatArray, rate: float) -> list[tuple[int, int]]:
    """Return pairs of which one jumps to the other's position, most frequent first."""
    expected, allowed, known = _expected(positions, rate)
    visible = np.isfinite(positions[..., 0])
    off = np.linalg.norm(positions - expected, axis=-1)
    goes_on = visible & known & (off <= allowed)
    counts: dict[tuple[int, int], int] = {}
    frame, marker = np.nonzero(visible & ~goes_on)
    points = positions[frame, marker]
    away = np.linalg.norm(points[:, None] - expected[frame], axis=-1)
    miss = np.where(known, off, np.inf)[frame, marker]
    reach = allowed * (MAX_ACCELERATION / DEFAULT_ACCELERATION)
    there = known[frame] & (away <= reach[frame]) & ~goes_on[frame]
    there &= NEARER * away < miss[:, None]
    there[np.arange(len(marker)), marker] = False
    for k, other in np.argwhere(there).tolist():
        pair = tuple(sorted((int(marker[k]), other)))
        counts[pair] = counts.get(pair, 0) + 1  # type: ignore[index,arg-type]
    return sorted(counts, key=lambda pair: (-counts[pair], pair))


@dataclass(frozen=True, slots=True)
class _Path:
    """One way to exchange two markers, up to a frame.

    Attributes:
        cost: Negative log-likelihood.
        state: 1 if it ends exchanged, else 0.
        changes: Frames in which it changes.
        past: Last visible frames and positions of both markers.
    """

    cost: float
    state: int
    changes: tuple[int, ...]
    past: tuple[list[Any], list[Any]]


def _crossed(
    positions: FloatArray, a: int, b: int, rate: float, lengths: MarkerDistances
) -> tuple[float, BoolArray]:
    """Return the frames in which two markers have each other's names ``(F,)``.

    Also returns the log-likelihood gain over no exchange.

    Viterbi search: of the paths that end straight and those that end crossed, the best
    is kept from frame to frame, with the last visible positions of both markers.
    """
    both = positions[:, [a, b]]
    visible = np.isfinite(both[..., 0])
    acceleration = _acceleration(both, rate)
    expected, allowed, known = _expected(both, rate, acceleration)
    off = np.linalg.norm(both - expected, axis=-1)
    smooth = ~visible | (known & (off <= allowed))
    # In frames without events, both keep their names.
    same = np.vstack([np.zeros((1, 2), bool), visible[1:] == visible[:-1]])
    events = np.flatnonzero(~(smooth & same).all(axis=1)).tolist()
    events = sorted({0, *events})
    ends = [*events[1:], len(both)]
    never = _Path(0.0, 0, (), ([], []))
    paths = [never, _Path(CHANGE, 1, (0,), ([], []))]
    points: list[list[Any]] = [
        [at if has else None for at, has in zip(row, there, strict=True)]
        for row, there in zip(both.tolist(), visible.tolist(), strict=True)
    ]
    for start, end in zip(events, ends, strict=True):
        shape = _shape(positions, a, b, start, end, lengths)
        length = int(visible[start:end].any(axis=1).sum())
        worth = max(0.0, shape), max(0.0, -shape) + FRAME * length

        def later(
            path: _Path,
            state: int,
            start: int = start,
            end: int = end,
            worth: tuple[float, float] = worth,
        ) -> _Path:
            cost, changes, past = path.cost + worth[state], path.changes, path.past
            if state != path.state:
                cost, changes = cost + CHANGE, (*changes, start)
            pasts = []
            for marker in (0, 1):
                point = points[start][marker ^ state]
                if start and point is not None:
                    cost += _off(past[marker], start, point, rate, acceleration)
                new = [
                    (frame, points[frame][marker ^ state])
                    for frame in range(max(start, end - PAST), end)
                    if points[frame][marker ^ state] is not None
                ]
                pasts.append([*past[marker], *new][-PAST:])
            return _Path(cost, state, changes, (pasts[0], pasts[1]))

        never = later(never, 0)
        if start == 0:
            paths = [later(path, path.state) for path in paths]
        else:
            paths = [
                min((later(path, state) for path in paths), key=lambda path: path.cost)
                for state in (0, 1)
            ]
    best = min(paths, key=lambda path: path.cost)
    crossed = np.zeros(len(both), np.int64)
    for change in best.changes:
        crossed[change:] ^= 1
    return never.cost - best.cost, crossed.astype(bool)


def _acceleration(both: FloatArray, rate: float) -> float:
    """Return the typical largest acceleration of two markers [m/s^2]."""
    bent = np.linalg.norm(np.diff(both, 2, axis=0), axis=-1)
    known = bent[np.isfinite(bent)]
    if not len(known):
        return DEFAULT_ACCELERATION
    return float(
        np.clip(
            ACCELERATION_FACTOR * np.median(known) * rate**2,
            MIN_ACCELERATION,
            DEFAULT_ACCELERATION,
        )
    )


def _off(
    past: list[Any], frame: int, point: list[float], rate: float, acceleration: float
) -> float:
    """Return the cost of a position after those visible before.

    It is a negative log-likelihood, bounded by that of an arbitrary position.
    """
    if not past:
        return ANYWHERE
    last, at = past[-1]
    age = frame - last
    begin, first = next(entry for entry in past if last - entry[0] < PAST)
    run = last - begin
    ratio = age / run if run else 0.0
    square: float = sum(
        (p - x - ratio * (x - y)) ** 2 for p, x, y in zip(point, at, first, strict=True)
    )
    time = age / rate
    allowed = NOISE + 0.5 * acceleration * time**2 + (0.0 if run else SPEED * time)
    volume = 3.0 * math.log(allowed / NOISE)
    cost: float = 0.5 * square / allowed**2 + volume
    return min(cost, ANYWHERE)


def _shape(
    positions: FloatArray,
    a: int,
    b: int,
    start: int,
    end: int,
    known_lengths: MarkerDistances,
) -> float:
    """Return how much better an exchange fits distances to the other markers."""
    if end - start < MIN_SWAP:
        return 0.0
    frames = np.unique(np.linspace(start, end - 1, SAMPLES).astype(np.int64))
    others = np.setdiff1d(np.arange(positions.shape[1]), (a, b))
    better = []
    for one, other in ((a, b), (b, a)):
        lengths = np.linalg.norm(
            positions[frames][:, others] - positions[frames, one][:, None], axis=-1
        )
        worth = []
        for marker in (one, other):
            spread = known_lengths.spread[marker, others]
            mean = known_lengths.mean[marker, others]
            off = (lengths - mean) / (TOLERANCE + SPREADS * spread)
            worth.append(np.minimum(off**2, 9.0))
        known = np.isfinite(worth[0] - worth[1])
        if known.any():
            scale = TOLERANCE + np.minimum(
                known_lengths.spread[one, others], known_lengths.spread[other, others]
            )
            weight = np.where(known, (TOLERANCE / scale) ** 2, 0.0)
            gain = np.where(known, worth[0] - worth[1], 0.0)
            if weight.sum() > 0:
                better.append(float((weight * gain).sum() / weight.sum()))
    return float(np.clip(SHAPE * sum(better), -SHAPE, SHAPE)) if better else 0.0


def _spans(crossed: BoolArray, both: FloatArray) -> list[tuple[int, int]]:
    """Return first and last frames of crossed spans that are long enough.

    One that begins or ends while neither is visible does so in the middle of that gap.
    """
    visible = np.asarray(np.isfinite(both[..., 0]).any(axis=1))
    spans = []
    # A few straight frames between crossed ones are a spike.
    for first, end in merge_runs(runs(crossed), MIN_SWAP):
        frames = first + np.flatnonzero(visible[first:end])
        if len(frames) < MIN_SWAP:
            continue
        before = np.flatnonzero(visible[: frames[0]])
        after = np.flatnonzero(visible[frames[-1] + 1 :])
        begin, last = int(frames[0]), int(frames[-1])
        if len(before):
            begin = (
                (int(before[-1]) + begin) // 2 + 1 if before[-1] < begin - 1 else begin
            )
        if len(after):
            last += int(after[0]) // 2
        spans.append((begin, last))
    return spans


def _taken(markers: Markers, source: IntArray) -> Markers:
    """Return markers with values taken from other columns ``(F, M)``."""

    def exchanged(values: Any) -> Any:
        return None if values is None else np.take_along_axis(values, source, 1)

    return replace(
        markers,
        positions=np.take_along_axis(markers.positions, source[..., None], 1),
        cameras=exchanged(markers.cameras),
        residuals=exchanged(markers.residuals),
        filled=exchanged(markers.filled),
    )

"""Points of a cloud tracked over time, without names."""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.record import dataclass

# A marker on a throwing hand accelerates by about 100 g [m/s^2].
MAX_ACCELERATION = 1000.0
# Noise of two positions, and of the speed between them [m].
NOISE = 0.004
# Largest speed of a marker [m/s]: the reach of a new point.
MAX_SPEED = 12.0
# Past frames that predict the next position.
PAST = 3


@dataclass(frozen=True, slots=True)
class Tracklets:
    """Points of a cloud joined to gapless runs.

    Attributes:
        ids: Run of each point in each frame ``(F, P)``; -1 if not visible.
        first: First frame of each run ``(T,)``.
        last: Last frame of each run ``(T,)``.
    """

    ids: IntArray
    first: IntArray
    last: IntArray

    def trajectory(self, positions: FloatArray, run: int) -> FloatArray:
        """Return the positions of a run from first to last frame ``(L, 3)``."""
        frames = slice(int(self.first[run]), int(self.last[run]) + 1)
        slots = (self.ids[frames] == run).argmax(axis=1)
        return np.asarray(positions[frames][np.arange(len(slots)), slots])


def follow(positions: FloatArray, rate: float) -> Tracklets:
    """Return the runs of points, tracked frame by frame.

    A point continues a run if each is the other's nearest, within what a marker may
    accelerate, and clearly nearer than any second one. Ambiguities end a run: labelling
    joins runs again, also over gaps.

    positions: ``(F, P, 3)`` [m]. rate: [frame/s].
    """
    from scipy.spatial.distance import cdist

    frames, count, _ = positions.shape
    visible = np.asarray(np.isfinite(positions).all(axis=-1))
    ids = np.full((frames, count), -1)
    first: list[int] = []
    last: list[int] = []
    reach = NOISE + MAX_ACCELERATION / rate**2
    fresh = NOISE + MAX_SPEED / rate
    past = np.zeros((0, PAST, 3))  # latest positions of the open runs, newest first
    age = np.zeros(0, np.int64)
    open_runs = np.zeros(0, np.int64)
    for frame in range(frames):
        slots = np.flatnonzero(visible[frame])
        points = positions[frame, slots]
        expected, radius = _expected(past, age, reach, fresh)
        near = cdist(expected, points) / radius[:, None]
        run, point = _mutual(near)
        taken = np.full(len(slots), -1)
        taken[point] = run
        old = taken >= 0
        new_runs = np.arange(int((~old).sum())) + len(first)
        numbers = np.empty(len(slots), np.int64)
        numbers[old] = open_runs[taken[old]]
        numbers[~old] = new_runs
        first += [frame] * len(new_runs)
        last += [frame] * len(new_runs)
        for number in numbers[old].tolist():
            last[number] = frame
        ids[frame, slots] = numbers
        before = np.zeros((len(slots), PAST, 3))
        before[:, 0] = points
        before[old, 1:] = past[taken[old], :-1]
        grown = np.ones(len(slots), np.int64)
        grown[old] = np.minimum(age[taken[old]] + 1, PAST)
        past, age, open_runs = before, grown, numbers
    return Tracklets(ids, np.array(first, np.int64), np.array(last, np.int64))


def _expected(
    past: FloatArray, age: IntArray, reach: float, fresh: float
) -> tuple[FloatArray, FloatArray]:
    """Return each run's expected next position, and its tolerance [m]."""
    now, one, two = past[:, 0], past[:, 1], past[:, 2]
    linear = 2.0 * now - one
    # Halfway to a parabola: a full one has seven times the noise.
    curved = 0.5 * (linear + 3.0 * now - 3.0 * one + two)
    expected = np.where(
        (age >= 3)[:, None], curved, np.where((age == 2)[:, None], linear, now)
    )
    return expected, np.where(age == 1, fresh, reach)


# A second candidate is no rival if it is this many times farther.
CLEAR = 2.0
# Positions nearer than this fraction of the reach are equal.
CERTAIN = 0.05


def _mutual(near: FloatArray) -> tuple[IntArray, IntArray]:
    """Return pairs of run and point that are mutually nearest, without rivals.

    near: Distances over the tolerance ``(R, P)``.
    """
    if not near.size:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    by_run = near.argmin(axis=1)
    by_point = near.argmin(axis=0)
    run = np.flatnonzero(by_point[by_run] == np.arange(len(near)))
    point = by_run[run]
    best = near[run, point]
    rival = np.minimum(_second(near)[run], _second(near.T)[point])
    sure = (best <= 1.0) & (rival > CLEAR * np.maximum(best, CERTAIN))
    return run[sure], point[sure]


def _second(near: FloatArray) -> FloatArray:
    if near.shape[1] < 2:
        return np.full(len(near), np.inf)
    return np.partition(near, 1, axis=1)[:, 1]

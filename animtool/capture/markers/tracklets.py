"""Tracks the points of a cloud over time, without names."""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.record import dataclass

# A marker on a throwing hand accelerates by about 100 g [m/s^2].
MAX_ACCELERATION = 1000.0
# Noise of two positions, and of the speed between them [m].
STEP_NOISE = 0.004
# Largest speed of a marker [m/s], which limits the reach of a new point.
MAX_SPEED = 12.0
# Number of past frames that predict the next position.
PAST_FRAMES = 3


@dataclass(frozen=True, slots=True)
class Tracklets:
    """Gapless runs of a point cloud: each follows one point from frame to frame."""

    ids: IntArray  # run of each point in each frame ``(F, P)``; -1 if not visible
    first: IntArray  # first frame of each run ``(T,)``
    last: IntArray  # last frame of each run ``(T,)``

    def trajectory(self, positions: FloatArray, run: int) -> FloatArray:
        """Return the positions of a run from first to last frame ``(L, 3)``."""
        frames = slice(int(self.first[run]), int(self.last[run]) + 1)
        indices = (self.ids[frames] == run).argmax(axis=1)
        return np.asarray(positions[frames][np.arange(len(indices)), indices])


def track_points(positions: FloatArray, rate: float) -> Tracklets:
    """Join the points of a cloud to gapless runs, frame by frame.

    A point continues a run if each is the other's nearest, within the reach of a
    marker's acceleration, and clearly nearer than any second candidate. Ambiguous
    points end a run: labelling joins runs again, also over gaps.

    positions: ``(F, P, 3)`` [m]. rate: [frame/s].
    """
    from scipy.spatial.distance import cdist

    frame_count, point_count, _ = positions.shape
    is_visible = np.asarray(np.isfinite(positions).all(axis=-1))
    ids = np.full((frame_count, point_count), -1)
    first: list[int] = []
    last: list[int] = []
    max_step = STEP_NOISE + MAX_ACCELERATION / rate**2
    max_first_step = STEP_NOISE + MAX_SPEED / rate
    # Latest positions of the open runs, newest first.
    past_positions = np.zeros((0, PAST_FRAMES, 3))
    run_ages = np.zeros(0, np.int64)
    open_run_ids = np.zeros(0, np.int64)
    for frame in range(frame_count):
        point_indices = np.flatnonzero(is_visible[frame])
        points = positions[frame, point_indices]
        expected_positions, max_distances = _expected_positions(
            past_positions, run_ages, max_step, max_first_step
        )
        relative_distance = cdist(expected_positions, points) / max_distances[:, None]
        run_rows, point_rows = _mutual_nearest(relative_distance)
        row_of_point = np.full(len(point_indices), -1)
        row_of_point[point_rows] = run_rows
        is_continued = row_of_point >= 0
        new_runs = np.arange(int((~is_continued).sum())) + len(first)
        run_ids = np.empty(len(point_indices), np.int64)
        run_ids[is_continued] = open_run_ids[row_of_point[is_continued]]
        run_ids[~is_continued] = new_runs
        first += [frame] * len(new_runs)
        last += [frame] * len(new_runs)
        for run_id in run_ids[is_continued].tolist():
            last[run_id] = frame
        ids[frame, point_indices] = run_ids
        next_positions = np.zeros((len(point_indices), PAST_FRAMES, 3))
        next_positions[:, 0] = points
        rows = row_of_point[is_continued]
        next_positions[is_continued, 1:] = past_positions[rows, :-1]
        next_ages = np.ones(len(point_indices), np.int64)
        next_ages[is_continued] = np.minimum(run_ages[rows] + 1, PAST_FRAMES)
        past_positions, run_ages, open_run_ids = next_positions, next_ages, run_ids
    return Tracklets(ids, np.array(first, np.int64), np.array(last, np.int64))


def _expected_positions(
    past_positions: FloatArray, ages: IntArray, max_step: float, max_first_step: float
) -> tuple[FloatArray, FloatArray]:
    """Extrapolate each run by one frame: positions ``(R, 3)``, and tolerances [m].

    past_positions: The latest ``(R, 3, 3)``, newest first. ages: How many of them are
    known ``(R,)``.
    """
    current, previous, before_previous = np.moveaxis(past_positions, 1, 0)
    linear_prediction = 2.0 * current - previous
    # Halfway to a parabola: a full parabola has seven times the noise.
    parabola = linear_prediction + 3.0 * current - 3.0 * previous + before_previous
    quadratic_prediction = 0.5 * parabola
    expected_positions = np.where(
        (ages >= 3)[:, None],
        quadratic_prediction,
        np.where((ages == 2)[:, None], linear_prediction, current),
    )
    return expected_positions, np.where(ages == 1, max_first_step, max_step)


# A second candidate is no rival if it is this many times farther away.
MIN_RIVAL_RATIO = 2.0
# Positions nearer than this fraction of the reach are equal.
EQUAL_DISTANCE = 0.05


def _mutual_nearest(distances: FloatArray) -> tuple[IntArray, IntArray]:
    """Return indices of runs and points that are each other's only near candidate.

    distances: Distances over the tolerance ``(R, P)``.
    """
    if not distances.size:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    nearest_point = distances.argmin(axis=1)
    nearest_run = distances.argmin(axis=0)
    run_indices = np.flatnonzero(
        nearest_run[nearest_point] == np.arange(len(distances))
    )
    point_indices = nearest_point[run_indices]
    nearest_distance = distances[run_indices, point_indices]
    second_distance = np.minimum(
        _second_smallest(distances)[run_indices],
        _second_smallest(distances.T)[point_indices],
    )
    rival_distance = MIN_RIVAL_RATIO * np.maximum(nearest_distance, EQUAL_DISTANCE)
    is_clear = (nearest_distance <= 1.0) & (second_distance > rival_distance)
    return run_indices[is_clear], point_indices[is_clear]


def _second_smallest(relative_distance: FloatArray) -> FloatArray:
    """Return the second smallest distance of each row; infinite if it has only one."""
    if relative_distance.shape[1] < 2:
        return np.full(len(relative_distance), np.inf)
    return np.partition(relative_distance, 1, axis=1)[:, 1]

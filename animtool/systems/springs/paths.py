"""Paths of pins and targets, and their teleports."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import fields
from typing import Any, TypeAlias, TypeVar

import numpy as np

from animtool.core.array_types import ArrayLike, BoolArray, FloatArray, IntArray
from animtool.core.errors import Fault, warning
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.maths.faces import rigid_motion
from animtool.systems.springs.body import Body
from animtool.systems.springs.motion import TimeGrid

# Times ``(K,)`` [s], and positions ``(K, P, 3)`` [m].
Path: TypeAlias = tuple[FloatArray, FloatArray]

# Tolerance for a jump at the end of a step [s]: rounding of times.
SLACK = 1e-9


@dataclass(frozen=True, slots=True)
class Pins:
    """Pinned particles and their positions over time.

    Positions are linear between times and constant outside of them.

    Attributes:
        particles: Which ``(P,)``.
        positions: At the times ``(K, P, 3)``, or ``(P, 3)`` if static [m]; None keeps
            the positions of the body.
        times: Ascending ``(K,)`` [s]; None if static.
    """

    particles: ArrayLike
    positions: ArrayLike | None = None
    times: ArrayLike | None = None


@dataclass(frozen=True, slots=True)
class PointTargets:
    """Target points that pull particles by zero-length springs.

    Attributes:
        particles: Pulled particles ``(A,)``; repeats are allowed.
        positions: Of the points at the times ``(K, A, 3)``, or ``(A, 3)`` if static
            [m].
        stiffness: Force over distance, of each or of all [N/m].
        damping: Force over the speed between particle and point, of each or all
            [N s/m].
        times: Ascending ``(K,)`` [s]; None if static.
    """

    particles: ArrayLike
    positions: ArrayLike
    stiffness: ArrayLike
    damping: ArrayLike = 0.0
    times: ArrayLike | None = None


Tied = TypeVar("Tied", Pins, PointTargets)


def over_knots(paths: Sequence[Path]) -> tuple[FloatArray, list[FloatArray]]:
    """Resample paths to shared times: ``(K,)`` [s] and each ``(K or 1, P, 3)`` [m].

    >>> times, (path,) = over_knots([(np.array([0.0, 1.0]), np.zeros((2, 1, 3)))])
    >>> times.tolist(), path.shape
    ([0.0, 1.0], (2, 1, 3))
    """
    moving_times = [times for times, _ in paths if len(times) > 1]
    knots = np.unique(np.concatenate(moving_times)) if moving_times else np.zeros(1)
    resampled = []
    for times, path in paths:
        constant = len(times) == 1
        is_aligned = constant or np.array_equal(times, knots)
        resampled.append(
            np.ascontiguousarray(path if is_aligned else _resampled(times, path, knots))
        )
    return knots, resampled


def combined(ties: Sequence[Tied]) -> Tied | None:
    """Merge pins, or targets, with times into one; None if there are none."""
    if not ties:
        return None
    names = {field.name for field in fields(ties[0])} - {"positions", "times"}
    columns: dict[str, Any] = {
        name: np.concatenate([getattr(tie, name) for tie in ties]) for name in names
    }
    paths: list[Any] = [(tie.times, tie.positions) for tie in ties]
    times, positions = _merged(paths)
    return type(ties[0])(positions=positions, times=times, **columns)


def _merged(paths: Sequence[Path]) -> Path:
    """Concatenate paths along their particles, over shared times."""
    knots, tracks = over_knots(paths)
    rows = [np.broadcast_to(track, (len(knots), *track.shape[1:])) for track in tracks]
    return knots, np.concatenate(rows, axis=1)


def position_at(path: Path, t: float) -> FloatArray:
    """Return positions on a path at a time [s] ``(P, 3)`` [m]."""
    times, positions = path
    row = int(np.clip(np.searchsorted(times, t, "right") - 1, 0, len(times) - 1))
    position: FloatArray = positions[row]
    if times[0] < t < times[-1]:
        fraction = (t - times[row]) / (times[row + 1] - times[row])
        position = position + (positions[row + 1] - position) * fraction
    return position


def reach_of(path: Path) -> tuple[float, float]:
    """Return a path's largest speed [m/s] and distance from its start [m]."""
    times, positions = path
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=2)
    speed = float((steps / np.diff(times)[:, None]).max(initial=0.0))
    return speed, float(
        np.linalg.norm(positions - positions[:1], axis=2).max(initial=0.0)
    )


def _resampled(times: FloatArray, path: FloatArray, knots: FloatArray) -> FloatArray:
    after = np.clip(np.searchsorted(times, knots, "right"), 1, len(times) - 1)
    begin, end = times[after - 1], times[after]
    fraction = np.clip((knots - begin) / (end - begin), 0.0, 1.0)[:, None, None]
    values: FloatArray = path[after - 1] + fraction * (path[after] - path[after - 1])
    return np.where(fraction == 1, path[after], values)


class Teleports:
    """Teleports of pins and targets, which move attached particles along.

    Holders ``(H,)`` are pins, then targets. If a holder of a connected group is faster
    than the limit [m/s], all holders of the group stay until the end of that interval
    and then jump: attached particles move rigidly with them and gain no velocity. The
    time between two jumps is a stage.
    """

    def __init__(
        self, body: Body, holders: IntArray, paths: tuple[Path, Path], limit: float
    ) -> None:
        self._holders, self._limit = holders, limit
        self._pins = paths[0][1].shape[1]
        self._knots, self._positions = _merged(paths)
        distances = np.linalg.norm(np.diff(self._positions, axis=0), axis=2)
        too_fast = distances > limit * np.diff(self._knots)[:, None]
        self._groups = np.zeros(len(body.positions), np.int64)
        if too_fast.any():
            self._groups = _groups(body)
        self._jumping = _jumps_by_group(too_fast, self._groups[holders])
        self._begins: IntArray = np.flatnonzero(self._jumping.any(axis=1))
        # Times of the jumps ``(J,)`` [s].
        self.times: FloatArray = self._knots[self._begins + 1]

    def __len__(self) -> int:
        """Return the number of jumps."""
        return len(self.times)

    def stage(self, t: float) -> int:
        """Return the number of jumps before a time [s]."""
        return int(np.searchsorted(self.times, t + SLACK, "right"))

    def _cells_until_jumps(self, grid: TimeGrid) -> list[int]:
        """Return the number of cells from a grid to each jump."""
        cells = [(t - SLACK - grid.origin) / grid.cell for t in self.times.tolist()]
        return [math.ceil(cell) - 1 - grid.index for cell in cells]

    def stage_of(self, grid: TimeGrid) -> int:
        """Return the stage of the next cell of a grid."""
        return sum(cells <= 0 for cells in self._cells_until_jumps(grid))

    def cells(self, grid: TimeGrid) -> float:
        """Return the number of cells before the next jump."""
        return min(
            (c for c in self._cells_until_jumps(grid) if c > 0), default=math.inf
        )

    def paths(self, stage: int) -> list[Path]:
        """Return times and positions of pins and of targets in a stage."""
        first = np.zeros(len(self._holders), np.int64)
        last = np.full(len(self._holders), len(self._knots) - 1)
        for begin in self._begins[:stage].tolist():
            first[self._jumping[begin]] = begin + 1
        for begin in self._begins[stage:][::-1].tolist():
            last[self._jumping[begin]] = begin
        rows = np.clip(np.arange(len(self._knots))[:, None], first, last)
        positions = self._positions[rows, np.arange(len(self._holders))]
        return [
            (self._knots, np.ascontiguousarray(part))
            for part in np.split(positions, [self._pins], axis=1)
        ]

    def across(self, state: FloatArray, begin: int, end: int) -> FloatArray:
        """Return a state carried over the jumps between two stages ``(2, N, 3)``."""
        result = state.copy() if end > begin else state
        for row in self._begins[begin:end].tolist():
            for group in np.unique(self._groups[self._holders[self._jumping[row]]]):
                self._carry(result, row, int(group))
        return result

    def _carry(self, state: FloatArray, row: int, group: int) -> None:
        """Move a group of particles over a jump, in the array."""
        holder_rows = np.flatnonzero(self._groups[self._holders] == group)
        before, after = self._positions[row : row + 2, holder_rows]
        rotation, shift = rigid_motion(before, after)
        members = self._groups == group
        state[0, members] = so3.rotate(rotation, state[0, members]) + shift
        state[1, members] = so3.rotate(rotation, state[1, members])
        pins = holder_rows < self._pins
        state[0, self._holders[holder_rows[pins]]] = after[pins]
        state[1, self._holders[holder_rows[pins]]] = 0.0

    def notices(self) -> list[Fault]:
        """Return a warning for each teleport of pins or targets."""
        notices = []
        for has_jumped, t in zip(self._jumping[self._begins], self.times, strict=True):
            names = ["pins"] if has_jumped[: self._pins].any() else []
            names += ["targets"] if has_jumped[self._pins :].any() else []
            message = (
                f"{' and '.join(names)} move faster than {self._limit:g} m/s until "
                f"{t:g} s: attached particles move along without gaining velocity"
            )
            hint = "raise the speed limit if they should pull it along"
            notices.append(warning("SIM122", message, hint, names[0]))
        return notices


def _groups(body: Body) -> IntArray:
    """Return the connected component of each particle ``(N,)``."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    count, ends = len(body.positions), body.springs.ends
    weights = np.ones(len(ends), np.int8)
    graph = coo_array((weights, (ends[:, 0], ends[:, 1])), shape=(count, count))
    labels: IntArray = connected_components(graph, directed=False)[1]
    return labels.astype(np.int64)


def _jumps_by_group(too_fast: BoolArray, groups: IntArray) -> BoolArray:
    """Return jumping holders ``(K - 1, H)``: all of a group if one jumps."""
    _, numbers = np.unique(groups, return_inverse=True)
    jumps = np.zeros((len(too_fast), numbers.max(initial=-1) + 1), bool)
    row, holder = np.nonzero(too_fast)
    jumps[row, numbers[holder]] = True
    return jumps[:, numbers]

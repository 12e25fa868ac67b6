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
from animtool.maths.faces import rigid_motion
from animtool.systems.springs.body import Body
from animtool.systems.springs.motion import TimeGrid, move_rigidly
from animtool.systems.springs.shapes import connected_groups

# Times ``(K,)`` [s], and positions ``(K, P, 3)`` [m].
TimedPositions: TypeAlias = tuple[FloatArray, FloatArray]

# Rounding tolerance for a teleport at the end of a step [s].
TIME_TOLERANCE = 1e-9


@dataclass(frozen=True, slots=True)
class Pins:
    """Pinned particles and their positions over time.

    Positions are interpolated linearly between times and constant outside of them.

    Attributes:
        particles: Indices of the pinned particles ``(P,)``.
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
        positions: Target points at the times ``(K, A, 3)``, or ``(A, 3)`` if static
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


Constraint = TypeVar("Constraint", Pins, PointTargets)


def resample_to_shared_times(
    paths: Sequence[TimedPositions],
) -> tuple[FloatArray, list[FloatArray]]:
    """Resample paths to the union of their times.

    Returns times ``(K,)`` [s], and positions of each path ``(K or 1, P, 3)`` [m].

    >>> static = np.array([0.0, 1.0]), np.zeros((2, 1, 3))
    >>> times, (path,) = resample_to_shared_times([static])
    >>> times.tolist(), path.shape
    ([0.0, 1.0], (2, 1, 3))
    """
    moving_times = [times for times, _ in paths if len(times) > 1]
    knots = np.unique(np.concatenate(moving_times)) if moving_times else np.zeros(1)
    resampled_paths = []
    for path in paths:
        times, positions = path
        if len(times) > 1 and not np.array_equal(times, knots):
            positions = np.array([position_at(path, t) for t in knots.tolist()])
        resampled_paths.append(np.ascontiguousarray(positions))
    return knots, resampled_paths


def merge_constraints(
    constraints: Sequence[Pins | PointTargets], kind: type[Constraint]
) -> Constraint | None:
    """Merge timed pins or targets of a kind into one record; None if there are none."""
    matching = [row for row in constraints if isinstance(row, kind)]
    if not matching:
        return None
    names = {field.name for field in fields(kind)} - {"positions", "times"}
    columns: dict[str, Any] = {
        name: np.concatenate([getattr(row, name) for row in matching]) for name in names
    }
    paths: list[Any] = [(row.times, row.positions) for row in matching]
    times, positions = _merge_paths(paths)
    return kind(positions=positions, times=times, **columns)


def _merge_paths(paths: Sequence[TimedPositions]) -> TimedPositions:
    """Concatenate paths along their particles, over shared times."""
    knots, resampled_paths = resample_to_shared_times(paths)
    rows = [
        np.broadcast_to(path, (len(knots), *path.shape[1:])) for path in resampled_paths
    ]
    return knots, np.concatenate(rows, axis=1)


def position_at(path: TimedPositions, t: float) -> FloatArray:
    """Return positions on a path at a time ``(P, 3)`` [m]."""
    times, positions = path
    row = int(np.clip(np.searchsorted(times, t, "right") - 1, 0, len(times) - 1))
    position: FloatArray = positions[row]
    if times[0] < t < times[-1]:
        fraction = (t - times[row]) / (times[row + 1] - times[row])
        position = position + (positions[row + 1] - position) * fraction
    return position


def max_speed_and_travel(path: TimedPositions) -> tuple[float, float]:
    """Return the maximum speed of a path [m/s] and distance from its start [m]."""
    times, positions = path
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=2)
    max_speed = float((steps / np.diff(times)[:, None]).max(initial=0.0))
    distances = np.linalg.norm(positions - positions[:1], axis=2)
    return max_speed, float(distances.max(initial=0.0))


class Teleports:
    """Teleports of pins and targets, which move the attached particles as well.

    Driven particles ``(H,)`` are those of pins, then those of targets. If one of a
    connected group is faster than ``max_speed`` [m/s], all driven particles of the
    group stay until the end of that interval and then teleport. Attached particles move
    rigidly with them and gain no velocity. The time between two teleports is a stage.
    """

    def __init__(
        self,
        body: Body,
        driven_particles: IntArray,
        paths: tuple[TimedPositions, TimedPositions],
        max_speed: float,
    ) -> None:
        self._driven_particles, self._max_speed = driven_particles, max_speed
        self._pin_count = paths[0][1].shape[1]
        self._knots, self._positions = _merge_paths(paths)
        distances = np.linalg.norm(np.diff(self._positions, axis=0), axis=2)
        is_too_fast = distances > max_speed * np.diff(self._knots)[:, None]
        self._group_of_particle = np.zeros(len(body.positions), np.int64)
        if is_too_fast.any():
            count, ends = len(body.positions), body.springs.ends
            self._group_of_particle = connected_groups(count, ends)
        groups = self._group_of_particle[driven_particles]
        self._is_teleporting = _teleports_by_group(is_too_fast, groups)
        self._teleport_knot_indices: IntArray = np.flatnonzero(
            self._is_teleporting.any(axis=1)
        )
        # Times of the teleports ``(J,)`` [s].
        self.times: FloatArray = self._knots[self._teleport_knot_indices + 1]

    def __len__(self) -> int:
        """Return the number of teleports."""
        return len(self.times)

    def stage(self, t: float) -> int:
        """Return the number of teleports before a time [s]."""
        return int(np.searchsorted(self.times, t + TIME_TOLERANCE, "right"))

    def _cells_until_teleports(self, grid: TimeGrid) -> list[int]:
        """Return the number of cells from the grid's current cell to each teleport."""
        times = (self.times - TIME_TOLERANCE - grid.origin) / grid.cell
        return [math.ceil(cell) - 1 - grid.index for cell in times.tolist()]

    def cell_stage(self, grid: TimeGrid) -> int:
        """Return the stage of the next cell of a grid."""
        return sum(cells <= 0 for cells in self._cells_until_teleports(grid))

    def cells_until_next(self, grid: TimeGrid) -> float:
        """Return the number of cells from the current cell to the next teleport."""
        cells = (cell for cell in self._cells_until_teleports(grid) if cell > 0)
        return min(cells, default=math.inf)

    def stage_paths(self, stage: int) -> list[TimedPositions]:
        """Return times and positions of pins, and of targets, in a stage."""
        first_knots = np.zeros(len(self._driven_particles), np.int64)
        last_knots = np.full(len(self._driven_particles), len(self._knots) - 1)
        for begin in self._teleport_knot_indices[:stage].tolist():
            first_knots[self._is_teleporting[begin]] = begin + 1
        for begin in self._teleport_knot_indices[stage:][::-1].tolist():
            last_knots[self._is_teleporting[begin]] = begin
        rows = np.clip(np.arange(len(self._knots))[:, None], first_knots, last_knots)
        positions = self._positions[rows, np.arange(len(self._driven_particles))]
        return [
            (self._knots, np.ascontiguousarray(path_positions))
            for path_positions in np.split(positions, [self._pin_count], axis=1)
        ]

    def apply(self, state: FloatArray, begin: int, end: int) -> FloatArray:
        """Return a state ``(2, N, 3)`` after the teleports between two stages."""
        result = state.copy() if end > begin else state
        for row in self._teleport_knot_indices[begin:end].tolist():
            particles = self._driven_particles[self._is_teleporting[row]]
            for group in np.unique(self._group_of_particle[particles]):
                self._move_group(result, row, int(group))
        return result

    def _move_group(self, state: FloatArray, row: int, group: int) -> None:
        """Move a group of particles over a teleport, in place."""
        driven_indices = np.flatnonzero(
            self._group_of_particle[self._driven_particles] == group
        )
        before, after = self._positions[row : row + 2, driven_indices]
        rotation, shift = rigid_motion(before, after)
        is_member = self._group_of_particle == group
        state[:, is_member] = move_rigidly(state[:, is_member], shift, rotation)
        is_pin = driven_indices < self._pin_count
        state[0, self._driven_particles[driven_indices[is_pin]]] = after[is_pin]
        state[1, self._driven_particles[driven_indices[is_pin]]] = 0.0

    def notices(self) -> list[Fault]:
        """Return a warning for each teleport of pins or targets."""
        notices = []
        for has_teleported, t in zip(
            self._is_teleporting[self._teleport_knot_indices], self.times, strict=True
        ):
            names = ["pins"] if has_teleported[: self._pin_count].any() else []
            names += ["targets"] if has_teleported[self._pin_count :].any() else []
            message = (
                f"{' and '.join(names)} move faster than {self._max_speed:g} m/s until "
                f"{t:g} s, so attached particles move along without gaining velocity"
            )
            hint = "raise speed_limit if they should drag the springs along"
            notices.append(warning("SIM122", message, hint, names[0]))
        return notices


def _teleports_by_group(is_too_fast: BoolArray, groups: IntArray) -> BoolArray:
    """Return a mask of teleports ``(K - 1, H)``, extended to complete groups."""
    _, numbers = np.unique(groups, return_inverse=True)
    group_teleports = np.zeros((len(is_too_fast), numbers.max(initial=-1) + 1), bool)
    row, column = np.nonzero(is_too_fast)
    group_teleports[row, numbers[column]] = True
    return group_teleports[:, numbers]

"""Emitters: birth times, positions and velocities of particles."""

from __future__ import annotations

import math
from dataclasses import field, replace
from typing import ClassVar

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.options import Checked, inherits_docs
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.sim.colliders.collider import Poses
from animtool.systems.particles.emitter_shapes import EmitterShape, Point
from animtool.systems.particles.records import Emission

# Of splitmix64: S. Vigna, 2015, after G. Steele, D. Lea, C. Flood, "Fast splittable
# pseudorandom number generators", 2014.
_STEP = np.uint64(0x9E3779B97F4A7C15)
_FIRST = np.uint64(0xBF58476D1CE4E5B9)
_SECOND = np.uint64(0x94D049BB133111EB)

# Shorter directions have a length of 0 in float64.
LEAST = 1e-150


def mixed(
    values: np.ndarray[tuple[int, ...], np.dtype[np.uint64]],
) -> np.ndarray[tuple[int, ...], np.dtype[np.uint64]]:
    """Return a 64-bit hash of all arguments."""
    z = values + _STEP
    z = (z ^ (z >> np.uint64(30))) * _FIRST
    z = (z ^ (z >> np.uint64(27))) * _SECOND
    return np.asarray(z ^ (z >> np.uint64(31)))


def uniforms(seed: int, keys: IntArray, count: int) -> FloatArray:
    """Return random numbers in [0, 1) for each key ``(N, count)``.

    >>> bool((uniforms(1, np.arange(9), 2)[7] == uniforms(1, np.array([7]), 2)).all())
    True
    """
    start = mixed(np.array([seed % 2**64], np.uint64))
    rows = mixed(keys.astype(np.uint64) ^ start)
    columns = np.arange(count, dtype=np.uint64) * _STEP
    bits = mixed(rows[:, None] + columns)
    return np.asarray((bits >> np.uint64(11)).astype(np.float64) * 2.0**-53)


# Key space of bursts, distinct from that of the steady rate.
_BURST = 1 << 40
# Key space of one burst.
MAX_AT_ONCE = 10**12
_CHANCES = 8
# Interval for measuring the motion of an emitter [s].
_BRIEF = 1e-4
# Shorter directions are not well defined.
SHORTEST = 1e-150


@dataclass(frozen=True, slots=True)
class Births:
    """The next N particles of an emitter."""

    times: FloatArray  # birth times ``(N,)`` [s]
    keys: IntArray  # random keys ``(N,)``
    missed: int  # number without room


@inherits_docs
@dataclass(frozen=True)
class Emitter(Emission, Checked):
    """Emits particles; their number depends on time alone.

    Every particle draws its place, direction, speed and lifetime by its number, so
    that neither the step nor the frame rate of an output changes them.

    Attributes:
        place: Where, in its frame.
        poses: Of its frame in the world over time.
    """

    code: ClassVar[str] = "SIM021"

    place: EmitterShape = field(default_factory=Point)
    poses: Poses = field(default_factory=Poses)

    def births(
        self, begin: float, after: float | None, until: float, room: int
    ) -> Births:
        """Return the particles born after one time, up to another.

        Args:
            begin: When the simulation begins [s]: the rate holds from then on.
            after: [s]; None is from the beginning on, that time included.
            until: [s]; included.
            room: How many there may be; the first ones are.
        """
        start = max(self.start, begin)
        first = 0 if after is None else self._emitted(start, after)
        last = self._emitted(start, until)
        emitted, kept = last - first, min(last - first, room)
        numbers = np.arange(first, first + kept, dtype=np.int64)
        times = [start + (numbers + 0.5) / self.rate] if len(numbers) else []
        keys = [numbers] if len(numbers) else []
        for i, (when, count) in enumerate(self.bursts):
            late = begin <= when if after is None else after < when
            if late and when <= until:
                emitted, some = emitted + count, min(count, room)
                times.append(np.full(some, float(when)))
                keys.append(_BURST * (i + 1) + np.arange(some, dtype=np.int64))
                kept += some
        if not times:
            return Births(np.zeros(0), np.zeros(0, np.int64), emitted)
        when_all, key_all = np.concatenate(times), np.concatenate(keys)
        order = np.argsort(when_all, kind="stable")
        times_all = np.clip(when_all[order], begin, until)
        return Births(times_all, key_all[order], emitted - kept)

    def _emitted(self, start: float, t: float) -> int:
        """Return the number emitted by the rate up to a time."""
        span = min(t, self.end) - start
        return max(math.floor(span * self.rate + 0.5), 0) if span > 0 else 0

    def drawn(
        self, births: Births
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return positions, velocities ``(N, 3)``, lifetimes and radii ``(N,)``."""
        chances = uniforms(self.seed, births.keys, _CHANCES)
        points, outwards = self.place.points(chances[:, :3])
        directions = self._directions(chances[:, 3:5], outwards)
        speeds = self.speed + self.speed_spread * (2 * chances[:, 5] - 1)
        lifetimes = self.lifetime + self.lifetime_spread * (2 * chances[:, 6] - 1)
        radii = self.radius + self.radius_spread * (2 * chances[:, 7] - 1)
        positions, velocities = self._in_world(
            births.times, points, directions * speeds[:, None]
        )
        return positions, velocities, np.maximum(lifetimes, 0.0), radii

    def drawn_at(self, t: float, count: int) -> tuple[FloatArray, FloatArray]:
        """Return N positions and velocities ``(N, 3)``, born at a time [s]."""
        burst = replace(self, rate=0.0, bursts=[(t, count)])
        return burst.drawn(burst.births(t, None, t, count))[:2]

    def _directions(
        self, chances: FloatArray, outwards: FloatArray | None
    ) -> FloatArray:
        """Return directions in a cone, uniform by solid angle ``(N, 3)``."""
        axis = np.array([0.0, 1.0, 0.0] if self.direction is None else self.direction)
        if not LEAST < np.linalg.norm(axis) < 1 / LEAST:
            # Its square overflows or underflows.
            axis = axis / np.abs(axis).max()
        middle = np.broadcast_to(axis.astype(np.float64), (len(chances), 3))
        if outwards is not None and self.direction is None:
            middle = outwards
        middle = middle / np.linalg.norm(middle, axis=1)[:, None]
        height = 1 - chances[:, :1] * (1 - math.cos(self.spread))
        across = np.sqrt(np.maximum(1 - height * height, 0))
        angle = 2 * np.pi * chances[:, 1:]
        least = np.argmin(np.abs(middle), axis=1)
        side = np.cross(middle, np.eye(3)[least])
        side /= np.linalg.norm(side, axis=1)[:, None]
        other = np.cross(middle, side)
        around = side * np.cos(angle) + other * np.sin(angle)
        return np.asarray(middle * height + around * across, np.float64)

    def _in_world(
        self, times: FloatArray, points: FloatArray, velocities: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        if len(self.poses.sample_times) == 1:
            row = self.poses.rows[0]
            return (
                so3.rotate(row[3:], points) + row[:3],
                so3.rotate(row[3:], velocities),
            )
        now, before = self.poses.at_times(times), self.poses.at_times(times - _BRIEF)
        positions = so3.rotate(now[:, 3:], points) + now[:, :3]
        earlier = so3.rotate(before[:, 3:], points) + before[:, :3]
        emitter_velocity = (positions - earlier) * (self.inherit / _BRIEF)
        return positions, so3.rotate(now[:, 3:], velocities) + emitter_velocity

    def problems(self) -> list[tuple[str, str]]:
        """Return invalid options, each with a message."""
        problems = [("place", message) for message in self.place.faults()]
        problems += [("poses", message) for message in self.poses.faults()]
        problems += super().problems()
        if not 0 <= self.spread <= math.pi:
            problems.append(("spread", "its spread must be from 0 to 180 degrees"))
        if self.radius_spread >= self.radius > 0:
            message = "its radius_spread must be below its radius"
            problems.append(("radius_spread", message))
        if not self.start <= self.end:
            problems.append(("end", "its end is before its start"))
        if self.direction is not None and not (
            SHORTEST < float(np.linalg.norm(self.direction)) < math.inf
        ):
            message = "its direction must be three finite numbers, not all 0"
            problems.append(("direction", message))
        for i, (when, count) in enumerate(self.bursts):
            if not math.isfinite(when) or not 0 <= count <= MAX_AT_ONCE:
                message = f"burst {i} must be at a finite time, of 0 particles or more"
                message += f" and {MAX_AT_ONCE:g} at most"
                problems.append(("bursts", message))
        return problems

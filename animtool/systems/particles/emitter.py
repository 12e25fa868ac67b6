"""Emitters: birth times, positions and velocities of particles."""

from __future__ import annotations

import math
from dataclasses import field, replace
from typing import ClassVar

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.options import CheckedRecord, inherits_docs
from animtool.core.quantities import angle_text, plain_number
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.sim.colliders.collider import Poses
from animtool.systems.particles.emitter_shapes import EmitterShape, Point
from animtool.systems.particles.records import Emission

# Constants of splitmix64: S. Vigna, 2015, after G. Steele, D. Lea, C. Flood, "Fast
# splittable pseudorandom number generators", 2014.
_HASH_INCREMENT = np.uint64(0x9E3779B97F4A7C15)
_HASH_FACTOR_1 = np.uint64(0xBF58476D1CE4E5B9)
_HASH_FACTOR_2 = np.uint64(0x94D049BB133111EB)

# Squares of shorter directions are 0 in float64, and those of the inverse overflow.
MIN_DIRECTION_LENGTH = 1e-150


def hash64(
    values: np.ndarray[tuple[int, ...], np.dtype[np.uint64]],
) -> np.ndarray[tuple[int, ...], np.dtype[np.uint64]]:
    """Return a 64-bit hash of each value (splitmix64)."""
    z = values + _HASH_INCREMENT
    z = (z ^ (z >> np.uint64(30))) * _HASH_FACTOR_1
    z = (z ^ (z >> np.uint64(27))) * _HASH_FACTOR_2
    return np.asarray(z ^ (z >> np.uint64(31)))


def uniform_samples(seed: int, keys: IntArray, count: int) -> FloatArray:
    """Return random numbers in [0, 1) that depend on a seed and keys ``(N, count)``.

    >>> samples = uniform_samples(1, np.arange(9), 2)
    >>> bool((samples[7] == uniform_samples(1, np.array([7]), 2)).all())
    True
    """
    seed_hash = hash64(np.array([seed % 2**64], np.uint64))
    key_hashes = hash64(keys.astype(np.uint64) ^ seed_hash)
    column_offsets = np.arange(count, dtype=np.uint64) * _HASH_INCREMENT
    bits = hash64(key_hashes[:, None] + column_offsets)
    return np.asarray((bits >> np.uint64(11)).astype(np.float64) * 2.0**-53)


# First random key of bursts; keys below it are those of the rate.
_BURST_KEYS = 1 << 40
# Largest number of particles of a burst.
MAX_BURST = 10**12
_RANDOM_COUNT = 8
# Interval for measuring the motion of an emitter [s].
_VELOCITY_INTERVAL = 1e-4


@dataclass(frozen=True, slots=True)
class Births:
    """New particles of an emitter, in order of birth."""

    times: FloatArray  # birth times ``(N,)`` [s]
    keys: IntArray  # random keys ``(N,)``
    skipped_count: int  # number of births beyond the capacity


@inherits_docs
@dataclass(frozen=True)
class Emitter(Emission, CheckedRecord):
    """Emits particles; the number emitted depends on time alone.

    The position, direction, speed and lifetime of a particle are random functions of
    its index, so that they do not depend on the step or the frame rate of an output.

    Attributes:
        place: Emitter shape in local space.
        poses: World poses of the emitter's frame over time.
    """

    code: ClassVar[str] = "SIM021"

    place: EmitterShape = field(default_factory=Point)
    poses: Poses = field(default_factory=Poses)

    def births(
        self, begin: float, start_time: float | None, end_time: float, capacity: int
    ) -> Births:
        """Return the particles that are born in a time interval.

        Args:
            begin: Time at which the simulation and the emission begin [s].
            start_time: Births after this time [s]; None is all from the start.
            end_time: Births up to this time, inclusive [s].
            capacity: Largest number of births; later ones are skipped.
        """
        first_time = max(self.start, begin)
        first_index = 0
        if start_time is not None:
            first_index = self._emitted_count(first_time, start_time)
        end_index = self._emitted_count(first_time, end_time)
        emitted_count = end_index - first_index
        kept_count = min(emitted_count, capacity)
        indices = np.arange(first_index, first_index + kept_count, dtype=np.int64)
        times = [first_time + (indices + 0.5) / self.rate] if len(indices) else []
        keys = [indices] if len(indices) else []
        for i, (burst_time, count) in enumerate(self.bursts):
            has_started = (
                begin <= burst_time if start_time is None else start_time < burst_time
            )
            if has_started and burst_time <= end_time:
                burst_count = min(count, capacity)
                burst_indices = np.arange(burst_count, dtype=np.int64)
                times.append(np.full(burst_count, float(burst_time)))
                keys.append(_BURST_KEYS * (i + 1) + burst_indices)
                emitted_count += count
                kept_count += burst_count
        if not times:
            return Births(np.zeros(0), np.zeros(0, np.int64), emitted_count)
        all_times, all_keys = np.concatenate(times), np.concatenate(keys)
        order = np.argsort(all_times, kind="stable")
        sorted_times = np.clip(all_times[order], begin, end_time)
        return Births(sorted_times, all_keys[order], emitted_count - kept_count)

    def _emitted_count(self, start: float, t: float) -> int:
        """Return the number of particles that the rate emits until a time."""
        duration = min(t, self.end) - start
        return max(math.floor(duration * self.rate + 0.5), 0) if duration > 0 else 0

    def sample_births(
        self, births: Births
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return positions, velocities ``(N, 3)``, lifetimes and radii ``(N,)``."""
        random_numbers = uniform_samples(self.seed, births.keys, _RANDOM_COUNT)
        points, outwards = self.place.points(random_numbers[:, :3])
        directions = self._directions(random_numbers[:, 3:5], outwards)
        speeds = self.speed + self.speed_spread * (2 * random_numbers[:, 5] - 1)
        lifetimes = self.lifetime + self.lifetime_spread * (
            2 * random_numbers[:, 6] - 1
        )
        radii = self.radius + self.radius_spread * (2 * random_numbers[:, 7] - 1)
        velocities = directions * speeds[:, None]
        positions, velocities = self._to_world(births.times, points, velocities)
        return positions, velocities, np.maximum(lifetimes, 0.0), radii

    def sample_at(self, t: float, count: int) -> tuple[FloatArray, FloatArray]:
        """Return positions and velocities ``(N, 3)`` of particles all born at ``t``."""
        burst = replace(self, rate=0.0, bursts=[(t, count)])
        return burst.sample_births(burst.births(t, None, t, count))[:2]

    def _directions(
        self, random_numbers: FloatArray, outwards: FloatArray | None
    ) -> FloatArray:
        """Return random directions in the cone of the emitter ``(N, 3)``."""
        axis = np.array([0.0, 1.0, 0.0] if self.direction is None else self.direction)
        if not MIN_DIRECTION_LENGTH < np.linalg.norm(axis) < 1 / MIN_DIRECTION_LENGTH:
            axis = axis / np.abs(axis).max()
        axes = np.broadcast_to(axis.astype(np.float64), (len(random_numbers), 3))
        if outwards is not None and self.direction is None:
            axes = outwards
        axes = axes / np.linalg.norm(axes, axis=1)[:, None]
        height = 1 - random_numbers[:, :1] * (1 - math.cos(self.spread))
        radius = np.sqrt(np.maximum(1 - height * height, 0))
        angle = 2 * np.pi * random_numbers[:, 1:]
        smallest_axis_indices = np.argmin(np.abs(axes), axis=1)
        first_tangent = np.cross(axes, np.eye(3)[smallest_axis_indices])
        first_tangent /= np.linalg.norm(first_tangent, axis=1)[:, None]
        second_tangent = np.cross(axes, first_tangent)
        radial = first_tangent * np.cos(angle) + second_tangent * np.sin(angle)
        return np.asarray(axes * height + radial * radius, np.float64)

    def _to_world(
        self, times: FloatArray, points: FloatArray, velocities: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return world positions and velocities, including the inherited velocity."""
        if self.poses.is_fixed:
            pose = self.poses.rows[0]
            positions = so3.rotate(pose[3:], points) + pose[:3]
            return positions, so3.rotate(pose[3:], velocities)
        poses = self.poses.at_times(times)
        earlier_poses = self.poses.at_times(times - _VELOCITY_INTERVAL)
        positions = so3.rotate(poses[:, 3:], points) + poses[:, :3]
        offsets = so3.rotate(earlier_poses[:, 3:], points)
        displacement = positions - (offsets + earlier_poses[:, :3])
        emitter_velocity = displacement * (self.inherit / _VELOCITY_INTERVAL)
        return positions, so3.rotate(poses[:, 3:], velocities) + emitter_velocity

    def problems(self) -> list[tuple[str, str]]:
        """Return the names of invalid options, each with a message."""
        problems = [("place", message) for message in self.place.faults()]
        problems += [("poses", message) for message in self.poses.faults()]
        problems += super().problems()
        if not 0 <= self.spread <= math.pi:
            degrees = math.degrees(self.spread)
            message = f"its spread must be from 0 to 180°, not {angle_text(degrees)}"
            if self.spread % 1 == 0 and 0 < self.spread <= math.degrees(math.pi):
                radians = plain_number(math.radians(self.spread))
                message = f"its spread, {self.spread:g} radians, must be from 0 to pi; "
                message += f"for {self.spread:g}° write {radians}"
            problems.append(("spread", message))
        if self.radius_spread >= self.radius > 0:
            message = "its radius_spread must be below its radius"
            problems.append(("radius_spread", message))
        if not self.start <= self.end:
            problems.append(("end", "its end is before its start"))
        if self.direction is not None and not (
            MIN_DIRECTION_LENGTH < float(np.linalg.norm(self.direction)) < math.inf
        ):
            message = "its direction must be three finite numbers, not all 0"
            problems.append(("direction", message))
        for i, (burst_time, count) in enumerate(self.bursts):
            if not math.isfinite(burst_time) or not 0 <= count <= MAX_BURST:
                message = f"burst {i} must be at a finite time, of 0 particles or more"
                message += f" and {MAX_BURST:g} at most"
                problems.append(("bursts", message))
            elif count != int(count):
                message = f"burst {i} has {count:g} particles, not a whole number; "
                message += "rows are [seconds, number]"
                if burst_time == int(burst_time):
                    message += f": write [{count:g}, {burst_time:g}]"
                problems.append(("bursts", message))
        return problems

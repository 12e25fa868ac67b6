"""Steering of members: goals, paths, speeds, avoidance and limits."""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.sim.colliders import Colliders
from animtool.systems.flocks.members import Members, max_speed
from animtool.systems.flocks.spec import PathModel

# Members in a block, so that their distances fit into the cache.
BLOCK_SIZE = 4096
RELATIVE_ROUNDING = 1e-9  # relative rounding error of a displacement [1]
_TINY_LENGTH = 1e-12  # lengths and speeds below have no direction [m], [m/s]


def goal_accelerations(
    members: Members, t: float, x: FloatArray, v: FloatArray
) -> FloatArray:
    """Return accelerations towards goals, paths and cruise speeds ``(N, 3)`` [m/s²]."""
    accelerations = np.zeros_like(x)
    for species, data, species_rows in zip(
        members.entries, members.species_data, members.ranges_by_entry, strict=True
    ):
        positions, speed = x[species_rows], species.speed
        if speed.weight:
            squared_speeds = (v[species_rows] * v[species_rows]).sum(axis=1)
            speed_gain = speed.weight * (speed.cruise**2 - squared_speeds)
            accelerations[species_rows] += speed_gain[:, None] * v[species_rows]
        for goal, goal_data in zip(species.goals, data.get("goals", ()), strict=True):
            offsets = goal_data["poses"].at(t)[:3] - positions
            acceleration = goal.weight * _shorten_by_radius(offsets, goal.radius)
            if goal.limit is not None:
                acceleration = clamp_lengths(acceleration, goal.limit)
            accelerations[species_rows] += acceleration
        for path in species.paths:
            for start in range(species_rows.start, species_rows.stop, BLOCK_SIZE):
                rows = slice(start, min(start + BLOCK_SIZE, species_rows.stop))
                offsets = _path_targets(path, x[rows]) - x[rows]
                offsets = _shorten_by_radius(offsets, path.radius)
                accelerations[rows] += path.weight * offsets
    return accelerations


def _shorten_by_radius(vectors: FloatArray, radius: float) -> FloatArray:
    """Return vectors ``(N, 3)`` shortened by a radius [m], to length 0 at least."""
    if not radius:
        return vectors
    lengths = np.linalg.norm(vectors, axis=1)[:, None]
    fractions = np.maximum(1 - radius / np.maximum(lengths, _TINY_LENGTH), 0.0)
    return np.asarray(vectors * fractions)


def _path_targets(path: PathModel, x: FloatArray) -> FloatArray:
    """Return the points on a path that members aim at ``(N, 3)`` [m]."""
    points = np.array(path.points)
    if path.closed:
        points = np.concatenate([points, points[:1]])
    segments = np.diff(points, axis=0)
    segment_lengths = np.linalg.norm(segments, axis=1)
    fractions = ((x[:, None] - points[:-1]) * segments).sum(axis=2)
    fractions = np.clip(
        fractions / np.maximum(segment_lengths**2, _TINY_LENGTH), 0.0, 1.0
    )
    offsets = points[:-1] + fractions[..., None] * segments - x[:, None]
    segment_indices = np.argmin((offsets * offsets).sum(axis=2), axis=1)
    arc_lengths = np.concatenate([[0.0], np.cumsum(segment_lengths)])
    nearest_fractions = fractions[np.arange(len(x)), segment_indices]
    nearest_lengths = nearest_fractions * segment_lengths[segment_indices]
    target_lengths = arc_lengths[segment_indices] + nearest_lengths + path.ahead
    if path.closed:
        target_lengths = target_lengths % arc_lengths[-1]
    else:
        target_lengths = np.minimum(target_lengths, arc_lengths[-1])
    return np.stack(
        [np.interp(target_lengths, arc_lengths, column) for column in points.T], axis=1
    )


# Interval for measuring the velocities of colliders [s], much shorter than a frame.
VELOCITY_INTERVAL = 2.0**-10


def avoidance_accelerations(
    members: Members, colliders: Colliders, t: float, x: FloatArray, v: FloatArray
) -> FloatArray:
    """Return accelerations away from colliders ``(N, 3)`` [m/s²].

    Surfaces repel nearby members. Approaching ones are also decelerated by the squared
    relative speed over twice the distance.
    """
    accelerations = np.zeros_like(x)
    ranges = members.repeat_per_individual(
        [entry.avoidance.distance for entry in members.entries]
    )
    weights = members.repeat_per_individual(
        [entry.avoidance.weight for entry in members.entries]
    )
    samples = colliders.sample(x, t, t + VELOCITY_INTERVAL)
    for distances, normals, collider_velocities in zip(
        samples.distances, samples.normals, samples.velocities, strict=True
    ):
        gaps = np.maximum(distances - members.radii, 0.0)
        proximity = np.maximum(1 - gaps / ranges, 0.0)
        is_near = proximity > 0
        if not is_near.any():
            continue
        relative_velocities = (v - collider_velocities)[is_near]
        normal_speeds = (relative_velocities * normals[is_near]).sum(axis=1)
        braking_distance = 2 * np.maximum(gaps[is_near], members.radii[is_near])
        braking_accelerations = np.minimum(normal_speeds, 0.0) ** 2 / braking_distance
        proximity = proximity[is_near]
        magnitudes = proximity * (weights[is_near] * proximity + braking_accelerations)
        accelerations[is_near] += magnitudes[:, None] * normals[is_near]
    return accelerations


def limit_steering(
    members: Members, v: FloatArray, accelerations: FloatArray
) -> FloatArray:
    """Return accelerations within the limits of each species ``(N, 3)`` [m/s²]."""
    limited_accelerations = accelerations
    for species, member_range in zip(
        members.entries, members.ranges_by_entry, strict=True
    ):
        if species.turning is not None:
            max_rate = float(np.radians(species.turning))
            limited_accelerations = _limit_turning(
                limited_accelerations, v, member_range, max_rate
            )
        if species.acceleration is not None:
            limited_accelerations = limited_accelerations.copy()
            limited_accelerations[member_range] = clamp_lengths(
                limited_accelerations[member_range], species.acceleration
            )
    return limited_accelerations


def _limit_turning(
    accelerations: FloatArray, v: FloatArray, member_range: slice, max_rate: float
) -> FloatArray:
    """Return accelerations whose turn rate is at most ``max_rate`` [rad/s]."""
    speeds = np.linalg.norm(v[member_range], axis=1)[:, None]
    directions = v[member_range] / np.maximum(speeds, _TINY_LENGTH)
    parallel = (accelerations[member_range] * directions).sum(axis=1)[
        :, None
    ] * directions
    accelerations = accelerations.copy()
    perpendicular = accelerations[member_range] - parallel
    lengths = np.linalg.norm(perpendicular, axis=1)[:, None]
    # Members at rest turn at once.
    fraction = np.minimum(max_rate * speeds / np.maximum(lengths, _TINY_LENGTH), 1.0)
    fraction = np.where(speeds > _TINY_LENGTH, fraction, 1.0)
    accelerations[member_range] = parallel + perpendicular * fraction
    return accelerations


def clamp_lengths(vectors: FloatArray, max_length: float) -> FloatArray:
    """Return vectors ``(N, 3)`` clamped to a maximum length."""
    lengths = np.linalg.norm(vectors, axis=1)[:, None]
    fractions = np.minimum(max_length / np.maximum(lengths, _TINY_LENGTH), 1.0)
    return np.asarray(vectors * fractions)


def limit_displacements(
    members: Members, before: FloatArray, after: FloatArray, h: float
) -> FloatArray:
    """Return new positions ``(N, 3)`` [m], limited to the reach in a time ``h`` [s]."""
    max_speeds = members.repeat_per_individual(
        [max_speed(entry) for entry in members.entries]
    )
    offsets = after - before
    lengths, max_lengths = np.linalg.norm(offsets, axis=1), max_speeds * abs(h)
    is_beyond = lengths > max_lengths * (1 + RELATIVE_ROUNDING)
    if not is_beyond.any():
        return after
    fractions = max_lengths / np.maximum(lengths, _TINY_LENGTH)
    return np.where(is_beyond[:, None], before + offsets * fractions[:, None], after)


def clamp_speeds(members: Members, v: FloatArray) -> FloatArray:
    """Return velocities clamped to the speeds of each species ``(N, 3)`` [m/s]."""
    min_speeds = members.repeat_per_individual(
        [entry.speed.least for entry in members.entries]
    )
    max_speeds = members.repeat_per_individual(
        [max_speed(entry) for entry in members.entries]
    )
    speeds = np.linalg.norm(v, axis=1)
    is_too_slow = (speeds < min_speeds) & (speeds > _TINY_LENGTH)
    is_outside = (speeds > max_speeds) | is_too_slow
    if not is_outside.any():
        return v
    factors = np.clip(speeds, min_speeds, max_speeds) / np.maximum(speeds, _TINY_LENGTH)
    return np.where(is_outside[:, None], v * factors[:, None], v)

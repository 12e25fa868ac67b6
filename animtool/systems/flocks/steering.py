"""Steering of single members: goals, paths, speed, avoidance and limits."""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.sim.colliders import Colliders
from animtool.systems.flocks.members import Members, max_speed
from animtool.systems.flocks.spec import PathModel

# Members processed together, so that their distances fit the cache.
BLOCK = 4096
_TINY = 1e-12  # lengths and speeds below have no direction [m], [m/s]


def goal_accelerations(
    members: Members, t: float, x: FloatArray, v: FloatArray
) -> FloatArray:
    """Return accelerations by goals, paths and speeds ``(N, 3)`` [m/s²]."""
    accelerations = np.zeros_like(x)
    for species, parts, members_rows in zip(
        members.entries, members.parts, members.parted, strict=True
    ):
        here, speed = x[members_rows], species.speed
        if speed.weight:
            squares = (v[members_rows] * v[members_rows]).sum(axis=1)
            lack = speed.weight * (speed.cruise**2 - squares)
            accelerations[members_rows] += lack[:, None] * v[members_rows]
        for goal, placed in zip(species.goals, parts.get("goals", ()), strict=True):
            off = placed["poses"].at(t)[:3] - here
            pull = goal.weight * _beyond(off, goal.radius)
            accelerations[members_rows] += (
                pull if goal.limit is None else limited(pull, goal.limit)
            )
        for path in species.paths:
            for first in range(0, len(here), BLOCK):
                rows = slice(
                    members_rows.start + first,
                    members_rows.start + min(first + BLOCK, len(here)),
                )
                off = _target(path, x[rows]) - x[rows]
                accelerations[rows] += path.weight * _beyond(off, path.radius)
    return accelerations


def _beyond(off: FloatArray, radius: float) -> FloatArray:
    """Return the part of vectors ``(N, 3)`` that exceeds a radius [m]."""
    if not radius:
        return off
    far = np.linalg.norm(off, axis=1)[:, None]
    return np.asarray(off * np.maximum(1 - radius / np.maximum(far, _TINY), 0.0))


def _target(path: PathModel, x: FloatArray) -> FloatArray:
    """Return the target points on a path ``(N, 3)`` [m]."""
    points = np.array(path.points)
    if path.closed:
        points = np.concatenate([points, points[:1]])
    segments = np.diff(points, axis=0)
    lengths = np.linalg.norm(segments, axis=1)
    shares = ((x[:, None] - points[:-1]) * segments).sum(axis=2)
    shares = np.clip(shares / np.maximum(lengths**2, _TINY), 0.0, 1.0)
    off = points[:-1] + shares[..., None] * segments - x[:, None]
    nearest = np.argmin((off * off).sum(axis=2), axis=1)
    marks = np.concatenate([[0.0], np.cumsum(lengths)])
    along = marks[nearest] + shares[np.arange(len(x)), nearest] * lengths[nearest]
    along = along + path.ahead
    along = along % marks[-1] if path.closed else np.minimum(along, marks[-1])
    return np.stack([np.interp(along, marks, each) for each in points.T], axis=1)


# Interval for measuring velocities of colliders [s]: frames are far longer.
INSTANT = 2.0**-10


def avoidance(
    members: Members, colliders: Colliders, t: float, x: FloatArray, v: FloatArray
) -> FloatArray:
    """Return accelerations away from colliders ``(N, 3)`` [m/s²].

    Surfaces repel nearby members, and brake approaching ones to a stop: by the square
    of the relative speed over twice the distance.
    """
    accelerations = np.zeros_like(x)
    reach = members.each([one.avoidance.distance for one in members.entries])
    push = members.each([one.avoidance.weight for one in members.entries])
    samples = colliders.sample(x, t, t + INSTANT)
    for distances, normals, speeds in zip(
        samples.distances, samples.normals, samples.velocities, strict=True
    ):
        gap = np.maximum(distances - members.radii, 0.0)
        near = np.maximum(1 - gap / reach, 0.0)
        rows = near > 0
        if not rows.any():
            continue
        closing = ((v - speeds)[rows] * normals[rows]).sum(axis=1)
        room = 2 * np.maximum(gap[rows], members.radii[rows])
        brake = np.minimum(closing, 0.0) ** 2 / room
        size = near[rows] * (push[rows] * near[rows] + brake)
        accelerations[rows] += size[:, None] * normals[rows]
    return accelerations


def steered(members: Members, v: FloatArray, requested: FloatArray) -> FloatArray:
    """Return accelerations within each species' limits ``(N, 3)`` [m/s²]."""
    limits = requested
    for species, rows in zip(members.entries, members.parted, strict=True):
        if species.turning is not None:
            limits = _turned_less(limits, v, rows, float(np.radians(species.turning)))
        if species.acceleration is not None:
            limits = limits.copy()
            limits[rows] = limited(limits[rows], species.acceleration)
    return limits


def _turned_less(
    requested: FloatArray, v: FloatArray, rows: slice, most: float
) -> FloatArray:
    """Return accelerations limited to a turning rate [rad/s]."""
    speeds = np.linalg.norm(v[rows], axis=1)[:, None]
    directions = v[rows] / np.maximum(speeds, _TINY)
    along = (requested[rows] * directions).sum(axis=1)[:, None] * directions
    requested = requested.copy()
    across = requested[rows] - along
    sizes = np.linalg.norm(across, axis=1)[:, None]
    # Members at rest turn at once.
    fraction = np.minimum(most * speeds / np.maximum(sizes, _TINY), 1.0)
    requested[rows] = along + across * np.where(speeds > _TINY, fraction, 1.0)
    return requested


def limited(values: FloatArray, most: float) -> FloatArray:
    """Return vectors ``(N, 3)`` clamped to a length."""
    sizes = np.linalg.norm(values, axis=1)[:, None]
    return np.asarray(values * np.minimum(most / np.maximum(sizes, _TINY), 1.0))


def kept_speeds(members: Members, v: FloatArray) -> FloatArray:
    """Return velocities clamped to each species' speeds ``(N, 3)`` [m/s]."""
    least = members.each([one.speed.least for one in members.entries])
    most = members.each([max_speed(one) for one in members.entries])
    speeds = np.linalg.norm(v, axis=1)
    outside = (speeds > most) | ((speeds < least) & (speeds > _TINY))
    if not outside.any():
        return v
    factors = np.clip(speeds, least, most) / np.maximum(speeds, _TINY)
    return np.where(outside[:, None], v * factors[:, None], v)

"""A collider: a shape, its pose over time, and its contact material."""

from __future__ import annotations

from dataclasses import field, replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from animtool.core.array_types import ArrayLike, BoolArray, FloatArray
from animtool.core.options import CheckedRecord, inherits_docs
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.sim.colliders.shapes import Mesh, Shape
from animtool.sim.contact import Contact


@dataclass(frozen=True)
class Poses:
    """World poses at sample times.

    Poses are interpolated between the samples; before the first and after the last
    sample they are constant.

    Attributes:
        times: Sample times ``(T,)`` [s], ascending; a single one for a fixed collider.
        origins: Origins of the local frame ``(T, 3)`` [m].
        rotations: Quaternions ``(T, 4)``, x y z w, of any length above 0.

    >>> Poses([0, 1], [[0, 0, 0], [2, 0, 0]], [[0, 0, 0, 1]] * 2).at(0.25).tolist()
    [0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
    """

    times: ArrayLike = (0.0,)
    origins: ArrayLike = ((0.0, 0.0, 0.0),)
    rotations: ArrayLike = ((0.0, 0.0, 0.0, 1.0),)

    @staticmethod
    def fixed(
        origin: ArrayLike = (0.0, 0.0, 0.0), rotation: ArrayLike = (0.0, 0.0, 0.0, 1.0)
    ) -> Poses:
        """Return a constant pose."""
        return Poses((0.0,), np.array([origin], float), np.array([rotation], float))

    @cached_property
    def sample_times(self) -> FloatArray:
        """Times as an array ``(T,)`` [s]."""
        return np.asarray(self.times, np.float64)

    @property
    def is_fixed(self) -> bool:
        """Whether there is a single pose."""
        return len(self.sample_times) == 1

    @cached_property
    def rows(self) -> FloatArray:
        """Origins and unit quaternions ``(T, 7)``."""
        rotations = so3.normalize(np.asarray(self.rotations, np.float64))
        origins = np.asarray(self.origins, np.float64)
        return np.concatenate([origins, so3.align_signs(rotations)], axis=1)

    def at(self, t: float) -> FloatArray:
        """Return the origin and quaternion ``(7,)`` at a time [s]."""
        row: FloatArray = self.at_times(np.array([t]))[0]
        return row

    def at_times(self, times: FloatArray) -> FloatArray:
        """Return origins and quaternions ``(F, 7)`` at times ``(F,)`` [s].

        >>> Poses([0, 1], np.eye(2, 3), [[0, 0, 0, 1]] * 2).at_times(np.array([0.5, 9]))
        array([[0.5, 0.5, 0. , 0. , 0. , 0. , 1. ],
               [0. , 1. , 0. , 0. , 0. , 0. , 1. ]])
        """
        key_times, rows = self.sample_times, self.rows
        key_indices = np.searchsorted(key_times, times, side="right") - 1
        poses: FloatArray = rows[np.maximum(key_indices, 0)]
        is_between = (key_indices >= 0) & (key_indices + 1 < len(key_times))
        i = key_indices[is_between]
        if len(i):
            before, after = rows[i], rows[i + 1]
            durations = key_times[i + 1] - key_times[i]
            fraction = (times[is_between] - key_times[i]) / durations
            displacement = (after[:, :3] - before[:, :3]) * fraction[:, None]
            poses[is_between, :3] = before[:, :3] + displacement
            poses[is_between, 3:] = so3.slerp(before[:, 3:], after[:, 3:], fraction)
        return poses

    def to_world(self, points: FloatArray) -> FloatArray:
        """Return local points in world space at all sample times ``(T, A, 3)`` [m]."""
        offsets = so3.rotate(self.rows[:, None, 3:], points)
        return np.asarray(self.rows[:, None, :3] + offsets, np.float64)

    def teleports(self, points: FloatArray, speed_limit: float) -> BoolArray:
        """Return a mask of intervals in which points exceed a speed ``(T - 1,)``."""
        distances = np.linalg.norm(np.diff(self.to_world(points), axis=0), axis=2)
        max_distances = speed_limit * np.diff(self.sample_times)
        return np.asarray(distances.max(axis=1) > max_distances, np.bool_)

    def faults(self) -> list[str]:
        """Return a message for each invalid value."""
        times = np.asarray(self.times, np.float64)
        arrays_and_widths = {
            "origins": (self.origins, 3),
            "rotations": (self.rotations, 4),
        }
        if times.ndim != 1 or not len(times) or not (np.diff(times) > 0).all():
            return ["its times must ascend, and there must be at least one"]
        faults = [] if np.isfinite(times).all() else ["its times are not finite"]
        for name, (values, width) in arrays_and_widths.items():
            array = np.asarray(values, np.float64)
            if array.shape != (len(times), width):
                shape = (len(times), width)
                faults.append(f"its {name} must have shape {shape}, not {array.shape}")
            elif not np.isfinite(array).all():
                faults.append(f"its {name} are not finite")
            elif width == 4 and not array.any(axis=1).all():
                faults.append("its rotations must not be all 0")
        return faults


@inherits_docs
@dataclass(frozen=True)
class Collider(Contact, CheckedRecord):
    """A shape, its pose over time, and its contact material.

    Attributes:
        shape: Shape in its local frame.
        poses: Poses of that frame in the world.
        speed_limit: Faster motion is a teleport, without velocity [m/s].
    """

    code: ClassVar[str] = "SIM020"

    shape: Shape
    poses: Poses = field(default_factory=Poses)

    @property
    def material(self) -> tuple[float, float, float, float]:
        """Restitution, friction, margin and depenetration."""
        return self.restitution, self.friction, self.margin, self.depenetration

    @cached_property
    def teleports(self) -> BoolArray:
        """Mask of the sample intervals in which the collider teleports ``(T - 1,)``."""
        return self.poses.teleports(self.shape.anchors(), self.speed_limit)

    @property
    def max_speed(self) -> float:
        """Maximum speed of the collider, teleports excluded [m/s]."""
        positions = self.poses.to_world(self.shape.anchors())
        distances = np.linalg.norm(np.diff(positions, axis=0), axis=2)
        distances = distances.max(axis=1, initial=0.0)
        speeds = distances / np.diff(self.poses.sample_times)
        return float(speeds[~self.teleports].max(initial=0.0))

    def as_solid(self) -> Collider:
        """Return the collider as a solid: a watertight mesh is marked as closed."""
        if not isinstance(self.shape, Mesh) or self.shape.closed:
            return self
        return replace(self, shape=replace(self.shape, closed=True))

    def end_poses(self, times: FloatArray) -> FloatArray:
        """Return poses at both ends of the steps between times [s] ``(K, 2, 7)``."""
        if self.poses.is_fixed:
            return np.broadcast_to(self.poses.rows, (len(times) - 1, 2, 7))
        key_times, poses = self.poses.sample_times, self.poses.at_times(times)
        if not self.teleports.any():
            return np.stack([poses[:-1], poses[1:]], axis=1)
        interval_indices = np.searchsorted(key_times, times, "right") - 1
        interval_indices = np.clip(interval_indices, 0, len(key_times) - 1)
        is_teleport = np.append(self.teleports, False)
        # Within a teleport, a collider stays where it was.
        is_in_teleport = is_teleport[interval_indices]
        poses[is_in_teleport] = self.poses.rows[interval_indices[is_in_teleport]]
        ends = np.stack([poses[:-1], poses[1:]], axis=1)
        # A collider that teleports within a step is at its goal from the start of it.
        teleport_counts = np.cumsum(np.append(0, is_teleport))[interval_indices]
        has_teleported = teleport_counts[1:] > teleport_counts[:-1]
        ends[has_teleported, 0] = ends[has_teleported, 1]
        return ends

    def problems(self) -> list[tuple[str, str]]:
        """Return the names of invalid options, each with a message."""
        faults = [("shape", message) for message in self.shape.faults()]
        faults += [("poses", message) for message in self.poses.faults()]
        return faults + super().problems()

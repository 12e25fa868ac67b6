"""Colliders from a scene's systems for springs attached to its character."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.core.units import UpAxis, up_from_up
from animtool.maths import so3
from animtool.motion.take import TakeStream
from animtool.scene.file.entries import SceneSystem
from animtool.scene.systems.character_motion import motion_from_take
from animtool.scene.systems.links import with_dependencies
from animtool.scene.systems.simulation import character_cache, open_systems
from animtool.scene.systems.surroundings import Surroundings
from animtool.sim.colliders import Collider, Colliders, MovingBodies, Poses, SheetMotion


def with_colliders(
    systems: Sequence[SceneSystem],
    path: Path,
    stream: TakeStream,
    options: Any,
    lead_seconds: float = 0.0,
) -> tuple[TakeStream, Colliders]:
    """Return a take and the colliders that the options of a pass name.

    The named systems of the scene, whose file is ``path``, and their dependencies are
    simulated over the frames of the take. If they need the scene's own character, all
    frames of the take are read at once. The options have ``colliders`` in the axes of
    the rig, ``characters``, ``systems`` and ``meshes``. The first frame is held for
    ``lead`` before the take continues [s].
    """
    surroundings = Surroundings((), options.characters, options.systems, options.meshes)
    names = {entry.system for entry in options.systems}
    named_systems = [i for i, system in enumerate(systems) if system.name in names]
    system_indices = with_dependencies(systems, named_systems) if named_systems else []
    character, running_systems = None, []
    if system_indices:
        take = stream.collect()
        stream = replace(stream, blocks=iter([take.motion]))
        character = motion_from_take(path, take)
        character = replace(character, times=character.times + lead_seconds)
        last = float(character.times[-1])
        simulated_systems = [systems[i] for i in system_indices]
        running_systems = open_systems(simulated_systems, last, character)
    system_runs = zip(system_indices, running_systems, strict=True)
    run_by_name = {systems[i].name: run for i, run in system_runs}
    colliders = surroundings.build(character_cache(character), run_by_name)
    rotation = up_from_up(stream.rig.up, UpAxis.Y)
    if rotation is not None:
        colliders = _rotate_colliders(colliders, np.array(rotation))
    shapes = [*options.colliders, *colliders]
    return stream, Colliders(shapes, colliders.sheets, colliders.bodies)


def _rotate_colliders(colliders: Colliders, rotation: FloatArray) -> Colliders:
    """Return colliders rotated about the origin by a quaternion ``(4,)``."""
    shapes = []
    for collider in colliders:
        pose_rows = _rotate_pose_rows(collider.poses.rows, rotation)
        poses = Poses(collider.poses.sample_times, pose_rows[:, :3], pose_rows[:, 3:])
        shapes.append(replace(collider, poses=poses))
    sheets = [
        replace(sheet, motion=_RotatedSheetMotion(sheet.motion, rotation))
        for sheet in colliders.sheets
    ]
    # No forces act on bodies, so only their motion is rotated.
    bodies = [_RotatedBodies(body, rotation) for body in colliders.bodies]
    return Colliders(shapes, sheets, cast("list[MovingBodies]", bodies))


def _rotate_pose_rows(rows: FloatArray, rotation: FloatArray) -> FloatArray:
    """Return origins and quaternions ``(…, 7)`` rotated about the origin."""
    origins = so3.rotate(rotation, rows[..., :3])
    return np.concatenate([origins, so3.multiply(rotation, rows[..., 3:])], axis=-1)


@dataclass(frozen=True, slots=True)
class _RotatedSheetMotion:
    """A moving surface, rotated about the origin."""

    motion: SheetMotion
    rotation: FloatArray  # ``(4,)``

    def points(self, t: float) -> FloatArray:
        """Return the points ``(N, 3)`` [m] of the surface at a time [s]."""
        return np.asarray(so3.rotate(self.rotation, self.motion.points(t)))

    def triangles(self, t: float) -> IntArray:
        """Return the point indices of the triangles ``(T, 3)``."""
        return self.motion.triangles(t)

    def forget(self, t: float) -> None:
        """Discard data before a time; earlier times are not sampled again [s]."""
        self.motion.forget(t)


class _RotatedBodies:
    """One-way coupled rigid bodies, rotated about the origin."""

    def __init__(self, bodies: MovingBodies, rotation: FloatArray) -> None:
        self._bodies, self._rotation = bodies, rotation
        self.colliders: Sequence[Collider] = bodies.colliders
        self.owners, self.count, self.masses = bodies.owners, 0, bodies.masses

    @property
    def max_speed(self) -> float:
        """Highest speed of the bodies so far [m/s]."""
        return self._bodies.max_speed

    def end_poses(self, t0: float, t1: float) -> FloatArray:
        """Return poses of the shapes ``(C, 2, 7)`` at both ends of a step [s]."""
        return _rotate_pose_rows(self._bodies.end_poses(t0, t1), self._rotation)

    def forget(self, t: float) -> None:
        """Discard data before a time; earlier times are not sampled again [s]."""
        self._bodies.forget(t)

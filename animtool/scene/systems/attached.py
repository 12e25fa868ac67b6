"""What hangs on the character of a scene runs into: the world that systems have."""

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
from animtool.scene.systems.character_motion import motion_of
from animtool.scene.systems.links import simulated_with
from animtool.scene.systems.simulation import characters_with, open_systems
from animtool.scene.systems.surroundings import Surroundings
from animtool.sim.colliders import Collider, Colliders, MovingBodies, Poses, SheetMotion


def around_take(
    systems: Sequence[SceneSystem],
    path: Path,
    stream: TakeStream,
    options: Any,
    lead: float = 0.0,
) -> tuple[TakeStream, Colliders]:
    """Return a take, and what the options of a pass name that is run into.

    The systems that they name are simulated with those that these need, over the frames
    of the take; the scene's own character is the take as it is. Its frames are then
    read at once.

    Args:
        systems: Of the scene.
        path: Of the scene.
        stream: The take.
        options: With ``colliders`` in the axes of the rig, and ``characters``,
            ``systems`` and ``meshes``.
        lead: How long the first frame is held before it goes on [s].
    """
    around = Surroundings((), options.characters, options.systems, options.meshes)
    names = {one.system for one in options.systems}
    wanted = [i for i, system in enumerate(systems) if system.name in names]
    numbers = simulated_with(systems, wanted) if wanted else []
    own, opened = None, []
    if numbers:
        take = stream.collect()
        stream = replace(stream, blocks=iter([take.motion]))
        own = motion_of(path, take)
        own = replace(own, times=own.times + lead)
        needed = [systems[i] for i in numbers]
        opened = open_systems(needed, float(own.times[-1]), own)
    named = {systems[i].name: one for i, one in zip(numbers, opened, strict=True)}
    built = around.built(characters_with(own), named)
    turn = up_from_up(stream.rig.up, UpAxis.Y)
    if turn is not None:
        built = _turned(built, np.array(turn))
    return stream, Colliders([*options.colliders, *built], built.sheets, built.bodies)


def _turned(colliders: Colliders, turn: FloatArray) -> Colliders:
    """Return colliders turned about the origin, by a quaternion ``(4,)``."""
    return Colliders(
        [replace(one, poses=_turned_poses(one.poses, turn)) for one in colliders],
        [
            replace(one, motion=_TurnedMotion(one.motion, turn))
            for one in colliders.sheets
        ],
        # Nothing pushes them, which is all that they do not know.
        [cast("MovingBodies", _TurnedBodies(one, turn)) for one in colliders.bodies],
    )


def _turned_poses(poses: Poses, turn: FloatArray) -> Poses:
    rows = _turned_rows(poses.rows, turn)
    return Poses(poses.sample_times, rows[:, :3], rows[:, 3:])


def _turned_rows(rows: FloatArray, turn: FloatArray) -> FloatArray:
    """Return origins and quaternions ``(…, 7)`` turned about the origin."""
    origins = so3.rotate(turn, rows[..., :3])
    return np.concatenate([origins, so3.multiply(turn, rows[..., 3:])], axis=-1)


@dataclass(frozen=True, slots=True)
class _TurnedMotion:
    """A surface in motion, turned about the origin."""

    motion: SheetMotion
    turn: FloatArray  # ``(4,)``

    def points(self, t: float) -> FloatArray:
        """Return its points ``(N, 3)`` at a time [s] [m]."""
        return np.asarray(so3.rotate(self.turn, self.motion.points(t)))

    def triangles(self, t: float) -> IntArray:
        """Return corners of its triangles ``(T, 3)`` at such a time."""
        return self.motion.triangles(t)

    def forget(self, t: float) -> None:
        """Take note that no time before one will be asked for [s]."""
        self.motion.forget(t)


class _TurnedBodies:
    """Rigid bodies that nothing pushes, turned about the origin."""

    def __init__(self, bodies: MovingBodies, turn: FloatArray) -> None:
        self._bodies, self._turn = bodies, turn
        self.colliders: Sequence[Collider] = bodies.colliders
        self.owners, self.count, self.masses = bodies.owners, 0, bodies.masses

    @property
    def fastest(self) -> float:
        """Speed of the fastest so far [m/s]."""
        return self._bodies.fastest

    def ends(self, t0: float, t1: float) -> FloatArray:
        """Return poses of the shapes ``(C, 2, 7)`` at both ends of a step [s]."""
        return _turned_rows(self._bodies.ends(t0, t1), self._turn)

    def forget(self, t: float) -> None:
        """Take note that no time before one will be asked for [s]."""
        self._bodies.forget(t)

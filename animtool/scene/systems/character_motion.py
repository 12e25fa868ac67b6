"""Characters in motion that systems meet, y up."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from animtool._types import FloatArray
from animtool.documents.names import is_named
from animtool.errors import Fault, OptionError
from animtool.motion import Motion
from animtool.reorient import reorient
from animtool.rig.kinematics import WorldTransforms, forward
from animtool.rig.skeleton import Rig
from animtool.scene.sources import open_source
from animtool.sim.colliders import Collider, Sphere, rig_colliders
from animtool.take import Take, TakeStream
from animtool.units import UpAxis


@dataclass(frozen=True, slots=True)
class CharacterMotion:
    """A character over its F frames, y up; held before the first and after the last."""

    path: Path  # its file
    rig: Rig  # its rig
    motion: Motion  # poses, and weights of shapes
    world: WorldTransforms  # of its joints
    times: FloatArray  # of the frames, the first at 0 s ``(F,)`` [s]

    def colliders(self, material: tuple[float, float, float]) -> list[Collider]:
        """Return the capsules of its rig over its frames: ``material`` [m]."""
        if not self.rig.colliders:
            message = f"the rig {self.rig.name!r} has no colliders"
            hint = "particles run into the capsules that its rig file lists"
            raise OptionError(Fault("SIM020", message, str(self.path), (), hint))
        restitution, friction, margin = material
        like = Collider(
            Sphere(1.0), restitution=restitution, friction=friction, margin=margin
        )
        return rig_colliders(self.rig, self.world, self.times, like)


@dataclass
class CharacterMotions:
    """Characters by their files, each read once; the scene's own by its file."""

    found: dict[Path, CharacterMotion] = field(default_factory=dict)

    def of(self, path: Path) -> CharacterMotion:
        """Return the character of a clip or a scene."""
        if path not in self.found:
            self.found[path] = _read(path)
        return self.found[path]


def _read(path: Path) -> CharacterMotion:
    return motion_of(path, open_take(path).collect())


def motion_of(path: Path, take: Take) -> CharacterMotion:
    """Return a take as systems see it, the first frame at 0 s."""
    if take.rig.up is not UpAxis.Y:
        take = reorient(TakeStream.of(take), UpAxis.Y).collect()
    world = forward(take.rig, *take.motion.dense())
    clock = take.clock
    times = np.arange(clock.count, dtype=np.float64) * float(clock.step / clock.fps)
    return CharacterMotion(path, take.rig, take.motion, world, times)


def open_take(path: Path) -> TakeStream:
    """Return the take of a clip, or of a scene with its passes."""
    if not is_named(path, "scene"):
        return open_source(path)
    from animtool.scene.file import load_scene

    return load_scene(path).open(keeps=False)

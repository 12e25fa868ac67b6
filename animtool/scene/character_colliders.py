"""The capsules of characters in motion, as what particles run into."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from animtool.errors import Fault, OptionError
from animtool.rig.kinematics import forward
from animtool.scene.sources import is_scene, open_source
from animtool.sim.colliders import Collider, Sphere, rig_colliders
from animtool.take import TakeStream

__all__ = ["character_colliders"]


def character_colliders(
    path: Path, material: tuple[float, float, float]
) -> list[Collider]:
    """Return the colliders of a character over its frames, the first at 0 s.

    Args:
        path: A clip or a scene.
        material: Restitution, friction and margin [m].

    Raises:
        FormatError: The file is malformed.
        OptionError: Its rig has no colliders (SIM020).
    """
    take = _opened(path).collect()
    if not take.rig.colliders:
        message = f"the rig {take.rig.name!r} has no colliders"
        hint = "particles run into the capsules that its rig file lists"
        raise OptionError(Fault("SIM020", message, str(path), (), hint))
    world = forward(take.rig, *take.motion.dense())
    clock = take.clock
    times = np.arange(clock.count) * float(clock.step / clock.fps)
    restitution, friction, margin = material
    like = Collider(
        Sphere(1.0), restitution=restitution, friction=friction, margin=margin
    )
    return rig_colliders(take.rig, world, times, like)


def _opened(path: Path) -> TakeStream:
    if not is_scene(path):
        return open_source(path)
    from animtool.scene.file import load_scene

    return load_scene(path).open()

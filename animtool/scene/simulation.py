"""What a scene simulates: kinds of systems, and what they give for each frame."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Protocol, TypeAlias

from animtool.errors import Fault
from animtool.scene.entries import SceneSystem

if TYPE_CHECKING:
    from animtool.sim.particles.run import ParticleFrame

__all__ = ["Simulation", "open_system"]

# What a frame may be; each has its writer in `animtool.usd`.
Geometry: TypeAlias = "ParticleFrame"


class Simulation(Protocol):
    """A system under way.

    Attributes:
        notices: What is odd about it so far.
    """

    notices: list[Fault]

    def at(self, t: float) -> Geometry:
        """Return what there is at a time [s], not before the last one asked for."""
        ...


def open_system(system: SceneSystem) -> Simulation:
    """Return a system at its beginning; the first frame is at 0 s."""
    from animtool.sim.particles.run import ParticleRun

    setup = system.setup
    if system.characters:
        from animtool.scene.character_colliders import character_colliders

        moving = [
            collider
            for path, material in system.characters
            for collider in character_colliders(path, material)
        ]
        setup = replace(setup, colliders=[*setup.colliders, *moving])
    return ParticleRun(setup, -system.preroll)

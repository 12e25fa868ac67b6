"""Particles: emission, forces, velocity fields, collisions and removal."""

from __future__ import annotations

from typing import TYPE_CHECKING

from animtool.core.plugins import lazy_names

if TYPE_CHECKING:
    from animtool.systems.particles.emitter import Emitter as Emitter
    from animtool.systems.particles.emitter_shapes import BoxShape as BoxShape
    from animtool.systems.particles.emitter_shapes import Disc as Disc
    from animtool.systems.particles.emitter_shapes import MeshSurface as MeshSurface
    from animtool.systems.particles.emitter_shapes import Point as Point
    from animtool.systems.particles.emitter_shapes import SphereShape as SphereShape
    from animtool.systems.particles.forces.base import Force as Force
    from animtool.systems.particles.forces.table import FORCES as FORCES
    from animtool.systems.particles.forces.table import find_force as find_force
    from animtool.systems.particles.run import ParticleFrame as ParticleFrame
    from animtool.systems.particles.run import ParticleRun as ParticleRun
    from animtool.systems.particles.setup import KillRegion as KillRegion
    from animtool.systems.particles.setup import Particles as Particles
    from animtool.systems.particles.state import ParticleState as ParticleState
    from animtool.systems.particles.velocity_field import VelocityField as VelocityField

_MODULES = {
    "emitter": ("Emitter",),
    "forces.table": ("FORCES", "find_force"),
    "forces.base": ("Force",),
    "emitter_shapes": ("BoxShape", "Disc", "MeshSurface", "Point", "SphereShape"),
    "run": ("ParticleFrame", "ParticleRun"),
    "setup": ("KillRegion", "Particles"),
    "state": ("ParticleState",),
    "velocity_field": ("VelocityField",),
}
_PUBLIC = {
    name: f"{__name__}.{module}" for module, names in _MODULES.items() for name in names
}

__all__ = sorted(_PUBLIC)  # noqa: PLE0605 - the table above is the list

if not TYPE_CHECKING:  # type checkers know the names that are imported, and no others
    _OLD_NAMES = {"BoxPlace": "BoxShape", "SpherePlace": "SphereShape"}
    __getattr__, __dir__ = lazy_names(__name__, _PUBLIC, _OLD_NAMES)

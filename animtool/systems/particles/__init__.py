"""Particles: emitted, moved by forces or a field, stopped by colliders, removed."""

from animtool.systems.particles.emitter import Emitter
from animtool.systems.particles.forces import FORCES, find_force
from animtool.systems.particles.forces.force import Force
from animtool.systems.particles.places import (
    BoxPlace,
    Disc,
    MeshSurface,
    Point,
    SpherePlace,
)
from animtool.systems.particles.run import ParticleFrame, ParticleRun
from animtool.systems.particles.setup import KillRegion, Particles
from animtool.systems.particles.state import ParticleState
from animtool.systems.particles.velocity_field import VelocityField

__all__ = [
    "FORCES",
    "BoxPlace",
    "Disc",
    "Emitter",
    "Force",
    "KillRegion",
    "MeshSurface",
    "ParticleFrame",
    "ParticleRun",
    "ParticleState",
    "Particles",
    "Point",
    "SpherePlace",
    "VelocityField",
    "find_force",
]

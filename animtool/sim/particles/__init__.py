"""Particles: emitted, moved by forces or a field, stopped by colliders, removed."""

from animtool.sim.particles.emitter import Emitter
from animtool.sim.particles.forces import FORCES, find_force
from animtool.sim.particles.forces.force import Force
from animtool.sim.particles.places import (
    BoxPlace,
    Disc,
    MeshSurface,
    Point,
    SpherePlace,
)
from animtool.sim.particles.run import ParticleFrame, ParticleRun
from animtool.sim.particles.setup import KillRegion, Particles
from animtool.sim.particles.state import ParticleState
from animtool.sim.particles.velocity_field import VelocityField

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

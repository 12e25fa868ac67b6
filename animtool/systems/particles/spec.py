"""The keys of particles in a scene file, as models, and the records of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from annotated_types import Len
from pydantic import Field

from animtool.core.errors import Fault, OptionError, counted
from animtool.documents.fields import Real, key, with_fields
from animtool.systems.framework.fields import (
    Characters,
    Colliders,
    EmitterShapeEntry,
    Forces,
    Integrator,
    MaxParticles,
    Meshes,
    PlacedModel,
    PrimName,
    RecordModel,
    Surfaces,
    SystemColliderModel,
    Tolerance,
)
from animtool.systems.framework.spec import SystemSpec
from animtool.systems.particles.records import Emission, Velocity

if TYPE_CHECKING:
    from animtool.systems.framework.simulation import SimContext
    from animtool.systems.particles.setup import Particles
    from animtool.systems.particles.simulation import ParticleSimulation


@with_fields(Emission)
@with_fields(Emission, "name", before="place")
class EmitterModel(PlacedModel, RecordModel):
    """What makes particles."""

    code: ClassVar[str] = "SIM021"
    makes: ClassVar[str] = "animtool.systems.particles.emitter:Emitter"

    place: EmitterShapeEntry = key(
        "Emitter shape: `point`, `disc`, `sphere`, `box` or `mesh`.",
        {"disc": {"radius": 0.2}},
        default={"point": None},
    )


@with_fields(Velocity)
class VelocityModel(RecordModel):
    """A velocity field: expressions of x, y, z, t and age."""

    makes: ClassVar[str] = "animtool.systems.particles.velocity_field:VelocityField"


class ParticlesModel(SystemSpec):
    """Particles: born, moved, stopped and removed. Lengths are in metres."""

    methods: ClassVar[Sequence[str] | None] = None
    exact: ClassVar[str] = "rk4"

    name: PrimName = Field(default="particles", examples=["embers"])
    emitters: Annotated[list[EmitterModel], Len(1)] = key(
        "Emitters.", [{"rate": 100, "speed": 2, "lifetime": 1}]
    )
    forces: Forces = Field([])
    velocity: VelocityModel | None = key(
        "A velocity field to follow, instead of forces.",
        {"x": "-z", "z": "x"},
        default=None,
    )
    colliders: Colliders = Field([])
    characters: Characters = Field([])
    systems: Surfaces = Field([])
    meshes: Meshes = Field([])
    kill: list[SystemColliderModel] = key(
        "Regions where they are removed.",
        [{"shape": {"plane": {"offset": -1}}}],
        default=[],
    )
    method: Integrator = "midpoint"
    step: Real = key(
        "Step of the simulation [s], independent of the frame rate.",
        0.005,
        default=0.01,
    )
    tolerance: Tolerance = None
    max_particles: MaxParticles = 1_000_000

    @property
    def title(self) -> str:
        """What they are called in words."""
        return "particles"

    @property
    def reads(self) -> list[str]:
        """What acts on them, in words."""
        field = ["a velocity field"] if self.velocity else []
        return [counted(len(self.emitters), "emitter"), *super().reads, *field]

    @property
    def counts(self) -> dict[str, int]:
        """What they are made of, by kind."""
        return {
            "emitters": len(self.emitters),
            "forces": len(self.forces),
            "max_particles": self.max_particles,
        }

    def setup(self, parts: Mapping[str, Any]) -> Particles:
        """Return what they are made of, without what they run into."""
        from animtool.sim.options import IntegrateOptions
        from animtool.systems.particles.setup import KillRegion, Particles

        return Particles(
            parts["emitters"],
            parts["forces"],
            parts.get("velocity"),
            kills=[KillRegion(region) for region in parts["kill"]],
            options=IntegrateOptions(self.method, self.step, self.tolerance),
            max_particles=self.max_particles,
            name=self.name,
        )

    def faults(self, parts: Mapping[str, Any]) -> Sequence[Fault]:
        """Return what makes no sense together (SIM001, SIM004, SIM005, SIM024)."""
        try:
            self.setup(parts).check()
        except OptionError as error:
            return [replace(one, where=one.where or "method") for one in error.faults]
        return ()


def build(spec: ParticlesModel, context: SimContext) -> ParticleSimulation:
    """Return particles at their beginning; what moves them is imported now."""
    from animtool.systems.particles.simulation import ParticleSimulation

    setup, around = spec.setup(context.parts), context.colliders
    setup = replace(
        setup, colliders=around[:], sheets=around.sheets, bodies=around.bodies
    )
    if context.budget is not None:
        options = replace(setup.options, budget=context.budget)
        setup = replace(setup, options=options)
    return ParticleSimulation(setup, context.begin)

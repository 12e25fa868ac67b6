"""The keys of particles in a scene file, as models, and the records of them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from annotated_types import Gt, Le, Len
from pydantic import Field

from animtool.documents.fields import Pair, Real, Vector, Whole, key
from animtool.errors import Fault, OptionError, counted
from animtool.systems.fields import (
    CharacterModel,
    ForceEntry,
    MovingMeshModel,
    PlacedModel,
    PlaceEntry,
    PrimName,
    RecordModel,
    SystemColliderModel,
    SystemSpec,
    SystemSurfaceModel,
    Tolerance,
)

if TYPE_CHECKING:
    from animtool.systems.particles.emitter import Emitter
    from animtool.systems.particles.run import ParticleSimulation
    from animtool.systems.particles.setup import Particles
    from animtool.systems.particles.velocity_field import VelocityField
    from animtool.systems.simulation import SimContext


class EmitterModel(PlacedModel, RecordModel):
    """What makes particles."""

    code: ClassVar[str] = "SIM021"

    name: str = key("For messages.", "embers", default="")
    place: PlaceEntry = key(
        "Where they are born: `point`, `disc`, `sphere`, `box` or `mesh`.",
        {"disc": {"radius": 0.2}},
        default={"point": None},
    )
    rate: Annotated[Real, Le(1e9)] = key("Particles a second.", 200, default=0.0)
    bursts: list[Pair] = key(
        "Seconds from the first frame on, and how many at once.",
        [[0, 50], [1.5, 50]],
        default=[],
    )
    start: Real | None = key(
        "Second that the rate begins in. Not given: the first.", 0.5, default=None
    )
    end: Real | None = key(
        "Second that the rate ends in. Not given: never.", 2.5, default=None
    )
    direction: Vector | None = key(
        "Middle of their directions. Not given: y, and from surfaces outwards.",
        [1, 1, 0],
        default=None,
    )
    spread: Real = key(
        "Half the angle of the cone about it [deg]; 180 is all around.", 20, default=0.0
    )
    speed: Real = key("Speed [m/s].", 3, default=0.0)
    speed_spread: Real = key("Most that it differs by [m/s].", 0.5, default=0.0)
    inherit: Real = key(
        "Share of the emitter's velocity that they have too.", 0.5, default=1.0
    )
    lifetime: Real | None = key(
        "How long they live [s]. Not given: for ever.", 2.5, default=None
    )
    lifetime_spread: Real = key("Most that it differs by [s].", 0.5, default=0.0)
    radius: Real = key("Their radius [m].", 0.01, default=0.005)
    radius_spread: Real = key("Most that it differs by [m].", 0.005, default=0.0)
    mass: Real = key("Their mass [kg].", 0.1, default=0.001)
    charge: Real = key("Their charge [C].", 1e-6, default=0.0)
    seed: Whole = key("Of what is random about them.", 7, default=0)

    def record(self, parts: Mapping[str, Any]) -> Emitter:
        """Return what makes them; what is not given is without end."""
        from animtool.systems.particles.emitter import Emitter

        own = self.model_dump(exclude={*PlacedModel.model_fields, "place"})
        own["bursts"] = [(when, int(count)) for when, count in self.bursts]
        own["spread"] = math.radians(self.spread)
        endless = {"start": -math.inf, "end": math.inf, "lifetime": math.inf}
        own |= {name: end for name, end in endless.items() if own[name] is None}
        return Emitter(place=parts["place"], poses=parts["poses"], **own)


class VelocityModel(RecordModel):
    """A velocity field: expressions of x, y, z, t and age."""

    x: str = key("Along x [m/s].", "-z", default="0")
    y: str = key("Along y [m/s].", "0.2", default="0")
    z: str = key("Along z [m/s].", "x", default="0")

    def record(self, parts: Mapping[str, Any]) -> VelocityField:  # noqa: ARG002
        """Return the field."""
        from animtool.systems.particles.velocity_field import VelocityField

        return VelocityField(self.x, self.y, self.z)


class ParticlesModel(SystemSpec):
    """Particles: born, moved, stopped and removed. Lengths are in metres."""

    methods: ClassVar[Sequence[str] | None] = None
    exact: ClassVar[str] = "rk4"

    name: PrimName = Field(default="particles", examples=["embers"])
    emitters: Annotated[list[EmitterModel], Len(1)] = key(
        "What makes them.", [{"rate": 100, "speed": 2, "lifetime": 1}]
    )
    forces: list[ForceEntry] = key(
        "What moves them: the name of a force, and its options.",
        [{"gravity": None}, {"drag": {"linear": 0.001}}],
        default=[],
    )
    velocity: VelocityModel | None = key(
        "A field that they go with, in place of forces.",
        {"x": "-z", "z": "x"},
        default=None,
    )
    colliders: list[SystemColliderModel] = key(
        "What they run into.",
        [{"shape": {"plane": None}, "restitution": 0.4}],
        default=[],
    )
    characters: list[CharacterModel] = key(
        "Characters in motion that they run into; none is written.",
        [{"file": "walk.clip.yaml", "friction": 0.3}],
        default=[],
    )
    systems: list[SystemSurfaceModel] = key(
        "Cloth, volumes and rigid bodies of the scene that they run into, as thick as "
        "their `radius`.",
        [{"system": "flag", "friction": 0.3}],
        default=[],
    )
    meshes: list[MovingMeshModel] = key(
        "Meshes of USD files that they run into, whose points may move.",
        [{"file": "beast.usdc", "prim": "/beast/body", "closed": True}],
        default=[],
    )
    kill: list[SystemColliderModel] = key(
        "Where they are removed.", [{"shape": {"plane": {"offset": -1}}}], default=[]
    )
    method: str = key("An integrator.", "rk4", default="midpoint")
    step: Real = key(
        "Step of the simulation [s], whatever the frame rate is.", 0.005, default=0.01
    )
    tolerance: Tolerance = None
    max_particles: Annotated[Whole, Gt(0), Le(10**7)] = key(
        "Particles at once.", 5000, default=1_000_000
    )

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
    from animtool.systems.particles.run import ParticleSimulation

    setup, around = spec.setup(context.parts), context.colliders
    setup = replace(
        setup, colliders=around[:], sheets=around.sheets, bodies=around.bodies
    )
    if context.budget is not None:
        options = replace(setup.options, budget=context.budget)
        setup = replace(setup, options=options)
    return ParticleSimulation(setup, context.begin)

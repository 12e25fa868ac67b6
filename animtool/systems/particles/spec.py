"""Scene keys of particles, and the records built from them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from annotated_types import Len
from pydantic import Field

from animtool.core.errors import Fault, OptionError
from animtool.core.options import key
from animtool.documents.fields import Real, with_fields
from animtool.systems.framework.fields import (
    EmitterShapeEntry,
    Integrator,
    MaxParticles,
    PlacedModel,
    PrimName,
    RecordModel,
    SystemColliderModel,
    Tolerance,
)
from animtool.systems.framework.spec import ForcedSpec
from animtool.systems.particles.records import Emission, Velocity

if TYPE_CHECKING:
    from animtool.systems.particles.setup import Particles


@with_fields(Emission)
@with_fields(Emission, "name", before_key="place")
class EmitterModel(PlacedModel, RecordModel):
    """A source of particles."""

    code: ClassVar[str] = "SIM021"
    record_path: ClassVar[str] = "animtool.systems.particles.emitter:Emitter"

    place: EmitterShapeEntry = key(
        "Emitter shape: `point`, `disc`, `sphere`, `box` or `mesh`.",
        {"disc": {"radius": 0.2}},
        default={"point": None},
    )


@with_fields(Velocity)
class VelocityModel(RecordModel):
    """A velocity field: expressions of x, y, z, t and age."""

    record_path: ClassVar[str] = (
        "animtool.systems.particles.velocity_field:VelocityField"
    )


class ParticlesModel(ForcedSpec):
    """Particles: born, moved, stopped and removed. Lengths are in metres."""

    methods: ClassVar[Sequence[str] | None] = None
    reference_method: ClassVar[str] = "rk4"
    counted_keys: ClassVar[Sequence[str]] = ("emitters", "forces")

    name: PrimName = Field(default="particles", examples=["embers"])
    emitters: Annotated[list[EmitterModel], Len(1)] = key(
        "Emitters.", [{"rate": 100, "speed": 2, "lifetime": 1}]
    )
    velocity: VelocityModel | None = key(
        "A velocity field to follow, instead of forces.",
        {"x": "-z", "z": "x"},
        default=None,
    )
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
        """Name of the entry in messages."""
        return "particles"

    @property
    def reads(self) -> list[str]:
        """External inputs as text, such as ``2 forces`` and a velocity field."""
        return [*super().reads, *(["a velocity field"] if self.velocity else [])]

    @property
    def counts(self) -> dict[str, int]:
        """Numbers of emitters and forces, and the limit of particles."""
        return {
            "emitters": len(self.emitters),
            "forces": len(self.forces),
            "max_particles": self.max_particles,
        }

    def setup(self, entry_data: Mapping[str, Any]) -> Particles:
        """Return the particle system, without colliders."""
        from animtool.sim.options import IntegrateOptions
        from animtool.systems.particles.setup import KillRegion, Particles

        return Particles(
            entry_data["emitters"],
            entry_data["forces"],
            entry_data.get("velocity"),
            kills=[KillRegion(region) for region in entry_data["kill"]],
            options=IntegrateOptions(self.method, self.step, self.tolerance),
            max_particles=self.max_particles,
            name=self.name,
        )

    def faults(self, entry_data: Mapping[str, Any]) -> Sequence[Fault]:
        """Return faults in keys and combinations (SIM001, SIM004, SIM005, SIM024)."""
        try:
            self.setup(entry_data).check()
        except OptionError as error:
            faults = error.faults
            return [replace(fault, where=fault.where or "method") for fault in faults]
        return ()

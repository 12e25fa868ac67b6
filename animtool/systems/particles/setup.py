"""The setup of a particle simulation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field
from typing import Annotated

from animtool.core.errors import AnimtoolError, Fault, OptionError
from animtool.core.options import Range, range_faults
from animtool.core.record import dataclass
from animtool.sim.colliders.bodies import MovingBodies
from animtool.sim.colliders.collider import Collider
from animtool.sim.colliders.sheets import Sheet
from animtool.sim.options import IntegrateOptions, checked_integrator
from animtool.systems.particles.emitter import Emitter
from animtool.systems.particles.forces.base import Force
from animtool.systems.particles.forces.table import FORCES
from animtool.systems.particles.velocity_field import VelocityField

# Default step [s]: four per frame at 24 frames per second.
DEFAULT_STEP = 1 / 96


@dataclass(frozen=True, slots=True)
class KillRegion:
    """A region that removes particles.

    Attributes:
        region: A collider, whose contact material is ignored. Particles outside of a
            container are removed.
    """

    region: Collider


@dataclass(frozen=True)
class Particles:
    """A particle system: emitters, forces, colliders and kill regions.

    Attributes:
        emitters: Sources of particles.
        forces: Forces on the particles.
        velocity: Velocity field that moves particles, instead of forces.
        colliders: Colliders.
        kills: Regions that remove particles.
        options: Method, and step [s]: all steps have this length, independent of the
            requested times.
        max_particles: Largest number of living particles; further births are skipped.
        name: Name for messages.
        sheets: Deforming surfaces as colliders.
        bodies: Bodies of another simulation, as colliders that particles push.
    """

    emitters: Sequence[Emitter]
    forces: Sequence[Force] = ()
    velocity: VelocityField | None = None
    colliders: Sequence[Collider] = ()
    kills: Sequence[KillRegion] = ()
    options: IntegrateOptions = field(
        default_factory=lambda: IntegrateOptions("midpoint", step=DEFAULT_STEP)
    )
    max_particles: Annotated[int, Range("1 or more", "SIM024", 1, finite=True)] = 10**6
    name: str = "particles"
    sheets: Sequence[Sheet] = ()
    bodies: Sequence[MovingBodies] = ()

    def check(self) -> None:
        """Raise if the setup is invalid.

        Raises:
            OptionError: The setup is invalid (SIM001, SIM004 to SIM006, SIM020 to
                SIM024); lists all faults.
        """
        faults = self._option_faults() + self._part_faults()
        if faults:
            raise OptionError(faults)

    def _option_faults(self) -> list[Fault]:
        """Return faults in the options and their combinations."""
        faults: list[Fault] = []
        try:
            checked_integrator(self.options)
        except AnimtoolError as error:
            faults += error.faults
        if self.options.step is None:
            message = "particles need a step: they are emitted during a step"
            faults.append(Fault("SIM024", message, where="step"))
        faults += range_faults(self)
        if not self.emitters:
            message = "it has no emitter, so there are no particles"
            faults.append(Fault("SIM024", message, where="emitters"))
        if self.velocity is not None and self.forces:
            message = "a velocity field moves particles whatever the forces are"
            hint = "remove one of them, or use a force that acts by drag: wind, "
            hint += "turbulence"
            faults.append(Fault("SIM024", message, where="velocity", hint=hint))
        return faults

    def _part_faults(self) -> list[Fault]:
        """Return faults in emitters, forces, colliders and regions."""
        faults = _record_faults("emitters", self.emitters)
        for i, force in enumerate(self.forces):
            location = f"{_table_name(force)}[{i}]"
            faults += [
                Fault("SIM022", f"its {option} {reason}", where=location)
                for option, reason in force.faults()
            ]
        if self.velocity is not None:
            faults += self.velocity.faults("velocity")
        faults += _record_faults("colliders", self.colliders)
        faults += _record_faults("kills", [kill.region for kill in self.kills])
        return faults + _record_faults("sheets", self.sheets)


def _record_faults(
    key: str, records: Sequence[Emitter | Collider | Sheet]
) -> list[Fault]:
    """Return the faults in records, located by name or number."""
    return [
        fault
        for i, record in enumerate(records)
        for fault in record.faults(record.name or f"{key}[{i}]")
    ]


def _table_name(force: Force) -> str:
    """Return the name of a force in `FORCES`, or the class name if it has none."""
    kind = type(force).__name__
    return next(
        (
            name
            for name, class_path in FORCES.items()
            if class_path.endswith(f":{kind}")
        ),
        kind,
    )

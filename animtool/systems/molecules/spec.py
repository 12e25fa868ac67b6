"""The keys of a molecular system in a scene file, as models."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Annotated, ClassVar, Literal

from annotated_types import Ge, Le, Len

from animtool.core.errors import Problem
from animtool.documents.check import FileModel
from animtool.documents.fields import (
    Count,
    Name,
    NotNegative,
    Pair,
    Positive,
    Real,
    Vector,
    key,
)
from animtool.systems.framework.colours import ColourModel
from animtool.systems.framework.fields import (
    ArrayEntry,
    Integrator,
    PlacedModel,
    PlacementModel,
    Seed,
)
from animtool.systems.framework.spec import SystemSpec


class AtomsModel(FileModel):
    """Atoms of one kind; those of argon where nothing else is given."""

    name: Name = key("Its name.", "argon")
    count: Count = key("How many, on a lattice.", 864, default=256)
    points: ArrayEntry | None = key(
        "Where each begins `(N, 3)` [m], in place of `count`.",
        "atoms.npz#points",
        default=None,
    )
    velocities: ArrayEntry | None = key(
        "Of these `(N, 3)` [m/s]. Not given: by `temperature`.",
        "atoms.npz#velocities",
        default=None,
    )
    mass: Positive = key("Of each [u].", 22.99, default=39.948)
    sigma: Annotated[Real, Ge(1e-3), Le(1e3)] = key(
        "Distance at which two neither attract nor repel each other [nm].",
        0.2,
        default=0.3405,
    )
    epsilon: NotNegative = key("Energy that parts two [kJ/mol].", 0.4, default=0.9961)
    charge: Real = key("Of each [e].", 1, default=0.0)
    radius: Positive | None = key(
        "Half the width that each is drawn with [m]. Not given: half of sigma.",
        0.15,
        default=None,
    )


class ThermostatModel(FileModel):
    """A bath that keeps a temperature: canonical velocity rescaling."""

    temperatures: Annotated[list[Pair], Len(1, 10_000)] = key(
        "Rows of seconds from the first frame on and a temperature [K], linear "
        "between.",
        [[0, 20], [4, 120]],
    )
    relaxation: Positive = key("Time in which it is approached [ps].", 0.5, default=0.2)


class TrapModel(PlacedModel):
    """A place that draws atoms in, such as optical tweezers or a tip."""

    stiffness: Real = key(
        "Force over the distance, near its middle [kJ/(mol nm²)].", 50
    )
    radius: Positive = key("It draws nobody beyond [nm].", 0.6, default=0.5)


class MoleculesModel(PlacementModel, SystemSpec):
    """Molecular dynamics of atoms with Lennard-Jones forces and charges."""

    methods: ClassVar[Sequence[str]] = (
        *("symplectic_euler", "velocity_verlet", "position_verlet", "rk4"),
    )
    made_of: ClassVar[Sequence[str]] = ("species",)
    acted_on: ClassVar[Sequence[str]] = ("traps",)
    code: ClassVar[str] = "SIM071"
    quantities: ClassVar[Sequence[str]] = (
        *("speed", "temperature", "density", "energy", "species"),
    )

    species: Annotated[list[AtomsModel], Len(1, 50)] = key(
        "Kinds of atoms; two of different kinds have the mean sigma and the geometric "
        "mean epsilon.",
        [{"name": "argon", "count": 256}],
    )
    box: Annotated[list[Positive], Len(3, 3)] = key(
        "Sides of the box, at whose ends it goes on at the other [nm].", [3, 3, 3]
    )
    at: Vector = key("Middle of the box [m].", [0, 5, 0], default=[0.0, 0.0, 0.0])
    lattice: Literal["fcc", "cubic"] = key(
        "`fcc`, or `cubic`, on which two kinds alternate.", "cubic", default="fcc"
    )
    block: Annotated[list[Positive], Len(3, 3)] | None = key(
        "Sides of the lattice, in the middle of the box [nm]. Not given: the box.",
        [2, 2, 2],
        default=None,
    )
    scale: Positive = key(
        "Metres that a nanometre is shown as [m/nm].", 0.1, default=1.0
    )
    pace: Positive = key("Picoseconds in a second [ps/s].", 5, default=1.0)
    temperature: NotNegative = key("At the beginning [K].", 94.4, default=0.0)
    thermostat: ThermostatModel | None = key(
        "A bath; without one energy stays.", {"temperatures": [[0, 94.4]]}, default=None
    )
    cutoff: Positive | None = key(
        "Distance beyond which two do not act on each other [nm]. Not given: 2.5 of "
        "the largest sigma.",
        0.9,
        default=None,
    )
    switch: Positive | None = key(
        "Distance from which on their force is switched off [nm]; the cut-off itself "
        "cuts it. Not given: 0.9 of the cut-off.",
        0.8,
        default=None,
    )
    damping: NotNegative = key(
        "Of charges: their force is that of the damped shifted force (Fennell and "
        "Gezelter), damped by erfc of this times the distance [1/nm].",
        3,
        default=2.0,
    )
    skin: NotNegative = key(
        "Neighbours are listed this much beyond the cut-off [nm], and anew where one "
        "has moved by half of it.",
        0.2,
        default=0.12,
    )
    traps: list[TrapModel] = key(
        "Places that draw atoms in; they may move.",
        [{"at": [0, 5, 0], "stiffness": 50}],
        default=[],
    )
    seed: Seed = 0
    method: Integrator = "velocity_verlet"
    colour: ColourModel | None = key(
        "Colours by `speed` [nm/ps], `temperature` [K], `density` (log10 [u/nm³]), "
        "`energy` [kJ/mol] or `species`.",
        {"by": "temperature"},
        default=None,
    )

    @property
    def reach(self) -> float:
        """The cut-off [nm]."""
        return self.cutoff or 2.5 * max(one.sigma for one in self.species)

    def problems(self) -> Iterator[Problem]:
        """Yield which keys make no sense together."""
        least, reach = min(self.box), self.reach
        if least < 2 * reach:
            message = f"the box is {least:g} nm wide, and twice the cut-off is "
            hint = f"give cutoff: {least / 2:.3g}, or a larger box"
            yield f"{message}{2 * reach:g} nm", "box", hint
        if self.switch is not None and self.switch > reach:
            message = f"the switch begins at {self.switch:g} nm, beyond the cut-off of "
            yield f"{message}{reach:g} nm", "switch", None
        sides = zip(self.block or (), self.box, strict=False)
        if any(side > most for side, most in sides):
            yield "the block is larger than the box", "block", None
        rows = self.thermostat.temperatures if self.thermostat else []
        times = [t for t, _ in rows]
        if times != sorted(set(times)):
            yield "times of the thermostat do not ascend", "thermostat", None
        if any(temperature < 0 for _, temperature in rows):
            yield "a temperature is below 0 K", "thermostat", None

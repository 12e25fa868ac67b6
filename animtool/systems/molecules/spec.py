"""Keys of molecular systems in scene files."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Annotated, ClassVar, Literal

from annotated_types import Ge, Le, Len

from animtool.core.errors import Problem
from animtool.core.options import key
from animtool.core.quantities import plain_number
from animtool.documents.check import FileModel
from animtool.documents.fields import (
    Count,
    Name,
    NonNegative,
    NumberPair,
    Positive,
    Real,
    Vector,
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

NANOMETRE = 1e-9  # [m]
FREEZING_POINT = 273.15  # 0 °C [K]
# No molecule fits in a box so small, but a box in metres is [nm].
MAX_METRES = 1e-5
# The unit of atomic masses [kg]; an electron has 5.5e-4 of it [u].
ATOMIC_MASS, MIN_MASS = 1.66053907e-27, 5e-4
MAX_ATOM_SIZE = 1.5  # atoms and united atoms are below 0.7 [nm]
NANOMETRES_PER_ANGSTROM, NANOMETRES_PER_PICOMETRE = 0.1, 1e-3


class AtomsModel(FileModel):
    """Atoms of one species; the defaults are those of argon."""

    name: Name = key("Its name.", "argon")
    count: Count = key("Number of atoms, on a lattice.", 864, default=256)
    points: ArrayEntry | None = key(
        "Initial positions `(N, 3)` [m], instead of `count`.",
        "atoms.npz#points",
        default=None,
    )
    velocities: ArrayEntry | None = key(
        "Velocities of these `(N, 3)` [m/s]. Default: from `temperature`.",
        "atoms.npz#velocities",
        default=None,
    )
    mass: Positive = key("Mass of each [u].", 22.99, default=39.948)
    sigma: Annotated[Real, Ge(1e-3), Le(1e3)] = key(
        "Distance at which the pair potential is zero [nm].", 0.2, default=0.3405
    )
    epsilon: NonNegative = key(
        "Depth of the potential well [kJ/mol].", 0.4, default=0.9961
    )
    charge: Real = key("Charge of each [e].", 1, default=0.0)
    radius: Positive | None = key(
        "Half the width of each atom when drawn [m]. Default: half of sigma.",
        0.15,
        default=None,
    )


class ThermostatModel(FileModel):
    """A bath that keeps a temperature: canonical velocity rescaling."""

    temperatures: Annotated[list[NumberPair], Len(1, 10_000)] = key(
        "Rows of seconds from the first frame and a temperature [K], linear in "
        "between.",
        [[0, 20], [4, 120]],
    )
    relaxation: Positive = key("Relaxation time [ps].", 0.5, default=0.2)


class TrapModel(PlacedModel):
    """A point that attracts atoms, such as optical tweezers or a tip."""

    stiffness: Real = key("Force over distance, near its centre [kJ/(mol nm²)].", 50)
    radius: Positive = key("No attraction beyond [nm].", 0.6, default=0.5)


class MoleculesModel(PlacementModel, SystemSpec):
    """Molecular dynamics of atoms with Lennard-Jones forces and charges."""

    methods: ClassVar[Sequence[str]] = (
        *("symplectic_euler", "velocity_verlet", "position_verlet", "rk4"),
    )
    components: ClassVar[Sequence[str]] = ("species",)
    counted_keys: ClassVar[Sequence[str]] = ("traps",)
    code: ClassVar[str] = "SIM071"
    quantities: ClassVar[Sequence[str]] = (
        *("speed", "temperature", "density", "energy", "species"),
    )

    species: Annotated[list[AtomsModel], Len(1, 50)] = key(
        "Kinds of atoms; two of different kinds use the mean sigma and the geometric "
        "mean epsilon.",
        [{"name": "argon", "count": 256}],
    )
    box: Annotated[list[Positive], Len(3, 3)] = key(
        "Side lengths of the periodic box [nm].", [3, 3, 3]
    )
    at: Vector = key("Centre of the box [m].", [0, 5, 0], default=[0.0, 0.0, 0.0])
    lattice: Literal["fcc", "cubic"] = key(
        "`fcc`, or `cubic`, on which two kinds alternate.", "cubic", default="fcc"
    )
    block: Annotated[list[Positive], Len(3, 3)] | None = key(
        "Side lengths of the lattice, centred in the box [nm]. Default: the box.",
        [2, 2, 2],
        default=None,
    )
    scale: Positive = key("Metres per nanometre in the scene [m/nm].", 0.1, default=1.0)
    pace: Positive = key("Picoseconds per second [ps/s].", 5, default=1.0)
    temperature: Real = key("Initial temperature [K], 0 or more.", 94.4, default=0.0)
    thermostat: ThermostatModel | None = key(
        "A heat bath; without one, energy is conserved.",
        {"temperatures": [[0, 94.4]]},
        default=None,
    )
    cutoff: Positive | None = key(
        "Cut-off distance of interactions [nm]. Default: 2.5 times the largest sigma.",
        0.9,
        default=None,
    )
    switch: Positive | None = key(
        "Distance from which the force is switched off smoothly [nm]; a value equal "
        "to the cut-off truncates it. Default: 0.9 of the cut-off.",
        0.8,
        default=None,
    )
    damping: NonNegative = key(
        "Damping of charges: the damped shifted force (Fennell and Gezelter), damped "
        "by erfc of this times the distance [1/nm].",
        3,
        default=2.0,
    )
    skin: NonNegative = key(
        "Neighbour lists reach this far beyond the cut-off [nm], and are rebuilt "
        "when an atom has moved by half of it.",
        0.2,
        default=0.12,
    )
    traps: list[TrapModel] = key(
        "Points that attract atoms; they may move.",
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
    def cutoff_distance(self) -> float:
        """Cut-off distance of interactions [nm]."""
        return self.cutoff or 2.5 * max(species.sigma for species in self.species)

    def _box_problem(self, min_side: float, reach: float) -> Problem:
        """Return the conflict of a box [nm] that is too small for the cut-off [nm]."""
        sigma = max(species.sigma for species in self.species)
        message = f"the box is {min_side:g} nm wide, but twice the cut-off is "
        message += f"{2 * reach:g} nm"
        hint = f"use cutoff: {min_side / 2:.3g}, or a larger box"
        if min_side < MAX_METRES:
            numbers = ", ".join(f"{side / NANOMETRE:g}" for side in self.box)
            hint = f"lengths of molecules are in nm: write [{numbers}]"
        elif self.cutoff is None and sigma > MAX_ATOM_SIZE:
            message += f", 5 times sigma, {sigma:g} nm"
            unit, factor = "ångström", NANOMETRES_PER_ANGSTROM
            if sigma * factor > MAX_ATOM_SIZE:
                unit, factor = "pm", NANOMETRES_PER_PICOMETRE
            hint = f"for {sigma:g} {unit} write sigma: "
            hint += plain_number(sigma * factor, 4)
            if sigma * factor > MAX_ATOM_SIZE:
                hint = "lengths of molecules are in nm: atoms are about 0.3 nm wide"
            k = [species.sigma for species in self.species].index(sigma)
            return message, f"species[{k}].sigma", hint
        return message, "box", hint

    def problems(self) -> Iterator[Problem]:
        """Yield conflicts between box, cut-off, lattice and thermostat."""
        for k, species in enumerate(self.species):
            if species.mass < MIN_MASS:
                mass = plain_number(species.mass / ATOMIC_MASS, 4)
                message = (
                    f"mass {species.mass:g} u of {species.name!r} is below that of "
                )
                message += "an electron"
                hint = f"masses are in u: for {species.mass:g} kg write {mass}"
                yield message, f"species[{k}].mass", hint
        min_side, reach = min(self.box), self.cutoff_distance
        if min_side < 2 * reach:
            yield self._box_problem(min_side, reach)
        if self.switch is not None and self.switch > reach:
            message = f"the switch starts at {self.switch:g} nm, beyond the cut-off of "
            yield f"{message}{reach:g} nm", "switch", None
        sides = zip(self.block or (), self.box, strict=False)
        if any(side > box_side for side, box_side in sides):
            yield "the block is larger than the box", "block", None
        rows = self.thermostat.temperatures if self.thermostat else []
        times = [t for t, _ in rows]
        if times != sorted(set(times)):
            yield "times of the thermostat do not ascend", "thermostat", None
        temperatures = [("temperature", self.temperature)]
        temperatures += [("thermostat", temperature) for _, temperature in rows]
        for name, temperature in temperatures:
            if temperature < 0:
                kelvin = temperature + FREEZING_POINT
                advice = f"for {temperature:g} °C write {kelvin:g}"
                message = f"{temperature:g} K is below absolute zero"
                yield message, name, advice if kelvin > 0 else None

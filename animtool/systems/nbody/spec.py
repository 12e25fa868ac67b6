"""The keys of an N-body system in a scene file, as models."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Annotated, ClassVar, Literal

from annotated_types import Ge, Gt, Le, Lt

from animtool.core.errors import Problem
from animtool.documents.check import FileModel
from animtool.documents.fields import (
    Count,
    Name,
    NotNegative,
    Positive,
    Real,
    Vector,
    Whole,
    key,
)
from animtool.systems.framework.colours import ColourModel
from animtool.systems.framework.fields import (
    ArrayEntry,
    Integrator,
    PlacedModel,
    PlacementModel,
    Seed,
    Tolerance,
    Velocities,
)
from animtool.systems.framework.spec import SystemSpec


class BodiesModel(FileModel):
    """Bodies of a file; at rest if it gives no velocities."""

    points: ArrayEntry = key("Where each begins `(N, 3)` [m].", "stars.npz#points")
    velocities: Velocities = None
    masses: ArrayEntry | None = key(
        "Of these `(N,)` [kg], in place of `mass`.", "stars.npz#masses", default=None
    )
    mass: Positive = key("Of each [kg].", 0.5, default=1.0)
    radius: NotNegative = key(
        "Half the width they are drawn with [m].", 0.05, default=0.02
    )


class SpheroidModel(FileModel):
    """Stars or dark matter around a centre, alike all around."""

    count: Count = key("How many bodies.", 2000)
    mass: Positive = key("Of all of them [kg].", 0.3)
    radius: Positive = key("Scale radius of the profile [m].", 0.3)
    profile: Literal["hernquist", "plummer"] = key(
        "`hernquist` or `plummer`.", "plummer", default="hernquist"
    )
    cutoff: Annotated[Real, Gt(0), Le(100)] = key(
        "No body is farther out [scale radii].", 8, default=10.0
    )


class DiscModel(FileModel):
    """Stars in an exponential disc that rotates about the galaxy's y."""

    count: Count = key("How many bodies.", 5000)
    mass: Positive = key("Of all of them [kg].", 1.0)
    radius: Positive = key("Scale length of the surface density [m].", 1.0)
    thickness: Annotated[Real, Gt(0), Le(1)] = key(
        "Scale height over the scale length.", 0.05, default=0.1
    )
    cutoff: Annotated[Real, Gt(0), Le(100)] = key(
        "No body is farther out [scale lengths].", 4, default=5.0
    )
    stability: NotNegative = key(
        "Toomre's Q: 0 is cold and falls into clumps, above 1 it stays.",
        1.5,
        default=1.2,
    )


class GalaxyModel(PlacementModel):
    """A galaxy in equilibrium, on its own; it spins about its y."""

    name: Name = key("Its name.", "milky_way")
    at: Vector = key("Its centre [m].", [0, 5, 0], default=[0.0, 0.0, 0.0])
    velocity: Vector = key("Of its centre [m/s].", [0.2, 0, 0], default=[0.0, 0.0, 0.0])
    disc: DiscModel | None = key(
        "Stars in a disc.", {"count": 5000, "mass": 1, "radius": 1}, default=None
    )
    bulge: SpheroidModel | None = key(
        "Stars around the centre.",
        {"count": 1000, "mass": 0.3, "radius": 0.2},
        default=None,
    )
    halo: SpheroidModel | None = key(
        "Dark matter around all; it is written, too, unless `shows_halo` is not.",
        {"count": 5000, "mass": 5, "radius": 3},
        default=None,
    )
    shows_halo: bool = key("Bodies of the halo are written.", False, default=True)
    nucleus: NotNegative = key(
        "Mass of one body in the centre [kg]; 0 is none.", 0.1, default=0.0
    )
    seed: Seed = 0
    radius: NotNegative = key("Half the width of its bodies [m].", 0.01, default=0.02)

    @property
    def parts(self) -> list[DiscModel | SpheroidModel]:
        """What it has, the halo last."""
        return [one for one in (self.disc, self.bulge, self.halo) if one is not None]

    @property
    def dark(self) -> int:
        """How many of its last bodies are not written."""
        return self.halo.count if self.halo and not self.shows_halo else 0


class EncounterModel(PlacementModel):
    """The orbit on which two galaxies meet, as two points would, about its y."""

    at: Vector = key("Where they meet [m].", [0, 5, 0], default=[0.0, 0.0, 0.0])
    separation: Positive = key("Their distance at the beginning [m].", 10)
    pericentre: Positive = key("Their distance where it is least [m].", 2)
    eccentricity: Annotated[Real, Ge(0), Lt(100)] = key(
        "Of the orbit: 1 is a parabola, above 1 they part.", 0.9, default=1.0
    )


class AttractorModel(PlacedModel):
    """A mass that attracts bodies and goes where it is put."""

    mass: NotNegative = key("Its mass [kg].", 10)
    softening: NotNegative = key(
        "Length below which its pull grows no more [m].", 0.2, default=0.1
    )


class NbodyModel(SystemSpec):
    """Bodies that attract each other: stars, galaxies, planets."""

    methods: ClassVar[Sequence[str]] = (
        *("symplectic_euler", "midpoint", "velocity_verlet", "position_verlet"),
        *("rk4", "rk45"),
    )
    made_of: ClassVar[Sequence[str]] = ("galaxies", "attractors")
    code: ClassVar[str] = "SIM070"
    quantities: ClassVar[Sequence[str]] = (
        *("speed", "density", "energy", "acceleration", "species"),
    )

    bodies: list[BodiesModel] = key(
        "Bodies of files.", [{"points": "stars.npz#points"}], default=[]
    )
    galaxies: list[GalaxyModel] = key(
        "Galaxies that are built.",
        [{"name": "disc", "disc": {"count": 5000, "mass": 1, "radius": 1}}],
        default=[],
    )
    encounter: EncounterModel | None = key(
        "The orbit of two galaxies, from which follow where they are and how fast.",
        {"separation": 10, "pericentre": 2},
        default=None,
    )
    attractors: list[AttractorModel] = key(
        "Masses that attract bodies and are not attracted.",
        [{"mass": 10, "at": [0, 5, 0]}],
        default=[],
    )
    gravity_constant: NotNegative = key(
        "The constant of gravity [m³/(kg s²)]; in nature 6.674e-11.", 0.5, default=1.0
    )
    softening: NotNegative = key(
        "Length ε of Plummer's softening [m]: two bodies attract each other by "
        "`d/(d² + ε²)^1.5`. With 0 close encounters are followed by shorter steps.",
        0.02,
        default=0.05,
    )
    accuracy: Annotated[Real, Ge(0), Le(0.02)] = key(
        "Error of accelerations that a tree may make, as a share of them (root mean "
        "square); few bodies are summed directly, and with 0 all are.",
        1e-3,
        default=2e-4,
    )
    substeps: Annotated[Whole, Ge(1), Le(2**20)] = key(
        "Most parts that a step is divided into where two bodies come close.",
        1024,
        default=64,
    )
    method: Integrator = "velocity_verlet"
    tolerance: Tolerance = None
    colour: ColourModel | None = key(
        "Colours by `speed` [m/s], `density` (log10 [kg/m³]), `energy` of each over "
        "its mass [J/kg], `acceleration` [m/s²] or `species`.",
        {"by": "speed"},
        default=None,
    )

    def problems(self) -> Iterator[Problem]:
        """Yield which keys make no sense together."""
        if not self.bodies and not self.galaxies:
            hint = "galaxies: [{name: disc, disc: {count: 5000, mass: 1, radius: 1}}]"
            yield "it has no bodies", None, hint
        for galaxy in self.galaxies:
            if not galaxy.parts and not galaxy.nucleus:
                hint = "give it a disc, a bulge, a halo or a nucleus"
                yield f"galaxy {galaxy.name!r} has no bodies", "galaxies", hint
        orbit, count = self.encounter, len(self.galaxies)
        if orbit is None:
            return
        if count != 2:
            message = f"an encounter is of two galaxies, and there are {count}"
            yield message, "encounter", None
        e, near = orbit.eccentricity, orbit.pericentre
        far = near * (1 + e) / (1 - e) if e < 1 else float("inf")
        if not near <= orbit.separation <= far:
            message = f"the separation is {orbit.separation:g} m, and on this orbit it "
            yield f"{message}is from {near:g} to {far:g} m", "encounter", None

"""Keys of N-body systems in scene files."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Annotated, ClassVar, Literal

from annotated_types import Ge, Gt, Le, Lt

from animtool.core.errors import Problem
from animtool.core.options import key
from animtool.core.quantities import length_text
from animtool.documents.check import FileModel
from animtool.documents.fields import (
    Count,
    Integer,
    Name,
    NonNegative,
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
    Tolerance,
    Velocities,
)
from animtool.systems.framework.spec import SystemSpec


class BodiesModel(FileModel):
    """Bodies from a file; at rest if it has no velocities."""

    points: ArrayEntry = key("Initial positions `(N, 3)` [m].", "stars.npz#points")
    velocities: Velocities = None
    masses: ArrayEntry | None = key(
        "Masses of these `(N,)` [kg], instead of `mass`.",
        "stars.npz#masses",
        default=None,
    )
    mass: Positive = key("Mass of each [kg].", 0.5, default=1.0)
    radius: NonNegative = key("Half their width when drawn [m].", 0.05, default=0.02)


class SpheroidModel(FileModel):
    """Spherical distribution of stars or dark matter."""

    count: Count = key("Number of bodies.", 2000)
    mass: Positive = key("Total mass [kg].", 0.3)
    radius: Positive = key("Scale radius of the profile [m].", 0.3)
    profile: Literal["hernquist", "plummer"] = key(
        "`hernquist` or `plummer`.", "plummer", default="hernquist"
    )
    cutoff: Annotated[Real, Gt(0), Le(100)] = key(
        "Largest radius of a body [scale radii].", 8, default=10.0
    )


class DiscModel(FileModel):
    """Stars in an exponential disc that rotates about the galaxy's y."""

    count: Count = key("Number of bodies.", 5000)
    mass: Positive = key("Total mass [kg].", 1.0)
    radius: Positive = key("Scale length of the surface density [m].", 1.0)
    thickness: Annotated[Real, Gt(0), Le(1)] = key(
        "Scale height over the scale length.", 0.05, default=0.1
    )
    cutoff: Annotated[Real, Gt(0), Le(100)] = key(
        "Largest radius of a body [scale lengths].", 4, default=5.0
    )
    stability: NonNegative = key(
        "Toomre's Q: 0 is cold and forms clumps; above 1 it is stable.",
        1.5,
        default=1.2,
    )


class GalaxyModel(PlacementModel):
    """An isolated galaxy in equilibrium, which rotates about its y axis."""

    name: Name = key("Its name.", "milky_way")
    at: Vector = key("Position of its centre [m].", [0, 5, 0], default=[0.0, 0.0, 0.0])
    velocity: Vector = key(
        "Velocity of its centre [m/s].", [0.2, 0, 0], default=[0.0, 0.0, 0.0]
    )
    disc: DiscModel | None = key(
        "Stars in a disc.", {"count": 5000, "mass": 1, "radius": 1}, default=None
    )
    bulge: SpheroidModel | None = key(
        "Stars around the centre.",
        {"count": 1000, "mass": 0.3, "radius": 0.2},
        default=None,
    )
    halo: SpheroidModel | None = key(
        "Dark matter around everything; it is also written, unless `shows_halo` is "
        "false.",
        {"count": 5000, "mass": 5, "radius": 3},
        default=None,
    )
    shows_halo: bool = key("Write the bodies of the halo.", False, default=True)
    nucleus: NonNegative = key(
        "Mass of a central body [kg]; 0 is none.", 0.1, default=0.0
    )
    seed: Seed = 0
    radius: NonNegative = key("Half the width of its bodies [m].", 0.01, default=0.02)

    @property
    def components(self) -> list[DiscModel | SpheroidModel]:
        """Components of the galaxy, the halo last."""
        components = (self.disc, self.bulge, self.halo)
        return [component for component in components if component is not None]

    @property
    def hidden_count(self) -> int:
        """Number of bodies at the end of the galaxy that are not written."""
        return self.halo.count if self.halo and not self.shows_halo else 0


class EncounterModel(PlacementModel):
    """The orbit on which two galaxies meet, as two points would, about its y."""

    at: Vector = key(
        "Position of the encounter [m].", [0, 5, 0], default=[0.0, 0.0, 0.0]
    )
    separation: Positive = key("Initial separation [m].", 10)
    pericentre: Positive = key("Separation at closest approach [m].", 2)
    eccentricity: Annotated[Real, Ge(0), Lt(100)] = key(
        "Eccentricity of the orbit: 1 is a parabola, above 1 a hyperbola.",
        0.9,
        default=1.0,
    )


class AttractorModel(PlacedModel):
    """A mass on a prescribed path that attracts bodies."""

    mass: NonNegative = key("Mass [kg].", 10)
    softening: NonNegative = key(
        "Length below which its attraction stops growing [m].", 0.2, default=0.1
    )


class NbodyModel(SystemSpec):
    """Bodies that attract each other: stars, galaxies, planets."""

    methods: ClassVar[Sequence[str]] = (
        *("symplectic_euler", "midpoint", "velocity_verlet", "position_verlet"),
        *("rk4", "rk45"),
    )
    components: ClassVar[Sequence[str]] = ("galaxies", "attractors")
    code: ClassVar[str] = "SIM070"
    quantities: ClassVar[Sequence[str]] = (
        *("speed", "density", "energy", "acceleration", "species"),
    )

    bodies: list[BodiesModel] = key(
        "Bodies from files.", [{"points": "stars.npz#points"}], default=[]
    )
    galaxies: list[GalaxyModel] = key(
        "Generated galaxies.",
        [{"name": "disc", "disc": {"count": 5000, "mass": 1, "radius": 1}}],
        default=[],
    )
    encounter: EncounterModel | None = key(
        "The orbit of two galaxies, which sets their positions and velocities.",
        {"separation": 10, "pericentre": 2},
        default=None,
    )
    attractors: list[AttractorModel] = key(
        "Masses that attract bodies but are not attracted.",
        [{"mass": 10, "at": [0, 5, 0]}],
        default=[],
    )
    gravity_constant: NonNegative = key(
        "Gravitational constant [m³/(kg s²)]; in nature 6.674e-11.", 0.5, default=1.0
    )
    softening: NonNegative = key(
        "Length ε of Plummer softening [m]: two bodies attract each other by `d/(d² "
        "+ ε²)^1.5`. With 0, close encounters are resolved with shorter steps.",
        0.02,
        default=0.05,
    )
    accuracy: Annotated[Real, Ge(0), Le(0.02)] = key(
        "Relative error of accelerations allowed for the tree (root mean square); "
        "few bodies are summed directly; with 0 all are.",
        1e-3,
        default=2e-4,
    )
    substeps: Annotated[Integer, Ge(1), Le(2**20)] = key(
        "Largest number of substeps where two bodies come close.", 1024, default=64
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
        """Yield conflicts between galaxies and their orbit."""
        if not self.bodies and not self.galaxies:
            hint = "galaxies: [{name: disc, disc: {count: 5000, mass: 1, radius: 1}}]"
            yield "it has no bodies", None, hint
        for galaxy in self.galaxies:
            if not galaxy.components and not galaxy.nucleus:
                hint = "add a disc, a bulge, a halo or a nucleus"
                yield f"galaxy {galaxy.name!r} has no bodies", "galaxies", hint
        orbit, count = self.encounter, len(self.galaxies)
        if orbit is None:
            return
        if count != 2:
            message = f"an encounter needs two galaxies, not {count or 'none'}"
            hint = "add a second galaxy, or remove encounter"
            if count > 2:
                hint = "keep two galaxies in this system, or remove encounter"
            yield message, "encounter", hint
        e, pericentre = orbit.eccentricity, orbit.pericentre
        apocentre = pericentre * (1 + e) / (1 - e) if e < 1 else float("inf")
        separation_text = f"the separation, {length_text(orbit.separation)}, is "
        nearest, farthest = length_text(pericentre), length_text(apocentre)
        if orbit.separation < pericentre:
            message = f"{separation_text}below the pericentre, {nearest}, the smallest "
            hint = f"write a separation of {nearest} or more"
            hint += ", or exchange separation and pericentre"
            yield f"{message}distance on this orbit", "encounter.separation", hint
        elif orbit.separation > apocentre:
            message = f"{separation_text}beyond {farthest}, the largest distance on an "
            message += f"orbit of eccentricity {e:g}"
            hint = f"write a separation from {nearest} to {farthest}, or "
            hint += "eccentricity: 1"
            yield message, "encounter.separation", hint

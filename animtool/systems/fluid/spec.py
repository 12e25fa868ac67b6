"""Keys of fluids in scene files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal, get_args

from annotated_types import Gt, Le, Len
from pydantic import Field

from animtool.core.errors import Fault, Problem
from animtool.core.options import key
from animtool.documents.check import FileModel
from animtool.documents.fields import (
    Integer,
    NonNegative,
    NumberPair,
    Positive,
    Real,
    Vector,
)
from animtool.systems.framework.colours import ColourModel
from animtool.systems.framework.fields import (
    ArrayEntry,
    Forces,
    MaxParticles,
    PlacedModel,
    ShapeEntry,
    SystemColliderModel,
)
from animtool.systems.framework.spec import ForcedSpec

# Quantities that can be written and used as colours.
Quantity = Literal["age", "density", "pressure", "speed"]


class FillModel(PlacedModel):
    """Fluid that is there at the beginning: a shape full of it, or points."""

    name: str = key("For messages.", "pool", default="")
    shape: ShapeEntry | None = key(
        "Shape to fill, in its frame, up to the colliders: `box`, `sphere`, "
        "`capsule` or `mesh`.",
        {"box": {"size": [0.4, 1, 0.8]}},
        default=None,
    )
    points: ArrayEntry | None = key(
        "Position of each particle `(N, 3)` [m], instead of a shape.",
        "water.npz#points",
        default=None,
    )
    velocities: ArrayEntry | None = key(
        "Velocities of these `(N, 3)` [m/s].", "water.npz#velocities", default=None
    )
    velocity: Vector = key(
        "Initial velocity [m/s].", [1, 0, 0], default=[0.0, 0.0, 0.0]
    )


class FluidEmitterModel(PlacedModel):
    """A nozzle that fluid comes out of, along its y."""

    name: str = key("For messages.", "tap", default="")
    radius: Positive | None = key("Radius of a round nozzle [m].", 0.1, default=None)
    size: Annotated[list[Positive], Len(2, 2)] | None = key(
        "Sides of a rectangular nozzle, along its x and z [m].",
        [0.4, 0.2],
        default=None,
    )
    speed: Positive = key("Outflow speed [m/s].", 2, default=1.0)
    opens: list[NumberPair] = key(
        "Spans of seconds, from the first frame, in which it runs. Default: always.",
        [[0, 1.5], [2, 3]],
        default=[],
    )


class FluidSurfaceModel(FileModel):
    """A mesh around the particles, in place of points."""

    cell: Positive | None = key(
        "Cell size of the surface grid [m]. Default: three quarters of the spacing.",
        0.02,
        default=None,
    )
    smoothing: NonNegative = key(
        "Half width of the smoothing kernel, in spacings.", 1.5, default=1.0
    )
    max_cells: Annotated[Integer, Gt(0), Le(10**9)] = key(
        "Limit of grid cells in a frame.", 10**8, default=5 * 10**7
    )


class FluidModel(ForcedSpec):
    """A fluid: particles that pressure keeps as dense as at rest."""

    counted_keys: ClassVar[Sequence[str]] = ("fills", "emitters", "drains", "forces")
    code: ClassVar[str] = "SIM064"
    quantities: ClassVar[Sequence[str]] = get_args(Quantity)

    spacing: Positive = key(
        "Spacing of particles [m]; half the spacing gives eight times as many.", 0.04
    )
    fills: list[FillModel] = key(
        "What is filled at the start.",
        [{"shape": {"box": {"size": [0.4, 1, 0.8]}}, "at": [0.2, 0.5, 0.4]}],
        default=[],
    )
    emitters: list[FluidEmitterModel] = key(
        "Inflow.", [{"at": [0, 2, 0], "radius": 0.1}], default=[]
    )
    drains: list[SystemColliderModel] = key(
        "Outflow.", [{"shape": {"plane": {"offset": -1}}}], default=[]
    )
    density: Positive = key("Rest density [kg/m³].", 900, default=1000.0)
    viscosity: NonNegative = key(
        "Kinematic viscosity [m²/s]: 1e-6 for water, 1e-4 for oil, 5e-3 for honey.",
        1e-4,
        default=1e-6,
    )
    tension: NonNegative = key(
        "Surface tension [N/m]: 0.072 for water, 0.022 for alcohol. Walls do not "
        "attract.",
        0.072,
        default=0.0,
    )
    compression: Annotated[Real, Gt(0), Le(0.2)] = key(
        "Largest mean compression; steps are divided to stay below it.",
        0.02,
        default=0.01,
    )
    forces: Forces = Field([{"gravity": None}])
    primvars: list[Quantity] = key(
        "Attributes to write: `age`, `density` (over that at rest), `pressure` [Pa], "
        "`speed` [m/s].",
        ["pressure"],
        default=[],
    )
    colour: ColourModel | None = key(
        "Colours by one of these. It needs a `range`: fluid starts at rest.",
        {"by": "speed", "range": [0, 4]},
        default=None,
    )
    surface: FluidSurfaceModel | None = key(
        "Write a mesh instead of points; needs `pip install 'animtool[surface]'`.",
        {"cell": 0.02},
        default=None,
    )
    max_particles: MaxParticles = 1_000_000

    @property
    def counts(self) -> dict[str, int]:
        """Numbers of entries by kind, and the limit of particles."""
        return {
            "fills": len(self.fills),
            "emitters": len(self.emitters),
            "drains": len(self.drains),
            "max_particles": self.max_particles,
        }

    def problems(self) -> Iterator[Problem]:
        """Yield conflicts between keys (SIM064)."""
        box = "shape: {box: {size: [1, 1, 1]}}"
        if not self.fills and not self.emitters:
            message = "it has neither a fill nor an emitter"
            yield message, "fills", f"fills: [{{{box}}}]"
        for i, fill in enumerate(self.fills):
            kind, place = next(iter(fill.shape)) if fill.shape else "", f"fills[{i}]"
            if fill.shape is not None and fill.points is not None:
                message, hint = "a fill has a shape or points, not both", "remove one"
                yield message, place, f"{hint} of them"
            elif fill.shape is None and fill.points is None:
                yield "a fill needs a shape or points", place, f"for example {box}"
            elif fill.velocities is not None and fill.points is None:
                hint = "for the particles of a shape write velocity: [x, y, z]"
                yield "velocities need points", f"{place}.velocities", hint
            elif kind in INFINITE_SHAPES:
                message = f"a {kind} has no volume to fill"
                yield message, f"{place}.shape", f"for example {box}"
        for i, emitter in enumerate(self.emitters):
            place = f"emitters[{i}]"
            if emitter.radius is not None and emitter.size is not None:
                message = "a round nozzle has a radius, a rectangular one a size, and "
                yield message + "this one both", place, "remove one of them"
            elif emitter.radius is None and emitter.size is None:
                message = "a nozzle needs a radius if it is round, a size if it is "
                yield message + "rectangular", place, "for example radius: 0.1"
            for begin, end in emitter.opens:
                if not begin <= end:
                    message = f"it closes at {end:g} s, before {begin:g} s"
                    yield message, f"{place}.opens", None

    def faults(self, entry_data: Mapping[str, Any]) -> Sequence[Fault]:
        """Return faults in keys, and for colours without a range."""
        faults = list(super().faults(entry_data))
        if self.colour is not None and self.colour.range is None:
            message, hint = "colours need a range", "range: [0, 4]"
            faults.append(Fault(self.code, message, where="colour", hint=hint))
        return faults


INFINITE_SHAPES = ("plane", "height_field")

"""Options of emitters and velocity fields, shared by Python and scene files."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated

from annotated_types import Le

from animtool.core.options import Range, above, key
from animtool.core.record import dataclass

_POSITIVE_RANGE = Range("above 0", "SIM021", 0.0, includes_minimum=False, finite=True)
# Smallest mass, as in springs: forces over smaller masses overflow.
_MASS_RANGE = Range("1e-30 or more", "SIM021", 1e-30, finite=True)
_SPREAD_RANGE = Range("0 or more", "SIM021", 0.0, finite=True)
_FINITE_RANGE = Range("finite", "SIM021", -math.inf, finite=True)


def _read_bursts(rows: Sequence[Sequence[float]]) -> list[tuple[float, int]]:
    """Return bursts from rows of a file."""
    return [(t, int(n) if float(n).is_integer() else n) for t, n in rows]  # type: ignore[misc]


@dataclass(frozen=True, kw_only=True)
class Emission:
    """Emission rate, and properties of the emitted particles.

    Attributes:
        spread: Half the angle of the cone, here in radians; pi is all around.
    """

    name: str = key("For messages.", "embers", "")
    rate: Annotated[float, _SPREAD_RANGE, Le(1e9)] = key(
        "Particles per second.", 200, 0.0
    )
    bursts: Sequence[tuple[float, int]] = key(
        "Seconds from the first frame, and number of particles at once.",
        [[0, 50], [1.5, 50]],
        (),
        read=_read_bursts,
    )
    start: float = key(
        "Time at which the rate starts [s]. Default: the first frame.", 0.5, -math.inf
    )
    end: float = key("Time at which the rate ends [s]. Default: never.", 2.5, math.inf)
    direction: Sequence[float] | None = key(
        "Mean direction. Default: y; from surfaces, outwards.", [1, 1, 0], None
    )
    spread: float = key(
        "Half angle of the cone about it [deg]; 180 is every direction.",
        20,
        0.0,
        read=math.radians,
    )
    speed: Annotated[float, _FINITE_RANGE] = key("Speed [m/s].", 3, 0.0)
    speed_spread: Annotated[float, _SPREAD_RANGE] = key(
        "Largest deviation [m/s].", 0.5, 0.0
    )
    inherit: Annotated[float, _FINITE_RANGE] = key(
        "Fraction of the emitter's velocity that they inherit.", 0.5, 1.0
    )
    lifetime: Annotated[float, above(0, "SIM021")] = key(
        "Lifetime [s]. Default: unlimited.", 2.5, math.inf
    )
    lifetime_spread: Annotated[float, _SPREAD_RANGE] = key(
        "Largest deviation [s].", 0.5, 0.0
    )
    radius: Annotated[float, _POSITIVE_RANGE] = key("Radius [m].", 0.01, 0.005)
    radius_spread: Annotated[float, _SPREAD_RANGE] = key(
        "Largest deviation [m].", 0.005, 0.0
    )
    mass: Annotated[float, _MASS_RANGE] = key("Mass [kg].", 0.1, 0.001)
    charge: Annotated[float, _FINITE_RANGE] = key("Charge [C].", 1e-6, 0.0)
    seed: int = key("Seed for random numbers.", 7, 0)


@dataclass(frozen=True)
class Velocity:
    """A velocity field given by expressions in x, y, z, t and age."""

    x: str = key("Component along x [m/s].", "-z", "0")
    y: str = key("Component along y [m/s].", "0.2", "0")
    z: str = key("Component along z [m/s].", "x", "0")

"""What is said of emitters and of velocity fields: in Python, and in files."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated

from annotated_types import Le

from animtool.core.options import Key, Range, above
from animtool.core.record import dataclass

_AMOUNT = Range("above 0", "SIM021", 0.0, reached=False, finite=True)
# As light as particles of springs may be: less divides forces into infinity.
_MASS = Range("1e-30 or more", "SIM021", 1e-30, finite=True)
_SPREAD = Range("0 or more", "SIM021", 0.0, finite=True)
_FINITE = Range("finite", "SIM021", -math.inf, finite=True)


def _bursts(rows: Sequence[Sequence[float]]) -> list[tuple[float, int]]:
    return [(when, int(count)) for when, count in rows]


@dataclass(frozen=True, kw_only=True)
class Emission:
    """How many particles an emitter makes, and what they are like.

    Attributes:
        spread: Half the angle of the cone, here in radians; pi is all around.
    """

    name: Annotated[str, Key("For messages.", "embers")] = ""
    rate: Annotated[float, _SPREAD, Le(1e9), Key("Particles a second.", 200)] = 0.0
    bursts: Annotated[
        Sequence[tuple[float, int]],
        Key(
            "Seconds from the first frame on, and how many at once.",
            [[0, 50], [1.5, 50]],
            read=_bursts,
        ),
    ] = ()
    start: Annotated[
        float, Key("Second that the rate begins in. Not given: the first.", 0.5)
    ] = -math.inf
    end: Annotated[
        float, Key("Second that the rate ends in. Not given: never.", 2.5)
    ] = math.inf
    direction: Annotated[
        Sequence[float] | None,
        Key(
            "Middle of their directions. Not given: y, and from surfaces outwards.",
            [1, 1, 0],
        ),
    ] = None
    spread: Annotated[
        float,
        Key(
            "Half the angle of the cone about it [deg]; 180 is all around.",
            20,
            read=math.radians,
        ),
    ] = 0.0
    speed: Annotated[float, _FINITE, Key("Speed [m/s].", 3)] = 0.0
    speed_spread: Annotated[
        float, _SPREAD, Key("Most that it differs by [m/s].", 0.5)
    ] = 0.0
    inherit: Annotated[
        float,
        _FINITE,
        Key("Share of the emitter's velocity that they have too.", 0.5),
    ] = 1.0
    lifetime: Annotated[
        float,
        above(0, "SIM021"),
        Key("How long they live [s]. Not given: for ever.", 2.5),
    ] = math.inf
    lifetime_spread: Annotated[
        float, _SPREAD, Key("Most that it differs by [s].", 0.5)
    ] = 0.0
    radius: Annotated[float, _AMOUNT, Key("Their radius [m].", 0.01)] = 0.005
    radius_spread: Annotated[
        float, _SPREAD, Key("Most that it differs by [m].", 0.005)
    ] = 0.0
    mass: Annotated[float, _MASS, Key("Their mass [kg].", 0.1)] = 0.001
    charge: Annotated[float, _FINITE, Key("Their charge [C].", 1e-6)] = 0.0
    seed: Annotated[int, Key("Seed for random numbers.", 7)] = 0


@dataclass(frozen=True)
class Velocity:
    """A velocity at each place and time: expressions of x, y, z, t and age."""

    x: Annotated[str, Key("Along x [m/s].", "-z")] = "0"
    y: Annotated[str, Key("Along y [m/s].", "0.2")] = "0"
    z: Annotated[str, Key("Along z [m/s].", "x")] = "0"

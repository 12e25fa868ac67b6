"""Contact materials: options in files, and values for simulations."""

from __future__ import annotations

from typing import Annotated

from animtool.core.options import Range, above, key, or_more
from animtool.core.record import dataclass

# Faster motion of a collider is a teleport [m/s]; no prop of a shot is this fast.
SPEED_LIMIT = 200.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Material:
    """Restitution, friction and related contact coefficients."""

    restitution: Annotated[float, Range("0 to 1", "SIM020", 0, 1)] = key(
        "Restitution: fraction of the normal speed that is returned, 0 to 1.", 0.4, 0.0
    )
    friction: Annotated[float, or_more(0, "SIM020", finite=True)] = key(
        "Coulomb's coefficient.", 0.3, 0.0
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Contact(Material):
    """Contact options of a collider."""

    name: str = key("For messages.", "step_1", "")
    container: bool = key(
        "Keep particles inside; with `kill`, remove those outside.", True, False
    )
    margin: Annotated[float, or_more(0, "SIM020", finite=True)] = key(
        "Distance to keep [m].", 0.01, 0.0
    )
    depenetration: Annotated[float, above(0, "SIM020")] = key(
        "How fast particles that start inside are pushed out [m/s].", 0.5, 1.0
    )
    speed_limit: Annotated[float, above(0, "SIM020")] = key(
        "Faster motion is treated as a teleport and collides with nothing [m/s].",
        500,
        SPEED_LIMIT,
    )

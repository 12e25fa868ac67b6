"""The table of integrators: a file a family, imported when used."""

from __future__ import annotations

from typing import cast

from animtool.errors import Fault, OptionError, excerpt
from animtool.plugins import load_object
from animtool.sim.integrators.integrator import Integrator

__all__ = ["INTEGRATORS", "find_integrator"]

_FOLDER = "animtool.sim.integrators"
_FAMILIES = {
    "explicit": ("euler", "modified_euler", "midpoint", "heun", "rk4"),
    "symplectic": ("symplectic_euler", "velocity_verlet", "position_verlet"),
    "adaptive": ("adaptive_doubling", "rk45", "dop853", "lsoda", "radau"),
    "implicit": ("implicit_euler", "trapezoid", "bdf2"),
}
# In the order in which they are listed: from the simplest on.
_ORDER = (
    *("euler", "modified_euler", "midpoint", "heun", "symplectic_euler"),
    *("velocity_verlet", "position_verlet", "rk4", "adaptive_doubling", "rk45"),
    *("implicit_euler", "trapezoid", "bdf2", "dop853", "lsoda", "radau"),
)
INTEGRATORS: dict[str, str] = {
    name: f"{_FOLDER}.{family}:{name.upper()}"
    for name in _ORDER
    for family, names in _FAMILIES.items()
    if name in names
}


def find_integrator(name: str) -> Integrator:
    """Return an integrator by its name.

    Raises:
        OptionError: There is none of that name (SIM001).

    >>> find_integrator("rk4").order
    4
    """
    if name not in INTEGRATORS:
        from animtool.documents.names import nearest

        message = f"no integrator is named {excerpt(name)}"
        raise OptionError(
            Fault("SIM001", message, hint=nearest(name, list(INTEGRATORS)))
        )
    return cast(Integrator, load_object(INTEGRATORS[name]))

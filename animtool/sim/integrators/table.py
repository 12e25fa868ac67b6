"""The table of integrators: imported when first used."""

from __future__ import annotations

from typing import cast

from animtool.core.names import check_known_name
from animtool.core.plugins import load_object
from animtool.sim.integrators.integrator import Integrator

__all__ = ["INTEGRATORS", "find_integrator"]

_PACKAGE = "animtool.sim.integrators"
# Modules of the integrators, sorted from simple to complex.
_MODULE_BY_NAME = {
    "euler": "explicit",
    "modified_euler": "explicit",
    "midpoint": "explicit",
    "heun": "explicit",
    "symplectic_euler": "symplectic",
    "velocity_verlet": "symplectic",
    "position_verlet": "symplectic",
    "rk4": "explicit",
    "adaptive_doubling": "adaptive",
    "rk45": "adaptive",
    "implicit_euler": "implicit",
    "trapezoid": "implicit",
    "bdf2": "implicit",
    "dop853": "adaptive",
    "lsoda": "adaptive",
    "radau": "adaptive",
}
INTEGRATORS: dict[str, str] = {
    name: f"{_PACKAGE}.{family}:{name.upper()}"
    for name, family in _MODULE_BY_NAME.items()
}


def find_integrator(name: str) -> Integrator:
    """Return an integrator by name.

    Raises:
        OptionError: The integrator is unknown (SIM001).

    >>> find_integrator("rk4").order
    4
    """
    check_known_name(name, INTEGRATORS, "integrator", "SIM001")
    return cast(Integrator, load_object(INTEGRATORS[name]))

"""The table of forces on particles: one file each, imported when used."""

from __future__ import annotations

from typing import cast

from animtool.errors import Fault, OptionError, excerpt
from animtool.plugins import load_object
from animtool.systems.particles.forces.force import Force

__all__ = ["FORCES", "find_force"]

_FOLDER = "animtool.systems.particles.forces"
FORCES: dict[str, str] = {
    "central": f"{_FOLDER}.central:Central",
    "charges": f"{_FOLDER}.charges:Charges",
    "drag": f"{_FOLDER}.drag:Drag",
    "electromagnetic": f"{_FOLDER}.electromagnetic:Electromagnetic",
    "field": f"{_FOLDER}.field:Field",
    "friction": f"{_FOLDER}.friction:Friction",
    "gravity": f"{_FOLDER}.gravity:Gravity",
    "propulsion": f"{_FOLDER}.propulsion:Propulsion",
    "spring": f"{_FOLDER}.spring:Spring",
    "turbulence": f"{_FOLDER}.turbulence:Turbulence",
    "uniform": f"{_FOLDER}.uniform:Uniform",
    "viscosity": f"{_FOLDER}.viscosity:Viscosity",
    "wind": f"{_FOLDER}.wind:Wind",
}


def find_force(name: str) -> type[Force]:
    """Return a kind of force by its name.

    Raises:
        OptionError: There is none of that name (SIM023).

    >>> find_force("gravity")().acceleration
    (0.0, -9.81, 0.0)
    """
    if name not in FORCES:
        from animtool.documents.names import nearest

        message = f"no force is named {excerpt(name)}"
        raise OptionError(Fault("SIM023", message, hint=nearest(name, list(FORCES))))
    return cast("type[Force]", load_object(FORCES[name]))

"""Table of forces on particles; each is imported when it is used."""

from __future__ import annotations

from typing import cast

from animtool.core.names import check_known_name
from animtool.core.plugins import load_object
from animtool.systems.particles.forces.base import Force

__all__ = ["FORCES", "find_force"]

_PACKAGE = "animtool.systems.particles.forces"
FORCES: dict[str, str] = {
    "central": f"{_PACKAGE}.pulls:Central",
    "charges": f"{_PACKAGE}.fields:Charges",
    "drag": f"{_PACKAGE}.air:Drag",
    "electromagnetic": f"{_PACKAGE}.fields:Electromagnetic",
    "field": f"{_PACKAGE}.fields:Field",
    "friction": f"{_PACKAGE}.air:Friction",
    "gravity": f"{_PACKAGE}.pulls:Gravity",
    "propulsion": f"{_PACKAGE}.pulls:Propulsion",
    "spring": f"{_PACKAGE}.pulls:Spring",
    "turbulence": f"{_PACKAGE}.fields:Turbulence",
    "uniform": f"{_PACKAGE}.pulls:Uniform",
    "viscosity": f"{_PACKAGE}.air:Viscosity",
    "wind": f"{_PACKAGE}.air:Wind",
}


def find_force(name: str) -> type[Force]:
    """Return a class of forces by name.

    Raises:
        OptionError: There is none of that name (SIM023).

    >>> find_force("gravity")().acceleration
    (0.0, -9.81, 0.0)
    """
    check_known_name(name, FORCES, "force", "SIM023")
    return cast("type[Force]", load_object(FORCES[name]))

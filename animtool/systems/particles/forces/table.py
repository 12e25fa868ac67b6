"""Table of forces on particles; each is imported when it is used."""

from __future__ import annotations

from typing import cast

from animtool.core.names import check_known_name
from animtool.core.plugins import load_object
from animtool.systems.particles.forces.base import Force

__all__ = ["FORCES", "find_force"]

_FOLDER = "animtool.systems.particles.forces"
FORCES: dict[str, str] = {
    "central": f"{_FOLDER}.pulls:Central",
    "charges": f"{_FOLDER}.fields:Charges",
    "drag": f"{_FOLDER}.air:Drag",
    "electromagnetic": f"{_FOLDER}.fields:Electromagnetic",
    "field": f"{_FOLDER}.fields:Field",
    "friction": f"{_FOLDER}.air:Friction",
    "gravity": f"{_FOLDER}.pulls:Gravity",
    "propulsion": f"{_FOLDER}.pulls:Propulsion",
    "spring": f"{_FOLDER}.pulls:Spring",
    "turbulence": f"{_FOLDER}.fields:Turbulence",
    "uniform": f"{_FOLDER}.pulls:Uniform",
    "viscosity": f"{_FOLDER}.air:Viscosity",
    "wind": f"{_FOLDER}.air:Wind",
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

"""Time integration: systems with a state, and the methods that step them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from animtool.core.plugins import lazy_names

if TYPE_CHECKING:
    from animtool.sim.integrating import integrate as integrate
    from animtool.sim.integrators.integrator import INTEGRATORS as INTEGRATORS
    from animtool.sim.integrators.integrator import Integrator as Integrator
    from animtool.sim.integrators.integrator import find_integrator as find_integrator
    from animtool.sim.options import IntegrateOptions as IntegrateOptions
    from animtool.sim.system import Energy as Energy
    from animtool.sim.system import FirstOrder as FirstOrder
    from animtool.sim.system import ForceSystem as ForceSystem
    from animtool.sim.system import RateSystem as RateSystem
    from animtool.sim.system import SecondOrder as SecondOrder
    from animtool.sim.system import System as System
    from animtool.sim.trajectory import Checkpoint as Checkpoint
    from animtool.sim.trajectory import Stats as Stats
    from animtool.sim.trajectory import Status as Status
    from animtool.sim.trajectory import Trajectory as Trajectory

_MODULES = {
    "integrating": ("integrate",),
    "integrators.integrator": ("INTEGRATORS", "Integrator", "find_integrator"),
    "options": ("IntegrateOptions",),
    "system": (
        *("Energy", "FirstOrder", "ForceSystem", "RateSystem", "SecondOrder", "System"),
    ),
    "trajectory": ("Checkpoint", "Stats", "Status", "Trajectory"),
}
_PUBLIC = {
    name: f"{__name__}.{module}" for module, names in _MODULES.items() for name in names
}

__all__ = sorted(_PUBLIC)  # noqa: PLE0605 - the table above is the list

if not TYPE_CHECKING:  # type checkers know the names that are imported, and no others
    __getattr__, __dir__ = lazy_names(__name__, _PUBLIC)

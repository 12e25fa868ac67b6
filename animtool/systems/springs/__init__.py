"""Particles and springs: ropes, strands, sheets, cloth and volumes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from animtool.core.plugins import lazy_names

if TYPE_CHECKING:
    from animtool.systems.springs.body import Body as Body
    from animtool.systems.springs.body import Springs as Springs
    from animtool.systems.springs.body import Welded as Welded
    from animtool.systems.springs.body import join as join
    from animtool.systems.springs.body import springs_between as springs_between
    from animtool.systems.springs.body import weld as weld
    from animtool.systems.springs.constraints import Pins as Pins
    from animtool.systems.springs.constraints import PointTargets as PointTargets
    from animtool.systems.springs.drawing import Tearing as Tearing
    from animtool.systems.springs.drawing import tear_surface as tear_surface
    from animtool.systems.springs.equilibrium import Rest as Rest
    from animtool.systems.springs.equilibrium import find_rest as find_rest
    from animtool.systems.springs.motion import SpringMotion as SpringMotion
    from animtool.systems.springs.records import Air as Air
    from animtool.systems.springs.records import Family as Family
    from animtool.systems.springs.records import SelfContact as SelfContact
    from animtool.systems.springs.records import Solver as Solver
    from animtool.systems.springs.records import SpringOptions as SpringOptions
    from animtool.systems.springs.shapes import block as block
    from animtool.systems.springs.shapes import rope as rope
    from animtool.systems.springs.shapes import sheet as sheet
    from animtool.systems.springs.shapes import strand as strand
    from animtool.systems.springs.shapes import surface as surface
    from animtool.systems.springs.shapes import tetrahedra as tetrahedra
    from animtool.systems.springs.system import SpringSystem as SpringSystem
    from animtool.systems.springs.trajectories import (
        simulate_springs as simulate_springs,
    )

_MODULES = {
    "body": ("Body", "Springs", "Welded", "join", "springs_between", "weld"),
    "drawing": ("Tearing", "tear_surface"),
    "motion": ("SpringMotion",),
    "constraints": ("Pins", "PointTargets"),
    "records": ("Air", "Family", "SelfContact", "Solver", "SpringOptions"),
    "equilibrium": ("Rest", "find_rest"),
    "shapes": ("block", "rope", "sheet", "strand", "surface", "tetrahedra"),
    "trajectories": ("simulate_springs",),
    "system": ("SpringSystem",),
}
_PUBLIC = {
    name: f"{__name__}.{module}" for module, names in _MODULES.items() for name in names
}

__all__ = sorted(_PUBLIC)  # noqa: PLE0605 - the table above is the list

if not TYPE_CHECKING:  # type checkers know the names that are imported, and no others
    _OLD_NAMES = {"Targets": "PointTargets"}
    __getattr__, __dir__ = lazy_names(__name__, _PUBLIC, _OLD_NAMES)

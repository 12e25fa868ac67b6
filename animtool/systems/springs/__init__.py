"""Particles and springs: ropes, strands, sheets, cloth and volumes."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from animtool.systems.springs.body import Body as Body
    from animtool.systems.springs.body import Springs as Springs
    from animtool.systems.springs.body import join as join
    from animtool.systems.springs.body import springs_between as springs_between
    from animtool.systems.springs.options import SpringMotion as SpringMotion
    from animtool.systems.springs.paths import Air as Air
    from animtool.systems.springs.paths import Pins as Pins
    from animtool.systems.springs.paths import Targets as Targets
    from animtool.systems.springs.records import Family as Family
    from animtool.systems.springs.records import SelfContact as SelfContact
    from animtool.systems.springs.records import Solver as Solver
    from animtool.systems.springs.records import SpringOptions as SpringOptions
    from animtool.systems.springs.resting import Rest as Rest
    from animtool.systems.springs.resting import find_rest as find_rest
    from animtool.systems.springs.shapes import Welded as Welded
    from animtool.systems.springs.shapes import block as block
    from animtool.systems.springs.shapes import rope as rope
    from animtool.systems.springs.shapes import sheet as sheet
    from animtool.systems.springs.shapes import strand as strand
    from animtool.systems.springs.shapes import surface as surface
    from animtool.systems.springs.shapes import tetrahedra as tetrahedra
    from animtool.systems.springs.shapes import weld as weld
    from animtool.systems.springs.simulating import simulate_springs as simulate_springs
    from animtool.systems.springs.system import SpringSystem as SpringSystem
    from animtool.systems.springs.tearing import Tearing as Tearing
    from animtool.systems.springs.tearing import tear_surface as tear_surface

_PUBLIC = {
    "Air": "paths",
    "Body": "body",
    "Family": "records",
    "Tearing": "tearing",
    "Pins": "paths",
    "SelfContact": "records",
    "Solver": "records",
    "SpringMotion": "options",
    "SpringOptions": "records",
    "SpringSystem": "system",
    "Springs": "body",
    "Targets": "paths",
    "Welded": "shapes",
    "Rest": "resting",
    "block": "shapes",
    "find_rest": "resting",
    "join": "body",
    "tear_surface": "tearing",
    "rope": "shapes",
    "sheet": "shapes",
    "simulate_springs": "simulating",
    "springs_between": "body",
    "strand": "shapes",
    "surface": "shapes",
    "tetrahedra": "shapes",
    "weld": "shapes",
}

__all__ = sorted(_PUBLIC)  # noqa: PLE0605 - the table above is the list


def __getattr__(name: str) -> object:
    """Import a public name when it is first used."""
    if name not in _PUBLIC:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = importlib.import_module(f"{__name__}.{_PUBLIC[name]}")
    value: object = getattr(module, name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*globals(), *_PUBLIC]

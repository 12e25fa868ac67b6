"""How systems are to be written: their prims."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from animtool.errors import Fault, Severity, excerpt
from animtool.scene.entries import SceneSystem
from animtool.units import UpAxis, up_from_up
from animtool.usd.layers import StageMetadata
from animtool.usd.names import distinct_names, legal_name
from animtool.usd.simulated import SimulatedJob


def system_job(
    systems: Sequence[SceneSystem],
    model: str,
    metadata: StageMetadata,
    meters_per_unit: float,
    up: UpAxis,
) -> SimulatedJob:
    """Return what is to be written of systems: ``meters_per_unit`` [m]."""
    turn = up_from_up(up, UpAxis.Y)
    written = [system for system in systems if system.written]
    return SimulatedJob(
        model,
        _prim_names(written),
        metadata,
        meters_per_unit,
        None if turn is None else np.array(turn),
    )


def named_alike(systems: Sequence[SceneSystem]) -> list[Fault]:
    """Return a warning for every system whose prim another's name has (SCN090)."""
    said = []
    for system, prim in zip(systems, _prim_names(systems), strict=True):
        if prim != legal_name(system.name):
            message = f"another system is named {excerpt(system.name)} before it: its "
            message += f"prim is {excerpt(prim)}"
            hint = "give each its own name"
            said.append(system.place.fault("SCN090", message, hint, Severity.WARNING))
    return said


def _prim_names(systems: Sequence[SceneSystem]) -> list[str]:
    names = [system.name for system in systems]
    return distinct_names(names, names, names).names

"""The cases that simulations break on, in everything that simulates."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from adapters.hard.attached import ATTACHED
from adapters.hard.bodies import BODIES
from adapters.hard.integrators import INTEGRATING
from adapters.hard.particles import PARTICLES
from adapters.hard.rigid import RIGID
from adapters.hard.scenes import SCENES
from adapters.hard.springs import BY_INTEGRATORS, BY_SOLVERS
from adapters.hard.subsystem import Subsystem
from support.data import data_files
from support.suite import every_other, some_quick

SUBSYSTEMS = [
    INTEGRATING,
    BY_SOLVERS,
    BY_INTEGRATORS,
    PARTICLES,
    RIGID,
    ATTACHED,
    SCENES,
    BODIES,
]
BY_TURNS = [BY_INTEGRATORS, PARTICLES, RIGID, BODIES]
# Of integrators, bodies that attract each other, and rigid ones alone.
OPEN = {"degenerate_inertia", "close_encounter"}


def listed(path: Path) -> list[str]:
    return [entry["id"] for entry in json.loads(path.read_text("utf-8"))["instances"]]


def ways(system: Subsystem, case: str, turn: int) -> Sequence[str]:
    """Return the ways of a case, by turns where they have much in common.

    The first is what scenes have by default, and has every case.
    """
    found = system.ways_of(case)
    if system not in BY_TURNS:
        return found
    if system is BY_INTEGRATORS:
        return every_other(found, turn)
    return [*found[:1], *every_other(found[1:], turn)]


def hard_cases() -> list[Any]:
    """Return a parameter a case, thing that simulates and way that it does."""
    found: list[Any] = []
    for param in data_files("sim", "hard_cases*.json"):
        (path,) = param.values
        if path is None:
            return [pytest.param(None, None, None, marks=param.marks, id=param.id)]
        found += [
            pytest.param(system, case, way, id=f"{system.name}-{case}-{way}")
            for turn, case in enumerate(listed(path))
            for system in SUBSYSTEMS
            if case in system.cases
            for way in ways(system, case, turn)
        ]
    return found


@pytest.mark.slow
@pytest.mark.parametrize(("system", "case", "way"), some_quick(hard_cases(), 8))
def test_hard_cases(system: Subsystem, case: str, way: str) -> None:
    system.cases[case](way)


@pytest.mark.parametrize("path", data_files("sim", "hard_cases*.json"))
def test_no_case_is_left_out(path: Path) -> None:
    cases = set(listed(path))
    for system in SUBSYSTEMS:
        assert not system.cases.keys() & system.apart.keys(), system.name
        known = system.cases.keys() | system.apart.keys() | OPEN
        assert cases <= known, f"{system.name}: {cases - known}"
        assert known <= cases | OPEN, f"{system.name}: {known - cases}"

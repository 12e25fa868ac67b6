"""Figures of a few ions, and of small lattices that are warmed and cooled."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from support.example_figures import example_figures

SPECIES: list[dict[str, Any]] = [
    {"name": "argon", "count": 19},
    {"name": "neon", "count": 6, "mass": 20.2, "sigma": 0.28, "epsilon": 0.3},
]
LATTICE = {"species": SPECIES, "temperature": 70.0, "seed": 5, "box": [2.4, 2.1, 2.2]}
RUNS: dict[str, dict[str, Any]] = {
    "ions": {},
    "position": {"method": "position_verlet", "colour": {"by": "speed"}},
    "rk4": {"method": "rk4", "thermostat": None, "colour": {"by": "temperature"}},
    "fcc": {**LATTICE, "colour": {"by": "density"}, "pace": 1},
    "cubic": {
        **LATTICE, "lattice": "cubic", "block": [2.0, 2.0, 2.1], "cutoff": 0.9,
        "switch": 0.75, "damping": 3, "skin": 0.08, "colour": {"by": "species"},
        "thermostat": {"temperatures": [[0, 90], [0.2, 20]], "relaxation": 0.1},
    },
}  # fmt: skip


@pytest.mark.parametrize("name", RUNS)
def test_atoms(tmp_path: Path, name: str) -> None:
    example_figures(__file__, tmp_path, "molecules", name, RUNS[name])

"""Figures of a few bodies and of small galaxies that meet."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from support.example_figures import example_figures

DISC = {"count": 40, "mass": 1.0, "radius": 0.5, "thickness": 0.1, "stability": 1.3}
GALAXIES: list[dict[str, Any]] = [
    {"name": "a", "disc": DISC, "nucleus": 0.2, "seed": 3,
     "bulge": {"count": 9, "mass": 0.3, "radius": 0.1},
     "halo": {"count": 12, "mass": 2, "radius": 1.2, "profile": "plummer"},
     "rotate": [0.9, 0.3, 0.1, 0.2], "shows_halo": False},
    {"name": "b", "disc": {**DISC, "count": 20}, "at": [1, 2, 3],
     "velocity": [0.1, 0.2, -0.1], "seed": 4,
     "halo": {"count": 8, "mass": 1, "radius": 0.9, "cutoff": 3}},
]  # fmt: skip
RUNS: dict[str, dict[str, Any]] = {
    "verlet": {},
    "rk45": {"method": "rk45", "tolerance": 1e-6, "colour": {"by": "acceleration"}},
    "position": {"method": "position_verlet", "colour": {"by": "energy"}},
    "galaxies": {"bodies": [], "galaxies": GALAXIES, "colour": {"by": "density"}},
    "encounter": {
        "bodies": [], "galaxies": GALAXIES, "attractors": [],
        "colour": {"by": "species"}, "accuracy": 0.01,
        "encounter": {"separation": 4, "pericentre": 1, "eccentricity": 0.8,
                      "at": [1, 0, 2], "rotate": [0.9, 0.1, 0.3, 0.1]},
    },
    "parabola": {
        "bodies": [], "galaxies": GALAXIES, "step": 1 / 32,
        "encounter": {"separation": 4, "pericentre": 1, "eccentricity": 1},
    },
}  # fmt: skip


@pytest.mark.parametrize("name", RUNS)
def test_bodies(tmp_path: Path, name: str) -> None:
    example_figures(__file__, tmp_path, "nbody", name, RUNS[name])

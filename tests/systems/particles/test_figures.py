"""Figures of small clouds under every force, emitter and method."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from support.example_figures import example_figures, globe

PLACES: dict[str, Any] = {
    "sphere": {"sphere": {"radius": 0.3}},
    "box": {"box": {"size": [0.2, 0.4, 0.6]}},
    "point": {"point": None},
}
AT = [3.0, -1.0, 2.0]
MORE = [
    {"uniform": {"push": [0.1, 0.02, -0.05]}},
    {
        "central": {
            "centre": [3, -0.5, 2],
            "strength": 0.8,
            "power": 1.5,
            "softening": 0.2,
        }
    },
    {"friction": {"deceleration": 0.7}},
    {"turbulence": {"strength": 2.0, "size": 0.6, "change": 1.5}},
    {"electromagnetic": {"electric": [0.1, 0, 0.2], "magnetic": [0.3, 2, 0.1]}},
    {"viscosity": {"viscosity": 0.5}},
]
RUNS: dict[str, dict[str, Any]] = {
    "midpoint": {},
    "rk45": {"method": "rk45", "tolerance": 1e-7, "colliders": []},
    "globe": {"colliders": [{**globe(0.3, [3, -1.3, 2.1]), "restitution": 0.5}]},
    "verlet": {"method": "velocity_verlet"},
    "field": {"velocity": {"x": "-z + 0.2 * t", "y": "0.3 * x", "z": "y"},
              "forces": [], "colliders": [], "method": "rk4"},
    **{
        place: {
            "emitters": [
                {"place": shape, "at": AT, "rate": 40, "start": 0.03, "end": 0.25,
                 "rotate": [0.9, 0.3, 0.1, 0.2], "speed": 0.8, "spread": 70,
                 "mass": 0.2, "lifetime": 0.3, "seed": 6}
            ],
            "forces": MORE,
        }
        for place, shape in PLACES.items()
    },
}  # fmt: skip


@pytest.mark.parametrize("name", RUNS)
def test_clouds(tmp_path: Path, name: str) -> None:
    example_figures(__file__, tmp_path, "particles", name, RUNS[name])

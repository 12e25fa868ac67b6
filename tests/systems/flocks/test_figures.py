"""Figures of small shoals of two kinds, with each method and in a box."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from support.example_figures import example_figures, globe

RUNS: dict[str, dict[str, Any]] = {
    "midpoint": {},
    "globe": {"colliders": [globe(0.3, [3.4, -1.6, 2.4])], "method": "heun"},
    "heun": {"method": "heun", "colliders": []},
    "rk4": {"method": "rk4", "forces": []},
    "euler": {"method": "symplectic_euler"},
    "walls": {"domain": {"at": [3.2, -0.8, 2.1], "size": [2, 1.5, 3]}},
    "wrap": {
        "domain": {"at": [3.2, -0.8, 2.1], "size": [4.2, 4.4, 4.5], "wrap": True},
        "colliders": [],
        "species": [
            {"name": "a", "count": 7, "at": [3, -1, 2], "seed": 4, "beat": 2.5,
             "direction": [1, 0.2, -0.4], "spread": 50, "banking": 0.5,
             "place": {"box": {"size": [1.5, 2, 3]}}, "joins": ["b"],
             "attraction": {"weight": 1.5, "radius": 1.2},
             "alignment": {"weight": 2, "radius": 1.0},
             "repulsion": {"weight": 0.3, "radius": 0.8, "least": 0.2},
             "speed": {"least": 0.5, "cruise": 2}, "vision": {"radius": 1.4},
             "goals": [{"at": [3, 0, 2], "weight": 3, "limit": 0.8}],
             "paths": [{"points": [[2, -1, 1], [4, -1, 1.5], [4, -0.5, 3]],
                        "closed": True, "weight": 2, "radius": 0.1}]},
            {"name": "b", "count": 3, "at": [3.5, -1, 2.5], "seed": 5},
        ],
    },
}  # fmt: skip


@pytest.mark.parametrize("name", RUNS)
def test_shoals(tmp_path: Path, name: str) -> None:
    example_figures(__file__, tmp_path, "flocks", name, RUNS[name])

"""Figures of drops that fall, spray and drain, and of their surface."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from support.example_figures import example_figures, globe

RUNS: dict[str, dict[str, Any]] = {
    "drops": {},
    "colour": {
        "colour": {"by": "speed", "range": [0, 4]},
        "primvars": ["age", "density", "pressure", "speed"],
        "viscosity": 0.1,
        "compression": 0.05,
    },
    "globe": {"colliders": [globe(0.3, [3.05, -1.3, 2.05])], "tension": 0.5,
              "drains": []},
    "pool": {
        "spacing": 0.08,
        "fills": [
            {"shape": {"box": {"size": [0.4, 0.3, 0.25]}}, "at": [3, -0.9, 2],
             "rotate": [0.98, 0.1, 0.1, 0.1], "velocity": [0.3, 0, -0.5]},
        ],
        "emitters": [{"radius": 0.1, "at": [3.1, -0.4, 2.2], "speed": 1.4}],
        "drains": [{"shape": {"sphere": {"radius": 0.2}}, "at": [3.3, -1.1, 2.1]}],
    },
}  # fmt: skip


@pytest.mark.parametrize("name", RUNS)
def test_drops(tmp_path: Path, name: str) -> None:
    example_figures(__file__, tmp_path, "fluid", name, RUNS[name])

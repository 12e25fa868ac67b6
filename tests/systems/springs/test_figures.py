"""Figures of a rope, strands, cloth and a volume in wind, on a floor that rises."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from support.example_figures import example_figures, globe
from support.system_examples import EXAMPLES

# A sheet that falls on a ball and folds over itself, and one that tears.
FOLDED: dict[str, Any] = {
    "corner": [-0.4, 0.35, -0.4], "across": [0.8, 0.1, 0], "up": [0, 0.05, 0.9],
    "resolution": [7, 8], "mass": 0.3, "radius": 0.02, "drag": 0.2, "step": 1 / 96,
    "springs": {"structural": {"stiffness": 90, "ratio": 0.1},
                "diagonals": {"stiffness": 30}, "bend": {"stiffness": 2}},
    "wind": {"velocity": [0.5, 0, 1], "density": 1.2},
    "gravity": [0.5, -9, 0.3],
    "self_contact": {"thickness": 0.04, "friction": 0.4},
    "colliders": [
        {"shape": {"sphere": {"radius": 0.2}}, "at": [0.05, 0.1, 0.05],
         "friction": 0.4, "moves": [[0, 0, 0, 0], [0.4, 0.1, 0, 0.2]]},
        {"shape": {"box": {"size": [0.1, 0.3, 1]}}, "at": [-0.25, 0.15, 0],
         "rotate": [0.98, 0.1, 0.15, 0]},
        {"shape": {"capsule": {"radius": 0.05, "length": 0.4}}, "at": [0.3, 0.2, 0.1]},
    ],
    "pins": [],
}  # fmt: skip
GLOBE = {**globe(0.25, [0.05, 0.05, 0.05]), "moves": [[0, 0, 0, 0], [0.4, 0, 0.1, 0]]}
TORN = {
    "structural": {"stiffness": 40, "ratio": 0.05, "tear": 0.08},
    "diagonals": {"stiffness": 10, "tear": 0.2},
}
RUNS: dict[str, tuple[str, dict[str, Any]]] = {
    **{kind: (kind, {}) for kind in ("rope", "strands", "cloth", "volume")},
    **{
        f"{kind} {solver}": (kind, {"solver": solver, "step": 1 / 64})
        for kind in ("rope", "cloth", "volume")
        for solver in ("xpbd", "implicit_euler", "bdf2")
    },
    "folded": ("cloth", {**FOLDED, "self_contact": None,
                         "solver": "symplectic_euler", "step": 1 / 384}),
    "folded xpbd": ("cloth", {**FOLDED, "solver": "xpbd", "stretch": 0.02}),
    "folded implicit": ("cloth", {**FOLDED, "self_contact": None,
                                  "solver": "implicit_euler"}),
    "torn": ("cloth", {**FOLDED, "self_contact": None, "springs": TORN,
                       "pins": [{"particles": ["left"]}],
                       "solver": "symplectic_euler", "step": 1 / 384}),
    "settled": ("rope", {"settle": True, "pins": [{"particles": ["start"]},
                         {"particles": ["end"]}], "wind": None}),
    "boxed": ("volume", {"tetrahedra": None, "corner": [3, -1.1, 2],
                         "size": [0.3, 0.2, 0.4], "resolution": [3, 2, 3],
                         "springs": {"structural": {"stiffness": 60, "ratio": 0.1},
                                     "face_diagonals": {"stiffness": 20},
                                     "body_diagonals": {"stiffness": 9}}}),
    "on a mesh": ("cloth", {**FOLDED, "solver": "xpbd", "stretch": 0.02,
                            "colliders": [GLOBE]}),
    "on a mesh by forces": ("cloth", {**FOLDED, "self_contact": None,
                                      "solver": "symplectic_euler", "step": 1 / 384,
                                      "colliders": [GLOBE]}),
    "rope on a mesh": ("rope", {"from": [-0.3, 0.35, 0.02], "to": [0.4, 0.3, 0.1],
                                "colliders": [GLOBE], "solver": "xpbd", "count": 9,
                                "pins": [], "step": 1 / 96}),
    "strands on a mesh": ("strands", {"solver": "xpbd", "step": 1 / 96,
                                      "colliders": [{**GLOBE, "at": [3.2, -1.2, 2]}]}),
    "strands xpbd": ("strands", {"solver": "xpbd", "step": 1 / 64}),
}  # fmt: skip


@pytest.mark.parametrize("name", RUNS)
def test_springs(tmp_path: Path, name: str) -> None:
    kind, changes = RUNS[name]
    assert kind in EXAMPLES
    times = (0.0, 0.0625, 0.2, 0.40625)
    example_figures(__file__, tmp_path, kind, name, changes, times)

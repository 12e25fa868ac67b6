"""Figures of a rope, strands, cloth and a volume in wind, on a floor that rises."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from support.example_figures import example_figures
from support.system_examples import EXAMPLES

RUNS: dict[str, tuple[str, dict[str, Any]]] = {
    **{kind: (kind, {}) for kind in ("rope", "strands", "cloth", "volume")},
    **{
        f"{kind} {solver}": (kind, {"solver": solver, "step": 1 / 64})
        for kind in ("rope", "cloth", "volume")
        for solver in ("xpbd", "implicit_euler", "bdf2")
    },
    "strands xpbd": ("strands", {"solver": "xpbd", "step": 1 / 64}),
}


@pytest.mark.parametrize("name", RUNS)
def test_springs(tmp_path: Path, name: str) -> None:
    kind, changes = RUNS[name]
    assert kind in EXAMPLES
    times = (0.0, 0.0625, 0.2, 0.40625)
    example_figures(__file__, tmp_path, kind, name, changes, times)

"""Rows of what was made."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from animtool.cli.plan_summary import mesh_text, stats_json


def report(*outputs: str) -> Any:
    """What a bake reports, as far as it is printed."""
    rounding = SimpleNamespace(rounding=SimpleNamespace(error=1e-6))
    return SimpleNamespace(
        result=SimpleNamespace(outputs=[Path(name) for name in outputs]),
        seconds={"total": 2.0},
        worst=SimpleNamespace(written=rounding),
    )


@pytest.mark.parametrize(
    ("outputs", "named"),
    [
        (("rig.usdc", "walk.usdc"), "walk.usdc"),
        (("one.usdc",), "one.usdc"),
        ((), "stdout"),
    ],
)
def test_the_last_file_names_an_output(outputs: tuple[str, ...], named: str) -> None:
    rows = stats_json([], [report(*outputs)])
    assert [row["output"] for row in rows if "output" in row] == [named]


def test_characters_have_lines_of_their_own() -> None:
    characters = SimpleNamespace(
        own=2, shared=1, samples=5, frames=20, error=0.002, slide=0.0
    )
    written = SimpleNamespace(
        error=0.0, samples=10, bytes=0, vertices=3, characters=characters
    )
    mesh = SimpleNamespace(
        name="people",
        written=written,
        seconds=0.1,
        frames=10,
        kind="crowds",
        simulated=True,
    )
    take: Any = SimpleNamespace(
        meshes=[mesh], meshes_of="", source=Path("square.scene.yaml")
    )
    assert mesh_text(take) == [
        "  1 system of square.scene.yaml, simulated",
        "    people: 3 agents, 10 frames, 10 ms a frame",
        "      2 with an animation of their own, 25% of poses written: "
        "joints within 2 mm, standing feet 0 mm",
        "      1 with a part in an animation of who stands",
    ]

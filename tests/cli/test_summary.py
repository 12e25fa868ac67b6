"""Rows and lines of what was made."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from animtool.cli.summary import (
    BAKE_TEMPLATE,
    STATS_TEMPLATE,
    channel_lines,
    mesh_groups,
)
from animtool.clip.key_report import ChannelDeviation
from animtool.core.values import plain_value
from animtool.report.text import render
from animtool.scene.bake.prims import BakeReport
from animtool.scene.bake.progress import BakeStats, OutputCost, StageCost


@pytest.mark.parametrize(
    ("outputs", "named"),
    [
        (("rig.usdc", "walk.usdc"), "walk.usdc"),
        (("one.usdc",), "one.usdc"),
        ((), "stdout"),
    ],
)
def test_the_last_file_names_an_output(outputs: tuple[str, ...], named: str) -> None:
    report: Any = SimpleNamespace(
        files=[Path(name) for name in outputs],
        seconds={"total": 2.0},
        worst=SimpleNamespace(
            written=SimpleNamespace(rounding=SimpleNamespace(error=1e-6))
        ),
    )
    cost = BakeReport.cost.__get__(report)
    assert plain_value(cost) == {"output": named, "seconds": 2.0, "error": 1e-6}


def test_the_largest_error_of_each_unit_names_its_channel_once() -> None:
    errors = [
        ChannelDeviation("joint/knee.rotation", 0.25, "deg", 3.0),
        ChannelDeviation("joint/hip.rotation", 0.5, "deg", 2.0),
        ChannelDeviation("joint/hip.slide", 0.1, "cm", 2.0),
    ]
    counts, largest = channel_lines(errors)
    assert "3" in counts
    named = [largest.count(error.target) for error in errors]
    assert named == [0, 1, 1]


def test_stages_and_outputs_are_rows_of_one_table() -> None:
    bake_stats = BakeStats([StageCost("a.bvh", "source", 0.25, 2_000_000)])
    bake_stats.costs.append(OutputCost("a.usdc", None, 0.001))
    assert STATS_TEMPLATE.text(bake_stats) == [
        "stage           seconds  peak MB  error mm",
        "a.bvh (source)    0.250      2.0",
        "a.usdc                                   1",
    ]


def test_characters_have_lines_of_their_own() -> None:
    characters = SimpleNamespace(
        own=2, shared=1, samples=5, frames=20, error=0.002, slide=0.0
    )
    written = SimpleNamespace(
        error=0.0, samples=10, bytes=0, vertices=3, characters=characters
    )
    mesh: Any = SimpleNamespace(
        name="people",
        written=written,
        milliseconds_per_frame=10.0,
        kind="crowds",
        is_simulated=True,
        of="square.scene.yaml",
    )
    (group,) = mesh_groups([mesh])
    take = {"only": {"meshes": [mesh]}}
    lines = [
        line for line in BAKE_TEMPLATE.lines if getattr(line, "name", "") == MESHES
    ]
    assert group["meshes"] == [mesh]
    assert render(take, lines, BAKE_TEMPLATE.printers) == [
        "  1 system of square.scene.yaml, simulated",
        "    people: 3 agents, 10 frames, 10 ms per frame",
        "      2 with their own animation, 25% of poses written: "
        "joints within 2 mm, planted feet 0 mm",
        "      1 with a part in an animation of standing characters",
    ]


MESHES = "only.meshes:groups"

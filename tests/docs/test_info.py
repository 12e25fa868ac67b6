"""The keys of what ``info`` prints as JSON are in the reference."""

from __future__ import annotations

import re
from dataclasses import fields
from pathlib import Path

import pytest

from animtool.core.values import parse_template
from animtool.report.describe import TakeDescription
from animtool.report.describe_rig import (
    GoalDescription,
    MeshDescription,
    RigDescription,
    TargetsDescription,
)
from animtool.report.describe_scene import (
    OutputDescription,
    PassDescription,
    PropDescription,
    SceneDescription,
    SystemDescription,
)
from animtool.usd.caches.info import ChunkSet, PointPrimSummary, PointsDescription

TABLES = {
    "A take:": TakeDescription,
    "A USD file without a character:": PointsDescription,
    "and each of `prims`, as of `points` of a take:": PointPrimSummary,
    "A scene:": SceneDescription,
    "each of its `systems`:": SystemDescription,
    "and each of its `outputs`:": OutputDescription,
}
# Of a rate that is given as a fraction, the report has it as text too.
ALL = {"path", "notices"}


@pytest.fixture(scope="module")
def section(root: Path) -> str:
    return (root / "animtool/docs/reference/info.md").read_text("utf-8")


@pytest.mark.parametrize("title", TABLES)
def test_tables_have_the_keys_of_the_records(section: str, title: str) -> None:
    table = section.split(f"\n{title}\n")[1].lstrip().split("\n\n")[0]
    cells = [row.split("|")[1] for row in table.splitlines()[2:]]
    listed = [key for cell in cells for key in re.findall(r"`(\w+)`", cell)]
    record = TABLES[title]
    keys = {key.key for key in parse_template(getattr(record, "json_keys", "*"))}
    # A star, without a key, is all fields.
    names = {field.name for field in fields(record)} if "" in keys else set()
    stated = keys - {""} | names
    assert len(listed) == len(set(listed))
    assert set(listed) | ALL == stated | ALL


@pytest.mark.parametrize(
    "record",
    [
        RigDescription, MeshDescription, TargetsDescription, GoalDescription,
        PropDescription, PassDescription, ChunkSet,
    ],
)  # fmt: skip
def test_keys_of_small_records_are_named(section: str, record: type) -> None:
    named = set(re.findall(r"`(\w+)`", section))
    assert {field.name for field in fields(record)} - ALL <= named

"""The page on architecture names what is there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest


@pytest.fixture(scope="module")
def page(root: Path) -> str:
    return (root / "animtool/docs/architecture.md").read_text("utf-8")


def test_paths_are_there(page: str, root: Path) -> None:
    named = set(re.findall(r"`((?:animtool|tests)/[\w./]+)`", page))
    assert len(named) > 20
    assert [path for path in sorted(named) if not (root / path).exists()] == []


def test_every_package_has_a_line(page: str, root: Path) -> None:
    listed = re.findall(r"^\| `animtool/(\w+)` \|", page, re.MULTILINE)
    folders = {path.parent.name for path in (root / "animtool").glob("*/__init__.py")}
    assert set(listed) == folders | {"kernels"}
    assert len(listed) == len(set(listed))


def test_each_entry_of_the_list_names_its_file(page: str) -> None:
    section = page.split("## How to add …")[1].split("\n## ", maxsplit=1)[0]
    entries = re.findall(r"^\*\*(.+?)\*\*(.+?)(?=^\*\*|\Z)", section, re.M | re.S)
    assert "A keyframe interpolation." in dict(entries)
    assert [name for name, text in entries if "`animtool/" not in text] == []


def test_names_of_the_page_of_words_are_declared(root: Path) -> None:
    text = (root / "animtool/docs/names.md").read_text("utf-8")
    rows = [line.rsplit("|", 2)[1] for line in text.splitlines() if line[:2] == "| "]
    named = {name for row in rows for name in re.findall(r"`(\w+)`", row)}
    code = "\n".join(p.read_text("utf-8") for p in (root / "animtool").rglob("*.py"))
    declared = set(re.findall(r"^(?:class |def |)(\w+)\b", code, re.MULTILINE))
    assert len(named) > 15
    assert sorted(named - declared) == []

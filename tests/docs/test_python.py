"""The examples of the page on Python, run as they are printed."""

from __future__ import annotations

import doctest
import re
from pathlib import Path

import pytest

import animtool


@pytest.mark.slow(0.5)
@pytest.mark.parametrize(
    "name", ["README.md", "animtool/docs/python.md", "animtool/docs/howto/arrays.md"]
)
def test_the_examples(
    root: Path, workplace: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    text = (root / name).read_text("utf-8")
    assert text.count("```pycon\n")
    monkeypatch.chdir(workplace)
    found = doctest.testfile(str(root / name), module_relative=False)
    assert found.attempted >= text.count("\n>>> ")
    assert not found.failed


@pytest.mark.parametrize("name", ["README.md", "animtool/docs/reference/index.md"])
def test_the_page_is_linked(root: Path, name: str) -> None:
    links = re.findall(r"\]\(([^)]*python\.md)\)", (root / name).read_text("utf-8"))
    assert links
    assert all(((root / name).parent / link).is_file() for link in links)


def test_every_public_name_is_on_the_page(root: Path) -> None:
    text = (root / "animtool/docs/python.md").read_text("utf-8")
    unnamed = {n for n in animtool.__all__ if not re.search(rf"\b{n}\b", text)}
    assert not unnamed

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import pytest

from animtool.config import Config, find_config
from animtool.errors import OptionError


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("animtool.toml", "start = 1001"),
        ("pyproject.toml", "[tool.animtool]\nstart = 1001"),
    ],
)
def test_the_nearest_settings(tmp_path: Path, name: str, text: str) -> None:
    (tmp_path / name).write_text(text)
    folder = tmp_path / "a/b"
    folder.mkdir(parents=True)
    (folder.parent / "pyproject.toml").write_text("[project]\nname = 'other'")
    assert find_config(folder / "take.bvh") == Config(Fraction(1001))


def test_no_settings(tmp_path: Path) -> None:
    (tmp_path / "animtool.toml").write_text("")
    assert find_config(tmp_path / "take.bvh") == Config()


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("start =", "CFG001"),
        ("begin = 1", "CFG002"),
        ("start = 'x'", "CFG003"),
        ("start = true", "CFG003"),
    ],
)
def test_malformed_settings(tmp_path: Path, text: str, code: str) -> None:
    (tmp_path / "animtool.toml").write_text(text)
    with pytest.raises(OptionError) as caught:
        find_config(tmp_path / "take.bvh")
    assert caught.value.code == code


def test_settings_that_are_no_table(tmp_path: Path) -> None:
    project = tmp_path / "pyproject.toml"
    project.write_text("tool = 5")
    assert find_config(tmp_path / "take.bvh") == Config()
    project.write_text("[tool]\nanimtool = 5")
    with pytest.raises(OptionError):
        find_config(tmp_path / "take.bvh")

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import pytest

from animtool.core.config import Config, TimelineConfig, find_config, project_roots
from animtool.core.errors import OptionError


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
    found = find_config(folder / "take.bvh")
    assert found == Config(Fraction(1001), (tmp_path,), {}, None, tmp_path / name)


def test_no_settings(tmp_path: Path) -> None:
    (tmp_path / "animtool.toml").write_text("")
    path = tmp_path / "animtool.toml"
    assert find_config(tmp_path / "take.bvh") == Config(
        None, (tmp_path,), {}, None, path
    )


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("start =", "CFG001"),
        ("begin = 1", "CFG002"),
        ("start = 'x'", "CFG003"),
        ("start = true", "CFG003"),
        ("start = 1000000001", "CFG003"),
        ("start = -1000000001", "CFG003"),
        pytest.param(f"start = {'9' * 400}", "CFG003", id="many-digits"),
        pytest.param(f"start = {'[' * 100_000}", "CFG001", id="deep"),
        pytest.param(f"{'.'.join('a' * 20_000)} = 1", "CFG001", id="long key"),
        ("roots = '../library'", "CFG003"),
        ("roots = [1]", "CFG003"),
        ("timeline = 24", "CFG003"),
        ("[timeline]\nrate = 24", "CFG002"),
        ("[timeline]\nfps = 'fast'", "CFG003"),
        ("[timeline]\nfps = true", "CFG003"),
        ("[timeline]\ncut_start = 1.5", "CFG003"),
        ("[timeline]\nfirst_timecode = 3600", "CFG003"),
    ],
)
def test_malformed_settings(tmp_path: Path, text: str, code: str) -> None:
    (tmp_path / "animtool.toml").write_text(text)
    with pytest.raises(OptionError) as caught:
        find_config(tmp_path / "take.bvh")
    assert caught.value.code == code


def test_settings_of_timelines(tmp_path: Path) -> None:
    (tmp_path / "animtool.toml").write_text(
        "[timeline]\nfps = 29.97\ncut_start = 1001\nfirst_timecode = '01:00:00;00'\n"
    )
    found = find_config(tmp_path / "cut.edl").timeline
    assert found == TimelineConfig(Fraction(30000, 1001), 1001, "01:00:00;00")


def test_settings_that_are_no_table(tmp_path: Path) -> None:
    project = tmp_path / "pyproject.toml"
    project.write_text("tool = 5")
    assert find_config(tmp_path / "take.bvh") == Config()
    project.write_text("[tool]\nanimtool = 5")
    with pytest.raises(OptionError):
        find_config(tmp_path / "take.bvh")


def test_roots_are_the_project_and_what_it_names(tmp_path: Path) -> None:
    (tmp_path / "animtool.toml").write_text("roots = ['../library', '/srv/rigs']")
    (tmp_path / "a").mkdir()
    found = [root.resolve() for root in project_roots(tmp_path / "a/x.rig.yaml")]
    library = tmp_path.parent / "library"
    assert found == [tmp_path, library, Path("/srv/rigs").resolve()]


def test_the_root_without_a_project(tmp_path: Path) -> None:
    # An empty project: none further up can be the nearest.
    (tmp_path / "animtool.toml").write_text("")
    assert project_roots(tmp_path / "x.rig.yaml") == (tmp_path,)


def test_the_root_is_what_is_under_version_control(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clips = tmp_path / "show/clips"
    clips.mkdir(parents=True)
    path = clips / "walk.clip.yaml"
    assert project_roots(path) == (clips,)
    # Of a worktree it is a file.
    (tmp_path / "show/.git").write_text("gitdir: elsewhere\n")
    assert project_roots(path) == (tmp_path / "show",)
    (clips / "animtool.toml").write_text("")
    assert project_roots(path) == (clips,)
    (clips / "animtool.toml").unlink()
    # Files below a home come from anywhere.
    monkeypatch.setenv("HOME", str(tmp_path / "show"))
    monkeypatch.setenv("USERPROFILE", str(tmp_path / "show"))
    assert project_roots(path) == (clips,)


def test_the_root_without_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("animtool.core.config.find_config", lambda _: Config())
    assert project_roots(Path("/a/b/x.rig.yaml")) == (Path("/a/b").resolve(),)

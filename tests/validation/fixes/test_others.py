"""Which other files may name what a rig has."""

from __future__ import annotations

from pathlib import Path

import pytest

from animtool.validation.fixes.names import files_using_names

RIG = "rig: animtool/1\nname: hero\njoints: [{name: a.l, type: free}]\n"
SIDECAR = "rig: animtool/1\nname: side\nfrom: hero.rig.yaml\n"


@pytest.mark.parametrize(
    ("name", "text", "may"),
    [
        (
            "a.clip.yaml",
            "clip: animtool/1\nrig: hero.rig.yaml\nx: joint/a.l.angle\n",
            True,
        ),
        ("sub/a.clip.json", '{"rig": "../hero.rig.yaml", "x": "a.l"}', True),
        ("a.clip.yaml", "clip: animtool/1\nx: joint/a.l.angle\n", True),
        ("a.clip.yaml", "clip: animtool/1\nrig: side.rig.yaml\nx: a.l\n", True),
        ("a.clip.yaml", "clip: animtool/1\nrig: gone.rig.yaml\nx: a.l\n", True),
        ("a.targets.yaml", "targets: animtool/1\nx: a.l\n", True),
        ("a.clip.yaml", "a.l: [", True),
        ("b.rig.yaml", SIDECAR + "joints: [{name: a.l}]\n", True),
        ("a.clip.yaml", "clip: animtool/1\nrig: other.rig.yaml\nx: a.l\n", False),
        ("a.clip.yaml", "clip: animtool/1\nrig: hero.usda\nx: a.l\n", False),
        ("a.clip.yaml", "clip: animtool/1\nrig: hero.rig.yaml\nx: a_l\n", False),
        ("b.rig.yaml", RIG, False),
        ("notes.yaml", "a.l", False),
    ],
)
def test_files_that_may_mean_it(
    name: str, text: str, may: bool, tmp_path: Path
) -> None:
    rig = tmp_path / "hero.rig.yaml"
    rig.write_text(RIG, "utf-8")
    (tmp_path / "other.rig.yaml").write_text(RIG.replace("a.l", "b"), "utf-8")
    (tmp_path / "side.rig.yaml").write_text(SIDECAR, "utf-8")
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True)
    path.write_text(text, "utf-8")
    assert list(files_using_names(rig, ["b.l", "a.l"])) == (
        [(path, "a.l")] if may else []
    )


@pytest.mark.parametrize(
    ("text", "uses"),
    [
        ("# reach along a beam\nclip: animtool/1\n", False),
        ("clip: animtool/1\ndescription: along a beam\n", False),
        ("clip: animtool/1\nx: [joint/a b.rotation]\n", True),
        ("clip: animtool/1\nx: {a b: 1}\n", True),
        ("clip: animtool/1\nx: 'joints[a b].limits'\n", True),
    ],
)
def test_a_name_within_other_words_is_not_used(
    text: str, uses: bool, tmp_path: Path
) -> None:
    rig = tmp_path / "hero.rig.yaml"
    rig.write_text(RIG, "utf-8")
    path = tmp_path / "a.clip.yaml"
    path.write_text(text, "utf-8")
    assert list(files_using_names(rig, ["a b"])) == ([(path, "a b")] if uses else [])


def test_all_of_a_project_is_looked_at(tmp_path: Path) -> None:
    rig = tmp_path / "rigs/hero.rig.yaml"
    rig.parent.mkdir()
    rig.write_text(RIG, "utf-8")
    clip = tmp_path / "shots/a.clip.yaml"
    clip.parent.mkdir()
    clip.write_text("clip: animtool/1\nx: a.l\n", "utf-8")
    assert list(files_using_names(rig, ["a.l"])) == []
    (tmp_path / "animtool.toml").touch()
    assert list(files_using_names(rig, ["a.l"])) == [(clip, "a.l")]

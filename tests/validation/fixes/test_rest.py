"""Rest poses taken from the bind pose."""

from __future__ import annotations

from pathlib import Path

import pytest

from animtool.rig.file import load_rig
from animtool.validation.fixes.run import fix_files
from animtool.validation.run import validate

HEAD = "rig: animtool/1\nname: page\njoints:\n- {name: hips, type: free}\n"


@pytest.mark.parametrize("entry", [
    "- {name: chest, parent: hips, type: ball}\n",
    "- name: chest\n  parent: hips\n  type: ball  # why\n",
])  # fmt: skip
@pytest.mark.parametrize("rotate", ["", ", rotate: [0.6, 0.8, 0, 0]"])
def test_the_rest_pose_is_the_bind_pose(
    entry: str, rotate: str, tmp_path: Path
) -> None:
    path = tmp_path / "page.rig.yaml"
    bind = f"bind:\n  chest: {{translate: [0, 0.50, 1e-3]{rotate}}}\n"
    path.write_text(HEAD + entry + bind, "utf-8")
    assert [fault.code for fault in validate(path)] == ["RIG222"]
    fixes = fix_files([path])
    assert [fault.code for fault, _ in fixes.report.mended] == ["RIG222"]
    assert validate(path) == []
    rig = load_rig(path)
    assert rig.joints[1].translation == (0.0, 0.5, 0.001)
    assert rig.bind == {}
    assert path.read_text("utf-8").endswith(bind)


@pytest.mark.parametrize(
    "pose", ["{rotate: [0.6, 0.8, 0, 0]}", "{translate: [0, 0, 0]}"]
)
def test_what_says_nothing_of_a_place_is_no_finding(pose: str, tmp_path: Path) -> None:
    path = tmp_path / "page.rig.yaml"
    path.write_text(
        f"{HEAD}- {{name: chest, parent: hips, type: ball}}\nbind: {{chest: {pose}}}\n"
    )
    assert validate(path) == []

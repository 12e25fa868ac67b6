"""Scenes and targets that ended in a traceback."""

from __future__ import annotations

from pathlib import Path

import pytest

from animtool.core.errors import FormatError
from animtool.ik.file import load_targets
from animtool.rig.file import load_rig
from animtool.scene.file.read import load_scene


def test_systems_under_a_misspelt_key(tmp_path: Path) -> None:
    path = tmp_path / "a.scene.yaml"
    path.write_text("scene: animtool/1\nrange: [1, 2]\nsystem: [{}]\noutput: {}\n")
    with pytest.raises(FormatError) as caught:
        load_scene(path, {})
    assert [fault.code for fault in caught.value.faults] == ["DOC020"]


def test_a_stage_with_a_name_that_no_file_can_have(tmp_path: Path) -> None:
    path = tmp_path / "a.targets.yaml"
    goal = f"{{effector: a, position: {{prim: /a, file: {'9' * 500}.usda}}}}"
    path.write_text(f"targets: animtool/1\nfps: 24\nrange: [1, 2]\ngoals: [{goal}]\n")
    with pytest.raises(FormatError):
        load_targets(path)


def test_a_rig_from_a_file_with_a_name_that_no_file_can_have(tmp_path: Path) -> None:
    path = tmp_path / "a.rig.yaml"
    path.write_text(f"rig: animtool/1\nname: a\nfrom: {'9' * 500}\n")
    with pytest.raises(FormatError):
        load_rig(path)

"""What is odd about the joints of a rig file, and no fault."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.cli import animtool

from animtool import Rig
from animtool.core.errors import Severity
from animtool.rig.file import load_rig

RACK = """\
rig: animtool/1
name: rack
units: {length: cm}
joints:
- {name: stand, type: free, translate: [%s, 10, 0]%s}
- {name: lamp_l, type: ball, parent: stand, translate: [10, 0, 0], mirror: lamp_r}
"""


def rack(folder: Path, x: float, more: str = "") -> Path:
    path = folder / "rack.rig.yaml"
    path.write_text(RACK % (x, more), "utf-8")
    return path


def test_a_pair_below_a_parent_off_the_middle_is_noted(tmp_path: Path) -> None:
    rig = load_rig(rack(tmp_path, 20))
    (note,) = rig.notices
    assert (note.code, note.severity) == ("RIG101", Severity.NOTE)
    assert (note.lines, note.where) == ((6,), "joints[1].mirror")
    assert "200 mm" in note.message
    assert rig.joints[rig.index("lamp_r")].translation == pytest.approx((-0.5, 0, 0))


@pytest.mark.parametrize(("x", "more"), [(0, ""), (1e-5, ""), (20, ", mirror: other")])
def test_other_pairs_are_not(tmp_path: Path, x: float, more: str) -> None:
    assert not load_rig(rack(tmp_path, x, more)).notices


def test_a_pair_of_roots_is_not(tmp_path: Path) -> None:
    path = tmp_path / "two.rig.yaml"
    joint = "{name: a_l, type: free, translate: [1, 0, 0], mirror: a_r}"
    path.write_text(f"rig: animtool/1\nname: two\njoints: [{joint}]\n", "utf-8")
    assert not load_rig(path).notices


def test_notices_come_along_from_the_other_rig(tmp_path: Path) -> None:
    rack(tmp_path, 20)
    path = tmp_path / "more.rig.yaml"
    path.write_text("rig: animtool/1\nname: more\nfrom: rack.rig.yaml\n", "utf-8")
    assert [note.code for note in Rig.load(path).notices] == ["RIG101"]
    assert Rig.load(path).notices[0].path == str(tmp_path.resolve() / "rack.rig.yaml")


def test_commands_say_so(tmp_path: Path) -> None:
    path = rack(tmp_path, 20)
    clip = tmp_path / "still.clip.yaml"
    clip.write_text(
        "clip: animtool/1\nrig: rack.rig.yaml\nfps: 24\nrange: [1, 4]\n", "utf-8"
    )
    for words in (
        ["info", path],
        ["convert", path, tmp_path / "rack.usda"],
        ["bake", clip, "-o", tmp_path / "still.usda", "--strict"],
    ):
        done = animtool(*words)
        assert done.code == 0, done.stderr
        assert done.stderr.count("note: RIG101") == 1

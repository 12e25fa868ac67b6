"""The pages of codes: each is there, and its examples are what it says."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from animtool.validation.run import validate
from animtool.validation.tables import RULES, page

HEADINGS = ["What", "Why", "How to mend"]
PAGES = {code: text for code in RULES if (text := page(code)) is not None}
# Codes without a page yet. None is added here; each that gets one leaves.
WITHOUT = (Path(__file__).parent / "without_page.txt").read_text("utf-8").split()
WALKER = """\
rig: animtool/1
name: walker
joints:
- {name: hips, type: free, translate: [0, 1, 0]}
- {name: foot_l, parent: hips, type: free, translate: [0, -1, 0]}
"""
PUPPET = """\
rig: animtool/1
name: puppet
joints:
- {name: elbow, type: pin, axis: [0, 0, 1], limits: [0, 140]}
- {name: twin, type: pin, axis: [0, 0, 1], limits: [0, 140], mimic: {joint: elbow}}
controls:
- {name: curl, range: [0, 1], drives: [{joint: elbow.angle, expr: curl * 90}]}
"""
CAPTURE = """\
HIERARCHY
ROOT hips
{
  OFFSET 0 0 0
  CHANNELS 3 Zrotation Xrotation Yrotation
  JOINT leg.l
  {
    OFFSET 10 0 0
    CHANNELS 0
    End Site
    {
      OFFSET 0 -10 0
    }
  }
  JOINT leg.r
  {
    OFFSET -10 0 0
    CHANNELS 0
    End Site
    {
      OFFSET 0 -10 0
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.0333333
0 0 0
0 0 5
"""
BASE = "rig: animtool/1\nname: base\njoints: [{name: hips, type: free}]\n"


def examples(code: str, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", PAGES[code], re.M | re.S)


def test_every_code_has_a_page_but_those_listed() -> None:
    assert sorted(set(RULES) - set(PAGES)) == WITHOUT


def test_every_page_has_a_code(root: Path) -> None:
    files = {path.stem for path in (root / "animtool/docs/rules").iterdir()}
    assert files == set(PAGES)


@pytest.mark.parametrize("code", PAGES)
def test_the_form_of_a_page(code: str) -> None:
    lines = PAGES[code].splitlines()
    assert lines[0] == f"# {code}: {RULES[code].title}"
    headings = [line[3:] for line in lines if line.startswith("## ")]
    assert headings in (HEADINGS, [*HEADINGS, "Example"])
    outside = re.sub(r"^```.*?^```", "", PAGES[code], flags=re.M | re.S)
    assert max(map(len, outside.splitlines()[1:])) <= 88


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with what the examples refer to."""
    folder = tmp_path_factory.mktemp("stage")
    points = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    ninth = np.full((4, 9), 1 / 9)
    eighth = np.tile([0.125] * 8 + [0.0], (4, 1))
    np.savez(
        folder / "body.npz",
        points=points,
        large=points * 100,
        holed=points * [1, np.nan, 1],
        normals=points,
        short=points[:3],
        faces=np.array([[0, 1, 2, 3]]),
        objects=np.array([{}], object),
        indices=np.array([[0, 1]] * 4),
        weights=np.full((4, 2), 0.5),
        loose=np.full((4, 2), 0.45),
        rounded=np.full((4, 2), 128 / 255),
        nine=np.tile(np.arange(9), (4, 1)),
        ninth=ninth,
        eighth=eighth,
        smile=points,
        half=points / 2,
        still=points * 0,
    )
    (folder / "walk.bvh").write_text(CAPTURE, "utf-8")
    (folder / "base.rig.yaml").write_text(BASE, "utf-8")
    (folder / "walker.rig.yaml").write_text(WALKER, "utf-8")
    (folder / "puppet.rig.yaml").write_text(PUPPET, "utf-8")
    return folder


@pytest.mark.parametrize("code", [c for c in PAGES if examples(c, "yaml")])
def test_the_examples_are_true(code: str, stage: Path) -> None:
    wrong, right = examples(code, "yaml")
    assert code in codes(wrong, stage)
    assert codes(right, stage) == []


def codes(text: str, stage: Path) -> list[str]:
    """Return what is found in an example, put into a file where it is a part."""
    kind = re.match("(rig|clip|scene): animtool", text)
    path = stage / f"page.{kind[1] if kind else 'rig'}.yaml"
    head = "" if kind else "rig: animtool/1\n"
    if not kind and not re.search("^name:", text, re.M):
        head += "name: page\n"
    path.write_text(head + text, "utf-8")
    return [fault.code for fault in validate(path)]


@pytest.mark.parametrize("code", [c for c in PAGES if examples(c, "bvh")])
def test_lines_of_captures_are_true(code: str, tmp_path: Path) -> None:
    wrong, right = examples(code, "bvh")
    assert CAPTURE.count(right) == 1
    path = tmp_path / "take.bvh"
    path.write_text(CAPTURE, "utf-8")
    assert validate(path) == []
    path.write_text(CAPTURE.replace(right, wrong), "utf-8")
    assert code in [fault.code for fault in validate(path)]

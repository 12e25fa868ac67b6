"""Rules on clips beyond the examples of their pages: other ways to have the fault."""

from __future__ import annotations

from pathlib import Path

import pytest

from animtool.core.errors import Severity
from animtool.documents.document import read_document
from animtool.validation.run import validate
from animtool.validation.subjects.clip import open_clip_document

RIG = """\
rig: animtool/1
name: page
joints:
- {name: hips, type: free}
- {name: wheel, parent: hips, type: pin, axis: [1, 0, 0]}
- {name: arm, parent: hips, type: ball, translate: [0, 0.5, 0], limits: {swing: 60}}
controls:
- {name: curl, range: [0, 1], drives: [{joint: wheel.angle, expr: curl * 90}]}
"""
HEAD = "clip: animtool/1\nrig: page.rig.yaml\nfps: 24\n"
EULER = "channels: [{{target: joint/{}, {}interp: linear, keys: [{}]}}]\n"
WHEEL = "channels: [{target: joint/wheel.angle, interp: linear, post: cycle, keys: "
CASES: dict[str, tuple[str, list[str]]] = {
    "a ball that swings out of its cone between keys": (
        "channels: [{target: joint/arm.rotation, euler: XYZ, tangents: auto, keys: "
        "[{t: 1, v: [0, 0, 0]}, {t: 9, v: [59, 0, 0]}, {t: 17, v: [59, 0, 0]}, "
        "{t: 25, v: [0, 0, 0]}]}]\n",
        ["CLIP102", "CLIP205"],
    ),
    "a ball that swings out at a key": (
        "channels: [{target: joint/arm.rotation, euler: XYZ, interp: linear, keys: "
        "[{t: 1, v: [0, 0, 0]}, {t: 9, v: [70, 0, 0]}, {t: 17, v: [0, 0, 0]}]}]\n",
        ["CLIP102"],
    ),
    "a control that eases": (
        "channels: [{target: control/curl, keys: "
        "[{t: 1, v: 0}, {t: 9, v: 1}, {t: 17, v: 1}, {t: 25, v: 0}]}]\n",
        [],
    ),
    "an angle that flips": (
        EULER.format("wheel.angle", "", "{t: 1, v: 179}, {t: 2, v: -179}"),
        ["CLIP206"],
    ),
    "an angle that turns round slowly": (
        EULER.format("wheel.angle", "", "{t: 1, v: 0}, {t: 49, v: 1080}"),
        [],
    ),
    "angles that flip, but step": (
        EULER.format(
            "hips.rotation",
            "euler: XYZ, ",
            "{t: 1, v: [0, 0, 178], interp: step}, {t: 2, v: [0, 0, -178]}",
        ),
        [],
    ),
    "an angle that wraps in 12 frames": (
        EULER.format("wheel.angle", "", "{t: 1, v: 179}, {t: 13, v: -179}"),
        ["CLIP206"],
    ),
    "an angle that wraps on its way": (
        EULER.format(
            "wheel.angle",
            "",
            "{t: 1, v: 150}, {t: 13, v: 170}, {t: 25, v: -170}, {t: 37, v: -150}",
        ),
        ["CLIP206"],
    ),
    "an angle that wraps at a whole turn": (
        EULER.format(
            "wheel.angle",
            "",
            "{t: 1, v: 330}, {t: 13, v: 350}, {t: 25, v: 10}, {t: 37, v: 30}",
        ),
        ["CLIP206"],
    ),
    "three angles that flip in 12 frames": (
        EULER.format(
            "hips.rotation",
            "euler: XYZ, ",
            "{t: 1, v: [10, 80, 0]}, {t: 13, v: [-170, 95, 180]}",
        ),
        ["CLIP206"],
    ),
    "the second of three angles that wraps": (
        EULER.format(
            "hips.rotation",
            "euler: ZXY, ",
            "{t: 1, v: [0, -170, 5]}, {t: 13, v: [0, 165, 5]}",
        ),
        ["CLIP206"],
    ),
    "an angle that wraps, but steps": (
        EULER.format(
            "wheel.angle", "", "{t: 1, v: 179, interp: step}, {t: 13, v: -179}"
        ),
        [],
    ),
    "a wheel that turns once from half to half": (
        EULER.format("wheel.angle", "", "{t: 1, v: -180}, {t: 49, v: 180}"),
        [],
    ),
    "a turntable to its last frame": (
        EULER.format("wheel.angle", "", "{t: 1, v: 0}, {t: 48, v: 352.5}"),
        [],
    ),
    "a turntable that comes back": (
        EULER.format("wheel.angle", "", "{t: 1, v: 0}, {t: 48, v: 350}, {t: 96, v: 0}"),
        [],
    ),
    "a spin that begins below zero": (
        EULER.format(
            "wheel.angle", "", "{t: 1, v: -150}, {t: 49, v: 160}, {t: 97, v: 470}"
        ),
        [],
    ),
    "a tumble by half a turn": (
        EULER.format(
            "hips.rotation",
            "euler: XYZ, ",
            "{t: 1, v: [0, 0, 0]}, {t: 25, v: [180, 0, 180]}",
        ),
        [],
    ),
    "angles that flip two of three": (
        EULER.format(
            "hips.rotation",
            "euler: XYZ, ",
            "{t: 1, v: [0, 89, 0]}, {t: 2, v: [180, 91, 180]}",
        ),
        ["CLIP206"],
    ),
    "a wheel that cycles whole turns": (
        f"range: [1, 48]\n{WHEEL}[{{t: 1, v: 0}}, {{t: 13, v: 360}}]}}]\n",
        [],
    ),
    "a wheel that cycles three quarters": (
        f"range: [1, 48]\n{WHEEL}[{{t: 1, v: 0}}, {{t: 25, v: 270}}]}}]\n",
        ["CLIP207", "MOT202"],
    ),
    "an open cycle that is never repeated": (
        f"range: [1, 25]\n{WHEEL}[{{t: 1, v: 0}}, {{t: 25, v: 270}}]}}]\n",
        [],
    ),
    "a cycle of one key": (
        f"range: [1, 25]\n{WHEEL}[{{t: 1, v: 20}}]}}]\n",
        [],
    ),
    "a joint that leaps and is back": (
        EULER.format(
            "hips.rotation",
            "euler: XYZ, ",
            "{t: 1, v: [0, 0, 0]}, {t: 9, v: [0, 0, 2]}, {t: 10, v: [80, 0, 2]}, "
            "{t: 11, v: [0, 0, 2]}, {t: 20, v: [0, 0, 4]}",
        ),
        ["MOT203"],
    ),
}


@pytest.fixture
def clip(tmp_path: Path) -> Path:
    (tmp_path / "page.rig.yaml").write_text(RIG, "utf-8")
    return tmp_path / "page.clip.yaml"


@pytest.mark.parametrize("name", CASES)
def test_a_clip(name: str, clip: Path) -> None:
    text, wanted = CASES[name]
    clip.write_text(HEAD + text, "utf-8")
    assert sorted(fault.code for fault in validate(clip)) == wanted


def test_overshoot_after_what_has_no_limits(clip: Path) -> None:
    overshooting = CASES["a ball that swings out of its cone between keys"][0]
    free = "{target: joint/hips.translation, keys: [{t: 1, v: [0, 0, 0]}]}, "
    clip.write_text(HEAD + overshooting.replace("[{target", "[" + free + "{target", 1))
    (fault,) = [fault for fault in validate(clip) if fault.code == "CLIP205"]
    assert fault.where == "channels[1].keys[1]"


def test_a_clip_without_a_rig_is_noted(clip: Path) -> None:
    clip.write_text("clip: animtool/1\nfps: 24\nrange: [1, 9]\nchannels: []\n", "utf-8")
    (fault,) = open_clip_document(read_document(clip)).faults
    assert (fault.code, fault.severity) == ("CLIP011", Severity.NOTE)


def test_overshoot_names_its_key_and_frames(clip: Path) -> None:
    clip.write_text(HEAD + CASES["a ball that swings out of its cone between keys"][0])
    (fault,) = [fault for fault in validate(clip) if fault.code == "CLIP205"]
    assert fault.lines == (4,)
    assert fault.where == "channels[0].keys[1]"
    assert "frames 10 to 16" in fault.message


def test_a_pin_wraps_where_its_limits_leave_a_shorter_way(tmp_path: Path) -> None:
    turns = EULER.format("wheel.angle", "", "{t: 1, v: 170}, {t: 25, v: -170}")
    for limits, codes in (("[-180, 180]", set()), ("[-180, 200]", {"CLIP206"})):
        pin = f"axis: [1, 0, 0], limits: {limits}}}"
        rig = RIG.replace("axis: [1, 0, 0]}", pin)
        (tmp_path / "page.rig.yaml").write_text(rig)
        path = tmp_path / "turn.clip.yaml"
        path.write_text(HEAD + turns)
        found = validate(path)
        assert {f.code for f in found if f.code.startswith("CLIP2")} == codes


def test_a_wrap_has_its_numbers_in_the_units_of_the_file(tmp_path: Path) -> None:
    rig = RIG.replace("name: page\n", "name: page\nunits: {angle: rad}\n")
    (tmp_path / "page.rig.yaml").write_text(rig.replace("swing: 60", "swing: 1"))
    path = tmp_path / "wrap.clip.yaml"
    keys = "{t: 1, v: [0, 0, 3.12]}, {t: 13, v: [0, 0, -3.12]}"
    path.write_text(HEAD + EULER.format("hips.rotation", "euler: XYZ, ", keys))
    (found,) = [fault for fault in validate(path) if fault.code == "CLIP206"]
    for said in ("'joint/hips.rotation' z", "357.5", "178.76", "frame 13", "29.8"):
        assert said in found.message
    assert found.hint is not None
    assert "[0, 0, 3.16319]" in found.hint

"""Drivers in rig files: read, written, mirrored, refused with their places."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from animtool import Rig
from animtool.core.errors import FormatError
from animtool.rig.driver_plan import plan_of
from animtool.rig.write import rig_text

HEAD = "rig: animtool/1\nname: arm\n"
JOINTS = """\
joints:
- {name: root, type: free}
- {name: shoulder, parent: root, type: ball, limits: {twist_axis: [1, 0, 0]}}
- {name: elbow, parent: shoulder, type: pin, axis: [0, 0, 1], limits: [0, 150]}
- {name: piston, parent: root, type: prismatic, axis: [0, 1, 0]}
"""


def load(folder: Path, text: str, name: str = "arm") -> Rig:
    path = folder / f"{name}.rig.yaml"
    path.write_text(text, "utf-8")
    return Rig.load(path)


def codes(folder: Path, text: str) -> list[tuple[str, int]]:
    with pytest.raises(FormatError) as caught:
        load(folder, text)
    return [(fault.code, fault.lines[0]) for fault in caught.value.faults]


FULL = (
    JOINTS
    + """\
- {name: roll, parent: elbow, type: pin, axis: [1, 0, 0],
   driven: {expr: shoulder.twist / 2}}
- {name: rod, parent: root, type: prismatic, axis: [0, 1, 0],
   driven: {by: elbow.angle, curve: [[0, 0], [90, 0.1]], interp: smooth}}
shapes:
- {name: bulge, driven: {by: piston.slide, curve: [[0, 0], [2, 1]]}}
- {name: up, driven: {expr: "clamp(shoulder.swing_z / 90, 0, bend)"}}
controls:
- {name: bend, driven: {expr: elbow.angle / 150},
   drives: [{shape: side, curve: [[0, 0], [1, 2]], interp: smooth}]}
"""
).replace("shapes:\n", "shapes:\n- {name: side}\n")


@pytest.mark.parametrize(
    "units", ["{length: cm, angle: deg}", "{length: m, angle: rad}"]
)
def test_drivers_come_back_as_they_were_written(tmp_path: Path, units: str) -> None:
    rig = load(tmp_path, f"{HEAD}units: {units}\n{FULL}")
    again = load(tmp_path, rig_text(rig), "again")
    assert again == rig
    assert plan_of(rig).shapes == ("side", "bulge", "up")
    roll, rod = (rig.joints[rig.index(name)].driven for name in ("roll", "rod"))
    assert roll is not None
    assert rod is not None
    # Half of a twist is half of it in any unit; others count units of the file.
    twist = {"shoulder.twist": np.array([0.8])}
    assert roll.evaluate(twist)[0] == pytest.approx(0.4)
    length, angle = (1.0, 1.0) if "rad" in units else (0.01, math.radians(1))
    full = rod.evaluate({"elbow.angle": np.array([90 * angle])})
    assert full[0] == pytest.approx(0.1 * length)


def test_a_sidecar_drives_in_its_own_units(tmp_path: Path) -> None:
    shapes = "shapes: [{name: bulge}]\n"
    load(tmp_path, f"{HEAD}units: {{length: cm}}\n{JOINTS}{shapes}", "base")
    side = (
        "rig: animtool/1\nname: arm\nfrom: base.rig.yaml\nunits: {angle: rad}\n"
        "joints:\n- {name: piston, type: prismatic, axis: [0, 1, 0],"
        " driven: {expr: elbow.angle * 0.5}}\n"
        "shapes:\n- {name: bulge, driven: {expr: elbow.angle + piston.slide}}\n"
    )
    rig = load(tmp_path, side, "side")
    (bulge,) = rig.shapes
    assert bulge.driven is not None
    values = {"elbow.angle": np.array([1.0]), "piston.slide": np.array([0.5])}
    assert bulge.driven.evaluate(values)[0] == pytest.approx(1.5)
    # Written in the units of the base, it means the same.
    again = load(tmp_path, rig_text(rig), "again")
    driver = again.shapes[0].driven
    assert driver is not None
    assert driver.evaluate(values)[0] == pytest.approx(1.5)
    slide = again.joints[again.index("piston")].driven
    assert slide is not None
    assert slide.evaluate(values)[0] == pytest.approx(0.5)


def test_a_mirror_drives_by_the_other_side(tmp_path: Path) -> None:
    text = (
        HEAD
        + """\
joints:
- {name: root, type: free}
- {name: wrist_l, parent: root, type: ball, translate: [1, 0, 0], mirror: wrist_r,
   limits: {twist_axis: [1, 0, 0]}}
- {name: roll_l, parent: root, type: pin, axis: [1, 0, 0], mirror: roll_r,
   translate: [0.5, 0, 0], driven: {expr: wrist_l.twist / 2 + wrist_l.swing_y}}
"""
    )
    rig = load(tmp_path, text)
    right = rig.joints[rig.index("roll_r")].driven
    assert right is not None
    assert right.names == ("wrist_r.swing_y", "wrist_r.twist")
    angle = math.radians(1)
    values = {"wrist_r.twist": np.array([angle]), "wrist_r.swing_y": np.array([-angle])}
    assert right.evaluate(values)[0] == pytest.approx(1.5 * angle)
    assert load(tmp_path, rig_text(rig), "again") == rig


PIN = "{name: a, type: pin, axis: [1, 0, 0], driven: {expr: elbow.angle}"
ROLL = "- {name: roll, type: pin, axis: [1, 0, 0], driven: {DRIVEN}}\n"


@pytest.mark.parametrize(
    ("driven", "code"),
    [
        ("expr: elbow.angel / 2", "RIG033"),
        ("expr: elbo.angle / 2", "RIG008"),
        ("expr: root.angle", "RIG033"),
        ("expr: bent * 2", "RIG012"),
        ("by: elbow.slide, curve: [[0, 0], [1, 1]]", "RIG033"),
        ("expr: elbow.angle, curve: [[0, 0]]", "RIG015"),
        ("curve: [[0, 0], [1, 1]]", "RIG015"),
        ("expr: elbow.angle, by: elbow.angle", "RIG015"),
        ("expr: elbow.angle, interp: smooth", "RIG015"),
        ("by: elbow.angle, curve: [[1, 0], [0, 1]]", "RIG016"),
        ("expr: elbow.angle ** 2", "RIG013"),
        ("expr: elbow.__class__.angle()", "RIG013"),
        ('expr: "elbow.angle[0]"', "RIG013"),
        (f"expr: {'+'.join(['1'] * 600)}", "RIG013"),
        ("expr: roll.angle", "RIG032"),
        ("expr: 1e999 * elbow.angle", "RIG013"),
        ("by: elbow.angle, curve: [[0, 0], [1, .inf]]", "DOC021"),
    ],
)
def test_faults_have_a_code_and_a_line(tmp_path: Path, driven: str, code: str) -> None:
    text = HEAD + JOINTS + ROLL.replace("DRIVEN", driven)
    found = codes(tmp_path, text)
    assert [line for _, line in found] == [8]
    assert found[0][0].startswith(code[:3])
    if code[:3] == "RIG":
        assert found[0][0] == code


def test_circles_are_named_wherever_they_lead(tmp_path: Path) -> None:
    text = (
        HEAD
        + JOINTS
        + "- {name: a, type: pin, axis: [1, 0, 0], driven: {expr: c}}\n"
        + "controls: [{name: c, driven: {expr: a.angle}}]\n"
    )
    with pytest.raises(FormatError) as caught:
        load(tmp_path, text)
    (fault,) = caught.value.faults
    assert fault.code == "RIG032"
    assert {"a", "c"} <= set(fault.message.replace(" ", "").split(":")[-1].split("→"))


@pytest.mark.parametrize(
    "more",
    [
        f"- {PIN}, mimic: {{joint: elbow}}}}\n",
        f"- {PIN}}}\ncontrols: [{{name: c, drives: [{{joint: a.angle, expr: c}}]}}]\n",
        "shapes: [{name: s, driven: {expr: elbow.angle}}]\n"
        "controls: [{name: c, drives: [{shape: s, expr: c}]}]\n",
        "controls: [{name: c, driven: {expr: piston.slide},"
        " drives: [{joint: elbow.angle, expr: c}]}]\n",
        "controls:\n- {name: c, driven: {expr: piston.slide},"
        " drives: [{control: d, expr: c}]}\n"
        "- {name: d, drives: [{joint: elbow.angle, expr: d}]}\n",
    ],
)
def test_rivals_of_drivers_are_refused(tmp_path: Path, more: str) -> None:
    found = codes(tmp_path, HEAD + JOINTS + more)
    assert {code for code, _ in found} == {"RIG034"}


def test_free_balls_and_fixed_joints_are_not_driven(tmp_path: Path) -> None:
    for kind in ("ball", "fixed", "free"):
        text = f"- {{name: a, type: {kind}, driven: {{expr: elbow.angle}}}}\n"
        assert codes(tmp_path, HEAD + JOINTS + text)


def test_drives_of_controls_read_no_joints(tmp_path: Path) -> None:
    text = "controls: [{name: c, drives: [{shape: s, expr: elbow.angle}]}]\n"
    found = codes(tmp_path, HEAD + JOINTS + "shapes: [{name: s}]\n" + text)
    assert [code for code, _ in found] == ["RIG013"]

"""Rules on rigs beyond the examples of their pages: other ways to have the fault."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from animtool.validation.run import validate

HEAD = "rig: animtool/1\nname: page\njoints:\n"
ROOT = "- {name: root, type: free}\n"
LEG = (
    "- {name: thigh, type: ball}\n"
    "- {name: knee, parent: thigh, translate: [0, -0.4, 0], KNEE}\n"
    "- {name: ankle, parent: knee, type: ball, translate: [0, -0.4, 0]}\n"
    "ik: [{name: leg, root: thigh, tip: ankle, pole_dir: [0, 0, 1]}]\n"
)
TWO = (
    "- {name: a, type: pin, axis: [1, 0, 0], limits: [0, 90]}\n"
    "- {name: b, type: pin, axis: [1, 0, 0], limits: LIMITS, mimic: MIMIC}\n"
)
BALL = "- {name: arm, type: ball, limits: {LIMITS}, tips: [[0.3, 0, 0]]}\n"
SIDES = (
    "- {name: hips, type: free}\n"
    "- {name: hip_l, parent: hips, type: ball, translate: [0.1, 0, 0]}\n"
    "- {name: hip_r, parent: hips, type: ball, translate: [-0.1, 0, 0]}\n"
)
CASES: dict[str, tuple[str, list[str]]] = {
    "a twist that leaves out rest": (
        BALL.replace("LIMITS", "twist: [10, 40], twist_axis: [1, 0, 0]"),
        ["RIG201"],
    ),
    "a twist that ends at rest": (
        BALL.replace("LIMITS", "twist: [0, 40], twist_axis: [1, 0, 0]"),
        [],
    ),
    "both sides in one place": (
        SIDES.replace("-0.1", "0.1")
        + "- {name: knee_l, parent: hip_l, type: ball, translate: [0, -0.4, 0]}\n"
        "- {name: knee_r, parent: hip_r, type: ball, translate: [0, -0.4, 0]}\n",
        ["RIG118"],
    ),
    "both sides in the middle": (
        SIDES.replace("-0.1,", "0,").replace("0.1,", "0,"),
        [],
    ),
    "one side farther out than the other": (
        SIDES.replace("-0.1", "-0.2")
        + "- {name: knee_l, parent: hip_l, type: ball, translate: [0.1, -0.4, 0]}\n"
        "- {name: knee_r, parent: hip_r, type: ball, translate: [-0.1, -0.4, 0]}\n",
        ["RIG212"],
    ),
    "a sine in degrees, and another control that goes too far": (
        "- {name: a, type: pin, axis: [1, 0, 0], limits: [-90, 90]}\n"
        "- {name: b, type: pin, axis: [1, 0, 0], limits: [-90, 90]}\n"
        "controls:\n"
        "- {name: x, range: [0, 360], drives: [{joint: a.angle, expr: sin(x) * 99}]}\n"
        "- {name: y, range: [0, 1], drives: [{joint: b.angle, expr: y * 99}]}\n",
        ["RIG115", "RIG204"],
    ),
    "a follower that rests outside": (
        TWO.replace("LIMITS", "[0, 90]").replace("MIMIC", "{joint: a, offset: 95}"),
        ["RIG201", "RIG205"],
    ),
    "a follower that rests inside": (
        TWO.replace("LIMITS", "[5, 95]").replace("MIMIC", "{joint: a, offset: 5}"),
        [],
    ),
    "a follower that goes below its limits": (
        TWO.replace("LIMITS", "[0, 90]").replace("MIMIC", "{joint: a, offset: -30}"),
        ["RIG201", "RIG205"],
    ),
    "a mirrored joint, said once": (
        "- {name: k_l, type: pin, axis: [1, 0, 0], limits: [5, 9], mirror: k_r, "
        "translate: [1, 0, 0]}\n",
        ["RIG201"],
    ),
    "a ball that may neither swing nor twist": (
        BALL.replace("LIMITS", "swing: 0, twist: locked, twist_axis: [1, 0, 0]"),
        ["RIG202"],
    ),
    "a ball that may only twist": (
        BALL.replace("LIMITS", "swing: 0, twist: [-9, 9], twist_axis: [1, 0, 0]"),
        [],
    ),
    "a swing without a twist, about any axis": (
        BALL.replace("LIMITS", "swing: 40"),
        [],
    ),
    "a bone that is aslant": (
        BALL.replace("LIMITS", "twist: [-9, 9], twist_axis: [0.5, 1, 0]"),
        [],
    ),
    "a knee that is fixed": (LEG.replace("KNEE", "type: fixed"), ["RIG214"]),
    "a knee without width": (
        LEG.replace("KNEE", "type: pin, axis: [1, 0, 0], limits: [0, 0]"),
        ["RIG202", "RIG214"],
    ),
    "a knee that slides": (
        LEG.replace("KNEE", "type: prismatic, axis: [0, 1, 0], limits: [0, 0.1]"),
        [],
    ),
    "a knee that only twists": (
        LEG.replace("KNEE", "type: ball, limits: {swing: 0, twist: [-9, 9]}"),
        ["RIG214"],
    ),
    "a pole along the chain": (
        LEG.replace("KNEE", "type: ball").replace("[0, 0, 1]", "[0, 1, 0]"),
        ["RIG215"],
    ),
    # Its root is turned, so that the chain points along Z of what it hangs on.
    "a pole along a chain that is turned": (
        LEG.replace("KNEE", "type: ball").replace(
            "{name: thigh,", "{name: thigh, rotate: [0.7071, 0.7071, 0, 0],"
        ),
        ["RIG215"],
    ),
    "a chain of two joints": (
        "- {name: eye, type: ball}\n"
        "- {name: look, parent: eye, type: fixed, translate: [0, 0, 1]}\n"
        "ik: [{name: gaze, root: eye, tip: look}]\n",
        [],
    ),
    "a rig of one side": (SIDES.replace("-0.1, 0, 0", "-0.1, 0.01, 0"), []),
    "a ball driven beyond its cone": (
        BALL.replace("LIMITS", "swing: 30")
        + "controls: [{name: up, range: [0, 1], drives: "
        "[{joint: arm.rotation.z, expr: up * 40}]}]\n",
        ["RIG204"],
    ),
    "a ball driven to its cone": (
        BALL.replace("LIMITS", "swing: 30")
        + "controls: [{name: up, range: [-1, 1], drives: "
        "[{joint: arm.rotation.z, expr: up * 30}]}]\n",
        [],
    ),
    "a curve that peaks between samples": (
        TWO.replace("LIMITS", "[0, 200]").replace("MIMIC", "{joint: a}")
        + "controls: [{name: up, range: [0, 1], drives: "
        "[{joint: a.angle, curve: [[0, 0], [0.51, 95], [0.52, 0]]}]}]\n",
        ["RIG204"],
    ),
    "a chain of controls": (
        TWO.replace("LIMITS", "[0, 90]").replace("MIMIC", "{joint: a}")
        + "controls:\n- {name: up, range: [0, 2], drives: [{control: mid, expr: up}]}\n"
        "- {name: mid, drives: [{joint: a.angle, expr: mid * 50}]}\n",
        ["RIG204"],
    ),
    "a control that an expression reads": (
        ROOT + "controls:\n- {name: gain, range: [0, 1]}\n"
        "- {name: up, drives: [{joint: root.translation.y, expr: up * gain}]}\n",
        [],
    ),
    "a shape that no control drives": (
        ROOT + "shapes: [{name: a}, {name: b}, {name: ab, combine: [a, b]}]\n"
        "controls: [{name: up, drives: [{shape: a, expr: up}]}]\n",
        ["RIG208"],
    ),
    "shapes of a rig that clips drive": (
        ROOT + "shapes: [{name: a}, {name: b}, {name: ab, combine: [a, b]}]\n",
        [],
    ),
    "a name that begins with a digit": (
        '- {name: "1st", type: free}\n- {name: _1st, parent: "1st", type: ball}\n',
        ["RIG219", "RIG221"],
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_a_rig(name: str, tmp_path: Path) -> None:
    text, wanted = CASES[name]
    path = tmp_path / "page.rig.yaml"
    path.write_text(HEAD + text, "utf-8")
    assert sorted(fault.code for fault in validate(path)) == wanted


def test_a_shape_without_an_effect_is_named_at_its_place(tmp_path: Path) -> None:
    np.savez(
        tmp_path / "body.npz",
        points=np.eye(3),
        faces=[[0, 1, 2]],
        still=np.zeros((3, 3)),
    )
    path = tmp_path / "page.rig.yaml"
    path.write_text(
        f"{HEAD}{ROOT}meshes: [{{name: body, points: body.npz, faces: body.npz}}]\n"
        "shapes: [{name: smile, mesh: body, deltas: body.npz#still}]\n",
        "utf-8",
    )
    (fault,) = [fault for fault in validate(path) if fault.code == "RIG209"]
    assert fault.where == "shapes[0]"
    assert fault.message == "'smile' moves no point of 'body'"


def test_a_drive_without_a_value_is_no_fault_of_those_that_read_it(
    tmp_path: Path,
) -> None:
    path = tmp_path / "page.rig.yaml"
    path.write_text(
        f"{HEAD}- {{name: a, type: pin, axis: [1, 0, 0], limits: [0, 90]}}\n"
        "controls:\n"
        "- {name: bend, range: [0, 1], drives: [{joint: a.angle, expr: bend * 9}]}\n"
        "- {name: deep, range: [0, 1], drives: [{control: bend, expr: 1 / deep}]}\n",
        "utf-8",
    )
    (fault,) = [fault for fault in validate(path) if fault.code == "RIG207"]
    assert fault.where == "controls[1].drives[0]"
    assert "where 'deep' is 0" in fault.message
    assert not any("inf" in fault.message for fault in validate(path))


def test_names_with_spaces_are_one_warning(tmp_path: Path) -> None:
    path = tmp_path / "page.rig.yaml"
    joints = (
        "- {name: lower arm, type: free}\n"
        "- {name: wri st, type: fixed, parent: lower arm}\n"
        "- {name: hand, type: fixed, parent: wri st}\n"
    )
    path.write_text(HEAD + joints, "utf-8")
    (fault,) = [f for f in validate(path) if f.code in {"RIG109", "RIG221"}]
    assert (fault.code, fault.severity) == ("RIG109", "warning")
    assert fault.message == "2 of 3 joint names contain a space: 'lower arm'"
    assert "lower_arm" in str(fault.hint)


@pytest.mark.parametrize(
    ("joints", "found"), [("[arm_l, arm_r]", []), ("[arm_r, arm_l]", ["RIG225"])]
)
def test_skins_of_left_and_right(tmp_path: Path, joints: str, found: list[str]) -> None:
    sleeve = np.random.default_rng(7).normal(0, 0.02, (8, 3))
    sleeve[:, 0] = np.linspace(0.2, 0.5, 8)
    points = np.concatenate([sleeve, sleeve * [-1, 1, 1]])
    np.savez(
        tmp_path / "body.npz",
        points=points,
        faces=[[0, 1, 2]],
        indices=np.repeat([0, 1], 8)[:, None],
        weights=np.ones((16, 1)),
    )
    path = tmp_path / "page.rig.yaml"
    path.write_text(
        f"{HEAD}{ROOT}"
        "- {name: arm_l, parent: root, type: ball, translate: [0.2, 0, 0]}\n"
        "- {name: hand_l, parent: arm_l, type: ball, translate: [0.3, 0, 0]}\n"
        "- {name: arm_r, parent: root, type: ball, translate: [-0.2, 0, 0]}\n"
        "- {name: hand_r, parent: arm_r, type: ball, translate: [-0.3, 0, 0]}\n"
        "meshes: [{name: body, points: body.npz, faces: body.npz, skin: "
        f"{{joints: {joints}, indices: body.npz, weights: body.npz}}}}]\n",
        "utf-8",
    )
    assert [fault.code for fault in validate(path)] == found

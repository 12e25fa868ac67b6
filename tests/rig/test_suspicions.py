"""Warnings about limits and rotations in another unit or order."""

from __future__ import annotations

from pathlib import Path

import pytest

from animtool.rig.file import load_rig

PIN = "{{name: {}, type: pin, axis: [0, 0, 1], limits: {}}}"


def warnings(folder: Path, joints: list[str], angle: str = "deg") -> list[str]:
    text = (
        "rig: animtool/1\nname: a\nunits: {length: cm, angle: " + angle + "}\njoints:\n"
    )
    path = folder / "a.rig.yaml"
    path.write_text(text + "".join(f"- {joint}\n" for joint in joints), "utf-8")
    return [f"{one.code} {one.message}; {one.hint}" for one in load_rig(path).notices]


def pins(*limits: list[float], name: str = "joint") -> list[str]:
    return [PIN.format(f"{name}{i}", pair) for i, pair in enumerate(limits)]


@pytest.mark.parametrize(
    ("joints", "angle"),
    [
        (pins([-1.2, 1.2], [0, 2.5], [-0.4, 0.4]), "deg"),
        (pins([-1.2, 1.2], [-6.28, 6.28], [-0.4, 0.4]), "deg"),
        (pins([0, 1.5708]), "deg"),
        ([*pins([-90, 90]), *pins([-2.5, 2.5], name="knee_l")], "deg"),
        (pins([0, 140]), "rad"),
        (pins([-12.5, 147.5]), "rad"),
        (pins([-0.3, 147.3], name="knee_l"), "rad"),
        (["{name: a, type: ball, limits: {twist: [-90, 90]}}"], "rad"),
        (["{name: elbow, type: ball, limits: {swing: 1.2}}"], "deg"),
    ],
)
def test_limits_in_another_unit(tmp_path: Path, joints: list[str], angle: str) -> None:
    (said,) = warnings(tmp_path, joints, angle)
    assert said.startswith("RIG107")


BALL_AND_PIN = [
    "{name: thigh, type: ball}",
    "{name: crank, type: pin, parent: thigh, axis: [1, 0, 0]}",
]


@pytest.mark.parametrize(
    ("target", "expression", "found"),
    [
        ("thigh.rotation.z", "0.9 * side", True),
        ("thigh.rotation.z", "0.02 * side", False),
        ("crank.angle", "37 * side", False),  # a winch that turns many times
        ("crank.angle", "4 * side", True),
    ],
)
def test_drives_in_degrees(
    tmp_path: Path, target: str, expression: str, found: bool
) -> None:
    control = (
        "{name: side, range: [-37.3, 37.5], drives: "
        f"[{{joint: {target}, expr: {expression}}}]}}"
    )
    text = "rig: animtool/1\nname: a\nunits: {length: m, angle: rad}\njoints:\n"
    text += "".join(f"- {joint}\n" for joint in BALL_AND_PIN)
    path = tmp_path / "a.rig.yaml"
    path.write_text(f"{text}controls:\n- {control}\n", "utf-8")
    codes = [notice.code for notice in load_rig(path).notices]
    assert codes.count("RIG112") == found


def test_the_hint_converts_the_limit(tmp_path: Path) -> None:
    (said,) = warnings(tmp_path, pins([-2.5, 2.5], name="knee"))
    assert said.endswith("[-143.2, 143.2]")
    (said,) = warnings(tmp_path, pins([0, 90]), "rad")
    assert said.endswith("[0, 1.571]")


@pytest.mark.parametrize(
    ("joints", "angle"),
    [
        (pins([-2, 2], [-3, 3]), "deg"),  # two stiff joints
        (pins([-2, 2], [-3, 3], [-1, 1], [0, 140]), "deg"),  # a stiff spine
        (pins([0, 0], [0, 0], [0, 0], name="knee"), "deg"),
        (pins([0, 0.1], [0, 0.1], [0, 0.1]), "deg"),
        (pins([0, 2.5], [-1.5708, 1.5708]), "rad"),
        (pins([-12.566, 12.566], [-1000, 1000]), "rad"),  # a wrist, a wheel
        (
            ["{name: slide, type: prismatic, axis: [1, 0, 0], limits: [0, 1.5708]}"],
            "deg",
        ),
    ],
)
def test_plausible_limits(tmp_path: Path, joints: list[str], angle: str) -> None:
    assert warnings(tmp_path, joints, angle) == []


def test_w_last(tmp_path: Path) -> None:
    turned = "{name: a, type: free, rotate: [0, 0, 0, 1]}"
    (said,) = warnings(tmp_path, [turned, turned.replace("a,", "b,")])
    assert said.startswith("RIG108")
    other = "{name: b, type: free, rotate: [0.995, 0.1, 0, 0]}"
    assert warnings(tmp_path, [turned, other]) == []
    assert warnings(tmp_path, [turned.replace("0, 1]", "0, -1]")]) == []


def codes(folder: Path, head: str, *joints: str, tail: str = "") -> list[str]:
    path = folder / "a.rig.yaml"
    lines = "".join(f"- {{{joint}}}\n" for joint in joints)
    text = f"rig: animtool/1\nname: a\n{head}\njoints:\n{lines}{tail}"
    path.write_text(text, "utf-8")
    return [notice.code for notice in load_rig(path).notices]


def chain(length: float, count: int = 3, name: str = "part") -> list[str]:
    """Return joints in a row."""
    joints = [f"name: {name}0, type: free"]
    for i in range(1, count):
        joints.append(
            f"name: {name}{i}, parent: {name}{i - 1}, type: ball, "
            f"translate: [0, {length / (count - 1):.6g}, 0]"
        )
    return joints


@pytest.mark.parametrize(
    ("unit", "length", "name", "found"),
    [
        ("m", 45, "arm", True),  # a lamp in centimetres
        ("m", 700, "link", True),  # a robot in millimetres
        ("cm", 0.45, "arm", True),  # a lamp in metres
        ("mm", 0.7, "link", True),
        ("cm", 1.8, "knee", True),  # a person in metres
        ("m", 0.45, "arm", False),
        ("m", 14, "boom", False),  # a camera crane
        ("m", 14, "knee", False),  # a giant
        ("mm", 700, "link", False),
        ("mm", 12, "tibia", False),  # an insect
        ("cm", 1.2, "tibia", False),
        ("in", 8, "wing", False),
    ],
)
def test_sizes_of_any_kind_of_rig(
    tmp_path: Path, unit: str, length: float, name: str, found: bool
) -> None:
    head = f"units: {{length: {unit}}}"
    assert codes(tmp_path, head, *chain(length, name=name)) == ["RIG217"] * found


BODY = [
    "name: hips, type: free, translate: [0, 0.9, 0]",
    "name: spine, parent: hips, type: ball, translate: [0, 0.3, 0.02]",
    "name: head, parent: spine, type: ball, translate: [0, 0.4, 0]",
    "name: foot, parent: hips, type: ball, translate: [0, -0.85, 0.05]",
]
OTHER = [
    line.replace("[0, 0.9, 0]", "[0, 0, 0.9]")
    .replace("[0, 0.3, 0.02]", "[0, 0.02, 0.3]")
    .replace("[0, 0.4, 0]", "[0, 0, 0.4]")
    .replace("[0, -0.85, 0.05]", "[0, 0.05, -0.85]")
    for line in BODY
]


def test_offsets_that_are_world_positions(tmp_path: Path) -> None:
    arm = [
        "name: shoulder, type: ball, translate: [0.2, 1.4, 0]",
        "name: elbow, parent: shoulder, type: ball, translate: [0.5, 1.4, 0]",
        "name: thumb, parent: elbow, type: ball, translate: [0.75, 1.42, 0.03]",
        "name: palm, parent: elbow, type: ball, translate: [0.8, 1.38, 0]",
    ]
    assert codes(tmp_path, "", *arm) == ["RIG113"]
    # In the middle of the body, only the feet show it.
    standing = [
        line.replace("0.3, 0.02", "1.2, 0.02")
        .replace("0.4, 0", "1.6, 0")
        .replace("-0.85", "0.05")
        for line in BODY
    ]
    assert codes(tmp_path, "", *standing) == ["RIG113"]
    assert codes(tmp_path, "", *BODY) == []


def test_a_body_stands_along_the_up_axis(tmp_path: Path) -> None:
    assert codes(tmp_path, "up: Z", *BODY) == ["RIG111"]
    assert codes(tmp_path, "up: Y", *OTHER) == ["RIG111"]
    assert codes(tmp_path, "up: Y", *BODY) == codes(tmp_path, "up: Z", *OTHER) == []
    # A snake lies along Y.
    assert codes(tmp_path, "up: Z", *chain(1.0, 12, "neck")) == []


ELBOW = "name: elbow, type: pin, axis: [0, 0, 1], limits: [0, 140]"


@pytest.mark.parametrize(
    ("angle", "drive", "found"),
    [
        ("deg", "expr: curl * 1.5708", True),
        ("deg", "expr: curl * 1.57", True),
        ("deg", "curve: [[0, 0], [1, 2.3562]]", True),
        ("rad", "expr: curl * 120", True),
        ("deg", "expr: curl * 1.5", False),  # a breath
        ("deg", "expr: curl * 90", False),
        ("rad", "expr: curl * 1.5708", False),
    ],
)
def test_drives_in_another_unit(
    tmp_path: Path, angle: str, drive: str, found: bool
) -> None:
    elbow = ELBOW if angle == "deg" else ELBOW.replace("140", "2.4")
    control = (
        f"{{name: curl, range: [0, 1], drives: [{{joint: elbow.angle, {drive}}}]}}"
    )
    head, tail = f"units: {{angle: {angle}}}", f"controls:\n- {control}\n"
    # A drive beyond its limits is reported by validation.
    assert codes(tmp_path, head, elbow, tail=tail) == ["RIG112"] * found


def test_quaternions_of_another_length(tmp_path: Path) -> None:
    turned = "name: b, parent: a, type: ball, rotate: "
    for numbers, found in (
        ("[0.5, 0.5, 0, 0]", True),
        ("[0, 2, 0, 0]", True),
        ("[0.71, 0.71, 0, 0]", False),
    ):
        joints = ("name: a, type: free", turned + numbers, f"{turned}{numbers}")
        two = (*joints[:2], joints[2].replace("b,", "c,", 1))
        assert codes(tmp_path, "up: Y", *two) == ["RIG110"] * found

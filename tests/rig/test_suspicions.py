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
        (pins([0, 1.5708]), "deg"),
        ([*pins([-90, 90]), *pins([-2.5, 2.5], name="knee_l")], "deg"),
        (pins([0, 140]), "rad"),
        (["{name: a, type: ball, limits: {twist: [-90, 90]}}"], "rad"),
        (["{name: elbow, type: ball, limits: {swing: 1.2}}"], "deg"),
    ],
)
def test_limits_in_another_unit(tmp_path: Path, joints: list[str], angle: str) -> None:
    (said,) = warnings(tmp_path, joints, angle)
    assert said.startswith("RIG107")


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

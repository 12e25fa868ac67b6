"""Warnings about colliders, masses, chains and expressions in another unit."""

from __future__ import annotations

from pathlib import Path

import pytest

from animtool.rig.file import load_rig

BODY = """\
rig: animtool/1
name: body
joints:
- {name: hips, type: free, translate: [0, 0.9, 0]}
- {name: head, parent: hips, type: ball, translate: [0, 0.7, 0]}
- {name: knee, parent: hips, type: pin, axis: [1, 0, 0], translate: [0, -0.4, 0]}
- {name: foot, parent: knee, type: ball, translate: [0, -0.4, 0.1]}
"""


def codes(folder: Path, *lines: str, body: str = BODY) -> list[str]:
    path = folder / "body.rig.yaml"
    path.write_text(body + "".join(f"{line}\n" for line in lines), "utf-8")
    return [notice.code for notice in load_rig(path).notices]


@pytest.mark.parametrize(
    ("stretch", "found"), [(10, True), (5, True), (2, False), (0.1, False)]
)
def test_stretch_in_percent(tmp_path: Path, stretch: float, found: bool) -> None:
    chain = f"- {{name: leg, root: hips, tip: foot, stretch: {stretch}}}"
    assert codes(tmp_path, "ik:", chain) == ["RIG114"] * found


@pytest.mark.parametrize(
    ("ends", "expr", "found"),
    [
        ("[0, 360]", "sin(x) * 20", True),
        ("[-180, 180]", "20 * cos(x)", True),
        ("[-360, 720]", "sin(x) * 20", True),
        ("[-17, 17]", "sin(x) * 20", True),
        ("[-3, 3]", "sin(x) * 20", False),
        ("[0, 360]", "sin(x * pi / 180) * 20", False),
        ("[0, 6.2832]", "sin(x) * 20", False),
        ("[0, 100]", "sin(x) * 20", False),  # a time
        ("[0, 360]", "x + sin(1)", False),
    ],
)
def test_degrees_in_functions_of_radians(
    tmp_path: Path, ends: str, expr: str, found: bool
) -> None:
    control = (
        f"- {{name: x, range: {ends}, drives: [{{joint: knee.angle, expr: EXPR}}]}}"
    )
    lines = "controls:", control.replace("EXPR", expr)
    assert codes(tmp_path, *lines) == ["RIG115"] * found


@pytest.mark.parametrize(
    ("angle", "expr", "found"),
    [
        ("deg", "sin(knee.angle)", True),
        ("rad", "sin(knee.angle)", False),
        ("deg", "sin(knee.angle * pi / 180)", False),
    ],
)
def test_degrees_of_a_joint(tmp_path: Path, angle: str, expr: str, found: bool) -> None:
    body = BODY.replace("joints:", f"units: {{angle: {angle}}}\njoints:")
    shape = f"- {{name: bulge, driven: {{expr: {expr}}}}}"
    assert codes(tmp_path, "shapes:", shape, body=body) == ["RIG115"] * found


@pytest.mark.parametrize(
    ("unit", "radius", "name", "found"),
    [
        ("m", 9, "knee", True),
        ("m", 0.09, "knee", False),
        ("m", 0.9, "knee", False),  # a belly of a giant
        ("cm", 9, "knee", False),
        ("m", 9, "crank", False),  # a ball on a small machine
    ],
)
def test_radii_in_another_unit(
    tmp_path: Path, unit: str, radius: float, name: str, found: bool
) -> None:
    lines = ["colliders:", f"- {{joint: hips, capsule: {{radius: {radius}}}}}"]
    body = BODY.replace("knee", name)
    if unit == "cm":
        body = body.replace("joints:", "units: {length: cm}\njoints:")
        body = body.replace("0.", "")
    assert ("RIG116" in codes(tmp_path, *lines, body=body)) is found


@pytest.mark.parametrize(
    ("mass", "name", "found"),
    [
        (8500, "knee", True),
        (75, "knee", False),
        (800, "knee", False),  # a robot of steel
        (8500, "crank", False),
    ],
)
def test_masses_in_grams(tmp_path: Path, mass: float, name: str, found: bool) -> None:
    lines = "masses:", f"- {{joint: hips, mass: {mass}}}"
    body = BODY.replace("knee", name)
    assert codes(tmp_path, *lines, body=body) == ["RIG117"] * found

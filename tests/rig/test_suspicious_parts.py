"""Parts of a rig in another unit, and reversed strands."""

from __future__ import annotations

from pathlib import Path

import numpy as np
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


RIG = """\
rig: animtool/1
name: hero
units: {length: UNIT}
joints:
- {name: hips, type: free}
- {name: head, parent: hips, type: ball, translate: [0, 60, 0]}
meshes:
- name: body
  points: a.npz
  faces: a.npz
SKIN
attach:
- {name: "long 'hair'", kind: strands, joint: JOINT, points: a.npz#hair}
"""
SKIN = """\
  skin: {method: linear, joints: [hips, head], indices: a.npz, weights: a.npz}
"""


def strand_codes(
    folder: Path, hair: np.ndarray, joint: str = "head", skin: str = SKIN
) -> list[str]:
    # A square at the height of the head, of 11 by 11 points 1 apart.
    x, z = np.meshgrid(np.arange(11.0), np.arange(11.0))
    points = np.stack([x.ravel(), np.full(121, 60.0), z.ravel()], axis=1)
    np.savez(
        folder / "a.npz",
        points=points,
        faces=np.array([[0, 1, 12, 11]]),
        indices=np.tile([0, 1], (121, 1)),
        weights=np.tile([0.1, 0.9], (121, 1)),
        hair=hair,
    )
    found = []
    for unit in ("cm", "m"):
        text = RIG.replace("UNIT", unit).replace("JOINT", joint)
        (folder / "a.rig.yaml").write_text(text.replace("SKIN\n", skin))
        rig = load_rig(folder / "a.rig.yaml")
        found.append([one.code for one in rig.notices if one.code == "RIG119"])
    assert found[0] == found[1]
    return found[0]


@pytest.mark.parametrize("count", [1, 40])
def test_reversed_strands(tmp_path: Path, count: int) -> None:
    roots = np.random.default_rng(1).integers(0, 11, (count, 3)) * [1.0, 0, 1]
    heights = np.linspace(60.1, 70, 8)[:, None] * [0, 1, 0]
    hair = roots[:, None] + heights
    assert strand_codes(tmp_path, hair) == []
    assert strand_codes(tmp_path, hair[:, ::-1]) == ["RIG119"]
    assert strand_codes(tmp_path, hair[:, ::-1], skin="") == ["RIG119"]
    # Hair that is on the surface with both ends, or with none.
    flat = hair[:, ::-1].copy()
    flat[:, 0, 1] = 60.1
    assert strand_codes(tmp_path, flat) == []
    assert strand_codes(tmp_path, hair[:, ::-1] + [0, 20, 0]) == []
    # A joint below moves its surface with it.
    assert strand_codes(tmp_path, hair[:, ::-1], "hips") == ["RIG119"]


def test_tips_on_another_part_of_the_body(tmp_path: Path) -> None:
    roots = np.arange(5.0)[:, None] * [1, 0, 1]
    hair = roots[:, None] + np.linspace(60.1, 70, 8)[:, None] * [0, 1, 0]
    skin = SKIN.replace("[hips, head]", "[head, hips]")
    assert strand_codes(tmp_path, hair[:, ::-1], skin=skin) == []

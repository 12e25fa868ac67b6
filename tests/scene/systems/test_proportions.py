"""Systems that do not fit the characters beside them."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.skinned_rig import write_pair

from animtool import BakeOptions, bake
from animtool.validation.run import validate

SCENE = """\
scene: animtool/1
fps: 24
{head}
systems:
- {kind}:
    {where}
    mass: 0.05
    springs: {{structural: {{stiffness: 100}}}}
    pins:
    - {{particles: [{end}], {carrier}}}
output: {{file: o.usdc}}
"""
OWN = "source: {file: pair.clip.yaml}"
ROPE = "from: [0, {y}, 0]\n    to: [0.3, {y}, 0]\n    count: 5"
CLOTH = "corner: [0, {y}, 0]\n    across: [0.2, 0, 0]\n    up: [0, 0.2, 0]"
JOINT = "joint: {source: true, joint: hips}"


def scene(folder: Path, y: float, **keys: str) -> Path:
    write_pair(folder)
    given = {"kind": "rope", "where": ROPE, "end": "start", "carrier": JOINT}
    given = {"head": OWN, **given, **keys}
    given["where"] = given["where"].replace("{y}", f"{y:g}")
    path = folder / "shot.scene.yaml"
    path.write_text(SCENE.format(**given), "utf-8")
    return path


CASES: dict[str, dict[str, str]] = {
    "rope": {},
    "cloth": {"kind": "cloth", "where": CLOTH, "end": "top"},
    "a vertex": {"carrier": "vertex: {source: true, mesh: body, vertex: 0}"},
    "an offset": {"carrier": JOINT.replace("hips", "hips, offset: [0, 90, 0]")},
    "drawn": {"carrier": f"{JOINT}, stiffness: 10"},
    "a file": {
        "head": "range: [1, 3]",
        "carrier": "joint: {file: pair.clip.yaml, joint: hips}",
    },
}


def path_kind(name: str) -> str:
    return CASES[name].get("kind", "rope")


@pytest.mark.parametrize("name", CASES)
def test_a_pin_far_from_its_joint_is_said(tmp_path: Path, name: str) -> None:
    path = scene(tmp_path, 90, **CASES[name])
    found = [fault for fault in validate(path) if fault.code == "SIM168"]
    assert len(found) == 1
    assert found[0].where == f"systems[0].{path_kind(name)}.pins[0]"
    assert "in cm" in found[0].message
    report = bake(path, tmp_path / "o.usdc", BakeOptions(overwrite=True))
    assert [n.message for n in report.notices if n.code == "SIM168"] == [
        found[0].message
    ]


@pytest.mark.parametrize(
    "keys",
    [
        {},
        {"carrier": JOINT.replace("hips", "hips, offset: [0, 0.1, 0]")},
        {"carrier": "moves: [[0, 0, 0, 0], [1, 9, 0, 0]]"},
    ],
)
def test_a_pin_near_its_joint_is_fine(tmp_path: Path, keys: dict[str, str]) -> None:
    path = scene(tmp_path, 0.9, **keys)
    assert "SIM168" not in [fault.code for fault in validate(path)]


def test_a_scene_that_counts_as_the_rig_does_is_that_in_metres(tmp_path: Path) -> None:
    bake(scene(tmp_path, 0.9), tmp_path / "m.usda", BakeOptions())
    centimetres = ROPE.replace("0.3", "30")
    head = f"units: {{length: cm}}\n{OWN}"
    path = scene(tmp_path, 90, where=centimetres, head=head)
    assert "SIM168" not in [fault.code for fault in validate(path)]
    bake(path, tmp_path / "cm.usda", BakeOptions())
    one, other = (tmp_path / f"{name}.usda" for name in ("m", "cm"))
    assert one.read_bytes() == other.read_bytes()
    far = scene(tmp_path, 9000, where=centimetres, head=head)
    (found,) = [fault for fault in validate(far) if fault.code == "SIM168"]
    assert "systems use" not in found.message


FREE = {"carrier": "moves: [[0, 0, 0, 0]]"}
DROPS = """\
scene: animtool/1
fps: 24
source: {file: pair.clip.yaml}
systems:
- particles:
    emitters: [{bursts: [[0, 3]], at: [0, 90, 0]}]
output: {file: o.usdc}
"""


@pytest.mark.parametrize(
    ("y", "width", "said"),
    [(90, 0.3, True), (0.9, 60, True), (0.9, 0.3, False), (9000, 0.3, False)],
)
def test_a_system_that_would_fit_in_the_unit_of_the_rig(
    tmp_path: Path, y: float, width: float, said: bool
) -> None:
    path = scene(tmp_path, y, where=ROPE.replace("0.3", f"{width:g}"), **FREE)
    found = [fault for fault in validate(path) if fault.code == "SIM169"]
    assert len(found) == said
    for fault in found:
        assert "in cm" in fault.message
        report = bake(path, tmp_path / "o.usdc", BakeOptions(overwrite=True))
        assert fault.message in [notice.message for notice in report.notices]


def test_emitters_count_by_where_they_are(tmp_path: Path) -> None:
    path = scene(tmp_path, 1)
    path.write_text(DROPS, "utf-8")
    assert "SIM169" in [fault.code for fault in validate(path)]
    path.write_text(DROPS.replace("fps", "units: {length: cm}\nfps", 1), "utf-8")
    assert "SIM169" not in [fault.code for fault in validate(path)]


def test_a_unit_that_scenes_cannot_name_is_not_advised(tmp_path: Path) -> None:
    path = scene(tmp_path, 9000.0)
    bake(tmp_path / "pair.clip.yaml", tmp_path / "feet.usda", BakeOptions())
    feet = tmp_path / "feet.usda"
    text = feet.read_text("utf-8")
    assert "metersPerUnit = 0.01" in text
    feet.write_text(text.replace("= 0.01", "= 0.3048", 1), "utf-8")
    text = path.read_text("utf-8").replace("pair.clip.yaml", "feet.usda")
    path.write_text(text, "utf-8")
    (found,) = [one for one in validate([path]) if one.code == "SIM168"]
    assert "0.3048 m" in found.message
    assert "units:" not in (found.hint or "")


PRIM = """#usda 1.0
(
    metersPerUnit = {unit}
    upAxis = "Y"
)
def Xform "hook"
{{
    double3 xformOp:translate = ({x}, {y}, 0)
    uniform token[] xformOpOrder = ["xformOp:translate"]
}}
"""


@pytest.mark.parametrize(
    ("unit", "x", "y", "right"),
    [
        (0.01, 1.0, 3.0, "write 1"),
        (1.0, 100.0, 300.0, "write 0.01"),
        (1.0, 1.0, 3.0, ""),
        (1.0, 3.0, 1.0, ""),  # elsewhere, in no other unit at the pin
    ],
)
def test_a_prim_whose_file_is_in_another_unit(
    tmp_path: Path, unit: float, x: float, y: float, right: str
) -> None:
    where = ROPE.replace("[0,", "[1,")
    carrier = "prim: {file: hook.usda, prim: /hook}"
    path = scene(tmp_path, 3.0, head="range: [1, 3]", where=where, carrier=carrier)
    (tmp_path / "hook.usda").write_text(PRIM.format(unit=unit, x=x, y=y), "utf-8")
    found = [fault for fault in validate(path) if fault.code == "SIM168"]
    assert [(fault.hint or "").endswith(right) for fault in found] == [True] * bool(
        right
    )

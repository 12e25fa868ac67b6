"""Systems whose numbers look like another unit: one warning each."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.beasts import write_beast

from animtool.validation.run import validate

ROPE = """\
- rope:
    from: [0, 3, 0]
    to: [0, 0.8, 0]
    count: 4
    mass: 0.3
    springs: {structural: {stiffness: 100, ratio: 0.1}}
"""
CLOTH = """\
- cloth:
    name: flag
    mass: 1
    corner: [0, 1, 0]
    across: [1, 0, 0]
    up: [0, 1, 0]
    resolution: [2, 2]
    springs: {structural: {stiffness: 100}}
"""
BODY = """\
- rigid:
    name: crates
    bodies: [{name: a, shape: {SHAPE}, mass: 1.5}]
"""
BOX = BODY.replace("SHAPE", "box: {size: [0.2, 0.3, 0.2]}")
BALL = BODY.replace("SHAPE", "sphere: {radius: 0.1}")


def codes(folder: Path, systems: str, head: str = "") -> list[str]:
    path = folder / "a.scene.yaml"
    text = f"scene: animtool/1\nfps: 24\nrange: [1, 2]\n{head}systems:\n{systems}"
    path.write_text(f"{text}output: {{file: a.usda}}\n", "utf-8")
    return [fault.code for fault in validate(path)]


@pytest.mark.parametrize(
    ("systems", "old", "new", "found"),
    [
        (ROPE, "ratio: 0.1", "ratio: 10", True),
        (ROPE, "ratio: 0.1", "ratio: 2", False),
        (ROPE, "to: [0, 0.8, 0]", "to: [0, 80, 0]", True),
        (ROPE, "to: [0, 0.8, 0]", "to: [0, -12, 0]", False),
        (ROPE, "mass: 0.3", "mass: 300", True),
        (ROPE, "mass: 0.3", "mass: 30", False),  # a chain
        (CLOTH, "mass: 1", "mass: 180", True),
        (CLOTH, "mass: 1", "mass: 15", False),  # rubber
        (BOX, "mass: 1.5", "mass: 1500", True),
        (BOX, "mass: 1.5", "mass: 240", False),  # of gold
        (BALL, "mass: 1.5", "mass: 1500", True),
        (BALL, "mass: 1.5", "mass: 90", False),
        (BOX, "mass: 1.5", "density: 2.7", True),
        (BOX, "mass: 1.5", "density: 20", False),  # foam
        (BOX, "mass: 1.5", "mass: 1.5, friction: 60", True),
        (BOX, "mass: 1.5", "mass: 1.5, friction: 1.5", False),
    ],
)
def test_lengths_masses_and_percentages(
    systems: str, old: str, new: str, found: bool, tmp_path: Path
) -> None:
    assert old in systems
    assert codes(tmp_path, systems) == []
    assert codes(tmp_path, systems.replace(old, new)) == ["SIM200"] * found


def test_a_cable_may_be_long(tmp_path: Path) -> None:
    cable = ROPE.replace("to: [0, 0.8, 0]", "to: [60, 3, 0]")
    assert codes(tmp_path, cable) == ["SIM200"]
    assert codes(tmp_path, cable.replace("mass: 0.3", "mass: 40")) == []


def test_units_of_the_scene_count(tmp_path: Path) -> None:
    rope = ROPE.replace("[0, 3, 0]", "[0, 300, 0]").replace("0.8", "80")
    assert codes(tmp_path, rope) == ["SIM200"]
    assert codes(tmp_path, rope, "units: {length: cm}\n") == []


@pytest.mark.parametrize(
    ("options", "found"),
    [
        ("gravity: 981", True),
        ("gravity: -9.81", True),
        ("gravity: 1.62", False),  # the moon
        ("gravity: 0", False),
        ("wind: [0, 0, 3000]", True),
        ("wind: [0, 0, 60]", False),
    ],
)
def test_gravity_and_wind_of_a_pass(options: str, found: bool, tmp_path: Path) -> None:
    text = (
        "scene: animtool/1\nsource: {file: swing.clip.yaml}\noutput: {file: a.usda}\n"
    )
    text += f"passes: [{{simulate: {{what: [tail], {options}}}}}]\n"
    path = write_beast(tmp_path, text, bones=2, last=2, way=0)
    codes = [fault.code for fault in validate(path)]
    assert codes.count("SIM200") == found

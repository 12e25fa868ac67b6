"""What joints weigh: read, written, scaled, and what is refused."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.cli import animtool
from support.faults import raises

from animtool.core.errors import FormatError
from animtool.rig.file import load_rig
from animtool.rig.parts import Mass
from animtool.rig.write import rig_text

RIG = """\
rig: animtool/1
name: arm
units: {length: cm}
joints:
- {name: upper, type: ball}
- {name: lower, type: ball, parent: upper, translate: [30, 0, 0]}
masses:
"""


def rig_file(folder: Path, *masses: str, name: str = "arm.rig.yaml") -> Path:
    path = folder / name
    path.write_text(RIG + "".join(f"- {mass}\n" for mass in masses), "utf-8")
    return path


WHOLE = (
    "{joint: upper, mass: 2, centre: [15, 0, 0], inertia: [0.1, 0.2, 0.25], "
    "axes: [0, 1, 0, 0]}"
)


def test_masses_are_read_in_metres_and_written_again(tmp_path: Path) -> None:
    path = rig_file(tmp_path, WHOLE, "{joint: lower, mass: 1}")
    rig = load_rig(path)
    upper = Mass("upper", 2.0, (0.15, 0.0, 0.0), (0.1, 0.2, 0.25), (1.0, 0.0, 0.0, 0.0))
    assert rig.masses == (upper, Mass("lower", 1.0))
    again = tmp_path / "again.rig.yaml"
    again.write_text(rig_text(rig), "utf-8")
    assert load_rig(again).masses == rig.masses


def test_masses_come_back_from_usd_and_are_in_info(tmp_path: Path) -> None:
    path = rig_file(tmp_path, WHOLE)
    layer, again = tmp_path / "arm.usda", tmp_path / "back.rig.yaml"
    for command in (("convert", path, layer), ("convert", layer, again)):
        assert animtool(*command).code == 0
    assert load_rig(again).masses == load_rig(path).masses
    assert "mass      2 kg" in animtool("info", path).stdout


def test_a_sidecar_takes_the_place_of_a_joint_s_mass(tmp_path: Path) -> None:
    rig_file(tmp_path, WHOLE, "{joint: lower, mass: 1}")
    side = tmp_path / "side.rig.yaml"
    side.write_text(
        "rig: animtool/1\nname: side\nfrom: arm.rig.yaml\n"
        "masses: [{joint: upper, mass: 9}]\n"
    )
    assert {mass.joint: mass.mass for mass in load_rig(side).masses} == {
        "lower": 1.0, "upper": 9.0
    }  # fmt: skip


@pytest.mark.parametrize(
    ("mass", "code"),
    [
        ("{joint: none, mass: 1}", "RIG008"),
        ("{joint: lower, mass: 0}", "DOC022"),
        ("{joint: lower, mass: 1, inertia: [1, 1, 9]}", "RIG047"),
        ("{joint: lower, mass: 1, inertia: [0, 0, 0]}", "RIG047"),
        ("{joint: lower, mass: 1, axes: [0, 0, 0, 0]}", "RIG006"),
        ("{joint: upper, mass: 1}", "RIG011"),
    ],
)
def test_what_makes_no_sense_is_refused(tmp_path: Path, mass: str, code: str) -> None:
    with raises(FormatError, code):
        load_rig(rig_file(tmp_path, WHOLE, mass))

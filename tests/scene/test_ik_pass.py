"""The pass ``ik`` in scenes: feet held, hands on props, faults in their places."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.cli import animtool

from animtool import open_source
from animtool.core.errors import FormatError
from animtool.scene.file.read import load_scene

SCENE = """scene: animtool/1
source: {file: samples/walk/walk.bvh}
passes:
- time_scale: {speed: 0.8}
- ik: {targets: feet.targets.yaml}
output: {file: held.usdc}
"""
FEET = """targets: animtool/1
goals:
- {effector: LeftFoot, root: LeftUpLeg, hold: [[8, 14]], ease: 3}
"""
SIDECAR = """rig: animtool/1
name: walker
from: samples/walk/walk.bvh
joints:
- {name: LeftLeg, type: pin, axis: [1, 0, 0], limits: [0, 150]}
ik:
- {name: leg_l, root: LeftUpLeg, tip: LeftFoot, goal: position}
"""


@pytest.fixture
def place(workplace: Path) -> Path:
    (workplace / "held.scene.yaml").write_text(SCENE)
    (workplace / "feet.targets.yaml").write_text(FEET)
    return workplace


def test_a_foot_is_held_after_other_passes(place: Path) -> None:
    done = animtool("bake", place / "held.scene.yaml")
    assert done.code == 0, done.stderr
    take = open_source(place / "held.usdc").collect()
    feet = take.world().positions[:, take.rig.index("LeftFoot")]
    assert np.ptp(feet[7:14], axis=0).max() < 1e-5
    assert np.ptp(feet[14:30], axis=0).max() > 1e-2


@pytest.mark.slow
def test_what_is_missed_is_a_warning(place: Path) -> None:
    far = FEET + "- {effector: RightHand, position: [0, 900, 0], root: RightArm}\n"
    (place / "feet.targets.yaml").write_text(far)
    done = animtool("bake", place / "held.scene.yaml")
    assert done.code == 0
    assert "'RightHand' does not reach its target at frames" in done.stderr
    done = animtool("bake", place / "held.scene.yaml", "--strict", "--overwrite")
    assert done.code == 1


def test_chains_and_limits_of_another_rig(place: Path) -> None:
    (place / "walker.rig.yaml").write_text(SIDECAR)
    (place / "feet.targets.yaml").write_text(
        "targets: animtool/1\ngoals:\n- {effector: leg_l, hold: [[8, 14]]}\n"
    )
    text = SCENE.replace("feet.targets.yaml", "feet.targets.yaml, rig: walker.rig.yaml")
    (place / "held.scene.yaml").write_text(text)
    take = load_scene(place / "held.scene.yaml").open().collect()
    feet = take.world().positions[:, take.rig.index("LeftFoot")]
    assert np.ptp(feet[7:14], axis=0).max() < 1e-5
    assert not take.rig.chains


@pytest.mark.parametrize(
    ("options", "codes"),
    [
        ("{}", ["TGT013"]),
        ("{targets: nowhere.targets.yaml}", ["DOC015"]),
        ("{targets: feet.targets.yaml, method: magic}", ["SCN002"]),
        ("{targets: feet.targets.yaml, tolerance: '5'}", ["IK014"]),
        (f"{{targets: feet.targets.yaml, seed: {2**64}}}", ["IK014"]),
        (
            "{targets: feet.targets.yaml, rest_weight: -1, restarts: -1, smooth: -1}",
            ["IK014", "IK014", "IK014"],
        ),
        ("{targets: feet.targets.yaml, goals: []}", ["SCN001"]),
    ],
)
def test_options_are_checked_as_the_scene_is_loaded(
    place: Path, options: str, codes: list[str]
) -> None:
    text = SCENE.replace("{targets: feet.targets.yaml}", options)
    (place / "held.scene.yaml").write_text(text)
    with pytest.raises(FormatError) as caught:
        load_scene(place / "held.scene.yaml")
    assert [fault.code for fault in caught.value.faults] == codes
    assert caught.value.faults[0].lines == (5,)


def test_faults_of_the_targets_have_their_own_place(place: Path) -> None:
    (place / "feet.targets.yaml").write_text(FEET.replace("LeftFoot", "LeftFeet"))
    done = animtool("bake", place / "held.scene.yaml")
    assert done.code == 3
    assert "feet.targets.yaml:3:14: TGT001 goals[0].effector" in done.stderr
    assert not (place / "held.usdc").exists()


def test_targets_of_another_rate_have_the_place_of_the_pass(place: Path) -> None:
    (place / "feet.targets.yaml").write_text(FEET + "fps: 25\n")
    done = animtool("bake", place / "held.scene.yaml")
    assert done.code == 3
    assert "TGT014 the targets are at 25 fps, the take at 30 fps" in done.stderr


def test_a_stage_that_targets_follow_is_not_replaced(place: Path) -> None:
    shot = '#usda 1.0\ndef Xform "prop" {\n}\n'
    (place / "held.usda").write_text(shot)
    (place / "feet.targets.yaml").write_text(
        "targets: animtool/1\ngoals:\n- {effector: LeftHand, root: LeftArm, "
        "position: {prim: /prop, file: held.usda}}\n"
    )
    (place / "held.scene.yaml").write_text(SCENE.replace("usdc", "usda"))
    done = animtool("bake", place / "held.scene.yaml", "--overwrite")
    assert done.code == 2
    assert "OUT003" in done.stderr
    assert (place / "held.usda").read_text() == shot


def test_targets_of_another_kind_are_located_in_the_scene(place: Path) -> None:
    (place / "walker.rig.yaml").write_text(SIDECAR)
    path = place / "held.scene.yaml"
    path.write_text(SCENE.replace("feet.targets.yaml", "walker.rig.yaml"))
    with pytest.raises(FormatError) as caught:
        load_scene(path).open().collect()
    (fault,) = caught.value.faults
    assert (fault.code, fault.path, fault.lines) == ("DOC009", str(path), (5,))
    assert ".targets.yaml" in (fault.hint or "")

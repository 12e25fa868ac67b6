"""The takes and rigs for retargeting: their scripts make them, and feet stay."""

from __future__ import annotations

import json
import runpy
import sys
from pathlib import Path

import numpy as np
import pytest
from support.cli import animtool
from support.printed import Printed

from animtool import open_source
from animtool.retarget import map_joints
from animtool.retarget.motion import retarget_take
from animtool.rig.file import load_rig
from animtool.rig.kinematics import forward_kinematics, rest_world

FOLDER = Path(__file__).parents[2] / "samples/retarget"
TAKES = sorted((FOLDER / "takes").iterdir())
RIGS = sorted((FOLDER / "rigs").iterdir())
# The ball of a foot above the ground [m].
BALL = 0.02


@pytest.mark.parametrize("kind", ["takes", "rigs"])
def test_the_script_makes_the_files(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "argv", ["make", str(tmp_path)])
    runpy.run_path(str(FOLDER / f"make_{kind}.py"), run_name="__main__")
    kept = {path.name: path.read_bytes() for path in (FOLDER / kind).iterdir()}
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == kept
    assert len(kept) == {"takes": 12, "rigs": 3}[kind]


@pytest.mark.parametrize("path", TAKES, ids=lambda path: path.stem)
def test_feet_stay_where_they_stand(path: Path) -> None:
    take = open_source(path).collect()
    motion = take.motion
    world = forward_kinematics(
        take.rig, motion.translations.dense(), motion.rotations.dense()
    )
    stands = []
    for side in ("Left", "Right"):
        ball = world.positions[:, take.rig.index(f"{side}ToeBase")]
        assert ball[:, 1].min() > BALL - 1e-4
        low = ball[:, 1] < BALL + 1e-4
        both = low[1:] & low[:-1]
        assert np.linalg.norm(np.diff(ball, axis=0)[both], axis=1).max() < 1e-4
        stands.append(low)
    # Who runs or jumps leaves the ground; nobody else does.
    assert (~(stands[0] | stands[1])).any() == (path.stem in {"run", "jump"})


@pytest.mark.parametrize("path", RIGS, ids=lambda path: path.name.split(".")[0])
def test_rigs_stand_on_the_ground_with_bones_of_their_own(path: Path) -> None:
    rig, biped = (
        load_rig(path),
        load_rig(FOLDER.parents[1] / "rigs/biped/biped.rig.yaml"),
    )
    assert rig.names == biped.names
    places = rest_world(rig).positions[0]
    for side in "lr":
        sole = rig.joints[rig.index(f"toe_{side}")].tips[0][1]
        assert abs(places[rig.index(f"toe_{side}"), 1] + sole) < 1e-6
    ratios = [
        np.linalg.norm(places[rig.index(a)] - places[rig.index(b)])
        / np.linalg.norm(rest[biped.index(a)] - rest[biped.index(b)])
        for rest in [rest_world(biped).positions[0]]
        for a, b in [("hip_l", "knee_l"), ("elbow_l", "shoulder_l"), ("hip_l", "hip_r")]
    ]
    assert np.ptp(ratios) > 0.05


@pytest.mark.parametrize("path", RIGS, ids=lambda path: path.name.split(".")[0])
def test_the_foot_under_a_kick_stays_on_each_rig(path: Path) -> None:
    take, rig = open_source(FOLDER / "takes/kick.bvh").collect(), load_rig(path)
    motion = retarget_take(take, rig, map_joints(take.rig, rig)).take.motion
    world = forward_kinematics(
        rig, motion.translations.dense(), motion.rotations.dense()
    )
    for joint in ("ankle_l", "toe_l"):
        places = world.positions[:, rig.index(joint)]
        assert np.ptp(places, axis=0).max() < 1e-4
    assert np.ptp(world.positions[:, rig.index("toe_r"), 2]) > 0.3


@pytest.mark.slow(2.4)
def test_the_batch_reports_each_take_on_each_rig_and_the_worst_first(
    workplace: Path, printed: Printed
) -> None:
    """The scores come from the processes as the command alone has them."""
    command = "animtool batch samples/retarget/onto.batch.yaml"
    printed.copy(command, workplace)
    again = animtool(*command.split()[1:], "--format", "json", cwd=workplace)
    assert again.code == 0, again.stderr
    # What is up to date has the scores of the run that made it.
    assert json.loads(again.stdout)["skipped"] == len(TAKES) * len(RIGS)
    items = json.loads(again.stdout)["items"]
    assert len(items) == len(TAKES) * len(RIGS)
    for item in items:
        (own,) = item["scores"]
        assert own["pass"] == "retarget"
        excess = [
            (one["value"] - one["ideal"]) / (one["usual"] - one["ideal"])
            for one in own["scores"]
        ]
        item["worst"] = max(excess)
    worst = max(items, key=lambda item: float(item["worst"]))
    told = printed.stderr(command)
    table = told.partition("), worst first:\n")[2].splitlines()
    assert table[1].split()[0] == worst["output"]
    assert again.stderr.partition("), worst first:\n")[2].splitlines() == table
    alone = animtool(
        *("retarget", workplace / worst["input"], "--format", "json"),
        *("--to", FOLDER / f"rigs/{worst['values']['rig']}.rig.yaml"),
    )
    found = json.loads(alone.stdout)
    scores = {one["name"]: one["value"] for one in worst["scores"][0]["scores"]}
    assert worst["worst"] > 1
    assert scores["drift"] == found["drift_max"]
    assert scores["soles"] == found["sole_error"]
    assert (
        worst["scores"][0]["names"]["not mapped, of the rig"]
        == (found["unmapped_target"])
    )

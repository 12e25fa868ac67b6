"""``animtool ik``: from files to files, with its report and its exit codes."""

from __future__ import annotations

import json
import math
import re
import shutil
import subprocess
import sys
from dataclasses import fields
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.cli import animtool, animtool_process
from support.printed import NO_INPUT
from support.robots import ARM
from support.usd import joint_positions, open_stage, validation_errors

from animtool import Rig, open_source
from animtool.cli.ik import ik
from animtool.cli.options import read_values
from animtool.core.units import LengthUnit
from animtool.ik.options import IkMethod, TakeOptions
from animtool.ik.report import MISSED_ANGLE, MISSED_LENGTH
from animtool.scene.sources.open import SourceOptions

REACH = """targets: animtool/1
units: {length: cm}
fps: 24
range: [1, 12]
goals:
- effector: arm_l
  position: {keys: [{t: 1, v: [30, 110, 30]}, {t: 12, v: [35, 130, 30]}]}
- {effector: leg_r, position: [-10, 20, 20], orientation: [1, 0, 0, 0]}
"""
FEET = """targets: animtool/1
goals:
- {effector: leg_l, hold: [[3, 12]], ease: 2}
- {effector: leg_r, hold: [[15, 21]], ease: 2}
"""
FAR = REACH.replace("[-10, 20, 20]", "[-10, 20, 320]")


@pytest.fixture
def place(root: Path, tmp_path: Path) -> Path:
    """Return a project with a rig, two takes and three files of targets."""
    for name in ("rigs/biped", "samples/stride", "samples/walk"):
        shutil.copytree(root / name, tmp_path / name, ignore=NO_INPUT)
    (tmp_path / "animtool.toml").touch()
    for name, text in (("reach", REACH), ("feet", FEET), ("far", FAR)):
        (tmp_path / f"{name}.targets.yaml").write_text(text, "utf-8")
    return tmp_path


BIPED = "rigs/biped/biped.rig.yaml"
STRIDE = "samples/stride/stride.clip.yaml"


def run(place: Path, *arguments: object, rig: str = BIPED) -> Any:
    return animtool("ik", rig, *arguments, cwd=place)


def test_a_report_alone_writes_nothing(place: Path) -> None:
    before = sorted(place.iterdir())
    done = run(place, "--targets", "reach.targets.yaml")
    assert done.code == 0, done.stderr
    assert "12 converged" in done.stderr
    assert "arm_l position:" in done.stderr
    assert "leg_r orientation:" in done.stderr
    assert sorted(place.iterdir()) == before


def test_the_report_in_json(place: Path) -> None:
    done = run(place, "-t", "reach.targets.yaml", "--format", "json")
    found = json.loads(done.stdout)
    assert (found["ik"], found["frames"], found["first"]) == ("animtool/1", 12, 1)
    assert found["statuses"] == {"converged": 12}
    arm, leg = found["goals"]
    assert (arm["effector"], arm["joint"], arm["missed"]) == ("arm_l", "wrist_l", [])
    assert set(leg["residuals"]) == {"position", "orientation"}
    position = leg["residuals"]["position"]
    assert position["unit"] == "m"
    assert 0 <= position["mean"] <= position["p95"] <= position["max"] < 1e-5
    assert found["degrees_of_freedom"] > found["conditions"] > 0


@pytest.mark.slow
def test_a_clip_keeps_the_controls_of_the_poses_that_it_starts_from(
    root: Path, tmp_path: Path
) -> None:
    stride, out = root / "samples/stride", tmp_path / "rail.clip.yaml"
    done = animtool(
        "ik", root / "rigs/biped/biped.rig.yaml", "-t", stride / "rail.targets.yaml",
        "--clip", stride / "stride.clip.yaml", "-o", out, "--format", "json",
    )  # fmt: skip
    assert done.code == 0, done.stderr
    channels = json.loads(done.stdout)["channels"]
    targets = [channel["target"] for channel in channels]
    text = out.read_text("utf-8")
    assert targets == re.findall("^- target: (.*)$", text, re.M)
    controls = [target for target in targets if target.startswith("control/")]
    assert len(controls) == 4
    assert "joint/elbow_r.angle" in targets
    assert not [target for target in targets if ".local_" in target]
    assert {channel["unit"] for channel in channels} == {None, "m", "deg"}
    # The head looks at a sign beside what look_x makes it look at.
    assert "CLIP116" in done.stderr


def test_what_is_out_of_reach_is_named(place: Path) -> None:
    done = run(place, "-t", "far.targets.yaml", "-o", "far.usda")
    assert done.code == 0
    warned = "far.targets.yaml:8:3: warning: IK101 goals[1]: 'leg_r' does not reach "
    assert f"{warned}its target at frames 1 to 12" in done.stderr
    assert ": it is 2.46 m and 19° off at frame " in done.stderr
    assert (place / "far.usda").exists()


@pytest.mark.slow
def test_strict_refuses_what_is_missed(place: Path) -> None:
    given = ("-t", "far.targets.yaml", "-o", "far.usda", "--strict")
    done = run(place, *given)
    assert done.code == 4
    assert "IK101" in done.stderr
    assert "leg_r position: largest error 2" in done.stderr
    assert not (place / "far.usda").exists()
    assert run(place, *given, "--missed", "3m", "--missed-degrees", "180").code == 0
    found = run(place, *given, "--format", "json", "--overwrite")
    assert found.code == 4
    assert json.loads(found.stdout)["goals"][1]["missed"][0]["distance"] > 2


def test_the_joints_that_move_are_listed(place: Path) -> None:
    text = REACH[: REACH.index("- {effector: leg_r")]
    (place / "hand.targets.yaml").write_text(text)
    plain = run(place, "-t", "hand.targets.yaml")
    done = run(place, "-t", "hand.targets.yaml", "-v")
    line = "joints that move: shoulder_l, elbow_l, forearm_l\n"
    assert line in done.stderr
    assert line not in plain.stderr


def test_strict_refuses_warnings(place: Path) -> None:
    text = REACH.replace("orientation: [1", "weight: {pole: 1}, orientation: [1")
    (place / "odd.targets.yaml").write_text(text)
    done = run(place, "-t", "odd.targets.yaml", "-o", "o.usda", "--strict")
    assert done.code == 1
    assert "TGT101" in done.stderr
    assert not (place / "o.usda").exists()


def test_a_stage_plays_what_was_solved(place: Path) -> None:
    done = run(place, "-t", "reach.targets.yaml", "-o", "reach.usda")
    assert done.code == 0, done.stderr
    stage = open_stage(place / "reach.usda")
    assert validation_errors(stage) == []
    rig = Rig.load(place / BIPED)
    found = joint_positions(stage, [1, 12])
    wrist, ankle = rig.index("wrist_l"), rig.index("ankle_r")
    expected = [[0.3, 1.1, 0.3], [0.35, 1.3, 0.3]]
    np.testing.assert_allclose(found[:, wrist], expected, atol=1e-5)
    np.testing.assert_allclose(found[:, ankle], [[-0.1, 0.2, 0.2]] * 2, atol=1e-5)


@pytest.mark.slow
def test_a_clip_is_fixed_and_otherwise_kept(place: Path) -> None:
    done = run(place, "-t", "feet.targets.yaml", "--clip", STRIDE, "-o", "fixed.usdc")
    assert done.code == 0, done.stderr
    before = open_source(place / STRIDE).collect()
    after = open_source(place / "fixed.usdc").collect()
    names = before.rig.names
    ours, theirs = after.world().positions, before.world().positions
    ankle = names.index("ankle_l")
    assert np.ptp(theirs[2:12, ankle], axis=0).max() > 1e-3
    assert np.ptp(ours[2:12, ankle], axis=0).max() < 1e-5
    hands = [names.index(name) for name in ("wrist_l", "wrist_r", "head")]
    np.testing.assert_allclose(ours[:, hands], theirs[:, hands], atol=1e-5)


@pytest.mark.slow
def test_one_pose(place: Path) -> None:
    for given, frame in ((("--pose",), 1), (("--pose", "12"), 12)):
        done = run(place, "-t", "reach.targets.yaml", *given, "-o", f"p{frame}.usda")
        assert done.code == 0, done.stderr
        stage = open_stage(place / f"p{frame}.usda")
        assert stage.GetStartTimeCode() == stage.GetEndTimeCode() == frame
    done = run(place, "-t", "feet.targets.yaml", "--clip", STRIDE, "--pose", "5")
    assert "1 converged" in done.stderr
    done = run(place, "-t", "feet.targets.yaml", "--clip", STRIDE, "--pose", "99")
    assert done.code == 2
    assert "SCN013 frame 99 is not one of the frames 1 to 24" in done.stderr


def test_a_layer_over_a_rig_in_usd(place: Path) -> None:
    assert animtool("convert", BIPED, "biped.usda", cwd=place).code == 0
    done = run(place, "-t", "reach.targets.yaml", "-o", "reach.usda", "--rig-layer",
               "biped.usda", "--start", "1001", rig="biped.usda")  # fmt: skip
    assert done.code == 0, done.stderr
    text = (place / "reach.usda").read_text("utf-8")
    assert "startTimeCode = 1001\n" in text
    assert "def Skeleton" not in text


@pytest.mark.parametrize("suffix", ["bvh", "clip.yaml"])
def test_other_formats(place: Path, suffix: str) -> None:
    output = f"made.{suffix}"
    done = run(place, "-t", "reach.targets.yaml", "-o", output)
    assert done.code == 0, done.stderr
    unit = SourceOptions(unit=LengthUnit.M) if suffix == "bvh" else SourceOptions()
    take = open_source(place / output, unit).collect()
    wrist = take.world().positions[:, take.rig.index("wrist_l")]
    np.testing.assert_allclose(wrist[0], [0.3, 1.1, 0.3], atol=1e-3)
    assert take.clock.count == 12


def test_a_clip_names_the_rig_that_there_is(place: Path) -> None:
    done = run(place, "-t", "reach.targets.yaml", "-o", "made.clip.yaml")
    assert done.code == 0, done.stderr
    text = (place / "made.clip.yaml").read_text("utf-8")
    assert f"rig: {BIPED}\n" in text
    assert not (place / "made.rig.yaml").exists()
    assert animtool("bake", "made.clip.yaml", "-o", "made.usdc", cwd=place).code == 0
    walk = "samples/walk/walk.bvh"
    (place / "bvh.targets.yaml").write_text(
        "targets: animtool/1\ngoals:\n- {effector: LeftFoot, hold: [[5, 12]]}\n"
    )
    done = run(place, "-t", "bvh.targets.yaml", "--clip", walk, "-o", "w.clip.yaml",
               rig=walk)  # fmt: skip
    assert done.code == 0, done.stderr
    assert (place / "w.rig.yaml").exists()


def test_joints_may_be_patterns(place: Path) -> None:
    chosen = "shoulder_*,elbow_l,hip_*"
    given = ("-t", "reach.targets.yaml", "--joints", chosen, "--format", "json")
    done = run(place, *given)
    joints = json.loads(done.stdout)["joints"]
    assert joints == ["shoulder_l", "elbow_l", "hip_r"]


def test_usda_to_stdout(place: Path) -> None:
    done = run(place, "-t", "reach.targets.yaml", "--pose", "-o", "-")
    assert done.code == 0
    assert done.stdout.startswith("#usda 1.0")
    done = run(place, "-t", "reach.targets.yaml", "-o", "-", "--format", "json")
    assert done.code == 2


def test_rigs_of_other_files(place: Path) -> None:
    goal = "- {effector: LeftFoot, root: LeftUpLeg, hold: [[5, 12]]}"
    text = f"targets: animtool/1\ngoals:\n{goal}\n"
    (place / "bvh.targets.yaml").write_text(text)
    walk = "samples/walk/walk.bvh"
    done = run(place, "-t", "bvh.targets.yaml", "--clip", walk, "-o", "w.bvh", rig=walk)
    assert done.code == 0, done.stderr
    take = open_source(place / "w.bvh").collect()
    foot = take.world().positions[4:12, take.rig.index("LeftFoot")]
    assert np.ptp(foot, axis=0).max() < 1e-5
    usd = animtool("bake", walk, "-o", "w.usdc", cwd=place)
    assert usd.code == 0
    done = run(place, "-t", "bvh.targets.yaml", "--clip", "w.usdc", "-o", "x.usdc",
               rig="w.usdc")  # fmt: skip
    assert done.code == 0, done.stderr
    take = open_source(place / "x.usdc").collect()
    foot = take.world().positions[4:12, take.rig.index("LeftFoot")]
    assert np.ptp(foot, axis=0).max() < 1e-5


def test_joints_that_no_goal_moves_are_within_their_limits(place: Path) -> None:
    side = ARM[ARM.index('<joint name="elbow"') : ARM.index('<joint name="hand"')]
    side = side.replace("elbow", "side").replace("lower", "flap", 1)
    side = side.replace('child link="lower"', 'child link="flap"').replace(
        '"-2"', '".5"'
    )
    text = ARM.replace("</robot>", f'<link name="flap"/>{side}</robot>')
    (place / "arm.urdf").write_text(text, "utf-8")
    goal = "- {effector: tool, position: [0.1, 0.1, 0.5]}"
    (place / "tool.targets.yaml").write_text(f"targets: animtool/1\ngoals:\n{goal}\n")
    done = run(place, "-t", "tool.targets.yaml", "-o", "o.mot", rig="arm.urdf")
    assert done.code == 0, done.stderr
    names, values = (place / "o.mot").read_text().splitlines()[-2:]
    row = dict(zip(names.split(), values.split(), strict=True))
    assert float(row["side"]) == pytest.approx(math.degrees(0.5))


def test_motion_of_another_file_goes_to_joints_of_the_same_names(place: Path) -> None:
    assert animtool("bake", STRIDE, "-o", "stride.usdc", cwd=place).code == 0
    done = run(place, "-t", "feet.targets.yaml", "--clip", "stride.usdc", "-o", "f.bvh")
    assert done.code == 0, done.stderr
    done = run(place, "-t", "feet.targets.yaml", "--clip", "samples/walk/walk.bvh")
    assert done.code == 2
    assert "TGT017 has no joint of 'biped'" in done.stderr


BAD = {
    "unknown": ("effector: leg_r", "effector: leg_q", 3, "TGT001"),
    "nan": ("[-10, 20, 20]", "[-10, .nan, 20]", 3, "DOC022"),
    "reversed range": ("range: [1, 12]", "range: [12, 1]", 3, "CLIP006"),
    "rate": ("fps: 24", "fps: 30", 2, "TGT014"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_targets(place: Path, name: str) -> None:
    old, new, code, fault = BAD[name]
    (place / "bad.targets.yaml").write_text(REACH.replace(old, new))
    done = run(place, "-t", "bad.targets.yaml", "--clip", STRIDE, "-o", "bad.usda")
    assert done.code == code, done.stderr
    assert fault in done.stderr
    assert not (place / "bad.usda").exists()


def test_arrays_of_another_length(place: Path) -> None:
    np.savez(place / "a.npz", left=np.zeros((10, 3)))
    text = "targets: animtool/1\ngoals:\n- {effector: arm_l, position: 'a.npz#left'}\n"
    (place / "a.targets.yaml").write_text(text)
    done = run(place, "-t", "a.targets.yaml", "--clip", STRIDE)
    assert done.code == 2
    assert "TGT015 'a.npz#left' has 10 rows, but the take has  24 frames" in done.stderr


def test_targets_beyond_numbers_are_missed_by_words(place: Path) -> None:
    np.savez(place / "far.npz", p=np.tile([-1.0e202, 20, 20], (12, 1)))
    text = REACH.replace("[-10, 20, 20]", "far.npz#p")
    assert text != REACH
    (place / "far.targets.yaml").write_text(text)
    done = run(place, "-t", "far.targets.yaml")
    assert done.code == 0, done.stderr
    assert "over 1e+150 m" in done.stderr
    assert not re.search(r"\b(inf|nan)\b", done.stdout + done.stderr)


def test_joints_that_the_rig_lacks_are_a_fault_of_its_file(place: Path) -> None:
    done = run(place, "-t", "reach.targets.yaml", "--joints", "elbow_q")
    assert f"{BIPED}: TGT001 no joint of 'biped' matches 'elbow_q'" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (("-t", "reach.targets.yaml", "--joints", "elbow_q"), 2),
        (("-t", "reach.targets.yaml", "--joints", "toe_l"), 2),
        (("-t", "reach.targets.yaml", "--method", "magic"), 2),
        (("-t", "reach.targets.yaml", "--tolerance", "5"), 2),
        (("-t", "reach.targets.yaml", "--split"), 2),
        (("-t", "reach.targets.yaml", "--reduce", "1mm"), 2),
        (("-t", "reach.targets.yaml", "--seed", str(2**64)), 2),
        (("-t", "reach.targets.yaml", "--restarts", str(2**31)), 2),
        (("-t", "reach.targets.yaml", "-o", "x.bvh", "--rig-layer", "y.usda"), 2),
        (("-t", "reach.targets.yaml", "-o", "x.txt"), 2),
        (("-t", "reach.targets.yaml", "--units", "cm"), 2),
        (("-t", "reach.targets.yaml", "--source-fps", "30", "--table"), 2),
        (("-t", "reach.targets.yaml", "-o", "reach.targets.yaml"), 2),
        (("-t", "reach.targets.yaml", "--table", "-o", "x.usda"), 2),
        (("-t", "reach.targets.yaml", "--table", "--strict"), 2),
        (("-t", "reach.targets.yaml", "--plot", "x.png"), 2),
        (("-t", "reach.targets.yaml", "--table", "--plot", "x.txt"), 2),
        (("-t", "reach.targets.yaml", "--table", "--plot", "reach.targets.yaml"), 2),
        (("-t", "reach.targets.yaml", "--table", "--plot", "no/folder.png"), 3),
        (("--match", "--clip", "x.bvh", "--plot", "x.png"), 2),
        (("-t", "none.targets.yaml"), 3),
        (("-t", "reach.targets.yaml", "--clip", "none.bvh"), 3),
        (("-t", "reach.targets.yaml", "-o", "no/folder.usda"), 3),
        ((), 2),
    ],
)
def test_exit_codes(place: Path, arguments: tuple[str, ...], code: int) -> None:
    done = run(place, *arguments)
    assert done.code == code, done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("unit", ["m", "cm"])
def test_targets_in_another_unit_are_asked_after(place: Path, unit: str) -> None:
    # The hips travel there, so that no goal is missed.
    text = (
        f"targets: animtool/1\nunits: {{length: {unit}}}\ngoals:\n"
        "- {effector: wrist_l, position: [60, 130, 20]}\n"
    )
    (place / "unit.targets.yaml").write_text(text)
    done = run(place, "-t", "unit.targets.yaml")
    assert done.code == 0, done.stderr
    assert "IK101" not in done.stderr
    assert ("unit.targets.yaml:4:3: warning: TGT106" in done.stderr) == (unit == "m")
    assert run(place, "-t", "unit.targets.yaml", "--strict").code == int(unit == "m")


def test_what_runs_out_of_time_is_told_what_to_do(place: Path) -> None:
    done = run(place, "-t", "far.targets.yaml", "--time-budget", "1e-9")
    assert done.code == 0, done.stderr
    assert "out of budget" in done.stderr
    assert "--time-budget" in done.stderr


def test_a_target_beyond_all_numbers(place: Path) -> None:
    np.savez(place / "huge.npz", p=np.tile([1e300, 0, 0], (12, 1)))
    text = REACH.replace("[-10, 20, 20]", "huge.npz#p")
    (place / "huge.targets.yaml").write_text(text)
    done = run(place, "-t", "huge.targets.yaml", "-o", "h.usda", "--format", "json")
    assert done.code == 0, done.stderr
    found = json.loads(done.stdout)["goals"][1]
    assert found["residuals"]["position"]["max"] is None
    assert found["missed"][0]["distance"] is None
    assert "nan" not in (place / "h.usda").read_text("utf-8")


@pytest.mark.slow
def test_smoothing_keeps_the_goals(place: Path) -> None:
    given = ("-t", "feet.targets.yaml", "--clip", STRIDE, "--smooth", "0.2")
    done = run(place, *given, "--strict", "--format", "json")
    assert done.code == 0, done.stderr
    assert json.loads(done.stdout)["jumps"] == []


@pytest.mark.slow
def test_the_table(place: Path) -> None:
    done = run(place, "-t", "reach.targets.yaml", "--table", "--format", "json")
    assert done.code == 0, done.stderr
    (table,) = json.loads(done.stdout)["tables"]
    assert (table["unit"], table["measure"]) == ("iterations", "largest")
    first = table["rows"][0]["method"]
    rows = [row for row in table["rows"] if row["method"] == first][:7]
    tolerances = [row["options"]["tolerance"] for row in rows]
    ratios = [a / b for a, b in pairwise(tolerances)]
    assert ratios == pytest.approx([10] * 6)
    for row, tolerance in zip(rows, tolerances, strict=True):
        assert row["figures"]["reached"] == 1
        assert row["figures"]["miss"] <= tolerance * 1.01
        # The finest solution is at the targets.
        assert row["error"]["largest"] == pytest.approx(
            row["figures"]["miss"], rel=1e-3, abs=1e-9
        )
    assert {row["method"] for row in table["rows"]} == {str(m) for m in IkMethod}
    (chosen,) = [row for row in table["rows"] if row["chosen"]]
    assert chosen["options"]["tolerance"] == 1e-6
    text = run(place, "-t", "reach.targets.yaml", "--table").stdout
    assert "miss mm" in text
    assert "reached %" in text


@pytest.mark.slow(0.5)
def test_the_table_is_drawn(place: Path) -> None:
    pytest.importorskip("matplotlib", reason="no matplotlib (extra: preview)")
    done = run(place, "-t", "reach.targets.yaml", "--table", "--plot", "reach.svg")
    assert done.code == 0, done.stderr
    assert "reach.svg: drawn" in done.stderr
    assert (place / "reach.svg").stat().st_size > 4000
    again = run(place, "-t", "reach.targets.yaml", "--table", "--plot", "reach.svg")
    assert (again.code, "OUT001" in again.stderr) == (2, True)


def test_defaults_are_those_of_the_record() -> None:
    context = ik.make_context("ik", ["hero.rig.yaml"])
    values = read_values(TakeOptions, context.params)
    assert [*values] == [entry.name for entry in fields(TakeOptions)]
    assert TakeOptions(**values) == TakeOptions()
    said = {param.name: param.help or "" for param in ik.params if param.name}
    assert f"default: {MISSED_LENGTH * 1000:g}mm" in said["tol"]
    assert f"default: {math.degrees(MISSED_ANGLE):g}," in said["tol_degrees"]


@pytest.mark.parametrize("given", [("--missed", "1e-9mm"), ("--tolerance", "5mm")])
def test_what_is_solved_to_is_never_a_miss(place: Path, given: tuple[str, str]) -> None:
    done = run(place, "-t", "reach.targets.yaml", *given, "--strict")
    assert done.code == 0, done.stderr
    assert "IK101" not in done.stderr


def test_spans_outside_the_frames_are_named(place: Path) -> None:
    spans = "[[4, 9], [30, 40], [1012, 1020]]"
    text = f"targets: animtool/1\ngoals:\n- {{effector: leg_l, hold: {spans}}}\n"
    (place / "late.targets.yaml").write_text(text)
    done = run(place, "-t", "late.targets.yaml", "--clip", STRIDE)
    assert done.code == 0
    assert (
        "late.targets.yaml:3:3: warning: TGT104 goals[0]: the span from" in done.stderr
    )
    assert "the span from 30 to 40, to hold 'leg_l'" in done.stderr
    assert done.stderr.count("without an offset of 1000 it is") == 1
    assert "it is [12, 20]" in done.stderr
    assert run(place, "-t", "late.targets.yaml", "--clip", STRIDE, "--strict").code == 1
    one = run(place, "-t", "late.targets.yaml", "--clip", STRIDE, "--pose", "5")
    assert "TGT104" not in one.stderr


@pytest.mark.slow
def test_a_pole_that_keeps_a_limb_from_its_target(place: Path) -> None:
    for z, in_the_way in ((-3, True), (3, False)):
        (place / "pole.targets.yaml").write_text(
            "targets: animtool/1\ngoals:\n"
            f"- {{effector: leg_l, hold: [[4, 10]], pole: [0.09, 0.5, {z}]}}\n"
        )
        done = run(place, "-t", "pole.targets.yaml", "--clip", STRIDE)
        assert ("but not with its pole" in done.stderr) is in_the_way


def test_holding_the_rest_pose_is_reported(place: Path) -> None:
    text = "targets: animtool/1\nfps: 24\ngoals:\n- {effector: leg_l, hold: [[4, 9]]}\n"
    path = place / "held.targets.yaml"
    path.write_text(text)
    assert "TGT109" in run(place, "-t", path.name).stderr
    assert "TGT109" not in run(place, "-t", path.name, "--clip", STRIDE).stderr
    keys = "[{t: 1, v: [0.2, 0.9, 0.3]}, {t: 9, v: [0.2, 1.0, 0.3]}]"
    path.write_text(f"{text}- {{effector: arm_l, position: {{keys: {keys}}}}}\n")
    assert "TGT109" not in run(place, "-t", path.name).stderr


@pytest.mark.slow
def test_a_pose_loads_neither_usd_nor_what_is_for_clips(place: Path) -> None:
    code = (
        "import sys\nfrom animtool.cli.main import run\n"
        f"run(['ik', {BIPED!r}, '-t', 'reach.targets.yaml', '--pose', '-q'])\n"
        "heavy = {'pxr', 'scipy', 'rich', 'numpy.ma', 'numpy.random',\n"
        "         'animtool.ik.clip_solver'}\n"
        "print(sorted(heavy & set(sys.modules)))"
    )
    done = subprocess.run(
        [sys.executable, "-P", "-c", code],
        capture_output=True,
        text=True,
        check=True,
        cwd=place,
    )
    assert done.stdout.strip() == "[]"


@pytest.mark.slow(1)
def test_the_installed_command(place: Path) -> None:
    done = animtool_process(
        "ik", BIPED, "-t", "far.targets.yaml", "--strict", cwd=place
    )
    assert done.code == 4
    done = animtool_process("ik", BIPED, "-t", "reach.targets.yaml", "-o", "r.usdc",
                            cwd=place)  # fmt: skip
    assert done.code == 0
    assert (place / "r.usdc").exists()


def test_a_hand_on_a_prop(place: Path) -> None:
    (place / "shot.usda").write_text(
        '#usda 1.0\n(upAxis = "Z"\nmetersPerUnit = 0.01\ntimeCodesPerSecond = 24)\n'
        'def Xform "prop" {\n    double3 xformOp:translate.timeSamples = {\n'
        "        1: (30, -30, 110), 12: (35, -30, 130)}\n"
        '    uniform token[] xformOpOrder = ["xformOp:translate"]\n}\n'
    )
    (place / "prop.targets.yaml").write_text(
        "targets: animtool/1\nfps: 24\nrange: [1, 12]\ngoals:\n- {effector: arm_l, "
        "position: {prim: /prop, file: shot.usda, offset: [0, 0, 0.02]}}\n"
    )
    done = run(place, "-t", "prop.targets.yaml", "-o", "prop.usda")
    assert done.code == 0, done.stderr
    wrist = Rig.load(place / BIPED).index("wrist_l")
    found = joint_positions(open_stage(place / "prop.usda"), [1, 12])[:, wrist]
    # The offset is in the prop's frame, whose z is the rig's y.
    expected = [[0.3, 1.12, 0.3], [0.35, 1.32, 0.3]]
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_a_space_that_is_not_there_has_its_own_place(place: Path) -> None:
    (place / "shot.usda").write_text('#usda 1.0\ndef Xform "prop" {\n}\n')
    (place / "prop.targets.yaml").write_text(
        "targets: animtool/1\ngoals:\n- effector: arm_l\n  position:\n"
        "    prim: /prop\n    file: shot.usda\n    space: /hero\n"
    )
    done = run(place, "-t", "prop.targets.yaml")
    assert done.code == 3
    assert "prop.targets.yaml:7:12: TGT011 goals[0].position.space:" in done.stderr


def test_a_stage_that_targets_follow_is_not_replaced(place: Path) -> None:
    shot = '#usda 1.0\n(subLayers = [@./layer.usda@])\ndef Xform "prop" {\n}\n'
    (place / "shot.usda").write_text(shot)
    (place / "layer.usda").write_text("#usda 1.0\n")
    (place / "prop.targets.yaml").write_text(
        "targets: animtool/1\nrange: [1, 2]\ngoals:\n"
        "- {effector: arm_l, position: {prim: /prop, file: shot.usda}}\n"
    )
    given = ("-t", "prop.targets.yaml", "--overwrite", "-o")
    done = run(place, *given, "shot.usda")
    assert done.code == 2
    assert "shot.usda: OUT003" in done.stderr
    assert (place / "shot.usda").read_text() == shot
    # A layer of the shot may be made anew.
    done = run(place, *given, "layer.usda")
    assert done.code == 0, done.stderr


def test_what_a_rig_is_from_is_not_replaced(place: Path) -> None:
    (place / "walk.rig.yaml").write_text(
        "rig: animtool/1\nname: walk\nfrom: samples/walk/walk.bvh\n"
    )
    (place / "feet.targets.yaml").write_text(
        "targets: animtool/1\ngoals: [{effector: LeftFoot, hold: [[1, 2]]}]\n"
    )
    given = ("-t", "feet.targets.yaml", "-o", "samples/walk/walk.bvh", "--overwrite")
    before = (place / "samples/walk/walk.bvh").read_bytes()
    done = run(place, *given, rig="walk.rig.yaml")
    assert done.code == 2
    assert "OUT003" in done.stderr
    assert (place / "samples/walk/walk.bvh").read_bytes() == before


def test_names_of_what_holds_no_motion(place: Path) -> None:
    for name in ("x.targets.yaml", "x.rig.yaml", "x.SCENE.yml"):
        done = run(place, "-t", "reach.targets.yaml", "-o", name)
        assert done.code == 2
        assert f"{name}: OUT004" in done.stderr
        assert not (place / name).exists()


def test_weights_are_bounded_and_large_ones_warn_of_nothing_else(place: Path) -> None:
    for weight, code in ("1e18", 0), ("1e200", 3):
        text = REACH.replace("[-10, 20, 20]", f"[-10, 20, 20], weight: {weight}")
        (place / "heavy.targets.yaml").write_text(text)
        done = run(place, "-t", "heavy.targets.yaml", "--overwrite")
        assert done.code == code, done.stderr
        assert "RuntimeWarning" not in done.stderr


def test_a_folder_is_no_stage(place: Path) -> None:
    (place / "prop.targets.yaml").write_text(
        "targets: animtool/1\ngoals:\n"
        "- {effector: arm_l, position: {prim: /prop, file: samples}}\n"
    )
    done = run(place, "-t", "prop.targets.yaml")
    assert done.code == 3
    assert "'samples' is a folder" in done.stderr


SNAPS = """\
targets: animtool/1
fps: 24
range: [1, 24]
goals:
- effector: tip
  position:
    interp: linear
    keys: [{t: 1, v: [1, 0.3, 0]}, {t: 12, v: [2.2, 0.3, 0]}, {t: 24, v: [1, 0.3, 0]}]
"""
LIMB = """\
rig: animtool/1
name: limb
joints:
- {name: base, type: %s}
- {name: upper, type: pin, parent: base, axis: [0, 0, 1]}
- {name: lower, type: pin, parent: upper, translate: [1, 0, 0], axis: [0, 0, 1],
   limits: [0, 150]}
- {name: tip, type: fixed, parent: lower, translate: [0.7, 0, 0]}
"""
SLIDE = "prismatic, axis: [0, 1, 0], limits: [0, 0.01]"


@pytest.mark.parametrize("slides", [True, False])
def test_to_ease_a_limb_out_is_advised_where_it_may_be(
    tmp_path: Path, slides: bool
) -> None:
    rig, targets = tmp_path / "limb.rig.yaml", tmp_path / "snaps.targets.yaml"
    text = LIMB % (SLIDE if slides else "fixed")
    rig.write_text(text, "utf-8")
    targets.write_text(SNAPS, "utf-8")
    found = json.loads(animtool("ik", rig, "-t", targets, "--format", "json").stdout)
    (said,) = [one for one in found["notices"] if one["code"] == "IK102"]
    assert ("soft: 0.1" in said["hint"]) is not slides
    targets.write_text(SNAPS.replace("tip\n", "tip\n  soft: 0.1\n"), "utf-8")
    eased = animtool("ik", rig, "-t", targets, "--format", "json")
    assert (eased.code == 0) is not slides


COLLAPSED = """\
HIERARCHY
ROOT hips
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT knee
  {
    OFFSET 0 -40 0
    CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 0 -40 0
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.041667
0 90 0 0 0 0 0 0 0 0 0 0
0 90 1 0 0 0 0 0 0 0 5 0
"""


@pytest.mark.parametrize(
    "command",
    [
        ("ik", "a.bvh", "-t", "t.targets.yaml", "--clip", "a.bvh"),
        ("loop", "a.bvh", "--first", "1", "--last", "2"),
        ("info", "a.bvh"),
        ("mocap", "clean", "a.bvh", "-o", "c.bvh"),
    ],
)
def test_what_reads_a_bvh_names_lost_positions_and_heeds_the_option(
    tmp_path: Path, command: tuple[str, ...]
) -> None:
    (tmp_path / "a.bvh").write_text(COLLAPSED, "utf-8")
    targets = "targets: animtool/1\ngoals:\n- {effector: knee, hold: [[1, 2]]}\n"
    (tmp_path / "t.targets.yaml").write_text(targets, "utf-8")
    for more, said in (((), True), (("--positions", "offsets"), False)):
        (tmp_path / "c.bvh").unlink(missing_ok=True)
        done = animtool(*command, *more, cwd=tmp_path)
        assert done.code == 0, done.stderr
        assert ("BVH111" in done.stderr + done.stdout) is said


def test_a_start_of_another_skeleton_is_one_warning(place: Path) -> None:
    lines = ["HIERARCHY", "ROOT hips", "{", "OFFSET 0 0 0"]
    lines += ["CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation"]
    for i in range(8):
        lines += [f"JOINT part_{i}", "{", "OFFSET 0 10 0", "CHANNELS 3 Zrotation"]
        lines[-1] += " Xrotation Yrotation"
    lines += ["End Site", "{", "OFFSET 0 10 0", *"}" * 10]
    row = " ".join(["0"] * 30)
    lines += ["MOTION", "Frames: 24", "Frame Time: 0.0416667", *[row] * 24]
    (place / "snake.bvh").write_text("\n".join(lines) + "\n", "utf-8")
    done = run(place, "-t", "feet.targets.yaml", "--clip", "snake.bvh")
    assert done.stderr.count("TGT102") == 1
    assert "1 of the 59 joints" in done.stderr

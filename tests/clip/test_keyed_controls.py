"""Takes as keys on the rigs that ship: controls are kept, and the pose comes back."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from animtool.clip.clip import Clip, clip_text
from animtool.clip.keyed_take import KeyedTake, fit_take_keys
from animtool.clip.sample import sample_values
from animtool.core.array_types import FloatArray
from animtool.core.clock import Clock
from animtool.maths import so3
from animtool.motion.take import Take
from animtool.rig.skeleton import Rig

RIGS = ("arm", "biped", "head", "machine", "quadruped")
FRAMES = 9
EXACT = 1e-9
TIMES = 1.0 + np.arange(FRAMES)


@cache
def rig_named(name: str) -> Rig:
    rigs = Path(__file__).parents[2] / "rigs"
    return Rig.load(rigs / name / f"{name}.rig.yaml")


def smooth(seed: str, low: float, high: float) -> FloatArray:
    """A value that moves within a range ``(F, 1)``, another for each seed."""
    phase = sum(map(ord, seed)) % 97
    wave = np.sin(0.37 * np.arange(FRAMES) + phase)
    return (low + (high - low) * (0.5 + 0.45 * wave))[:, None]


def take_of(rig: Rig, keyed: dict[str, FloatArray], *, controls: bool) -> Take:
    """What values of targets give, with those of the controls or without."""
    motion = sample_values(keyed, rig, TIMES).motion
    if not controls:
        motion = replace(motion, controls=None)
    clock = Clock(Fraction(24), Fraction(1), Fraction(1), FRAMES)
    return Take(rig, clock, motion)


def check(take: Take, folder: Path) -> tuple[KeyedTake, dict[str, str]]:
    """Write a take as a clip; check that the file samples back to the pose.

    Returns:
        The clip, and the targets of its channels.
    """
    made = fit_take_keys(take, take.rig, "one", EXACT)
    path = folder / "one.clip.yaml"
    path.write_text(clip_text(made.clip, take.rig, "one.rig.yaml"), "utf-8")
    back = Clip.load(path, take.rig).sample(take.rig).motion
    wanted, found = take.motion, back
    angles = so3.angle_between(wanted.rotations.dense(), found.rotations.dense())
    assert angles.max() <= EXACT
    assert_allclose(found.translations.dense(), wanted.translations.dense(), atol=EXACT)
    if wanted.weights is not None:
        assert found.weights is not None
        assert_allclose(found.weights.dense(), wanted.weights.dense(), atol=1e-3)
    assert made.reduction.error <= EXACT * 3
    return made, {channel.target: channel.euler for channel in made.clip.channels}


def all_controls(rig: Rig) -> dict[str, FloatArray]:
    return {
        f"control/{c.name}": smooth(
            c.name, max(c.low or 0.0, -99), min(c.high or 1, 99)
        )
        for c in rig.controls
    }


@pytest.mark.slow
@pytest.mark.parametrize("name", RIGS)
def test_controls_of_a_take_stay_controls(name: str, tmp_path: Path) -> None:
    rig = rig_named(name)
    made, targets = check(take_of(rig, all_controls(rig), controls=True), tmp_path)
    assert {*targets} == {f"control/{control.name}" for control in rig.controls}
    assert not made.notices
    assert max(error.error for error in made.errors) <= 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("name", ["arm", "biped", "machine", "quadruped"])
def test_controls_are_solved_for_from_joints_alone(name: str, tmp_path: Path) -> None:
    rig = rig_named(name)
    keyed = all_controls(rig)
    _, targets = check(take_of(rig, keyed, controls=False), tmp_path)
    assert {*targets} == {*keyed}
    back = Clip.load(tmp_path / "one.clip.yaml", rig).sample(rig).motion.controls
    assert back is not None
    values = back.dense()[..., 0].T
    for control, value in zip(rig.controls, values, strict=True):
        assert_allclose(value, keyed[f"control/{control.name}"][:, 0], atol=1e-6)


def test_controls_of_shapes_are_solved_for(tmp_path: Path) -> None:
    rig = rig_named("head")
    names = ("nod", "turn", "look_x", "blink_l", "brow_r", "jaw", "jaw_side", "pucker")
    keyed = {f"control/{n}": all_controls(rig)[f"control/{n}"] for n in names}
    _, targets = check(take_of(rig, keyed, controls=False), tmp_path)
    assert {*targets} == {*keyed}


@pytest.mark.parametrize("controls", [True, False])
def test_other_motion_is_written_as_joint_coordinates(
    tmp_path: Path, controls: bool
) -> None:
    rig = rig_named("biped")
    keyed = {
        "joint/hips.translation": np.hstack([smooth(n, -0.2, 0.3) for n in "abc"]),
        "joint/shoulder_l.rotation": so3.exp(
            np.hstack([smooth(n, -0.5, 0.5) for n in "def"])
        ),
        "joint/elbow_l.angle": smooth("elbow", 0.2, 1.5),
        "control/fist_l": smooth("fist", 0, 1),
    }
    made, targets = check(take_of(rig, keyed, controls=controls), tmp_path)
    assert {*targets} == {*keyed}
    assert not made.notices


@pytest.mark.slow
def test_a_joint_on_top_of_its_control_keeps_both(tmp_path: Path) -> None:
    rig = rig_named("biped")
    turn = so3.exp(np.hstack([smooth(n, -0.2, 0.4) for n in "abc"]))
    keyed = {"control/look_x": smooth("x", -40, 40), "joint/head.rotation": turn}
    made, targets = check(take_of(rig, keyed, controls=True), tmp_path)
    assert {*targets} == {*keyed}
    assert [note.code for note in made.notices] == ["CLIP116"]
    # Without the control's values no value of it gives the whole head.
    made, targets = check(take_of(rig, keyed, controls=False), tmp_path)
    assert "control/look_x" not in targets
    assert "joint/eye_l.rotation" in targets
    assert [note.code for note in made.notices] == ["CLIP115"]


def test_what_its_type_lacks_is_in_the_parents_space(tmp_path: Path) -> None:
    rig = rig_named("arm")
    keyed = {
        "joint/axis_2.local_rotation": so3.exp(
            np.hstack([smooth(n, -0.2, 0.4) for n in "abc"])
        ),
        "joint/finger_l.slide": smooth("grip", 0, 0.03),
        "joint/finger_r.slide": smooth("other", 0, 0.03),
    }
    made, targets = check(take_of(rig, keyed, controls=True), tmp_path)
    assert targets == {
        "joint/axis_2.local_rotation": targets["joint/axis_2.local_rotation"],
        "control/grip": "",
        "joint/finger_r.slide": "",
    }
    assert [note.code for note in made.notices] == ["CLIP117", "CLIP118"]


LED = """rig: animtool/1
name: led
joints:
- {name: a, type: pin, axis: [0, 0, 1]}
- {name: b, type: pin, axis: [1, 0, 0], parent: a, mimic: {joint: a}}
controls:
- {name: k, default: 30, drives: [{joint: a.angle, expr: k}]}
"""


def test_followers_of_a_joint_with_local_keys_stay_at_rest(tmp_path: Path) -> None:
    path = tmp_path / "led.rig.yaml"
    path.write_text(LED)
    rig = Rig.load(path)
    tilt = np.linspace(0.0, 1.0, FRAMES)[:, None] * [0.0, 1.0, 0.0]
    keyed = {"joint/a.local_rotation": so3.exp(tilt)}
    take = take_of(rig, keyed, controls=True)
    turns = take.motion.rotations.dense()[:, 1]
    assert so3.angle_between(turns, so3.IDENTITY).max() == 0.0
    _, targets = check(take, tmp_path)
    assert {*targets} == {"joint/a.local_rotation"}


def test_errors_of_angles_are_in_degrees() -> None:
    rig = rig_named("biped")
    wave = np.sin(np.arange(FRAMES))[:, None]
    keyed = {"joint/shoulder_l.rotation": so3.exp(wave * [0.3, 0.2, 0.1])}
    take = take_of(rig, keyed, controls=False)
    made = fit_take_keys(take, rig, "one", 1e-2)
    (error,) = made.errors
    assert error.target == "joint/shoulder_l.rotation"
    found = made.clip.sample(rig).motion.rotations.dense()
    off = so3.angle_between(take.motion.rotations.dense(), found)
    assert error.unit == "deg"
    assert error.error == pytest.approx(np.degrees(off.max()), rel=1e-6)
    assert error.error > 0.1


@pytest.mark.parametrize("angles", [(380.0, 640.0), (-640.0, -380.0)])
def test_whole_turns_of_a_leader_are_those_that_its_follower_shows(
    angles: tuple[float, float], tmp_path: Path
) -> None:
    rig = rig_named("machine")
    keyed = {"control/crank": np.linspace(*angles, FRAMES)[:, None]}
    _, targets = check(take_of(rig, keyed, controls=False), tmp_path)
    assert {*targets} == {"control/crank"}


SLID = """rig: animtool/1
name: slid
joints:
- {name: a, type: pin, axis: [0, 0, 1]}
- {name: b, type: prismatic, axis: [1, 0, 0], parent: a, mimic: {joint: a, gain: 0.1}}
"""


@pytest.mark.parametrize("sign", [1, -1])
def test_whole_turns_of_a_leader_are_those_that_a_slide_shows(
    sign: int, tmp_path: Path
) -> None:
    path = tmp_path / "slid.rig.yaml"
    path.write_text(SLID)
    rig = Rig.load(path)
    angles = sign * np.radians(np.linspace(400.0, 640.0, FRAMES))[:, None]
    take = take_of(rig, {"joint/a.angle": angles}, controls=False)
    made, targets = check(take, tmp_path)
    assert {*targets} == {"joint/a.angle"}
    (channel,) = made.clip.channels
    assert_allclose(np.ravel(channel.values)[[0, -1]], angles[[0, -1], 0])


@pytest.mark.slow
def test_keys_are_few_within_a_tolerance() -> None:
    rig = rig_named("biped")
    take = take_of(rig, all_controls(rig), controls=True)
    coarse = fit_take_keys(take, rig, "one", 2e-3)
    assert coarse.reduction.held
    assert coarse.reduction.error <= 2e-3
    fine = fit_take_keys(take, rig, "one", EXACT)
    assert coarse.reduction.keys < fine.reduction.keys
    worst = max(coarse.errors, key=lambda error: error.error)
    assert worst.target.startswith("control/")
    assert worst.error > 0

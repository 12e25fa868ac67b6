"""Drivers on motion: every source, block by block, reports, and what costs nothing."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from support.cli import animtool

from animtool import Clip, Rig, open_source
from animtool.clip.keyed_take import fit_take_keys
from animtool.clip.sample import sample_values
from animtool.core.array_types import FloatArray
from animtool.core.clock import Clock
from animtool.core.errors import FormatError
from animtool.maths import so3
from animtool.motion.driver_run import DriverRun
from animtool.motion.driving import drive_stream, drive_take
from animtool.motion.motion import Channel, Motion
from animtool.motion.passes import PassContext, apply_pass, find_pass
from animtool.motion.take import Take, TakeStream
from animtool.rig.drivers import Driver
from animtool.rig.expressions import parse_expression
from animtool.rig.limits import BallLimit, RangeLimit
from animtool.rig.parts import Shape
from animtool.rig.skeleton import Joint, JointType

X, Z = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)
PIN, BALL = JointType.PIN, JointType.BALL


def expr(text: str) -> Driver:
    return Driver(parse_expression(text, allows_coordinates=True))


def rig(roll: str = "wrist.twist / 2", **own: object) -> Rig:
    joints = (
        Joint("elbow", -1, PIN, axis=Z),
        Joint("roll", 0, PIN, (0.1, 0, 0), axis=X, driven=expr(roll)),
        Joint("wrist", 0, BALL, (0.3, 0, 0), limits=BallLimit(twist_axis=X)),
    )
    shapes = (
        Shape("bulge", driven=expr("elbow.angle / 2")),
        Shape("own"),
        Shape("both", combine=("bulge", "own")),
    )
    made = Rig("arm", joints, shapes=shapes)
    changed = replace(joints[1], **own)  # type: ignore[arg-type]
    return replace(made, joints=(joints[0], changed, joints[2]))


def take_of(
    made: Rig, elbow: FloatArray, twist: FloatArray, weights: FloatArray | None = None
) -> Take:
    rotations = np.tile(so3.IDENTITY, (len(elbow), 3, 1))
    rotations[:, 0] = so3.from_axis_angle(Z, elbow)
    rotations[:, 2] = so3.from_axis_angle(X, twist)
    translations = np.repeat(made.rest_translations[None], len(elbow), axis=0)
    motion = Motion(
        Channel.from_dense(translations),
        Channel.from_dense(rotations),
        weights=None if weights is None else Channel.from_dense(weights),
    )
    clock = Clock(Fraction(24), Fraction(1), Fraction(1), len(elbow))
    return Take(made, clock, motion)


def rolls(take: Take, j: int = 1) -> FloatArray:
    turn = take.motion.rotations.dense()[:, j]
    return 2 * np.arctan2(turn[:, 0], turn[:, 3])


def weights(take: Take) -> FloatArray:
    assert take.motion.weights is not None
    return take.motion.weights.dense()[..., 0]


def test_captured_motion_is_driven() -> None:
    elbow, twist = np.linspace(0, 1, 9), np.linspace(-1, 1.2, 9)
    own = np.zeros((9, 3, 1))
    own[:, 1] = 0.5
    take = drive_take(take_of(rig(), elbow, twist, own))
    assert rolls(take) == pytest.approx(twist / 2)
    assert weights(take)[:, 0] == pytest.approx(elbow / 2)
    assert weights(take)[:, 2] == pytest.approx(elbow / 4)
    assert take.motion.controls is None


def test_to_drive_again_changes_nothing() -> None:
    own = np.random.default_rng(0).uniform(0, 1, (5, 3, 1))
    once = drive_take(take_of(rig(), np.linspace(0, 1, 5), np.linspace(0, 1, 5), own))
    twice = drive_take(once)
    assert np.array_equal(rolls(once), rolls(twice))
    assert np.abs(weights(once) - weights(twice)).max() < 1e-15


def test_a_rig_without_drivers_is_left_alone() -> None:
    made = rig()
    joints = tuple(replace(joint, driven=None) for joint in made.joints)
    plain = replace(made, joints=joints, shapes=())
    take = take_of(plain, np.zeros(3), np.ones(3))
    assert drive_take(take) is take
    stream = TakeStream.of(take)
    assert drive_stream(stream) is stream


@pytest.mark.parametrize("frames", [1, 4])
def test_what_does_not_move_is_stored_once(frames: int) -> None:
    made = rig()
    take = drive_take(take_of(made, np.full(frames, 0.4), np.full(frames, 0.6)))
    assert not len(take.motion.rotations.animated)
    assert not len(take.motion.weights.animated)  # type: ignore[union-attr]
    assert rolls(take) == pytest.approx([0.3] * frames)


def test_the_sign_of_quaternions_has_no_say() -> None:
    take = take_of(rig(), np.zeros(6), np.linspace(0, 2, 6))
    flipped = take.motion.rotations.dense()
    flipped[::2] *= -1
    motion = replace(take.motion, rotations=Channel.from_dense(flipped))
    assert rolls(drive_take(replace(take, motion=motion))) == pytest.approx(
        np.linspace(0, 1, 6)
    )


def test_blocks_are_driven_as_the_whole() -> None:
    spin = np.linspace(0, 14, 60)
    made = rig("elbow.angle / 4")
    whole = drive_take(take_of(made, spin, np.zeros(60)))
    assert np.unwrap(rolls(whole)) == pytest.approx(spin / 4)
    # A shape reads the same angle as the joint.
    assert weights(whole)[:, 0] == pytest.approx(spin / 2)
    take = take_of(made, spin, np.zeros(60))
    blocks = [take.motion.select(slice(at, at + 7)) for at in range(0, 60, 7)]
    stream = replace(TakeStream.of(take), blocks=iter(blocks))
    parts = drive_stream(stream).collect()
    for one, two in zip(
        whole.motion.dense()[:2], parts.motion.dense()[:2], strict=True
    ):
        assert np.abs(one - two).max() < 1e-14
    assert np.abs(weights(whole) - weights(parts)).max() < 1e-13


def test_limits_hold_and_are_reported_once() -> None:
    made = rig(limits=RangeLimit(-0.2, 0.3))
    take = take_of(made, np.zeros(5), np.array([0, 0.5, 1.0, 0.6, -0.5]))
    done = drive_take(take)
    assert rolls(done) == pytest.approx([0, 0.25, 0.3, 0.3, -0.2])
    (notice,) = done.notices
    assert notice.code == "RIG103"
    assert "frame 3" in notice.message
    assert f"{np.degrees(0.2):.4g}" in notice.message
    assert drive_take(done).notices == done.notices


def test_motion_of_a_source_is_replaced_and_reported_with_the_largest_difference() -> (
    None
):
    take = take_of(rig(), np.zeros(4), np.array([0, 0.2, 0.4, 0.6]))
    turns = take.motion.rotations.dense()
    turns[:, 1] = so3.from_axis_angle(X, np.array([0, 0.1, 0.7, 0.3]))
    given = replace(
        take, motion=replace(take.motion, rotations=Channel.from_dense(turns))
    )
    stream = drive_stream(TakeStream.of(given), reports_replaced=True)
    done = stream.collect()
    assert rolls(done) == pytest.approx([0, 0.1, 0.2, 0.3])
    (notice,) = stream.notices
    assert notice.code == "RIG104"
    assert f"{np.degrees(0.5):.4g}" in notice.message
    assert "frame 3" in notice.message
    # What stands at rest in a capture says nothing about the joint.
    quiet = drive_stream(TakeStream.of(take), reports_replaced=True)
    quiet.collect()
    assert quiet.notices == []


def test_a_twist_through_half_a_turn_is_reported() -> None:
    twist = np.array([3.0, 3.1, 3.3, 3.5])
    done = drive_take(take_of(rig(), np.zeros(4), twist))
    assert [notice.code for notice in done.notices] == ["RIG105"]
    assert "frame 3" in done.notices[0].message
    # Limits of the twist put the seam elsewhere.
    made = rig()
    limits = BallLimit(None, (1.0, 5.0), X)
    wrist = replace(made.joints[2], limits=limits)
    moved = replace(made, joints=(*made.joints[:2], wrist))
    done = drive_take(take_of(moved, np.zeros(4), twist))
    assert not done.notices
    assert rolls(done) == pytest.approx(twist / 2)


@pytest.mark.parametrize("roll", ["1 / elbow.angle", "log(elbow.angle)"])
def test_a_driver_without_a_value_is_an_error_with_the_frame(roll: str) -> None:
    for limits in (None, RangeLimit(-1, 1)):
        made = rig(roll, limits=limits)
        with pytest.raises(FormatError) as caught:
            drive_take(take_of(made, np.array([0.5, 0.2, 0, 0.1]), np.zeros(4)))
        (fault,) = caught.value.faults
        assert fault.code == "CLIP015"
        assert "'roll'" in fault.message
        assert "frame 3" in fault.message


def test_a_driver_may_be_a_number() -> None:
    made = rig("0.25")
    shape = replace(made.shapes[0], driven=expr("1 / 2"))
    made = replace(made, shapes=(shape, *made.shapes[1:]))
    motion = drive_take(take_of(made, np.zeros(3), np.zeros(3))).motion
    turns = so3.log(motion.rotations.dense()[:, 1])
    np.testing.assert_allclose(turns[:, 0], 0.25, atol=1e-12)
    assert motion.weights is not None
    np.testing.assert_array_equal(motion.weights.dense()[:, 0], 0.5)


def test_numbers_beyond_numbers_are_an_error_too() -> None:
    made = rig("exp(elbow.angle * 1e300)")
    with pytest.raises(FormatError) as caught:
        drive_take(take_of(made, np.array([0, 0.5]), np.zeros(2)))
    assert [fault.code for fault in caught.value.faults] == ["CLIP015"]


def test_passes_leave_what_is_driven_driven() -> None:
    take = drive_take(take_of(rig(), np.linspace(0, 1, 12), np.linspace(0, 2, 12)))
    pass_ = find_pass("time_scale")
    options = pass_.options(speed=0.7)
    context = PassContext(lambda _: take, Path())
    done = apply_pass(TakeStream.of(take), pass_, options, context).collect()
    wrist = done.motion.rotations.dense()[:, 2]
    twist = 2 * np.arctan2(wrist[:, 0], wrist[:, 3])
    assert rolls(done) == pytest.approx(twist / 2, abs=1e-12)


def test_keys_of_angles_count_whole_turns_at_any_time() -> None:
    made = rig("elbow.angle / 4")
    angles = np.array([[0.0], [7.0], [14.0]])
    times = np.array([1.0, 2.0, 3.0])
    whole = sample_values({"joint/elbow.angle": angles}, made, times).motion
    late = sample_values({"joint/elbow.angle": angles[2:]}, made, times[2:]).motion
    one, two = (motion.rotations.dense()[-1, 1] for motion in (whole, late))
    assert np.abs(one - two).max() < 1e-14
    assert 2 * np.arctan2(one[0], one[3]) == pytest.approx(3.5 - 2 * np.pi) or (
        np.abs(one @ so3.from_axis_angle(X, np.array([3.5]))[0]) == pytest.approx(1)
    )


def test_a_take_is_keyed_without_what_is_driven() -> None:
    made = rig()
    own = np.zeros((20, 3, 1))
    own[:, 1, 0] = np.linspace(0, 1, 20)
    take = drive_take(take_of(made, np.linspace(0, 1, 20), np.linspace(0, 1, 20), own))
    keyed = fit_take_keys(take, made, "arm", 1e-5)
    targets = {channel.target for channel in keyed.clip.channels}
    assert targets == {"joint/elbow.angle", "joint/wrist.rotation", "shape/own"}
    assert keyed.reduction.held
    assert keyed.reduction.weight_error < 1e-3


RIG = """\
rig: animtool/1
name: arm
units: {length: UNIT, angle: ANGLE}
up: UP
joints:
- {name: root, type: free}
- {name: wrist_l, parent: root, type: ball, translate: [1, 0, 0], mirror: wrist_r,
   limits: {twist_axis: [1, 0, 0]}}
- {name: roll_l, parent: root, type: pin, axis: [1, 0, 0], translate: [0.5, 0, 0],
   mirror: roll_r, driven: {expr: wrist_l.twist / 2 + wrist_l.swing_z * 0.1}}
- {name: post, type: prismatic, axis: [0, 0, 1], driven: {expr: wrist_l.twist * GAIN}}
"""
CLIP = """\
clip: animtool/1
rig: arm.rig.yaml
fps: 24
range: [1, 9]
channels:
- {target: joint/wrist_l.rotation,
   keys: [{t: 1, v: [1, 0, 0, 0]}, {t: 9, v: [0.8, 0.6, 0, 0]}]}
- {target: joint/wrist_r.rotation,
   keys: [{t: 1, v: [1, 0, 0, 0]}, {t: 9, v: [0.8, 0, 0, 0.6]}]}
"""


def written(folder: Path, length: str, angle: str, up: str, gain: float) -> None:
    text = RIG.replace("UNIT", length).replace("ANGLE", angle).replace("UP", up)
    (folder / "arm.rig.yaml").write_text(text.replace("GAIN", str(gain)), "utf-8")
    (folder / "arm.clip.yaml").write_text(CLIP, "utf-8")


@pytest.mark.parametrize(
    ("length", "angle", "up", "gain"),
    [("cm", "deg", "Z", 0.5), ("m", "rad", "Y", 0.005 * 180 / np.pi)],
)
def test_units_and_roots(
    tmp_path: Path, length: str, angle: str, up: str, gain: float
) -> None:
    written(tmp_path, length, angle, up, gain)
    take = open_source(tmp_path / "arm.clip.yaml").collect()
    made = take.rig
    full = 2 * np.arctan2(0.6, 0.8)
    assert rolls(take, made.index("roll_l"))[-1] == pytest.approx(full / 2)
    post = take.motion.translations.dense()[-1, made.index("post")]
    assert post == pytest.approx([0, 0, 0.005 * np.degrees(full)])


def test_mirrored_motion_drives_the_other_side(tmp_path: Path) -> None:
    written(tmp_path, "m", "deg", "Y", 0.0)
    (tmp_path / "other.scene.yaml").write_text(
        "scene: animtool/1\nsource: {file: arm.clip.yaml}\n"
        "passes: [mirror: {}]\noutput: [{file: other.usda}]\n",
        "utf-8",
    )
    for name in ("arm.clip.yaml", "other.scene.yaml"):
        done = animtool("bake", name, "-o", f"{name[:5]}.usda", cwd=tmp_path)
        assert done.code == 0, done.stderr
        assert "RIG104" not in done.stderr
    first, other = (
        open_source(tmp_path / f"{name}.usda").collect() for name in ("arm.c", "other")
    )
    made = first.rig
    for one, two in (("roll_l", "roll_r"), ("roll_r", "roll_l")):
        a = first.motion.rotations.dense()[:, made.index(one)]
        b = other.motion.rotations.dense()[:, made.index(two)]
        assert np.abs(a[:, 3]) == pytest.approx(np.abs(b[:, 3]), abs=1e-6)
    moved = first.motion.rotations.dense()[-1, made.index("roll_r")]
    assert abs(2 * np.arcsin(moved[0])) > 0.05


def test_runs_are_reported_by_target() -> None:
    made = rig(limits=RangeLimit(0, 0.1))
    run = DriverRun(made)
    take = take_of(made, np.zeros(2), np.array([0.0, 1.0]))
    run.evaluate(take.motion, np.array([5.0, 6.0]))
    ((fault, target, frame),) = run.located_notices()
    assert (fault.code, target, frame) == ("RIG103", "joint/roll", 6.0)


def test_a_clip_on_the_rig_is_driven(tmp_path: Path) -> None:
    written(tmp_path, "m", "deg", "Y", 0.0)
    made = Rig.load(tmp_path / "arm.rig.yaml")
    clip = Clip.load(tmp_path / "arm.clip.yaml")
    assert rolls(clip.sample(made), made.index("roll_l"))[-1] > 0.5

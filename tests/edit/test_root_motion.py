"""Root motion: the world stays, and the way back is exact."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from support.nasty import nasty_rig, nasty_take
from support.takes import assert_same_motion, assert_same_world, takes

from animtool.core.clock import Clock
from animtool.core.errors import OptionError
from animtool.core.units import UpAxis
from animtool.edit.root_motion import (
    PASS,
    RootMotionOptions,
    extract_root,
    recompose_root,
)
from animtool.edit.tree import insert_joint
from animtool.formats.bvh.read import read_bvh
from animtool.maths import so3
from animtool.motion.motion import Channel, Motion
from animtool.motion.passes import PassContext, apply_pass
from animtool.motion.take import Take, TakeStream
from animtool.rig.controls import Control, Drive
from animtool.rig.expressions import parse_expression
from animtool.rig.parts import IkChain
from animtool.rig.skeleton import Joint, Pose, Rig

AXES = st.sampled_from(["", "x", "xz", "xyz", "zy"])
WITHIN = 1e-9  # [m], a thousandth of what is promised


def static_root(take: Take) -> Take:
    """Return a take below a root joint that is somewhere and never moves."""
    whole = insert_joint(take, "root", 0)
    root = Joint("root", -1, translation=(0.5, 0.25, -1), rotation=(0, 0.6, 0, 0.8))
    rig = replace(whole.rig, joints=(root, *whole.rig.joints[1:]))
    motion = whole.motion
    for name, values in (
        ("translations", rig.rest_translations),
        ("rotations", rig.rest_rotations),
    ):
        channel = getattr(motion, name)
        rest = channel.rest.copy()
        rest[0] = values[0]
        motion = replace(motion, **{name: replace(channel, rest=rest)})
    return replace(whole, rig=rig, motion=motion)


@given(takes(), AXES, st.booleans())
def test_a_new_root_leaves_the_world_and_comes_off_again(
    take: Take, axes: str, yaw: bool
) -> None:
    found = extract_root(take, axes=axes, yaw=yaw)
    assert_same_world(found, take, WITHIN)
    back = recompose_root(found)
    assert back.rig == take.rig
    assert_same_motion(back, take, WITHIN)


@given(takes(), AXES, st.booleans())
def test_a_root_of_the_rig_leaves_the_world_and_comes_to_rest(
    take: Take, axes: str, yaw: bool
) -> None:
    source = static_root(take)
    found = extract_root(source, axes=axes, yaw=yaw)
    assert found.rig == source.rig
    world, before = found.world(), source.world()
    assert np.abs(world.positions - before.positions)[:, 1:].max() < WITHIN
    assert np.abs(world.linear - before.linear)[:, 1:].max() < WITHIN
    back = recompose_root(found, keep=True)
    assert back.rig == source.rig
    assert_same_world(back, source, WITHIN)


@given(takes(uniform=True), st.booleans(), st.data())
def test_any_joint_can_be_the_root(take: Take, yaw: bool, data: st.DataObject) -> None:
    inner = sorted(set(take.rig.parents.tolist()) - {-1})
    assume(inner)
    root = take.rig.names[data.draw(st.sampled_from(inner))]
    found = extract_root(take, root, "xyz", yaw=yaw)
    below = [j for j in range(len(take.rig.joints)) if take.rig.names[j] != root]
    world, before = found.world(), take.world()
    assert np.abs(world.positions - before.positions)[:, below].max() < WITHIN
    gone = recompose_root(found, root)
    assert root not in gone.rig.names
    assert_same_world(gone, _without(take, root), WITHIN)


def _without(take: Take, root: str) -> Take:
    return recompose_root(take, root)


def test_the_root_goes_over_the_ground_with_the_hips(walk: Path) -> None:
    take = read_bvh(walk).collect()
    found = extract_root(take).world().positions
    hips = take.world().positions[:, 0]
    np.testing.assert_allclose(found[:, 0, [0, 2]], hips[:, [0, 2]], atol=1e-12)
    assert np.abs(found[:, 0, 1]).max() < 1e-12


def test_the_root_that_is_there_goes_with_the_joint_that_travels(walk: Path) -> None:
    take = static_root(read_bvh(walk).collect())
    found = extract_root(take, yaw=False)
    positions = found.world().positions
    hips = take.world().positions[:, 1]
    np.testing.assert_allclose(positions[:, 0, [0, 2]], hips[:, [0, 2]], atol=1e-12)
    np.testing.assert_allclose(positions[:, 0, 1], 0.25, atol=1e-12)


def test_a_root_turns_about_the_up_axis_only() -> None:
    take = upright(UpAxis.Z)
    turn = extract_root(take).motion.rotations.dense()[:, 0]
    np.testing.assert_allclose(turn[:, :2], 0, atol=1e-12)
    assert so3.angle_between(turn[0], turn[-1]) > 0.5


def upright(up: UpAxis, frames: int = 9) -> Take:
    """Return hips that turn about the up axis while they lean."""
    from fractions import Fraction

    from animtool.core.clock import Clock
    from animtool.motion.motion import Motion

    rig = Rig("one", (Joint("hips", -1), Joint("chest", 0)), up=up)
    yaw = np.linspace(0, 1, frames)[:, None, None] * np.array(up.vector)
    lean = so3.exp(np.full((frames, 1, 3), [0.2, 0, 0]))
    turns = so3.multiply(so3.exp(yaw), lean)
    turns = np.concatenate([turns, np.tile(so3.IDENTITY, (frames, 1, 1))], axis=1)
    motion = Motion(
        Channel.from_dense(np.zeros((frames, 2, 3))), Channel.from_dense(turns)
    )
    return Take(rig, Clock(Fraction(24), Fraction(1), Fraction(1), frames), motion)


def sheared(scale: tuple[float, float, float] = (1, 2, 3)) -> Take:
    """Return a take whose hips are scaled by axis."""
    take = upright(UpAxis.Y)
    scales = np.ones((take.clock.count, 2, 3))
    scales[:, 0] = scale
    return replace(take, motion=replace(take.motion, scales=Channel.from_dense(scales)))


def sunken() -> Take:
    """Return a take whose hips have no size."""
    return sheared((0, 0, 0))


def test_what_cannot_be_a_root() -> None:
    take = upright(UpAxis.Y)
    chain = replace(take.rig, chains=(IkChain("leg", "hips", "chest"),))
    cases = [
        (lambda: extract_root(take, axes="w"), "SCN020"),
        (lambda: extract_root(take, hips="knee"), "SCN012"),
        (lambda: extract_root(take, "chest", hips="hips"), "SCN020"),
        (lambda: extract_root(take, "chest"), "SCN020"),
        (lambda: extract_root(sunken(), "root", hips="chest"), "SCN020"),
        (lambda: recompose_root(take), "SCN012"),
        (lambda: recompose_root(take, "chest"), "SCN020"),
        (lambda: recompose_root(replace(take, rig=chain), "hips"), "SCN020"),
        (lambda: recompose_root(sheared(), "hips"), "SCN020"),
    ]
    for run, code in cases:
        with pytest.raises(OptionError) as error:
            run()
        assert error.value.code == code


def test_a_root_below_its_hips_says_what_to_write() -> None:
    take = upright(UpAxis.Y)
    with pytest.raises(OptionError) as caught:
        extract_root(take, "chest", hips="hips")
    (fault,) = caught.value.faults
    assert (fault.code, fault.hint) == ("SCN020", 'write root="hips", hips="chest"')
    with pytest.raises(OptionError) as caught:
        extract_root(take, hips="pelvis")
    (fault,) = caught.value.faults
    assert (fault.code, fault.hint) == ("SCN012", "the joint of the pelvis is 'hips'")


def test_a_joint_that_a_control_moves_stays_whatever_its_name() -> None:
    take = upright(UpAxis.Y)
    hips, chest = take.rig.joints
    drive = Drive("joint/hips.l.rotation.x", parse_expression("sway"))
    rig = replace(
        take.rig,
        joints=(replace(hips, name="hips.l"), chest),
        controls=(Control("sway", drives=(drive,)),),
    )
    with pytest.raises(OptionError) as error:
        recompose_root(replace(take, rig=rig), "hips.l")
    assert error.value.code == "SCN020"
    assert "refer to 'hips.l'" in str(error.value)


def test_bind_poses_follow_a_joint_that_goes() -> None:
    take = upright(UpAxis.Y)
    still = (0.0, 0.0, 0.0, 1.0)
    bind = {"hips": Pose((0, 1, 0), still), "chest": Pose((0, 2, 0), still)}
    back = recompose_root(replace(take, rig=replace(take.rig, bind=bind)), "hips")
    assert back.rig.bind == {"chest": Pose((0.0, 3.0, 0.0), still)}


def test_yaw_is_measured_from_hips_that_rest_turned() -> None:
    rig = nasty_rig()
    yaw = np.linspace(0, 2, 9)
    turn = so3.exp(yaw[:, None] * np.array(rig.up.vector))
    take = nasty_take(9)
    rotations = take.motion.rotations.dense()
    rotations[:, 0] = so3.multiply(turn, rig.rest_rotations[0])
    motion = replace(
        take.motion, rotations=Channel.from_dense(so3.align_signs(rotations))
    )
    take = replace(take, motion=motion)
    found = extract_root(take)
    own = found.motion.rotations.dense()[:, found.rig.index("root")]
    assert so3.angle_between(own, turn).max() < 1e-9
    assert_same_world(found, take, WITHIN)
    back = recompose_root(found)
    assert back.rig == rig
    assert_same_motion(back, take, WITHIN)


def test_what_does_not_turn_is_stored_once(walk: Path) -> None:
    found = extract_root(read_bvh(walk).collect(), axes="xz", yaw=False)
    root = found.rig.index("root")
    assert root in found.motion.translations.animated
    assert root not in found.motion.rotations.animated


def test_a_root_that_rests_turned_keeps_that_and_the_yaw() -> None:
    """Of a rig that stands up by its root: 90 degrees about x, then the yaw of 40."""
    up = so3.from_axis_angle(np.array([1.0, 0.0, 0.0]), np.pi / 2)
    yaw = so3.from_axis_angle(np.array([0.0, 1.0, 0.0]), np.radians(40.0))
    joints = (
        Joint("root", -1, rotation=tuple(up.tolist())),
        Joint("hips", 0, translation=(0.0, 0.0, -1.0)),
    )
    turns = np.tile(so3.IDENTITY, (2, 2, 1))
    turns[:, 0] = up
    # In the world the hips turn by the yaw.
    turns[1, 1] = so3.multiply(so3.conjugate(up), so3.multiply(yaw, up))
    moves = np.tile([joint.translation for joint in joints], (2, 1, 1))
    moves[1, 1] += [0.5, 0.25, 0.0]
    motion = Motion(Channel.from_dense(moves), Channel.from_dense(turns))
    clock = Clock(Fraction(30), Fraction(1), Fraction(1), 2)
    found = extract_root(Take(Rig("two", joints), clock, motion), "root", hips="hips")
    made = found.motion.rotations.dense()[:, 0]
    assert so3.angle_between(made[0], up) < 1e-9
    assert so3.angle_between(made[1], so3.multiply(yaw, up)) < 1e-9
    places = found.motion.translations.dense()[:, 0]
    assert np.abs(places - [[0, 0, 0], [0.5, 0, 0.25]]).max() < 1e-9


def test_a_root_below_a_joint_that_stands_off_and_turned_goes_where_the_hips_are() -> (
    None
):
    """Along x and z; up it stays where it was. The stage is turned by 90 degrees."""
    half = 0.5**0.5
    rig = Rig(
        "staged",
        (
            Joint("stage", -1, translation=(1.0, 2, 3), rotation=(0, half, 0, half)),
            Joint("root", 0, translation=(0.0, 0.5, 0.0)),
            Joint("hips", 1, translation=(0.0, 1.0, 0.0)),
        ),
    )
    places = np.tile(rig.rest_translations, (4, 1, 1))
    places[:, 2] += np.array([1.0, 0.25, -2.0]) * np.arange(4)[:, None]
    turns = np.tile(rig.rest_rotations, (4, 1, 1))
    motion = Motion(Channel.from_dense(places), Channel.from_dense(turns))
    clock = Clock(Fraction(24), Fraction(1), Fraction(1), 4)
    take = Take(rig, clock, motion)
    found = extract_root(take, "root", hips="hips")
    world, after = take.world().positions, found.world().positions
    np.testing.assert_allclose(after[:, [0, 2]], world[:, [0, 2]], atol=1e-12)
    root = after[:, 1]
    np.testing.assert_allclose(root[:, [0, 2]], world[:, 2][:, [0, 2]], atol=1e-12)
    np.testing.assert_allclose(root[:, 1], 2.5, atol=1e-12)


@pytest.mark.parametrize(
    ("axes", "travel", "up", "found"),
    [
        ("xy", (0.0, 0.0, 2.0), UpAxis.Y, True),
        ("XZ", (0.1, 2.0, 0.0), UpAxis.Z, True),
        ("xz", (0.0, 0.0, 2.0), UpAxis.Y, False),
        ("", (0.0, 0.0, 2.0), UpAxis.Y, False),
        ("xy", (2.0, 0.0, 0.1), UpAxis.Y, False),  # a side-scroller
        ("xy", (0.0, 0.0, 0.1), UpAxis.Y, False),  # in place
        ("y", (0.0, 0.0, 2.0), UpAxis.Y, False),  # the height alone
    ],
)
def test_axes_of_another_up_axis(
    axes: str, travel: tuple[float, float, float], up: UpAxis, found: bool
) -> None:
    rig = Rig(
        "one", (Joint("hips", -1), Joint("head", 0, translation=(0, 1, 0))), up=up
    )
    positions = np.tile(rig.rest_translations, (9, 1, 1))
    positions[:, 0] += np.linspace(0, 1, 9)[:, None] * np.array(travel)
    rotations = Channel.from_dense(np.tile(so3.IDENTITY, (9, 2, 1)))
    clock = Clock(Fraction(24), Fraction(1), Fraction(1), 9)
    take = Take(rig, clock, Motion(Channel.from_dense(positions), rotations))
    context = PassContext(lambda _: take, Path())
    options = RootMotionOptions(axes=axes)
    apply_pass(TakeStream.of(take), PASS, options, context)
    codes = [notice.code for notice in context.notices]
    assert codes == ["SCN121"] * found


def test_a_root_at_the_end_of_a_chain_is_told_what_a_root_is() -> None:
    take = upright(UpAxis.Y)
    with pytest.raises(OptionError) as error:
        extract_root(take, take.rig.names[-1])
    (fault,) = error.value.faults
    assert fault.code == "SCN020"
    assert 'root="root" is added above' in (fault.hint or "")

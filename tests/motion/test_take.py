"""Takes, whole and in blocks."""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from support.faults import raises

from animtool.core.array_types import FloatArray
from animtool.core.clock import Clock
from animtool.core.errors import AnimtoolError, Fault, OptionError
from animtool.formats.bvh.read import read_bvh
from animtool.maths import so3
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import Take, TakeStream
from animtool.rig.kinematics import forward_kinematics
from animtool.rig.skeleton import Joint, Rig

ARM = Rig("arm", (Joint("a", -1), Joint("b", 0, translation=(0.0, 2.0, 0.0))))


def dense_motion(frames: int = 5, **others: FloatArray) -> Motion:
    rng = np.random.default_rng(1)
    values = {
        "translations": rng.normal(size=(frames, 2, 3)),
        "rotations": so3.align_signs(so3.normalize(rng.normal(size=(frames, 2, 4)))),
        **others,
    }
    return Motion(**{name: Channel.from_dense(v) for name, v in values.items()})


def take_of(motion: Motion, count: int = 5, rig: Rig = ARM) -> Take:
    return Take(rig, Clock(Fraction(24), Fraction(1), Fraction(1), count), motion)


def test_the_world_of_a_take() -> None:
    take = take_of(dense_motion())
    world = take.world()
    translations, rotations, _ = take.motion.dense()
    assert_array_equal(
        world.positions, forward_kinematics(ARM, *take.motion.dense()).positions
    )
    whole = so3.multiply(rotations[:, 0], rotations[:, 1])
    assert_allclose(so3.angle_between(world.rotations[:, 1], whole), 0, atol=1e-7)
    assert (np.sum(world.rotations[1:] * world.rotations[:-1], axis=-1) >= 0).all()
    assert_allclose(world.scales, 1.0)
    expected = translations[:, 0] + so3.rotate(rotations[:, 0], translations[:, 1])
    assert_allclose(world.positions[:, 1], expected, atol=1e-12)


def test_scales_of_the_world() -> None:
    scales = np.ones((5, 2, 3))
    scales[:, 0] = 2.0
    scales[:, 1] = [1.0, 3.0, 0.5]
    world = take_of(dense_motion(scales=scales)).world()
    assert_allclose(world.scales[:, 1], np.tile([2.0, 6.0, 1.0], (5, 1)))
    plain = take_of(dense_motion()).world()
    assert_allclose(so3.angle_between(world.rotations, plain.rotations), 0, atol=1e-7)


def wrong(**parts: Any) -> Motion:
    motion = dense_motion()
    return replace(motion, rotations=replace(motion.rotations, **parts))


@pytest.mark.parametrize(
    ("motion", "count", "codes"),
    [
        (dense_motion(), 6, ["TAKE001"] * 2),
        (dense_motion(rotations=np.ones((5, 3, 4))), 5, ["TAKE001"]),
        (dense_motion(rotations=np.ones((5, 2, 3))), 5, ["TAKE001"] * 2),
        (dense_motion(translations=np.ones((4, 2, 3))), 5, ["TAKE001"]),
        (dense_motion(weights=np.ones((5, 1, 1))), 5, ["TAKE001"]),
        (wrong(values=np.ones((5, 1, 4))), 5, ["TAKE001"]),
        (wrong(animated=np.array([1, 0])), 5, ["TAKE002"]),
        (wrong(animated=np.array([0, 2])), 5, ["TAKE002"]),
        (wrong(animated=np.array([-1, 0])), 5, ["TAKE002"]),
    ],
)
def test_a_take_that_does_not_fit(motion: Motion, count: int, codes: list[str]) -> None:
    with pytest.raises(AnimtoolError) as caught:
        take_of(motion, count)
    assert [fault.code for fault in caught.value.faults] == codes


def test_notices_stay_with_a_take() -> None:
    note = Fault("RIG217", "small")
    take = replace(take_of(dense_motion()), notices=(note,))
    assert TakeStream.of(take).collect().notices == (note,)


def test_what_is_long_has_a_short_repr(walk: Path) -> None:
    take = read_bvh(walk).collect()
    world = take.world()
    for prop in (take, take.rig, take.motion, take.motion.rotations, world):
        assert "\n" not in repr(prop)
        assert len(repr(prop)) < 120
    assert repr(take) == "<Take of 'walk': 64 frames from 1 to 64 at 30 fps, 21 joints>"


def values_of(wrong: str) -> Motion:
    """Return two joints over three frames, the second at fault in the second."""
    turns = np.tile(so3.IDENTITY, (3, 2, 1))
    slides = np.arange(18.0).reshape(3, 2, 3)
    if wrong == "half":
        turns = turns.astype(np.float16) + np.float16(5e-4)
    elif wrong in {"nan", "inf"}:
        slides[1, 1, 0] = float(wrong)
    else:
        turns[1, 1] *= float(wrong)
    return Motion(Channel.from_dense(slides), Channel.from_dense(turns))


@pytest.mark.parametrize(
    ("wrong", "code", "words"),
    [
        ("nan", "TAKE004", "translations: joint 'b' at frame 2"),
        ("inf", "TAKE004", "translations: joint 'b' at frame 2"),
        ("0", "TAKE005", "rotations: joint 'b' at frame 2"),
        ("2", "TAKE005", "rotations: joint 'b' at frame 2"),
    ],
)
def test_a_take_with_no_numbers_or_no_rotations_is_refused(
    wrong: str, code: str, words: str
) -> None:
    rig = Rig("arm", (Joint("a", -1), Joint("b", 0)))
    clock = Clock(Fraction(24), Fraction(1), Fraction(1), 3)
    with pytest.raises(OptionError) as caught:
        Take(rig, clock, values_of(wrong))
    [fault] = caught.value.faults
    assert fault.code == code
    assert words in fault.message


def test_a_still_joint_with_no_rotation_is_refused() -> None:
    rig = Rig("arm", (Joint("a", -1), Joint("b", 0)))
    clock = Clock(Fraction(24), Fraction(1), Fraction(1), 3)
    still = np.zeros((3, 2, 4))
    motion = Motion(Channel.from_dense(np.zeros((3, 2, 3))), Channel.from_dense(still))
    with raises(OptionError, "TAKE005", match="'a'"):
        Take(rig, clock, motion)


def test_rotations_of_half_precision_are_a_take() -> None:
    rig = Rig("arm", (Joint("a", -1), Joint("b", 0)))
    clock = Clock(Fraction(24), Fraction(1), Fraction(1), 3)
    assert Take(rig, clock, values_of("half")).motion.frames == 3


def test_a_take_is_as_long_as_its_frames() -> None:
    rig = Rig("point", (Joint("a", -1),))
    clock = Clock(Fraction(30), Fraction(1), Fraction(1, 2), 3)
    still = Motion(
        Channel.from_dense(np.zeros((3, 1, 3))),
        Channel.from_dense(np.tile([0.0, 0.0, 0.0, 1.0], (3, 1, 1))),
    )
    take = Take(rig, clock, still)
    assert (len(take), take.fps, bool(take)) == (3, 30, True)


def test_streams_say_how_attributes_of_takes_are_reached() -> None:
    stream = TakeStream.of(take_of(dense_motion()))
    for name in ("world", "motion", "clock"):
        with pytest.raises(AttributeError, match=r"collect\(\)"):
            getattr(stream, name)
    with pytest.raises(AttributeError) as raised:
        _ = stream.unknown  # type: ignore[attr-defined]
    assert "collect" not in str(raised.value)
    assert copy(stream).rig is stream.rig


def test_a_motion_of_another_rig_or_length_says_what_to_do() -> None:
    motion = dense_motion()
    frames, joints = motion.frames, len(motion.translations.rest)
    longer = Rig("long", tuple(Joint(f"j{i}", i - 1) for i in range(joints + 3)))
    rig = Rig("short", longer.joints[:joints])
    for other, count, hint in (
        (longer, frames, "retarget_take moves a take"),
        (rig, frames + 1, f"write count={frames}"),
    ):
        with pytest.raises(OptionError) as caught:
            Take(other, Clock(24, 1, 1, count), motion)
        assert all(hint in (fault.hint or "") for fault in caught.value.faults)

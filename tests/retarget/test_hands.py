"""Hands that keep their contacts on other arms."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from animtool import Channel, Motion, Rig, Take, open_source
from animtool.core.array_types import FloatArray
from animtool.maths import so3
from animtool.motion.passes import PassContext, apply_pass, find_pass
from animtool.motion.take import TakeStream
from animtool.motion.transforms import Track, Transforms
from animtool.retarget import Retargeted, map_joints, retarget_take
from animtool.retarget.hands import (
    AnkleHeights,
    _are_hands_joined,
    _arm_length,
    _shift_into_reach,
    _soften_heights,
    arm_joints,
    elbow_hinge,
)
from animtool.rig.write import rig_text

FRAMES = 90


def longer(rig: Rig, share: float) -> Rig:
    """Return a rig with arms of another length."""
    joints = tuple(
        replace(
            joint, translation=tuple((share * np.array(joint.translation)).tolist())
        )
        if joint.name.endswith(("ForeArm", "Hand"))
        else joint
        for joint in rig.joints
    )
    return replace(rig, joints=joints)


def still(take: Take) -> tuple[FloatArray, FloatArray]:
    """Return the rest pose over frames, its feet on the ground."""
    rig = take.rig
    places = np.repeat(rig.rest_translations[None], FRAMES, axis=0)
    turns = np.repeat(rig.rest_rotations[None], FRAMES, axis=0)
    places[:, 0, 1] = 0.98
    return places, turns


def as_take(take: Take, places: FloatArray, turns: FloatArray) -> Take:
    channels = Channel.from_dense(places), Channel.from_dense(so3.align_signs(turns))
    clock = replace(take.clock, count=FRAMES)
    return replace(take, clock=clock, motion=Motion(*channels))


@pytest.fixture(scope="module")
def person(root: Path) -> Take:
    return open_source(root / "samples/walk/walk.bvh").collect()


@pytest.fixture(scope="module")
def clasp(person: Take) -> Take:
    """Who takes one hand in the other before the chest, turns, and lets go."""
    rig = person.rig
    places, turns = still(person)
    t = np.arange(FRAMES) / (FRAMES - 1)
    closed = np.clip(4 * np.minimum(t, 1 - t) - 0.2, 0, 0.8) / 0.8
    closed = closed**2 * (3 - 2 * closed)
    sway = 0.3 * np.sin(2 * np.pi * t)
    up = np.array([0.0, 1.0, 0.0])
    turns[:, rig.index("Spine")] = so3.from_axis_angle(up, sway)
    inwards = np.arcsin(0.14 / 0.255)
    for name, sign in (("Left", -1.0), ("Right", 1.0)):
        arm = so3.from_axis_angle(up, sign * closed * np.pi / 2)
        turns[:, rig.index(f"{name}Arm")] = arm
        elbow = so3.from_axis_angle(up, sign * closed * inwards)
        turns[:, rig.index(f"{name}ForeArm")] = elbow
    return as_take(person, places, turns)


def onto(take: Take, rig: Rig, *, hands: bool) -> Retargeted:
    return retarget_take(take, rig, map_joints(take.rig, rig), hands=hands)


def wrists(take: Take) -> tuple[FloatArray, FloatArray]:
    places = take.world().positions
    left, right = (places[:, take.rig.index(f"{s}Hand")] for s in ("Left", "Right"))
    return left, right


@pytest.mark.parametrize("share", [0.6, 1.4])
def test_hands_that_hold_each_other(clasp: Take, share: float) -> None:
    rig = longer(clasp.rig, share)
    free, made = (onto(clasp, rig, hands=hands) for hands in (False, True))
    held = made.standing.hands[0].is_active
    assert held[30:60].all()
    assert not held[[0, -1]].any()
    source = np.subtract(*wrists(clasp))
    found = np.subtract(*wrists(made.take))
    assert_allclose(found[held], share * source[held], atol=1e-4)
    loose = np.subtract(*wrists(free.take)) - share * source
    assert np.linalg.norm(loose[held], axis=1).min() > 0.05
    assert made.report.hand_error < 1e-4
    assert made.report.acceleration < 1.15 * free.report.acceleration


def test_who_holds_nothing_moves_as_before(person: Take) -> None:
    rig = longer(person.rig, 1.4)
    free, made = (onto(person, rig, hands=hands) for hands in (False, True))
    assert_allclose(
        made.take.motion.rotations.dense(), free.take.motion.rotations.dense()
    )


def test_a_copy_of_the_skeleton_holds_hands_as_the_source(clasp: Take) -> None:
    made = onto(clasp, clasp.rig, hands=True)
    assert_allclose(made.world.positions, clasp.world().positions, atol=1e-9)


def test_hands_that_stand_on_the_ground(person: Take) -> None:
    """Who is on hands and knees, and sways to and fro."""
    rig, side = person.rig, np.array([1.0, 0.0, 0.0])
    places, turns = still(person)
    t = np.arange(FRAMES) / (FRAMES - 1)
    turns[:, 0] = so3.from_axis_angle(side, np.pi / 2)
    places[:, 0, 1] = 0.64
    places[:, 0, 2] = 0.03 * np.sin(2 * np.pi * t)
    for name, sign in (("Left", -1.0), ("Right", 1.0)):
        hanging = so3.shortest_rotation(
            np.array([-sign, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
        )
        turns[:, rig.index(f"{name}Arm")] = hanging
        turns[:, rig.index(f"{name}UpLeg")] = so3.from_axis_angle(side, -np.pi / 2)
        turns[:, rig.index(f"{name}Leg")] = so3.from_axis_angle(side, np.pi / 2)
    take = as_take(person, places, turns)
    made = onto(take, longer(rig, 1.25), hands=True)
    for wrist, source in zip(wrists(made.take), wrists(take), strict=True):
        assert np.ptp(wrist, axis=0).max() < 1e-6
        assert_allclose(wrist[:, 1], source[:, 1], atol=1e-6)
    assert made.report.hand_error < 1e-6
    # Arms that are too short are as long as they can be, and the report says so.
    short = onto(take, longer(rig, 0.8), hands=True).report
    assert short.hand_error == pytest.approx(0.2 * 0.545, abs=0.01)


def test_hands_that_carry_a_prop(person: Take, tmp_path: Path) -> None:
    """A tray before the chest, in both hands, that goes up and forwards and turns."""
    rig, up = person.rig, np.array([0.0, 1.0, 0.0])
    places, turns = still(person)
    t = np.arange(FRAMES) / (FRAMES - 1)
    places[:, 0, 2] = t
    turns[:, 0] = so3.from_axis_angle(up, 0.5 * t)
    for name, sign in (("Left", -1.0), ("Right", 1.0)):
        arm = so3.from_axis_angle(up, sign * np.pi / 2 * np.ones(FRAMES))
        turns[:, rig.index(f"{name}Arm")] = arm
        bend = so3.from_axis_angle(up, sign * 0.3 * np.ones(FRAMES))
        turns[:, rig.index(f"{name}ForeArm")] = bend
    take = as_take(person, places, turns)
    left, right = wrists(take)
    way = (left + right) / 2

    def sample(times: FloatArray) -> Transforms:
        frames = times.astype(int)
        return Transforms(way[frames], turns[frames, 0], np.ones((len(frames), 3)))

    tray = Track("Props/tray", sample)
    shelf = Track("Props/shelf", lambda times: sample(times * 0), is_animated=False)
    times = np.stack([np.arange(FRAMES)] * 2, axis=1)[..., None].astype(float)
    motion = replace(take.motion, track_times=Channel.from_dense(times))
    take = replace(take, motion=motion, tracks=(tray, shelf))
    target = tmp_path / "ape.rig.yaml"
    target.write_text(rig_text(longer(rig, 1.25)), "utf-8")
    own = find_pass("retarget")
    context = PassContext(open_source, Path())
    made = apply_pass(
        TakeStream.of(take), own, own.options(rig=target, hold_hands=True), context
    ).collect()
    frames = np.arange(FRAMES, dtype=np.float64)
    moved, put = (track.at(frames) for track in made.tracks)
    assert_allclose(put.translations, shelf.at(frames).translations)
    for source, wrist in zip((left, right), wrists(made), strict=True):
        before = so3.rotate(so3.conjugate(turns[:, 0]), source - way)
        after = so3.rotate(so3.conjugate(moved.rotations), wrist - moved.translations)
        assert_allclose(after, before, atol=1e-6)


def test_the_ground_is_reached_softly() -> None:
    """A parabola from 20 cm below to 20 cm above, where it has the slope of 1."""
    found = _soften_heights(np.array([-0.5, -0.2, 0.0, 0.1, 0.2]), 0.2)
    assert_allclose(found, [0, 0, 0.05, 0.1125, 0.2])


def test_both_hands_come_nearer_by_what_one_of_them_lacks() -> None:
    """The first is 0.5 beyond; the other, near its shoulder, goes along."""
    starts = [np.zeros((2, 3)), np.array([[0.0, 1, 0]] * 2)]
    goals = [np.array([[1.5, 0, 0], [0.5, 0, 0]]), np.array([[0.5, 1.0, 0]] * 2)]
    found = _shift_into_reach(goals, starts, [1.0, 2.0])
    assert_allclose(found[0], [[1, 0, 0], [0.5, 0, 0]])
    assert_allclose(found[1], [[0, 1, 0], [0.5, 1, 0]], atol=1e-12)
    # Where both pull, what they hold stays as wide: 0.3 of the shoulders' 2.4 apart.
    starts = [np.zeros((1, 3)), np.array([[2.4, 0.0, 0]])]
    pair = [np.array([[1.3, 0, 0]]), np.array([[1.6, 0.0, 0]])]
    first, last = _shift_into_reach(pair, starts, [1.1, 1.1])
    assert_allclose(last - first, [[0.3, 0, 0]], atol=1e-9)
    assert first[0, 0] == pytest.approx(1.1, abs=1e-5)


@pytest.mark.parametrize(
    ("apart", "speed", "held"),
    [(0.19, 0.0, True), (0.21, 0.0, False), (0.1, 0.12, True), (0.1, 0.13, False)],
)
def test_hands_hold_each_other_who_are_near_and_go_one_way(
    apart: float, speed: float, held: bool
) -> None:
    """Nearer than 0.4 of an arm of half a metre, slower than 0.25 of it a second."""
    frames = np.arange(60) - 30
    ways = np.stack([np.full(60, apart), speed * frames / 60, 0.0 * frames], axis=1)
    found = _are_hands_joined(ways, 0.5, 60.0)
    assert found[25:35].all() == held
    assert not _are_hands_joined(ways[:2], 0.5, 60.0).any()
    assert not _are_hands_joined(ways, 0.0, 60.0).any()


def test_arms_are_as_long_as_their_bones_and_bend_across_them() -> None:
    """Of 0.3 and 0.4 m at an angle; of one who looks along z, about the way down."""
    places = np.array([[0.0, 1, 0], [0.3, 1, 0], [0.3, 0.6, 0]])
    turn = so3.exp(np.array([0.0, 0, 0.5]))
    names = {"upper_arm_l": 0, "forearm_l": 1, "hand_l": 2}
    arm = SimpleNamespace(
        first_joint=lambda role: names.get(role, -1),
        positions=places,
        bone_direction=lambda _: np.array([0.3, 0.0, 0.0]),
        facing_axes=np.eye(3)[[2, 1, 0]],
        rotations=np.array([so3.IDENTITY, turn, so3.IDENTITY]),
    )
    person: Any = arm
    assert arm_joints(person, "l") == [0, 1, 2]
    assert arm_joints(person, "r") is None
    assert _arm_length(person, "l") == pytest.approx(0.7)
    assert _arm_length(person, "r") == 0
    axis = so3.rotate(turn, elbow_hinge(person, [0, 1, 2]))
    assert_allclose(axis, [0, 0, -1], atol=1e-12)


def test_what_is_scaled_is_lifted_to_the_ground_along_the_up_axis() -> None:
    floor = AnkleHeights(source=0.08, target=0.1)
    assert_allclose(AnkleHeights.ground_offset(floor, 0.5, 2), [0, 0, 0.06])
    assert not AnkleHeights.ground_offset(None, 0.5, 2).any()

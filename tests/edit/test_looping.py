"""Loops: nothing jumps at the seam, and the character goes on."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.gaits import gait, swinging
from support.nasty import nasty_take, nasty_track, with_track
from support.takes import assert_same_motion, rigs

from animtool.core.array_types import FloatArray
from animtool.core.clock import Clock
from animtool.core.errors import OptionError
from animtool.edit.looping import PASS, LoopOptions, loop
from animtool.edit.travel import twist
from animtool.edit.tree import inserted
from animtool.formats.bvh.read import read_bvh
from animtool.maths import so3
from animtool.motion.motion import Channel, Motion
from animtool.motion.passes import PassContext
from animtool.motion.take import Take
from animtool.rig.parts import Shape
from animtool.rig.skeleton import Joint, JointType, Rig


def test_the_seam_is_no_step(walk: Path) -> None:
    take = read_bvh(walk).collect()
    found = loop(take, repeats=3)
    count = take.clock.count - 1
    assert found.clock.count == 3 * count
    world = found.world().positions
    steps = np.linalg.norm(np.diff(world, axis=0), axis=-1).max(axis=1)
    seams = steps[[count - 1, 2 * count - 1]]
    assert seams.max() <= 1.1 * np.delete(steps, [count - 1, 2 * count - 1]).max()


def turned_steps(take: Take) -> FloatArray:
    """Return rotation vectors from frame to frame ``(F - 1, J, 3)``."""
    turns = take.motion.rotations.dense()
    return so3.log(so3.multiply(so3.conjugate(turns[:-1]), turns[1:]))


def jumps(steps: FloatArray) -> FloatArray:
    """Return the changes of speed from step to step, the largest of any joint."""
    return np.linalg.norm(np.diff(steps, axis=0), axis=-1).max(axis=1)


@given(
    st.floats(0.55, 1.0),
    st.floats(0, 6),
    st.floats(0, 2),
    st.integers(8, 16),
    st.sampled_from([(0, 0), (1, 0), (0, 1), (3, 3)]),
)
def test_speed_does_not_jump_at_the_seam(
    part: float, phase: float, yaw: float, blend: int, around: tuple[int, int]
) -> None:
    length, (before, behind) = 50, around
    count = before + length + 1 + behind
    take = swinging(gait(count, length / part, phase), yaw=yaw)
    first = 101 + before
    found = loop(take, first, first + length, repeats=2, blend=blend)
    for steps, source in (
        (turned_steps(found), turned_steps(take)),
        (
            np.diff(found.world().positions, axis=0),
            np.diff(take.world().positions, axis=0),
        ),
    ):
        change = jumps(steps)
        seam = change[length - 2 : length + 1].max()
        # What the blend itself needs to cover the gap, and the motion's own.
        assert seam <= max(change[: length - 2].max(), 2 * jumps(source).max())


def test_a_blend_takes_most_of_the_jump_away() -> None:
    length, period = 40, 70.0
    take = swinging(gait(length + 3, period, 3.0))
    whole = loop(take, 102, 102 + length, repeats=2)
    cut = loop(take, 102, 102 + length, repeats=2, blend=0)
    after = jumps(turned_steps(whole))[length - 1]
    before = jumps(turned_steps(cut))[length - 1]
    assert after < 0.02
    assert before > 10 * after


@given(rigs(), st.integers(18, 40), st.integers(0, 2**31))
def test_a_cycle_stays_as_it_is(rig: Rig, length: int, seed: int) -> None:
    take = cyclic(rig, length, seed)
    kept = np.arange(length)
    expected = replace(
        take,
        clock=replace(take.clock, count=length),
        motion=take.motion.select(kept),
    )
    found = loop(take)
    assert_same_motion(found, expected, 1e-9)
    assert loop(take, repeats=3).clock.count == 3 * length


def cyclic(rig: Rig, length: int, seed: int) -> Take:
    """Return a take whose last frame is its first, of two harmonics."""
    rng = np.random.default_rng(seed)
    turn = 2 * np.pi * (np.arange(length + 1) % length) / length
    waves = np.stack([f(k * turn) for k in (1, 2) for f in (np.sin, np.cos)], axis=1)

    def wave(number: int, width: int, size: float) -> FloatArray:
        parts = rng.normal(0, size, (4, number, width))
        parts[2:] *= 0.2
        return np.einsum("fw,wnk->fnk", waves, parts)

    count = len(rig.joints)
    turns = so3.multiply(rig.rest_rotations, so3.exp(wave(count, 3, 0.2)))
    motion = Motion(
        Channel.from_dense(rig.rest_translations + wave(count, 3, 0.1)),
        Channel.from_dense(so3.align_signs(turns)),
        Channel.from_dense(1 + wave(count, 3, 0.02)),
        Channel.from_dense(wave(2, 1, 0.3)),
    )
    rig = replace(rig, shapes=(Shape("smile"), Shape("jaw")))
    clock = Clock(Fraction(30), Fraction(1), Fraction(1), length + 1)
    return Take(rig, clock, motion)


def below(take: Take, name: str, scale: float = 1.0) -> Take:
    """Return a take under a root that is turned, off the origin, and stands still."""
    whole = inserted(take, name, 0)
    motion = whole.motion
    places, turns, _ = motion.dense()
    places[:, 0], turns[:, 0] = [1, 2, 3], so3.exp([0.3, 0.4, -0.2])
    scales = np.ones(places.shape)
    scales[:, 0] = scale
    motion = Motion(*(Channel.from_dense(part) for part in (places, turns, scales)))
    return replace(whole, motion=motion)


@pytest.mark.parametrize("scale", [1.0, 0.01])
def test_travel_below_a_root_that_stands_still(scale: float) -> None:
    take = swinging(gait(31, 30.0), yaw=0.8)
    plain = loop(take, repeats=4).world().positions
    rooted = below(take, "reference", scale)
    # The same walk, about an up axis that the root leans.
    upright = rooted.motion.rotations.rest.copy()
    upright[0] = so3.exp([0, 0.4, 0])
    rooted = replace(
        rooted,
        motion=replace(
            rooted.motion, rotations=replace(rooted.motion.rotations, rest=upright)
        ),
    )
    found = loop(rooted, repeats=4).world().positions[:, 1:]
    expected = so3.rotate(upright[0], scale * plain) + np.array([1.0, 2.0, 3.0])
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_below_a_root_of_no_size_nothing_travels() -> None:
    found = loop(below(swinging(gait(31, 30.0)), "reference", 0.0), repeats=2)
    assert np.isfinite(found.motion.translations.dense()).all()


def test_what_slides_by_its_nature_does_not_travel() -> None:
    count = 31
    rig = Rig("press", (Joint("base", -1), Joint("ram", 0, type=JointType.PRISMATIC)))
    places = np.zeros((count, 2, 3))
    places[:, 1, 0] = np.linspace(0, 1, count)
    turns = np.tile(so3.IDENTITY, (count, 2, 1))
    motion = Motion(Channel.from_dense(places), Channel.from_dense(turns))
    take = Take(rig, Clock(Fraction(30), Fraction(1), Fraction(1), count), motion)
    found = loop(take, repeats=3).motion.translations.dense()
    assert found[:, 1, 0].max() <= 1
    assert found[30, 1, 0] == 0


def run(take: Take, **options: Any) -> tuple[Take, list[tuple[str, str]]]:
    """Return what the pass makes, and the codes and severities of what it says."""
    context = PassContext(lambda _: take, Path())
    found = PASS.run(take, LoopOptions(**options), context)
    assert isinstance(found, Take)
    return found, [(one.code, str(one.severity)) for one in context.notices]


def test_the_pass_finds_a_cycle_and_says_which() -> None:
    take = swinging(gait(90, 30.0))
    found, said = run(take, find=True, repeats=2)
    assert found.clock.count == 60
    assert said == [("SCN102", "note")]


def test_a_poor_seam_is_said() -> None:
    take = swinging(gait(61, 30.0))
    assert run(take, first=101, last=146)[1] == [("SCN101", "warning")]
    assert run(take)[1] == []


@pytest.mark.parametrize(
    "options", [{"repeats": 0}, {"blend": -1}, {"first": 120, "last": 120}]
)
def test_no_loop(options: dict[str, Any]) -> None:
    with pytest.raises(OptionError) as error:
        run(swinging(gait(61, 30.0)), **options)
    assert error.value.code == "SCN018"


@pytest.mark.parametrize("length", [1, 2, 3])
def test_a_blend_longer_than_the_cycle(length: int) -> None:
    take = swinging(gait(length + 1, 30.0))
    found = loop(take, repeats=2, blend=50)
    assert found.clock.count == 2 * length
    first = found.motion.rotations.dense()[0]
    np.testing.assert_array_equal(first, take.motion.rotations.dense()[0])


def test_what_climbs_and_leans_comes_back_and_what_drifts_goes_on() -> None:
    take = nasty_take(13)
    found = loop(take, repeats=4, blend=3)
    ends = take.world()
    up = np.array(take.rig.up.vector)
    turn = twist(so3.from_matrix(ends.linear[-1, 0] @ ends.linear[0, 0].T), up)
    start, drift = ends.positions[0, 0], ends.positions[-1, 0] - ends.positions[0, 0]
    assert drift @ up > 0.1
    assert so3.angle_between(turn, so3.IDENTITY) > 0.5
    world = found.world()
    first = world.linear[0, 0]
    for k in range(1, 4):
        place, pose = world.positions[12 * k, 0], world.linear[12 * k, 0]
        # The height of the first frame, and a step over the ground a cycle.
        np.testing.assert_allclose(place @ up, start @ up, atol=1e-9)
        drift -= (drift @ up) * up
        start = start + drift
        np.testing.assert_allclose(place, start, atol=1e-9)
        drift = so3.rotate(turn, drift)
        first = so3.to_matrix(turn) @ first
        np.testing.assert_allclose(pose, first, atol=1e-9)


def test_tokens_of_a_looped_track_repeat_and_are_held() -> None:
    take = with_track(nasty_take(13))
    assert take.motion.track_times is not None
    shown = nasty_track().at(take.motion.track_times.dense()[:-1, 0, 0])
    found = loop(take, repeats=3)
    assert found.motion.track_times is not None
    times = found.motion.track_times.dense()[:, 0, 0]
    # Between frames the value of the frame before lasts.
    for moment in (times, times + 0.9):
        made = found.tracks[0].at(moment)
        for own, wanted in zip(made.values[1:], shown.values[1:], strict=True):
            np.testing.assert_array_equal(own, np.tile(wanted, 3))
    heat = found.tracks[0].at(times).values[0][:, 0]
    np.testing.assert_allclose(heat[:12], heat[12:24])

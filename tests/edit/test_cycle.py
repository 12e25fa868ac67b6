"""The search for a cycle, and how well a given one closes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.gaits import gait, swinging

from animtool.core.clock import Clock
from animtool.core.errors import OptionError
from animtool.core.units import UpAxis
from animtool.edit.cycle import _PoseView, find_cycle, measure_cycle
from animtool.edit.frames import frame_index
from animtool.edit.looping import loop as loop_take
from animtool.formats.bvh.read import read_bvh
from animtool.maths import so3
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import Take
from animtool.rig.skeleton import Joint, Rig


@given(st.integers(12, 40), st.floats(0, 6), st.floats(-2, 2), st.sampled_from(UpAxis))
def test_a_gait_is_found_wherever_it_goes(
    period: int, phase: float, yaw: float, up: UpAxis
) -> None:
    take = swinging(gait(3 * period + 5, period, phase), yaw=yaw, up=up)
    cycle = find_cycle(take)
    assert cycle.last - cycle.first == period
    assert cycle.share < 0.01


def test_the_cycle_in_a_capture_of_other_props() -> None:
    rng = np.random.default_rng(5)
    wander = np.cumsum(rng.normal(0, 0.06, (200, 2)), axis=0)
    steps = gait(80, 33.0) + rng.normal(0, 0.002, (80, 2))
    still = np.tile(wander[-1:], (90, 1))
    take = swinging(np.concatenate([wander, still, steps + wander[-1]]))
    cycle = find_cycle(take)
    assert cycle.last - cycle.first == pytest.approx(33, abs=1)
    assert cycle.first >= 101 + 280
    assert find_cycle(take) == cycle


def test_frames_between_those_compared_are_looked_at() -> None:
    take = swinging(gait(400, 141.0), fps=120)
    cycle = find_cycle(take)
    assert cycle.last - cycle.first == 141


def test_the_search_stays_where_it_is_asked_to() -> None:
    take = swinging(gait(200, 30.0))
    cycle = find_cycle(take, 150, 220, shortest=1.5)
    assert (cycle.first >= 150, cycle.last <= 220) == (True, True)
    assert cycle.last - cycle.first == 60


@pytest.mark.parametrize(
    ("first", "hint"),
    [(0.07, "write first=4"), (0.0, None), (-0.5, None), (99.5, None)],
)
def test_a_first_frame_in_seconds(first: float, hint: str | None) -> None:
    with pytest.raises(OptionError) as error:
        frame_index(Clock(Fraction(30), Fraction(1), Fraction(1), 64), first, "first")
    (fault,) = error.value.faults
    assert (fault.hint or "").endswith(hint or ""), fault.hint
    assert ("seconds" in (fault.hint or "")) is (hint is not None)


@pytest.mark.parametrize(
    ("frame", "hint"), [(1001, "write first=1"), (1033, "write first=33")]
)
def test_a_frame_of_a_shot(frame: float, hint: str) -> None:
    clock = Clock(Fraction(30), Fraction(1), Fraction(1), 64)
    with pytest.raises(OptionError) as error:
        frame_index(clock, frame, "first")
    assert error.value.code == "SCN013"
    assert str(error.value.faults[0].hint).endswith(f"not 1001: {hint}")


@pytest.mark.parametrize(
    ("options", "code"),
    [
        ({"first": 99}, "SCN013"),
        ({"last": 999}, "SCN013"),
        ({"first": 110, "last": 104}, "SCN018"),
        ({"first": 110, "last": 110}, "SCN018"),
        ({"first": 110, "last": 112}, "SCN018"),
        ({"shortest": 60.0}, "SCN018"),
        ({"shortest": -1.0}, "SCN018"),
        ({"longest": float("nan")}, "SCN018"),
        ({"shortest": 2.0, "longest": 1.0}, "SCN018"),
    ],
)
def test_no_such_cycle(options: dict[str, float], code: str) -> None:
    with pytest.raises(OptionError) as error:
        find_cycle(swinging(gait(200, 30.0)), **options)
    assert error.value.code == code


def test_nothing_moves() -> None:
    with pytest.raises(OptionError) as error:
        find_cycle(swinging(np.zeros((60, 2))))
    assert error.value.code == "SCN018"
    assert measure_cycle(swinging(np.zeros((60, 2)))).share < 1e-6


def test_a_joint_alone_is_seen_to_turn() -> None:
    turn = so3.exp(np.sin(np.arange(70) / 30 * 2 * np.pi)[:, None, None] * [1, 0, 0])
    rig = Rig("ball", (Joint("ball", -1),))
    motion = Motion(Channel.from_dense(np.zeros((70, 1, 3))), Channel.from_dense(turn))
    take = Take(rig, Clock(Fraction(30), Fraction(1), Fraction(1), 70), motion)
    cycle = find_cycle(take)
    assert cycle.last - cycle.first == 30


def test_the_walk_has_the_cycle_that_it_was_made_with(walk: Path) -> None:
    cycle = find_cycle(read_bvh(walk).collect())
    assert cycle.last - cycle.first == 32
    assert cycle.apart < 1e-4


def test_ends_are_measured() -> None:
    take = swinging(gait(61, 30.0))
    good, poor = measure_cycle(take, 101, 161), measure_cycle(take, 101, 146)
    assert good.share < 0.02
    assert poor.share > 0.9
    with pytest.raises(OptionError) as error:
        measure_cycle(take, 120, 120)
    assert error.value.code == "SCN018"


@pytest.mark.parametrize("count", [2, 3])
def test_a_few_frames(count: int) -> None:
    take = swinging(gait(count, 30.0))
    assert measure_cycle(take).apart > 0
    shorter = replace(take, clock=replace(take.clock, fps=Fraction(2)))
    if count == 3:
        assert find_cycle(shorter).last == 103


def chain_of_two(frames: int, rest: np.ndarray, turns: np.ndarray) -> Take:
    """Return bones of 1 and 2 m on a root that rests and turns as given."""
    joints = (
        Joint("root", -1, translation=(1.0, 2.0, 3.0), rotation=tuple(rest.tolist())),
        Joint("upper", 0, translation=(0.0, 1.0, 0.0)),
        Joint("lower", 1, translation=(2.0, 0.0, 0.0)),
    )
    moves = np.tile([joint.translation for joint in joints], (frames, 1, 1))
    whole = np.tile(so3.IDENTITY, (frames, 3, 1))
    whole[:, 0] = turns
    motion = Motion(Channel.from_dense(moves), Channel.from_dense(whole))
    clock = Clock(Fraction(30), Fraction(1), Fraction(1), frames)
    return Take(Rig("chain", joints), clock, motion)


def test_joints_count_by_half_of_each_bone_that_they_move() -> None:
    """Of the last one a third is its origin's, and a third each that of two points."""
    take = chain_of_two(4, so3.IDENTITY, so3.IDENTITY)
    found = _PoseView.from_take(take).weights
    np.testing.assert_allclose(found, np.array([0.5, 1.5, 1 / 3, 1 / 3, 1 / 3]) / 3)


def test_a_heading_is_seen_from_the_rest_pose() -> None:
    """Of a root that rests upside down, which has no heading of its own."""
    over = np.array([1.0, 0.0, 0.0, 0.0])
    yaws = so3.from_axis_angle(np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.5, 1.2]))
    take = chain_of_two(3, over, so3.multiply(yaws, over))
    ground, heading = _PoseView.from_take(take)._ground_pose(np.arange(3))
    assert so3.angle_between(heading, yaws).max() < 1e-9
    np.testing.assert_allclose(ground, np.tile([1.0, 0.0, 3.0], (3, 1)))


@pytest.mark.parametrize(
    ("ends", "words"),
    [
        ((120, 120), ["first and last are both frame 120", "last is a later frame"]),
        ((160, None), ["first must be before the take's last frame, 160"]),
        ((130, 120), ["first is frame 130, after last, frame 120", "exchange them"]),
    ],
)
@pytest.mark.parametrize("function", [find_cycle, measure_cycle, loop_take])
def test_an_empty_cycle_names_its_ends(
    ends: tuple[int, int | None], words: list[str], function: Callable[..., object]
) -> None:
    take = swinging(gait(60, 30.0))
    with pytest.raises(OptionError) as error:
        function(take, *ends)
    (fault,) = error.value.faults
    assert fault.code == "SCN018"
    assert all(word in str(fault) for word in words), str(fault)

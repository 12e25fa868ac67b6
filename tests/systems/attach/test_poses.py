"""What a cycle carries a character by, in numbers."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from animtool.maths import so3
from animtool.rig.skeleton import Joint, Pose, Rig
from animtool.systems.attach.poses import (
    LocalPose,
    advance_cycle,
    bind_around,
    cycle_travel,
    ease_rotations,
)

UP = np.array([0.0, 1.0, 0.0])
RIG = Rig("one", (Joint("root", -1), Joint("child", 0)))


def pose(place: list[float], degrees: float = 0.0) -> LocalPose:
    """Return the pose of a root at a place, turned about the up axis."""
    turn = so3.exp(np.radians(degrees) * UP)
    return LocalPose(
        np.array([place, [0.0, 0.3, 0.0]]), np.stack([turn, so3.IDENTITY]), None, None
    )


def test_who_walks_goes_on_at_the_mean_of_both_speeds() -> None:
    """From 10 on, 3 before the end and 1 after the beginning: 2; heights do not add."""
    poses = (pose([5, 1, 2]), pose([6, 1.5, 2]), pose([12, 1, 2]), pose([15, 0.9, 2]))
    travel = cycle_travel(RIG, poses)
    assert_allclose(travel.shift, [12, 0, 0], atol=1e-12)
    assert_allclose(travel.rotation, so3.IDENTITY, atol=1e-12)
    again = advance_cycle(RIG, poses[0], travel)
    assert_allclose(again.translations, [[17, 1, 2], [0, 0.3, 0]])


def test_who_goes_round_a_corner_goes_on_in_the_new_direction() -> None:
    """A quarter turn about a point that is not the origin, with steps of a metre."""
    poses = (
        pose([3, 1, 0]),
        pose([4, 1, 0]),
        pose([9, 1, 4], -90),
        pose([9, 1, 5], -90),
    )
    travel = cycle_travel(RIG, poses)
    assert_allclose(travel.rotation, so3.exp(np.radians(-90) * UP), atol=1e-12)
    again = advance_cycle(RIG, poses[0], travel)
    # Where it begins anew it has gone one step on, along +Z.
    assert_allclose(again.translations[0], [9, 1, 6], atol=1e-12)
    assert_allclose(again.rotations[0], travel.rotation, atol=1e-12)
    # And the second frame is another step ahead.
    assert_allclose(
        advance_cycle(RIG, poses[1], travel).translations[0], [9, 1, 7], atol=1e-12
    )


@pytest.mark.parametrize(("end", "shift"), [(2.0, 0.0), (2.1, 3.1)])
def test_who_ends_within_two_steps_of_the_beginning_stands_in_place(
    end: float, shift: float
) -> None:
    poses = (pose([0, 1, 0]), pose([1, 1, 0]), pose([end - 1, 1, 0]), pose([end, 1, 0]))
    assert_allclose(cycle_travel(RIG, poses).shift, [shift, 0, 0], atol=1e-12)


def test_around_a_joint_the_bind_rotations_are_eased_into_those_of_a_pose() -> None:
    quarter = so3.exp(np.pi / 2 * UP)
    bind = {"hand": Pose((0.0, 0.3, 0.0), tuple(quarter))}
    joints = Joint("root", -1), Joint("spine", 0), Joint("hand", 1), Joint("leg", 0)
    rig = Rig("four", joints, bind=bind)
    turns = so3.exp(np.array([0.1, 0.2, 0.3, 0.4])[:, None] * UP)
    start = LocalPose(np.ones((4, 3)), turns, None, None)
    clear = bind_around(rig, start, 1)
    assert_allclose(clear.rotations, [*turns[:2], quarter, so3.IDENTITY])
    assert_allclose(clear.translations, start.translations)
    first, middle, last = ease_rotations(clear, start, 2)
    assert_allclose(first.rotations, clear.rotations)
    assert_allclose(middle.rotations[3], so3.exp(0.2 * UP))
    assert_allclose(last.rotations, turns)

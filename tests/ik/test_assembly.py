"""Chains as the solver has them: who leads whom, how far, and in which lengths."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from animtool.ik import Goal, build
from animtool.ik.assembly import (
    _priority_levels,
    _rotation_from_z,
)
from animtool.ik.sub_rig import coordinate_ranges, leader_of, sub_rig
from animtool.maths import so3
from animtool.rig.limits import RangeLimit
from animtool.rig.skeleton import Joint, JointType, Mimic, Rig

PIN, SLIDE = JointType.PIN, JointType.PRISMATIC


def followers() -> Rig:
    """Return pins: b is 2 a + 0.1, and c is 0.5 - 3 b."""
    return Rig(
        "followers",
        (
            Joint("a", -1, PIN, limits=RangeLimit(-1.0, 1.0)),
            Joint("b", 0, PIN, translation=(1.0, 0.0, 0.0),
                  limits=RangeLimit(-0.5, 9.0), mimic=Mimic("a", 2.0, 0.1)),
            Joint("c", 1, PIN, translation=(0.0, 2.0, 0.0),
                  limits=RangeLimit(-4.0, 2.0), mimic=Mimic("b", -3.0, 0.5)),
            Joint("free", 2, JointType.BALL, translation=(0.0, 0.0, 3.0)),
        ),
    )  # fmt: skip


def test_who_leads_a_row_of_followers_and_how_far_it_may_go() -> None:
    rig = followers()
    assert leader_of(rig, 0) == (0, 1, 0)
    assert leader_of(rig, 1) == (0, 2, pytest.approx(0.1))
    assert leader_of(rig, 2) == (0, -6, pytest.approx(0.2))
    # b from -0.3 on; c, which goes the other way, from -0.3 to 0.7.
    ranges = coordinate_ranges(rig)
    assert set(ranges) == {0}
    assert ranges[0] == pytest.approx((-0.3, 0.7))
    wide = replace(rig.joints[2], limits=None)
    ranges = coordinate_ranges(
        replace(rig, joints=(*rig.joints[:2], wide, rig.joints[3]))
    )
    assert ranges[0] == pytest.approx((-0.3, 1.0))
    never = replace(rig.joints[1], limits=RangeLimit(5.0, 9.0))
    ranges = coordinate_ranges(replace(rig, joints=(rig.joints[0], never)))
    assert ranges[0] == pytest.approx((2.45, 2.45))


def test_a_turn_takes_z_onto_any_axis() -> None:
    for axis in ([0, 0, 1], [0, 0, -1], [1, 0, 0], [0, -1, 0], [0.6, 0, -0.8]):
        found = so3.rotate(
            _rotation_from_z(np.array(axis, float)), np.array([0.0, 0, 1])
        )
        assert_allclose(found, axis, atol=1e-12)


def test_priorities_are_ranks_without_gaps() -> None:
    goals = [Goal("a", priority=k) for k in (5, 0, 9, 5)]
    assert _priority_levels(goals) == [1, 0, 2, 1]


def test_lengths_are_those_of_the_longest_way_to_a_goal() -> None:
    """Bones of 1, 2 and 3 m, and what a goal carries; of slides their range."""
    rig = followers()
    problem = build(rig, [Goal("free", (0.0, 0.5, 0.0)), Goal("b")])
    assert problem.length == pytest.approx(1 + 2 + 3 + 0.5)
    assert build(rig, [Goal("b")]).length == pytest.approx(1)
    rail = Joint("rail", -1, SLIDE, limits=RangeLimit(-1.0, 3.0))
    other = Joint("rail2", 0, SLIDE, limits=RangeLimit(0.0, 2.5))
    assert build(Rig("r", (rail, other)), [Goal("rail2")]).length == pytest.approx(4)
    endless = Rig("r", (replace(rail, limits=None),))
    assert build(endless, [Goal("rail")]).length == 1


def test_a_part_of_a_rig_has_what_it_hangs_from_and_who_follows() -> None:
    part, own = sub_rig(followers(), ["a"])
    assert (part.names, own.tolist()) == (["a", "b", "c"], [0, 1, 2])
    part, own = sub_rig(followers(), ["free"])
    assert own.tolist() == [0, 1, 2, 3]
    assert [joint.parent for joint in part.joints] == [-1, 0, 1, 2]

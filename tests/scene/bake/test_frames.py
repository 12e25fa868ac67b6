"""When a take is sampled for an output, and which joints move there."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from support.small_takes import small

from animtool.core.clock import Clock
from animtool.core.shot import Shot
from animtool.motion.take import Take, TakeStream
from animtool.rig.skeleton import Joint
from animtool.scene.bake.frames import TakePlan, moving_joints, sample_take
from animtool.scene.bake.options import BakeOptions


def planned(take: Take, options: BakeOptions) -> TakePlan:
    stream = TakeStream.of(take)
    fps = take.clock.fps if options.fps is None else options.fps
    start = Fraction(1001) if options.start is None else options.start
    return TakePlan(Path("a.bvh"), "", stream, None, options, fps, start, [])


@pytest.mark.parametrize(
    ("last", "missing"),
    [(1009, ""), (1010, ""), (1011, "1011"), (1013, "1011 to 1013")],
)
def test_the_last_frame_of_a_take_lasts_until_the_next_would_come(
    last: int, missing: str
) -> None:
    """At 12 samples a second every other frame of 24 has one."""
    take = replace(small(5), clock=Clock(12, Fraction(1), Fraction(1), 5))
    shot = Shot(1001, last, fps=Fraction(24))
    plan = planned(take, BakeOptions(shot=shot))
    sampled = sample_take(plan, plan.stream)
    assert sampled.first_and_last == (1001, last)
    codes = np.concatenate([codes for codes, _ in sampled.blocks])
    assert codes.tolist() == list(range(1001, last + 1))
    notices = [notice for notice in plan.notices if notice.code != "TAKE007"]
    assert all(missing in notice.message for notice in notices)
    assert bool(notices) is bool(missing)


def moving(take: Take, **options: bool) -> list[str]:
    plan = planned(take, BakeOptions(**options))  # type: ignore[arg-type]
    names = np.array(take.rig.names)
    return names[moving_joints(plan, take.rig, [take.motion])].tolist()


def resting(take: Take) -> Take:
    """Return a take whose first frame is the rest pose."""
    moves, turns, _ = take.motion.dense()
    joints = tuple(
        replace(joint, translation=tuple(t), rotation=tuple(r))
        for joint, t, r in zip(
            take.rig.joints, moves[0].tolist(), turns[0].tolist(), strict=True
        )
    )
    return replace(take, rig=replace(take.rig, joints=joints))


def test_which_joints_move() -> None:
    take = resting(small())
    assert moving(take) == ["hips", "arm_l"]
    assert moving(take, root_motion=True) == ["arm_l"]
    still = replace(take, motion=take.motion.select(np.zeros(12, np.int64)))
    # A layer of no joint would be none.
    assert moving(still) == ["hips"]
    # One that stays elsewhere than at rest is not at rest.
    joints = [replace(joint, translation=(9.0, 9, 9)) for joint in still.rig.joints]
    elsewhere = replace(still.rig, joints=tuple(joints))
    assert moving(replace(still, rig=elsewhere)) == ["hips", "arm_l", "arm_r"]


def test_other_roots_are_relative_to_the_first_that_the_skelroot_carries() -> None:
    take = small()
    joints = (*take.rig.joints[:2], Joint("prop", -1))
    apart = replace(take, rig=replace(take.rig, joints=joints))
    apart = resting(apart)
    assert moving(apart) == ["hips", "arm_l"]
    assert moving(apart, root_motion=True) == ["arm_l", "prop"]

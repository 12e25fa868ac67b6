"""Limits of the joints of who falls: open to how he stood, kept as he is shown."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from animtool.core.array_types import FloatArray
from animtool.maths import so3
from animtool.rig.limits import BallLimit, RangeLimit
from animtool.rig.skeleton import Joint, JointType, Rig
from animtool.systems.crowds.falls import clamp_to_limits, widen_limits

# At rest turned about y, and a pin about z.
REST = tuple(so3.exp(np.array([0.0, 0.7, 0.0])).tolist())
KNEE = RangeLimit(0.0, 2.0)
ANKLE = BallLimit((0.4, 0.8), (-0.3, 0.3), (0.0, 1.0, 0.0))


def rig(knee: RangeLimit | None = KNEE, ankle: BallLimit | None = ANKLE) -> Rig:
    return Rig(
        "r",
        (
            Joint("hips", -1),
            Joint("knee", 0, JointType.PIN, rotation=REST, limits=knee),
            Joint("ankle", 1, JointType.BALL, rotation=REST, limits=ankle),
        ),
    )


def turned(knee: list[float], ankle: list[float]) -> FloatArray:
    """Return local rotations of joints turned from rest by rotation vectors [rad]."""
    motions = so3.exp(np.array([[3.0, 0.0, 0.0], knee, ankle]))
    return so3.multiply(rig().rest_rotations, motions)


def same(one: FloatArray, other: FloatArray) -> None:
    assert_allclose(so3.angle_between(one, other), 0.0, atol=1e-7)


def test_what_joints_can_have_stays() -> None:
    pose = turned([0.0, 0.0, 1.2], [0.0, 0.2, 0.0])
    same(clamp_to_limits(rig(), pose), pose)


@pytest.mark.parametrize(
    ("knee", "shown"),
    [(2.5, 2.0), (-0.4, 0.0), (3.9, 2.0), (-2.0, 0.0)],
)
def test_a_pin_ends_at_its_limits(knee: float, shown: float) -> None:
    """The nearer one; beyond half a turn too."""
    found = clamp_to_limits(rig(), turned([0.0, 0.0, knee], [0.0, 0.0, 0.0]))
    same(found, turned([0.0, 0.0, shown], [0.0, 0.0, 0.0]))


def test_a_pin_turns_about_its_axis_alone() -> None:
    """By what is left of a turn of 1 about it and then one of 0.6 across."""
    pose = turned([0.0, 0.0, 0.0], [0.0, 0.0, 0.0])
    across, along = (so3.exp(np.array(v)) for v in ([0.6, 0.0, 0.0], [0.0, 0.0, 1.0]))
    pose[1] = so3.multiply(pose[1], so3.multiply(across, along))
    for own in (rig(), rig(knee=None)):
        same(clamp_to_limits(own, pose), turned([0.0, 0.0, 1.0], [0.0, 0.0, 0.0]))


def test_a_ball_ends_at_its_cone_and_its_twist() -> None:
    """About z the cone is 0.4 wide, about x 0.8."""
    for ankle, shown in (
        ([0.0, 1.0, 0.0], [0.0, 0.3, 0.0]),
        ([0.0, 0.0, -2.0], [0.0, 0.0, -0.4]),
        ([2.0, 0.0, 0.0], [0.8, 0.0, 0.0]),
    ):
        pose = turned([0.0, 0.0, 1.0], ankle)
        same(clamp_to_limits(rig(), pose), turned([0.0, 0.0, 1.0], shown))
        same(clamp_to_limits(rig(ankle=None), pose), pose)


def test_limits_open_to_a_pose_and_no_farther() -> None:
    """A knee bent back by 0.2, an ankle twisted by 0.5 and swung by twice its cone."""
    twist, swing = so3.exp(np.array([0, 0.5, 0])), so3.exp(np.array([0, 0, 0.8]))
    pose = turned([0.0, 0.0, -0.2], [0.0, 0.0, 0.0])
    pose[2] = so3.multiply(pose[2], so3.multiply(swing, twist))
    own = widen_limits(rig(), pose)
    same(clamp_to_limits(own, pose), pose)
    knee, ankle = own.joints[1].limits, own.joints[2].limits
    assert isinstance(knee, RangeLimit)
    assert isinstance(ankle, BallLimit)
    assert_allclose([knee.low, knee.high], [-0.2, 2.0])
    assert_allclose(ankle.twist, [-0.3, 0.5])
    assert_allclose(ankle.swing, [0.8, 1.6])
    bent = turned([0.0, 0.0, 1.2], [0.0, 0.2, 0.0])
    assert [joint.limits for joint in widen_limits(rig(), bent).joints[1:]] == [
        KNEE,
        ANKLE,
    ]
    free = rig(None, BallLimit())
    assert widen_limits(free, pose).joints == free.joints

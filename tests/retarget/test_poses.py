"""Turns that joints can have: which way pins bend, and twist that is shared."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from animtool.maths import so3
from animtool.retarget.poses import _bends, _within, share_twist
from animtool.rig.limits import RangeLimit
from animtool.rig.skeleton import Joint, JointType, Rig

UP = np.array([0.0, 1.0, 0.0])


@pytest.mark.parametrize(
    ("low", "high", "side"), [(0, 150, 1), (-150, 0, -1), (-150, 5, -1), (-5, 5, 1)]
)
def test_a_pin_bends_where_it_has_more_room(low: float, high: float, side: int) -> None:
    assert _bends(RangeLimit(np.radians(low), np.radians(high))) == side


def forearm(share: float) -> Any:
    """Return who has a twist joint along a forearm, whose hand rests turned."""
    rest = tuple(so3.from_axis_angle(UP, np.radians(30.0)).tolist())
    joints = (
        Joint("forearm", -1),
        Joint("twist", 0, rotation=rest, translation=(0.0, 0.1, 0.0)),
        Joint("hand", 0, rotation=rest, translation=(0.0, 0.3, 0.0)),
    )
    target = SimpleNamespace(rig=Rig("arm", joints))
    return SimpleNamespace(target=target, twists=[(1, 0, 2, share)])


def turned(angles: list[float]) -> np.ndarray:
    """Return local turns whose hand is turned about the forearm by degrees."""
    local = np.tile(so3.IDENTITY, (len(angles), 3, 1))
    rest = so3.from_axis_angle(UP, np.radians(30.0))
    swing = so3.from_axis_angle(np.array([1.0, 0.0, 0.0]), np.radians(40.0))
    twist = so3.from_axis_angle(UP, np.radians(angles))
    local[:, 2] = so3.multiply(rest, so3.multiply(swing, twist))
    return local


@pytest.mark.parametrize(
    ("angles", "before", "expected"),
    [
        ([0.0, 50.0, 100.0], None, [0, 50, 100]),
        ([170.0, 190.0, 350.0, 370.0], None, [170, 190, 350, 370]),
        ([-10.0, 20.0], 340.0, [350, 380]),
        ([-10.0, 20.0], -20.0, [-10, 20]),
    ],
)
def test_a_twist_joint_has_its_share_and_goes_on_from_the_frame_before(
    angles: list[float], before: float | None, expected: list[float]
) -> None:
    local = turned(angles)
    begun = None if before is None else np.radians([before])
    last = share_twist(forearm(0.4), local, begun)
    steps = np.radians(expected)
    assert_allclose(last, steps[-1:])
    whole = so3.from_axis_angle(UP, 0.4 * steps + np.radians(30.0))
    assert so3.angle_between(local[:, 1], whole).max() < 1e-7


def test_what_a_pin_can_have_is_its_twist_within_its_range() -> None:
    pin = Joint(
        "knee", -1, JointType.PIN, axis=(0.0, 1.0, 0.0),
        limits=RangeLimit(np.radians(-10.0), np.radians(90.0)),
    )  # fmt: skip
    rest = so3.from_axis_angle(np.array([0.0, 0.0, 1.0]), 0.5)
    own = so3.from_axis_angle(UP, np.radians([-30.0, -10.0, 45.0, 91.0]))
    found, held = _within(pin, rest, so3.multiply(rest, own))
    expected = so3.from_axis_angle(UP, np.radians([-10.0, -10.0, 45.0, 90.0]))
    assert so3.angle_between(found, so3.multiply(rest, expected)).max() < 1e-9
    assert held.tolist() == [True, False, False, True]

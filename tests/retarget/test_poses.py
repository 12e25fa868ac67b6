"""Turns that joints can have, and where limits stop them."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from animtool.maths import so3
from animtool.retarget.poses import _clamp_to_limits
from animtool.rig.limits import RangeLimit
from animtool.rig.skeleton import Joint, JointType

REST = so3.exp(np.array([0.3, 0.2, -0.1]))


@pytest.mark.parametrize(
    ("angle", "kept", "stopped"),
    [
        (0.5, 0.5, False),
        (1.0 + 5e-7, 1.0, False),
        (1.0 + 5e-6, 1.0, True),
        (-0.2 - 5e-7, -0.2, False),
        (-0.2 - 5e-6, -0.2, True),
        (2.5, 1.0, True),
    ],
)
def test_a_pin_is_stopped_a_millionth_beyond_its_limits(
    angle: float, kept: float, stopped: bool
) -> None:
    """Whatever is about other axes is left out."""
    axis, limits = np.array([0.0, 0.6, 0.8]), RangeLimit(-0.2, 1.0)
    joint = Joint("pin", 0, JointType.PIN, axis=(0.0, 0.6, 0.8), limits=limits)
    off = so3.multiply(
        so3.from_axis_angle(np.array([1.0, 0, 0]), np.array([0.4])),
        so3.from_axis_angle(axis, np.array([angle])),
    )
    found, free = _clamp_to_limits(joint, REST, so3.multiply(REST, off))
    wanted = so3.multiply(REST, so3.from_axis_angle(axis, np.array([kept])))
    assert_allclose(so3.align_signs(found, wanted[0]), wanted, atol=1e-12)
    assert free.tolist() == [stopped]


def test_what_is_free_or_fixed_is_left_or_held() -> None:
    local = so3.exp(np.array([[0.5, -1.0, 0.2]]))
    for kind in (JointType.FREE, JointType.BALL):
        found, free = _clamp_to_limits(Joint("a", 0, kind), REST, local)
        assert found is local
        assert not free.any()
    found, free = _clamp_to_limits(Joint("a", 0, JointType.FIXED), REST, local)
    assert_allclose(found, REST[None], atol=1e-12)
    assert not free.any()

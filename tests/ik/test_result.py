"""What a result says of the limits."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from numpy.testing import assert_allclose

from animtool.core.errors import OptionError
from animtool.ik import Goal, Targets, build, solve
from animtool.maths import so3
from animtool.rig.limits import BallLimit
from animtool.rig.skeleton import Joint, JointType, Rig


def neck(swing: tuple[float, float], twist: tuple[float, float]) -> Rig:
    limits = BallLimit(swing, twist, (0.0, 0.0, 1.0))
    return Rig("neck", (Joint("neck", -1, JointType.BALL, limits=limits),))


@pytest.mark.parametrize(("angle", "missed"), [(0.3, 0.0), (1.3, 0.5)])
def test_an_aim_beyond_the_cone_stops_on_it(angle: float, missed: float) -> None:
    problem = build(
        neck((0.8, 0.8), (-0.1, 0.1)), [Goal("neck", position=0.0, aim=1.0)]
    )
    point = [np.sin(angle), 0.0, np.cos(angle)]
    result = solve(problem, None, Targets(aims=[[point]]))
    assert abs(result.aims[0, 0] - missed) < 1e-6
    assert result.limits_active() == (["neck"] if missed else [])
    assert result.missed == ([(0, 0)] if missed else [])


def test_an_ellipse_is_wider_one_way() -> None:
    problem = build(neck((0.2, 0.9), (0.0, 0.0)), [Goal("neck", position=0.0, aim=1.0)])
    # About y, the second axis after z, it swings towards x.
    far = [[[np.sin(1.2), 0.0, np.cos(1.2)]], [[0.0, np.sin(1.2), np.cos(1.2)]]]
    result = solve(problem, None, Targets(aims=far))
    np.testing.assert_allclose(result.aims[:, 0], [0.3, 1.0], atol=1e-6)


def test_poses_are_a_take() -> None:
    problem = build(
        neck((3.0, 3.0), (-0.1, 0.1)), [Goal("neck", position=0.0, aim=1.0)]
    )
    angles = np.linspace(0.2, 0.6, 3)
    points = np.stack([np.sin(angles), 0 * angles, np.cos(angles)], axis=1)
    take = solve(problem, None, Targets(aims=points[:, None])).take("29.97", start=1001)
    assert (len(take), take.fps) == (3, Fraction(30000, 1001))
    assert take.clock.times.tolist() == [1001.0, 1002.0, 1003.0]
    aims = so3.rotate(take.world().rotations[:, 0], np.array([0.0, 0.0, 1.0]))
    assert_allclose(aims, points, atol=1e-6)


def test_poses_are_no_take_at_a_rate_that_is_none() -> None:
    problem = build(
        neck((3.0, 3.0), (-0.1, 0.1)), [Goal("neck", position=0.0, aim=1.0)]
    )
    result = solve(problem, None, Targets(aims=[[[0.0, 0.0, 1.0]]]))
    with pytest.raises(OptionError) as caught:
        result.take(fps=0)
    assert caught.value.code == "SCN022"


@pytest.mark.parametrize(("scale", "codes"), [(1.0, []), (100.0, ["IK104"])])
def test_goals_in_centimetres(scale: float, codes: list[str]) -> None:
    joints = (
        Joint("arm", -1, JointType.BALL),
        Joint("hand", 0, JointType.FIXED, (0.6, 0.0, 0.0)),
    )
    problem = build(Rig("puppet", joints), [Goal("hand")])
    points = [[[0.3 * scale, 1.2 * scale, 0.4 * scale]]]
    result = solve(problem, None, Targets(positions=points))
    assert [notice.code for notice in result.notices] == codes
    assert all("'hand' is 129 m out of reach" in n.message for n in result.notices)
    assert "of 'hand'" in repr(result)

"""What of a solve need not be given, and what frames out of reach are solved with."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from support.ik import limb

from animtool.ik import Goal, IkMethod, IkOptions, Targets, build, solve
from animtool.ik.clip_path import FollowOptions
from animtool.ik.fit import FitOptions
from animtool.ik.options import TakeOptions


def test_what_a_solve_is_where_nothing_is_given() -> None:
    own = IkOptions()
    assert (own.method, own.tolerance, own.angle_tolerance) == (
        IkMethod.AUTO,
        1e-6,
        1e-6,
    )
    assert (own.iterations, own.restarts, own.seed, own.seconds) == (5000, 200, 0, 0)
    assert (own.ordered, own.warm, own.near) == (False, False, False)
    follow = FollowOptions()
    assert (follow.fps, follow.smooth, follow.branches, follow.back) == (24, 0, 20, 8)
    assert follow.solving == own
    take = TakeOptions()
    assert take.tolerance == pytest.approx(1e-6)
    assert take.angle_tolerance == pytest.approx(math.radians(1e-4))
    assert (take.restarts, take.seed, take.seconds, take.joints) == (50, 0, 0, ())
    assert (take.rest_weight, take.smooth, take.method) == (0, 0, IkMethod.AUTO)
    fit = FitOptions(30.0)
    assert (fit.acceleration, fit.robust, fit.rounds) == (60, math.inf, 12)
    goal = Goal("a")
    assert goal.weights == (1, 0, 0, 0)
    assert (goal.offset, goal.aim_axis, goal.root) == ((0, 0, 0), (0, 0, 1), None)
    assert (goal.priority, goal.soft, goal.stretch) == (0, 0, 0)


def test_what_is_out_of_reach_is_searched_from_each_start_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Without starts of its own, damped, a few steps each, then many of the best."""
    problem = build(limb(), [Goal("elbow", (0.27, 0.0, 0.0))])
    targets = Targets([[[5.0, 5, 5]]])
    result = solve(problem, None, targets)
    asked: list[IkOptions] = []
    module: Any = __import__("animtool.ik.nearest", fromlist=["solve"])

    def noted(*given: Any, **more: Any) -> Any:
        asked.append(given[3])
        return solve(*given, **more)

    monkeypatch.setattr(module, "solve_in_frame", noted)
    options = IkOptions(warm=True, near=True, ordered=True, restarts=9)
    found = module.find_nearest_poses(
        problem, result, targets, options, np.zeros((1, 5))
    )
    assert found.positions[0, 0] <= result.positions[0, 0] + 1e-9
    for one in asked:
        assert (one.restarts, one.ordered, one.warm, one.near) == (
            0,
            False,
            False,
            False,
        )
        assert one.method is IkMethod.DAMPED
    steps = [one.iterations for one in asked]
    assert set(steps) == {8, 100}
    assert 1 <= steps.count(100) <= 4
    assert steps.count(8) <= 2 * 27

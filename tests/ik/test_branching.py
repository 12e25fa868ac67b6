"""Which branch of solutions a clip is on: the nearest, and the one that leads on."""

from __future__ import annotations

from dataclasses import replace
from itertools import starmap

import numpy as np
import pytest
from support.ik import arm
from support.suite import some_quick

from animtool.core.array_types import FloatArray
from animtool.ik import Goal, Problem, Targets, build, follow
from animtool.ik.result import IkStatus
from animtool.rig.joints import rest_coordinates
from animtool.rig.limits import RangeLimit
from animtool.rig.skeleton import Joint, JointType, Rig


def nearest(points: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """Return how near the end of two links, 1 and .7 long, comes to points ``(F,)``."""
    a, b = (np.linspace(low[i], high[i], 1201) for i in range(2))
    x = np.cos(a)[:, None] + 0.7 * np.cos(a[:, None] + b)
    y = np.sin(a)[:, None] + 0.7 * np.sin(a[:, None] + b)
    return np.array([np.hypot(x - p[0], y - p[1]).min() for p in points])


@pytest.mark.slow
@pytest.mark.parametrize("moving", [False, True])
@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_what_is_out_of_reach_is_at_the_nearest(seed: int, moving: bool) -> None:
    """Behind limits there are several minima, and frames follow one another in one."""
    rng = np.random.default_rng(seed)
    low = np.radians(rng.uniform([-90, -30], [-20, 0]))
    high = np.radians(rng.uniform([30, 60], [90, 120]))
    rig = arm(2)
    limits = [RangeLimit(*pair) for pair in zip(low, high, strict=True)]
    joints = (
        replace(rig.joints[0], axis=(0.0, 0.0, 1.0), limits=limits[0]),
        replace(
            rig.joints[1],
            axis=(0.0, 0.0, 1.0),
            translation=(1.0, 0.0, 0.0),
            limits=limits[1],
        ),
    )
    problem = build(replace(rig, joints=joints), [Goal("b1", (0.7, 0.0, 0.0))])
    corners = rng.uniform(-1.6, 1.6, (4, 2))
    share = np.linspace(0, 3, 73)
    points = np.stack([np.interp(share, range(4), corners[:, i]) for i in (0, 1)], 1)
    targets = Targets(np.concatenate([points, np.zeros((73, 1))], axis=1)[:, None])
    start = rest_coordinates(problem.rig, 73) if moving else None
    result = follow(problem, start, targets)
    misses = result.positions[:, 0]
    assert (~result.converged).sum() > 10
    off = misses - nearest(points, low, high)
    claimed = np.array([status is IkStatus.NEAREST for status in result.statuses])
    assert off[claimed].max() < 1e-3
    # A short way round a jump may be farther off, and does not claim to be nearest.
    steadier = np.array([status is IkStatus.STEADIER for status in result.statuses])
    assert steadier.sum() <= 3
    assert (claimed | steadier | result.converged).all()


def crane(swivel: float = np.pi) -> Problem:
    """Return an arm that swivels by so much each way, nods, and aims its y axis."""
    joints = (
        Joint("swivel", -1, JointType.PIN, axis=(0.0, 1.0, 0.0),
              limits=RangeLimit(-swivel, swivel)),
        Joint("nod", 0, JointType.PIN, axis=(0.0, 0.0, 1.0),
              limits=RangeLimit(-2.0, 2.0)),
        Joint("head", 1, JointType.PIN, translation=(0.0, 0.4, 0.0),
              axis=(0.0, 0.0, 1.0), limits=RangeLimit(-2.0, 2.0)),
    )  # fmt: skip
    aim = Goal("head", position=0.0, aim=1.0, aim_axis=(0.0, 1.0, 0.0))
    return build(Rig("crane", joints), [aim])


def aims(azimuth: FloatArray) -> Targets:
    """Return points around the crane, one a frame."""
    points = np.stack([np.cos(azimuth), 0 * azimuth + 0.1, -np.sin(azimuth)], axis=1)[
        :, None
    ]
    return Targets(aims=points)


@pytest.mark.parametrize("begin", [0.0, 1.5, 3.1])
def test_an_aim_goes_over_limits_that_are_one_turn_apart(begin: float) -> None:
    """The swivel is turned alike at both ends: no flip to the other side of the arm."""
    problem = crane()
    targets = aims(begin + np.linspace(0, 1.2 * np.pi, 48))
    clip = rest_coordinates(problem.rig, 48)
    result = follow(problem, clip, targets)
    assert result.converged.all()
    assert result.jumps == ()
    turns = np.diff(result.coordinates, axis=0)
    turns -= 2 * np.pi * np.round(turns / (2 * np.pi))
    assert np.abs(turns).max() < np.radians(12.0)


def test_a_clip_begins_on_the_branch_that_leads_on() -> None:
    """Beyond ±100 degrees the arm has to lean back, and does so from the start."""
    problem = crane(np.radians(100.0))
    targets = aims(np.radians(np.linspace(85.0, 160.0, 48)))
    clip = rest_coordinates(problem.rig, 48)
    result = follow(problem, clip, targets)
    assert result.converged.all()
    assert result.jumps == ()


def pulled(weight: float, priority: int) -> tuple[FloatArray, FloatArray]:
    """Return what two goals out of reach cost, and the least of a grid ``(F,)``."""
    rig = arm(2)
    hinge, limits = (0.0, 0.0, 1.0), RangeLimit(-2.6, 2.6)
    joints = (
        replace(rig.joints[0], axis=hinge, limits=limits),
        replace(rig.joints[1], axis=hinge, limits=limits, translation=(1.0, 0.0, 0.0)),
    )
    goals = [
        Goal("b1", (0.7, 0.0, 0.0)),
        Goal("b1", position=weight, priority=priority),
    ]
    problem = build(replace(rig, joints=joints), goals)
    rng = np.random.default_rng(5)
    ends = rng.uniform(-1.6, 1.6, (2, 2, 2))
    share = np.linspace(0, 1, 13)[:, None, None]
    points = ends[0] * (1 - share) + ends[1] * share
    spots = np.concatenate([points, np.zeros((13, 2, 1))], axis=2)
    start = rest_coordinates(problem.rig, 13)
    result = follow(problem, start, Targets(spots))
    claimed = np.array([status is IkStatus.NEAREST for status in result.statuses])
    counts = np.array([1.0, weight if priority == 0 else 0.0])
    found = np.hypot(*(result.positions * counts).T)
    a, b = np.meshgrid(*[np.linspace(-2.6, 2.6, 601)] * 2, indexing="ij")
    elbow = np.stack([np.cos(a), np.sin(a)], axis=-1)
    tip = elbow + 0.7 * np.stack([np.cos(a + b), np.sin(a + b)], axis=-1)
    least = [
        np.hypot(
            np.linalg.norm(tip - p[0], axis=-1),
            np.linalg.norm(elbow - p[1], axis=-1) * counts[1],
        ).min()
        for p in points
    ]
    assert claimed.sum() >= 5
    return found[claimed], np.array(least)[claimed]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("weight", "priority"),
    some_quick(
        starmap(pytest.param, [(0.02, 0), (0.1, 0), (0.3, 0), (1.0, 1), (4.0, 0)]), 3
    ),
)
def test_the_nearest_heeds_weights_and_priorities(weight: float, priority: int) -> None:
    found, least = pulled(weight, priority)
    assert (found - least).max() < 1.5e-3

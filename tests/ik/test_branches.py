"""Other ways through a stretch of a clip."""

from __future__ import annotations

import numpy as np
from support.ik import arm, random_pose, reached_by

from animtool.core.array_types import FloatArray
from animtool.ik import Goal, IkOptions, Targets, build
from animtool.ik.branches import Interval, best_path, branches, price, search_branches
from animtool.ik.chain import difference

FRAMES = 12


def stretch(seed: int = 3) -> Interval:
    """Four links that reach along a line."""
    problem = build(arm(4, limit=2.0), [Goal("b3", (0.3, 0.0, 0.0))])
    pose = random_pose(problem, seed) / 2
    rows = pose + 0.01 * np.arange(FRAMES)[:, None]
    targets = reached_by(problem, rows)
    poses = problem.chain.from_rig(rows)
    return Interval(
        problem,
        Targets(targets.positions),
        range(FRAMES),
        FRAMES // 2,
        poses,
        np.zeros(FRAMES),
        np.repeat(poses[:1], FRAMES, axis=0),
        np.full(FRAMES - 1, 0.3),
        rows,
        IkOptions(),
    )


def check(found: tuple[FloatArray, FloatArray], of: Interval) -> None:
    paths, costs = found
    assert costs.shape == paths.shape[:2]
    np.testing.assert_array_equal(paths[0], of.poses)
    for path, cost in zip(paths, costs, strict=True):
        for frame in np.flatnonzero(cost == 0):
            again, missed = of.solved(path[frame : frame + 1], np.array([frame]))
            assert missed[0] == 0
            np.testing.assert_allclose(again[0], path[frame], atol=1e-9)


def test_branches_reach_their_goals_where_they_cost_nothing() -> None:
    of = stretch()
    found = branches(of, 10, 0)
    assert len(found[0]) > 2
    check(found, of)


def test_searched_paths_reach_their_goals_where_they_cost_nothing() -> None:
    of = stretch()
    found = search_branches(of, 4, 0)
    assert (found[1][1:] == 0).any()
    check(found, of)


def test_the_cheapest_way_is_the_best_of_all() -> None:
    of = stretch()
    rng = np.random.default_rng(1)
    paths = of.poses + rng.normal(0, 0.05, (3, FRAMES, 4))
    costs = rng.uniform(0, 0.02, (3, FRAMES))
    for closed in (False, True):
        found = best_path(of, paths, costs, closed=closed)
        cost = {0: 0.0}
        for row in range(1, FRAMES):
            cost = {
                k: costs[k, row]
                + min(
                    before + ((paths[k, row] - paths[j, row - 1]) ** 2).sum()
                    for j, before in cost.items()
                )
                for k in range(3)
            }
        chosen = [
            int(np.flatnonzero((paths[:, row] == found[row]).all(axis=1))[0])
            for row in range(FRAMES)
        ]
        moves = difference(of.chain, found[:-1], found[1:])
        total = (moves**2).sum() + costs[chosen[1:], np.arange(1, FRAMES)].sum()
        assert chosen[0] == 0
        assert not closed or chosen[-1] == 0
        np.testing.assert_allclose(total, cost[0] if closed else min(cost.values()))


def test_what_misses_a_goal_costs_more_than_any_jump() -> None:
    misses = np.array([[[0.0] * 4], [[0.1, 0.0, 0.0, 0.0]], [[0.2, 0.0, 0.0, 0.0]]])
    cost = price(misses, np.array([True, False, False]))
    assert cost[0] == 0
    assert 1e3 < cost[1] < cost[2]

"""Other ways through a stretch of a clip."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from support.ik import arm, random_pose, reached_by

from animtool.core.array_types import FloatArray
from animtool.ik import Goal, IkOptions, Targets, build
from animtool.ik import branches as branching
from animtool.ik.branches import (
    Interval,
    best_path,
    find_branches,
    miss_cost,
    search_long_interval,
)
from animtool.ik.chain import joint_steps

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
            again, missed = of.solve_frames(path[frame : frame + 1], np.array([frame]))
            assert missed[0] == 0
            np.testing.assert_allclose(again[0], path[frame], atol=1e-9)


def test_branches_reach_their_goals_where_they_cost_nothing() -> None:
    of = stretch()
    found = find_branches(of, 10, 0)
    assert len(found[0]) > 2
    check(found, of)


def test_searched_paths_reach_their_goals_where_they_cost_nothing() -> None:
    of = stretch()
    found = search_long_interval(of, 4, 0)
    assert (found[1][1:] == 0).any()
    check(found, of)


def test_the_cheapest_way_is_the_best_of_all() -> None:
    of = stretch()
    rng = np.random.default_rng(1)
    paths = of.poses + rng.normal(0, 0.05, (3, FRAMES, 4))
    costs = rng.uniform(0, 0.02, (3, FRAMES))
    for closed in (False, True):
        found = best_path(of, paths, costs, is_end_fixed=closed)
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
        moves = joint_steps(of.chain, found[:-1], found[1:])
        total = (moves**2).sum() + costs[chosen[1:], np.arange(1, FRAMES)].sum()
        assert chosen[0] == 0
        assert not closed or chosen[-1] == 0
        np.testing.assert_allclose(total, cost[0] if closed else min(cost.values()))


def test_what_misses_a_goal_costs_more_than_any_jump() -> None:
    misses = np.array([[[0.0] * 4], [[0.1, 0.0, 0.0, 0.0]], [[0.2, 0.0, 0.0, 0.0]]])
    cost = miss_cost(misses, np.array([True, False, False]))
    assert cost[0] == 0
    assert 1e3 < cost[1] < cost[2]


def test_what_is_followed_costs_nothing_as_far_as_it_was_followed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Two of the starts reach their goals; each goes on for two frames either way."""
    count, spacing = 9, 4
    tracks: list[tuple[float, list[int]]] = []

    def tracked(pose: FloatArray, rows: FloatArray) -> tuple[FloatArray, int]:
        tracks.append((float(pose[0]), rows.tolist()))
        return pose + np.arange(len(rows))[:, None] / 10, min(2, len(rows))

    def solved(starts: FloatArray, _: FloatArray) -> tuple[FloatArray, FloatArray]:
        return starts, np.where(np.arange(len(starts)) < 2, 0.0, 7.0)

    monkeypatch.setattr(
        branching,
        "_random_starts",
        lambda *of: (np.full(1, 100.0 * of[3] + k) for k in range(of[2])),
    )
    of = SimpleNamespace(
        poses=np.arange(9.0)[:, None],
        costs=np.full(9, 0.5),
        frames=np.arange(9),
        solve_frames=solved,
        track=tracked,
    )
    paths, costs = search_long_interval(of, spacing, 1)  # type: ignore[arg-type]
    assert (paths[0, :, 0].tolist(), costs[0].tolist()) == ([*range(9)], [0.5] * 9)
    reach = min(branching.MAX_LAYERS * spacing // 2, count)
    first = branching.SOLUTIONS_PER_SAMPLE
    for i, at in enumerate((0, 4, 8)):
        row = 1 + i % branching.MAX_LAYERS * first
        reached = {f for f in (at - 1, at, at + 1) if 0 <= f < count}
        for k in (0, 1):
            free = np.flatnonzero(costs[row + k] == 0).tolist()
            assert set(free) == reached or branching.MAX_LAYERS < 3
            assert paths[row + k, at, 0] == 100 * (1 + i) + k
        assert (costs[row + 2] == 2 * branching.MISS_COST).all()
    ahead = [rows for pose, rows in tracks if pose == 200.0]
    assert ahead == [
        [*range(4, min(4 + reach, 9))],
        [*range(4, max(4 - reach, -1), -1)],
    ]

"""Figures of solves that are cut short, of clips, and of takes at targets."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ik.test_following import around, planar
from support.figures import check_figures
from support.ik import arm, every_goal, limb, mixed_rig, random_pose, reached_by
from support.targets import legs, tracks_of, walk_of

from animtool.clip.channels import ClipUnits
from animtool.ik import (
    FollowOptions,
    Goal,
    IkMethod,
    IkOptions,
    IkResult,
    Problem,
    TakeOptions,
    Targets,
    build,
    follow,
    solve,
    solve_take,
)
from animtool.ik.fit import FitOptions, fit
from animtool.ik.match_take import match_take
from animtool.ik.report import goal_reports, take_notices
from animtool.ik.write import targets_text


def shown(result: IkResult) -> dict[str, Any]:
    return {
        "coordinates": result.coordinates,
        "statuses": [status.name for status in result.statuses],
        "iterations": result.iterations,
        "descents": result.descents,
        "misses": result.misses,
        "reached": result.reached,
        "stretches": result.stretches,
        "jumps": [asdict(jump) for jump in result.jumps],
    }


def off(problem: Problem, seed: int, count: int, by: float) -> Targets:
    """Return targets of random poses, each off by some length [m]."""
    aimed = reached_by(problem, random_pose(problem, seed, count))
    rng = np.random.default_rng(seed)
    moved = np.asarray(aimed.positions)
    moved = moved + rng.normal(0, by, moved.shape)
    return replace(aimed, positions=moved)


def mixed(method: str) -> Problem:
    goals = every_goal()[: 2 if method == "ccd" else 3]
    if method == "damped":
        goals[1] = replace(goals[1], priority=1)
    return build(mixed_rig(), goals, rest_weight=0.0 if method == "ccd" else 0.05)


@pytest.mark.parametrize("method", ["damped", "gradient", "newton", "ccd"])
@pytest.mark.parametrize("iterations", [1, 4, 30])
def test_every_goal_by_steps(method: str, iterations: int) -> None:
    problem = mixed(method)
    if method == "ccd":  # where it stops after more differs by processor
        iterations = min(iterations, 8)
    start = random_pose(problem, 5, 3)
    options = IkOptions(IkMethod(method), iterations=iterations, restarts=2, seed=3)
    result = solve(problem, start, off(problem, 9, 3, 0.15), options)
    check_figures(__file__, f"{method} {iterations}", shown(result))


@pytest.mark.parametrize(
    ("method", "problem"),
    [
        ("fabrik", build(arm(5), [Goal("b4", (0.4, 0.1, 0.0))])),
        ("two_bone", build(limb(), [Goal("elbow", (0.27, 0.0, 0.0), pole=0.0)])),
        ("auto", build(arm(4, 0.6), [Goal("b3", (0.4, 0.0, 0.1), orientation=0.2)])),
        (
            "damped",
            build(limb(), [Goal("elbow", (0.27, 0.0, 0.0), soft=0.2, stretch=0.15)]),
        ),
    ],
)
def test_chains(method: str, problem: Problem) -> None:
    start = random_pose(problem, 4, 4)
    options = IkOptions(IkMethod(method), iterations=40, restarts=3, near=True)
    targets = off(problem, 2, 4, 0.1)
    far = np.asarray(targets.positions).copy()
    far[-1] *= 2
    result = solve(problem, start, replace(targets, positions=far), options)
    check_figures(__file__, f"chain {method}", shown(result))


@pytest.mark.parametrize("smooth", [0.0, 0.2])
def test_a_clip_is_followed(smooth: float) -> None:
    problem = planar(1.2)
    points = around(0.8, 20) + np.array([0.0, 0.0, 0.1])
    options = FollowOptions(smooth=smooth, fps=30.0, branches=4, back=0.3)
    result = follow(problem, [0.2, 0.8, 0.4], Targets(points), options)
    check_figures(__file__, f"follow {smooth}", shown(result))


def test_a_clip_is_smoothed_along_limits() -> None:
    """What limits hold is left out of what may be smoothed."""
    t = np.linspace(0, 1, 24)
    problem = build(arm(5, 0.7), [Goal("b4", (0.4, 0.0, 0.0))])
    path = [1.6 - 0.15 * t, 0.45 * np.sin(5 * t), 0.4 * np.cos(4 * t)]
    targets = Targets(np.stack(path, axis=1)[:, None])
    options = FollowOptions(smooth=0.3, fps=24.0, branches=2, back=0.3)
    start = random_pose(problem, 3)[0]
    result = follow(problem, start, targets, options)
    check_figures(__file__, "evened pins", shown(result))


GOALS = """
- {effector: leg_l, hold: [[4, 9], [14, 18]], ease: 3, soft: 0.1, stretch: 0.1}
- {effector: leg_r, offset: [0, 0, 0.05], during: [[3, 16]], ease: 4,
   position: {keys: [{t: 1, v: [0.1, 0.1, 0.1]}, {t: 12, v: [0.3, 0.2, 0.4]}]},
   orientation: [0.9, 0.1, 0.3, 0.2], weight: {position: 0.8, orientation: 0.3}}
- {effector: tail, root: tail, priority: 1, aim: {axis: [0, 0, -1], at: [0.3, 1.2, -2]}}
"""


@pytest.mark.slow
@pytest.mark.parametrize("smooth", [0.0, 0.15])
def test_a_take_at_its_targets(tmp_path: Path, smooth: float) -> None:
    take = walk_of(legs(), count=20)
    tracks = tracks_of(tmp_path, GOALS, take.rig)
    options = TakeOptions(smooth=smooth, rest_weight=0.01, restarts=3)
    found = solve_take(take, tracks, options)
    goals = goal_reports(found)
    check_figures(
        __file__,
        f"take {smooth}",
        {
            "motion": list(found.take.motion.dense())[:2],
            "misses": found.misses,
            "statuses": [status.name for status in found.statuses],
            "goals": [asdict(goal) for goal in goals],
            "notices": take_notices(found, goals, is_smoothed=smooth > 0),
        },
    )


def test_targets_of_a_take() -> None:
    take = walk_of(legs(), count=12)
    tracks = match_take(take, take.rig.chains, Path("walk.targets.yaml"))
    text = targets_text(tracks, ClipUnits(0.01, np.pi / 180))
    sampled = tracks.sample(take.rig, take.clock, take.world())
    check_figures(
        __file__,
        "match",
        {
            "text": text.text,
            "arrays": text.arrays,
            "positions": np.asarray(sampled.positions),
            "rotations": np.asarray(sampled.rotations),
            "poles": np.asarray(sampled.poles),
        },
    )


def test_a_clip_is_fitted_from_far_starts() -> None:
    """Frame after frame is looked for; two targets are swapped, some are wild."""
    rig = arm(5, 1.2)
    goals = [Goal("b4", (0.4, 0.1, 0.0)), Goal("b2", (0.3, 0.0, 0.1)), Goal("b3")]
    problem = build(rig, goals)
    t = np.linspace(0, 1, 30)[:, None]
    poses = 0.7 * np.sin(t * [3.0, 4.0, 5.0, 2.0, 6.0] + np.arange(5))
    rng = np.random.default_rng(6)
    positions = np.asarray(reached_by(problem, poses).positions)
    positions = positions + rng.normal(0, 2e-3, positions.shape)
    positions[10:18, [0, 1]] = positions[10:18, [1, 0]]
    positions[22, 2] += 0.5
    weights = np.zeros((30, 3, 4))
    weights[:, :, 0] = problem.length / 2e-3
    weights[5:9, 1] = 0.0
    options = FitOptions(30.0, 40.0, robust=4.0, rounds=5)
    targets = Targets(positions, weights=weights)
    starts = np.tile([0.9, -0.8, 0.5, 0.0, -0.4], (30, 1))
    found = [
        fit(problem, targets, starts, options),
        fit(problem, targets, starts, options, path=poses + 0.05),
        fit(problem, targets, starts, options, path=poses, first=12),
    ]
    check_figures(
        __file__,
        "fit",
        [
            [
                one.coordinates,
                one.misses,
                one.is_restarted,
                one.target_indices,
                one.cost_after,
            ]
            for one in found
        ],
    )

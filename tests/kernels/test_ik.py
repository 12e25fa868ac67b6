"""Inverse kinematics by closed forms: targets, goals and paths of small chains."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from animtool import _kernels
from animtool.ik.goals import GOAL_KINDS, GOAL_PARTS, TARGET_COLUMNS, WEIGHT_COLUMNS

HALF = np.sqrt(0.5)
INF = np.inf


def chain(*offsets: float) -> dict[str, Any]:
    """Return pins about z, each so far along x from the one before."""
    count = len(offsets)
    numbers = np.zeros((count, 18))
    numbers[:, [0, 4, 8, 12]] = 1
    numbers[:, 9] = offsets
    numbers[:, 14:16] = [-INF, INF]
    nodes = [[0, k - 1, k, 0] for k in range(count)]
    return {"nodes": np.array(nodes), "numbers": numbers}


def goal(node: int, tip: float, **weights: float) -> dict[str, Any]:
    """Return one goal at a tip along x, aimed along x."""
    numbers = [
        tip,
        0,
        0,
        0,
        0,
        0,
        1,
        0,
        0,
        *(weights.get(part, 0) for part in GOAL_PARTS),
    ]
    return {
        "goals": np.array([[node, -1, -1, 0]]),
        "goal_numbers": np.array([numbers], float),
    }


def target(
    position: tuple[float, ...] = (0, 0, 0), aim: tuple[float, ...] = (0, 0, 0)
) -> np.ndarray:
    row = np.zeros((1, 1, WEIGHT_COLUMNS.stop))
    row[..., TARGET_COLUMNS["position"]], row[..., TARGET_COLUMNS["aim"]] = (
        position,
        aim,
    )
    row[..., TARGET_COLUMNS["orientation"].stop - 1] = row[..., WEIGHT_COLUMNS] = 1
    return row


def looked(arrays: dict[str, Any], start: list[float], goals: np.ndarray) -> Any:
    zero = np.zeros((1, len(start)))
    return _kernels.linearize_ik(
        **arrays, starts=np.array([start]), targets=goals, steps=zero
    )


def test_kinds_of_goals_are_those_of_the_table() -> None:
    table = [
        (
            kind.name,
            kind.residual_count,
            kind.value_type.value,
            kind.is_length,
            kind.supports_ccd,
        )
        for kind in GOAL_KINDS
    ]
    assert list(_kernels.IK_GOAL_KINDS) == table


def test_targets_are_shares_of_the_length_and_seen_from_their_nodes() -> None:
    targets = np.zeros((2, 2, WEIGHT_COLUMNS.stop))
    targets[:] = np.arange(WEIGHT_COLUMNS.stop)
    about_x = [HALF, 0, 0, HALF]
    targets[0, :, 3:7] = about_x
    targets[1, 0, 3:7] = np.multiply(1e-200, about_x)
    targets[1, 1, 3:7] = 0
    frames = np.array([[0, 0, HALF, HALF], [0, 0, 0, 1.0]])
    _kernels.to_chain_targets(targets, frames, 4.0)
    plain = [0, 1, 2, 7, 8, 9, 10, 11, 12]
    assert_allclose(targets[..., plain], np.tile(np.divide(plain, 4), (2, 2, 1)))
    shares = np.arange(WEIGHT_COLUMNS.stop)[WEIGHT_COLUMNS]
    assert_allclose(targets[..., WEIGHT_COLUMNS], np.tile(shares, (2, 2, 1)))
    turned = [0.5, 0.5, -0.5, 0.5]
    assert_allclose(targets[:, 0, 3:7], [turned, turned], atol=1e-15)
    assert_allclose(targets[:, 1, 3:7], [about_x, [0, 0, 0, 1]], atol=1e-15)


def test_an_aim_at_its_own_point_is_met() -> None:
    arrays = chain(0, 0.5) | goal(1, 0.5, aim=1)
    angle = 0.3
    own = 0.5 * np.array([np.cos(angle) + np.cos(2 * angle), 0])
    own[1] = 0.5 * (np.sin(angle) + np.sin(2 * angle))
    _, residuals, jacobians, _ = looked(
        arrays, [angle, angle], target(aim=(*own.tolist(), 0))
    )
    assert_allclose(residuals, 0, atol=1e-12)
    assert np.isfinite(jacobians).all()


def test_an_aim_misses_by_its_angle() -> None:
    arrays = chain(0, 0.5) | goal(1, 0.0, aim=2)
    _, residuals, _, _ = looked(arrays, [0, 0], target(aim=(0.5, 3, 0)))
    assert_allclose(np.linalg.norm(residuals), 2 * np.pi / 2)


def solved(arrays: dict[str, Any], goals: np.ndarray, method: int) -> Any:
    count = len(arrays["nodes"])
    none = np.zeros((1, count))
    return _kernels.solve_ik(
        **arrays, starts=none, targets=goals, reachable=goals,
        stretches=np.ones((1, 1)), rests=none, rest_weight=0.0,
        length_tolerance=1e-6, angle_tolerance=1e-6, damping=1e-3, iterations=50,
        restarts=0, seed=1, seconds=0.0, ordered=False,
        warm=False, method=method,
    )  # fmt: skip


# Without steepest descent, which goes to and fro for hundreds of steps.
@pytest.mark.parametrize("method", [0, 2, 3, 4])
def test_a_joint_turns_what_follows_a_shut_one_in_its_place(method: int) -> None:
    arrays = chain(0, 0) | goal(1, 0.5, position=1)
    arrays["numbers"][1, 14:16] = 0
    angle = 0.7
    at = (0.5 * np.cos(angle), 0.5 * np.sin(angle), 0.0)
    coordinates, misses, reports, _ = solved(arrays, target(at), method)
    assert_allclose(coordinates[0], [angle, 0], atol=1e-5)
    assert misses[0, 0, 0] <= 1e-6
    assert reports[0, 0] == 0


@pytest.mark.parametrize(("method", "most"), [(0, 8), (2, 8), (3, 6)])
def test_a_target_out_of_reach_is_pointed_at_in_few_steps(
    method: int, most: int
) -> None:
    """The bone's length is a quarter of the way: its second derivatives count."""
    arrays = chain(0) | goal(0, 0.5, position=1)
    at = (2 * np.cos(0.7), 2 * np.sin(0.7), 0.0)
    coordinates, misses, reports, _ = solved(arrays, target(at), method)
    assert_allclose(coordinates, [[0.7]], atol=1e-8)
    assert_allclose(misses[0, 0], [1.5, *[0] * (len(GOAL_PARTS) - 1)], atol=1e-12)
    assert reports[0, 0] != 0
    assert reports[0, 1] <= most


def smoothed(
    arrays: dict[str, Any], path: np.ndarray, drifts: np.ndarray, **given: Any
) -> Any:
    frames = len(path)
    goals = np.tile(target(), (frames, 1, 1))
    return _kernels.smooth_ik(
        **arrays, path=path, targets=goals, reachable=goals,
        stretches=np.ones((frames, 1)), drifts=drifts, length_tolerance=1e-4,
        angle_tolerance=1e-4, damping=1e-9, **given,
    )  # fmt: skip


def cost_matrix(frames: int, weights: tuple[float, float, float]) -> np.ndarray:
    """Return H of the cost ``x^T H x / 2`` of motion less its drift."""
    first = np.diff(np.eye(frames), axis=0)
    second = np.diff(first, axis=0)
    anchor, speed, acceleration = weights
    return (
        anchor * np.eye(frames)
        + speed * first.T @ first
        + acceleration * second.T @ second
    )


def test_a_free_path_is_the_least_squares_one() -> None:
    """Without goals the frames that move solve a linear system."""
    rng = np.random.default_rng(0)
    frames, first, end = 12, 2, 10
    path = rng.normal(scale=0.1, size=(frames, 2))
    drifts = rng.normal(scale=0.05, size=(frames - 1, 2))
    weights = (0.3, 2.0, 5.0)
    q, _, rounds, before, after = smoothed(
        chain(0, 0.5) | goal(1, 0.5), path, drifts, first=first, end=end, rounds=20,
        anchor=weights[0], speed=weights[1], acceleration=weights[2],
    )  # fmt: skip
    drifted = np.concatenate([np.zeros((1, 2)), np.cumsum(drifts, axis=0)])
    anchor, rest = weights[0] * np.eye(frames), cost_matrix(frames, (0, *weights[1:]))
    # The anchor pulls at the pose, the rest at the pose less what it drifts.
    whole, right = anchor + rest, anchor @ path + rest @ drifted
    inside = np.arange(first, end)
    outside = np.setdiff1d(np.arange(frames), inside)
    expected = path.copy()
    expected[inside] = np.linalg.solve(
        whole[np.ix_(inside, inside)],
        right[inside] - whole[np.ix_(inside, outside)] @ path[outside],
    )
    assert rounds > 0
    assert_allclose(q, expected, atol=1e-8)

    def cost(x: np.ndarray) -> float:
        off, own = x - path, x - drifted
        return float(np.sum(off * (anchor @ off) + own * (rest @ own)) / 2)

    assert_allclose([before, after], [cost(path), cost(expected)], rtol=1e-9)

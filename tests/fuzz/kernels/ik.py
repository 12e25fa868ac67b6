"""Inverse kinematics."""

from __future__ import annotations

from typing import Any

import numpy as np

from animtool import _kernels
from animtool.ik.goals import GOAL_KINDS, WEIGHT_COLUMNS
from fuzz.kernels import Maker
from fuzz.kernels.curves import rotations
from fuzz.kernels.points import WIDTHS, joint_arrays, parents

Rng = np.random.Generator

_PIN, _SLIDE, _BALL = range(3)


class Problem:
    """A chain of N nodes and E goals on them.

    Attributes:
        chain: ``nodes`` and ``numbers``.
        arrays: These, ``goals`` and ``goal_numbers``.
        coordinates: Of a pose, Q.
        dofs: Degrees of freedom, D.
    """

    def __init__(self, rng: Rng) -> None:
        count, goals = int(rng.integers(1, 7)), int(rng.integers(0, 4))
        self.kinds = rng.integers(0, 3, count)
        self.nodes = np.zeros((count, 4), np.int64)
        self.numbers = np.zeros((count, 18))
        self.coordinates = self.dofs = 0
        self.begins: list[int] = []
        above = parents(rng, count)
        for n in range(count):
            self._add(rng, n, int(above[n]))
        self.chain = {"nodes": self.nodes, "numbers": self.numbers}
        self.goals = np.zeros((goals, 4), np.int64)
        for row in self.goals:
            tip = int(rng.integers(count))
            row[:] = [tip, rng.integers(tip + 1), rng.integers(tip + 1), 0]
        self.goals[:, 3] = rng.integers(0, max(goals, 1), goals)
        numbers = rng.normal(size=(goals, 9 + len(GOAL_KINDS)))
        numbers[:, 6:9] = [0, 0, 1]
        numbers[:, 9:] = rng.choice([0.0, 0.1, 1.0], (goals, 4))
        self.arrays = {**self.chain, "goals": self.goals, "goal_numbers": numbers}

    def _add(self, rng: Rng, n: int, parent: int) -> None:
        kind = int(self.kinds[n])
        followed = [m for m in range(n) if self.kinds[m] != _BALL and not self._led(m)]
        follows = kind != _BALL and bool(followed) and rng.random() < 0.2
        at = self.begins[followed[0]] if follows else self.coordinates
        self.begins.append(at)
        self.nodes[n] = [kind, parent, at, follows]
        numbers = self.numbers[n]
        numbers[:9] = np.eye(3).reshape(-1)
        numbers[9:12] = rng.normal(scale=0.3, size=3)
        numbers[12:14] = [1, 0]
        limited = bool(rng.integers(2))
        if kind == _BALL:
            free = [np.inf, np.inf, -np.inf, np.inf]
            numbers[14:] = [0.5, 1.0, -0.5, 0.5] if limited else free
        else:
            numbers[14:16] = [-1, 1] if limited else [-np.inf, np.inf]
        if not follows:
            self.coordinates += 4 if kind == _BALL else 1
            self.dofs += 3 if kind == _BALL else 1

    def _led(self, n: int) -> bool:
        return bool(self.nodes[n, 3])

    def poses(self, rng: Rng, *shape: int) -> Any:
        """Return poses within or near the limits."""
        values = rng.uniform(-1, 1, (*shape, self.coordinates))
        for n, (kind, _, at, _) in enumerate(self.nodes.tolist()):
            if self.kinds[n] == _BALL:
                values[..., at : at + 4] = rotations(rng, *shape)
            assert kind in {_PIN, _SLIDE, _BALL}
        return values

    def targets(self, rng: Rng, batch: int) -> Any:
        """Return targets ``(B, E, W)``."""
        values = rng.normal(
            scale=0.5, size=(batch, len(self.goals), WEIGHT_COLUMNS.stop)
        )
        values[..., 3:7] = rotations(rng, batch, len(self.goals))
        values[..., WEIGHT_COLUMNS] = rng.choice(
            [0.0, 1.0], values[..., WEIGHT_COLUMNS].shape
        )
        return values


def _place(rng: Rng) -> dict[str, Any]:
    batch, goals = (int(n) for n in rng.integers(0, 5, 2))
    return {
        "targets": rng.normal(size=(batch, goals, WEIGHT_COLUMNS.stop)),
        "frames": rotations(rng, goals),
        "length": 1.7,
    }


def _solve(rng: Rng) -> dict[str, Any]:
    problem, batch = Problem(rng), int(rng.integers(0, 4))
    targets = problem.targets(rng, batch)
    return {
        **problem.arrays,
        "starts": problem.poses(rng, batch),
        "targets": targets,
        "reachable": targets.copy() if rng.integers(2) else problem.targets(rng, batch),
        "stretches": rng.choice([1.0, 1.2], targets.shape[:2]),
        "rests": problem.poses(rng, batch),
        "rest_weight": float(rng.choice([0.0, 1e-4])),
        "length_tolerance": 1e-6,
        "angle_tolerance": 1e-6,
        "damping": 1e-3,
        "iterations": 60,
        "restarts": 3,
        "seed": int(rng.integers(2**63)),
        "seconds": float(rng.choice([0.0, 0.5])),
        "ordered": bool(rng.integers(2)),
        "warm": bool(rng.integers(2)),
        "method": int(rng.integers(4 if _SLIDE in problem.kinds else 5)),
    }


def _linearize(rng: Rng) -> dict[str, Any]:
    problem, batch = Problem(rng), int(rng.integers(0, 4))
    return {
        **problem.arrays,
        "starts": problem.poses(rng, batch),
        "targets": problem.targets(rng, batch),
        "steps": rng.normal(scale=0.1, size=(batch, problem.dofs)),
    }


def _smooth(rng: Rng) -> dict[str, Any]:
    problem, frames = Problem(rng), int(rng.integers(1, 7))
    targets = problem.targets(rng, frames)
    first, end = sorted(rng.integers(0, frames + 1, 2).tolist())
    return {
        **problem.arrays,
        "path": problem.poses(rng, frames),
        "targets": targets,
        "reachable": targets.copy(),
        "stretches": np.ones(targets.shape[:2]),
        "drifts": rng.normal(scale=0.1, size=(max(frames - 1, 0), problem.dofs)),
        "anchor": float(rng.choice([1e-3, 1.0])),
        "speed": 1.0,
        "acceleration": float(rng.choice([0.0, 10.0])),
        "first": first,
        "end": end,
        "length_tolerance": 1e-6,
        "angle_tolerance": 1e-6,
        "damping": 1e-6,
        "rounds": int(rng.integers(0, 3)),
    }


def _fit(rng: Rng) -> dict[str, Any]:
    problem, frames = Problem(rng), int(rng.integers(1, 7))
    first, end = sorted(rng.integers(0, frames + 1, 2).tolist())
    return {
        **problem.arrays,
        "path": problem.poses(rng, frames),
        "targets": problem.targets(rng, frames),
        "starts": problem.poses(rng, frames),
        "anchor": float(rng.choice([1e-3, 1.0])),
        "speed": float(rng.choice([0.0, 1.0])),
        "acceleration": float(rng.choice([0.0, 10.0])),
        "robust": float(rng.choice([0.1, 8.0, np.inf])),
        "rest_weight": float(rng.choice([0.0, 10.0])),
        "homing": float(rng.choice([0.0, 0.1])),
        "first": first,
        "end": end,
        "iterations": int(rng.integers(0, 9)),
        "rounds": int(rng.integers(0, 3)),
        "tracked": bool(rng.integers(2)),
    }


def _cheapest(rng: Rng) -> dict[str, Any]:
    problem = Problem(rng)
    count, length = int(rng.integers(1, 5)), int(rng.integers(0, 6))
    steps = max(length - 1, 0)
    return {
        **problem.chain,
        "paths": problem.poses(rng, count, length),
        "costs": rng.uniform(0, 1, (count, length)),
        "drifts": rng.normal(scale=0.1, size=(steps, problem.dofs)),
        "free_step": rng.uniform(0, 1, steps),
        "allows_any_start": bool(rng.integers(2)),
        "must_end_on_first": bool(rng.integers(2)),
    }


def _extend(rng: Rng) -> dict[str, Any]:
    problem, batch = Problem(rng), int(rng.integers(0, 4))
    return {**_limbs(rng, problem), "targets": problem.targets(rng, batch)}


def _limbs(rng: Rng, problem: Problem) -> dict[str, Any]:
    count = int(rng.integers(0, 3)) if len(problem.goals) else 0
    numbers = rng.uniform(0.1, 1.0, (count, 7))
    numbers[:, 5:] *= rng.choice([0.0, 0.5], (count, 2))
    return {
        "limbs": rng.integers(0, max(len(problem.goals), 1), count),
        "limb_numbers": numbers,
    }


def _arm(rng: Rng) -> dict[str, Any]:
    problem = Problem(rng)
    return {**problem.arrays, "rest_weight": float(rng.choice([0.0, 1e-4]))}


def _six_pins(problem: Problem) -> None:
    """Make a problem one of an arm with parallel axes."""
    out, across = np.eye(3).reshape(-1), [1.0, 0, 0, 0, 0, 1, 0, -1, 0]
    back = [1.0, 0, 0, 0, 0, -1, 0, 1, 0]
    problem.nodes = np.array([[0, n - 1, n, 0] for n in range(6)], np.int64)
    problem.numbers = np.zeros((6, 18))
    problem.numbers[:, :9] = [out, across, out, out, back, across]
    problem.numbers[1:, 9] = [0.1, 0.4, 0.4, 0.1, 0.0]
    problem.numbers[:, 12] = 1
    problem.numbers[:, 14:16] = [-np.inf, np.inf]
    problem.kinds = np.zeros(6, np.int64)
    problem.coordinates = problem.dofs = 6
    problem.goals = np.array([[5, -1, -1, 0]])
    numbers = np.array([[0.1, 0.1, 0, 0, 0, 0.1, 0, 0, 1, 1, 1, 0, 0]])
    problem.chain = {"nodes": problem.nodes, "numbers": problem.numbers}
    problem.arrays = {**problem.chain, "goals": problem.goals, "goal_numbers": numbers}


def _rig_solver(rng: Rng, *, arm: bool = False) -> dict[str, Any]:
    problem = Problem(rng)
    if arm:
        _six_pins(problem)
    joints = joint_arrays(rng, int(rng.integers(2, 6)))
    # At least as many columns as coordinates: the last joints are free.
    width = sum(WIDTHS[kind] for kind in joints["types"].tolist())
    while width < problem.coordinates:
        more = joint_arrays(rng, 1) | {"types": np.array([4]), "columns": [width]}
        joints = {
            key: np.concatenate([joints[key], np.asarray(more[key])]) for key in joints
        }
        width += 7
    balls = [at for n, at in enumerate(problem.begins) if problem.kinds[n] == _BALL]
    balls = [] if arm else balls
    count = len(joints["types"])
    periods = np.tile([-np.inf, np.inf], (problem.coordinates, 1))
    return {
        **problem.arrays,
        "rest_weight": 0.0,
        "goal_frames": rotations(rng, len(problem.goals)),
        "length": 1.5,
        "columns": rng.permutation(width)[: problem.coordinates],
        "scales": np.ones(problem.coordinates),
        "periods": periods,
        "balls": np.array(balls, np.int64),
        "ball_frames": rotations(rng, len(balls)),
        "mimics": rng.integers(0, max(width, 1), (1 if width else 0, 2)),
        "mimic_numbers": rng.normal(size=(1 if width else 0, 2)),
        **_limbs(rng, problem),
        "limb_joints": np.zeros((1, 2), np.int64)[: len(problem.goals)],
        "parents": parents(rng, count),
        "joint_columns": joints.pop("columns"),
        **joints,
        "closed": 2 if arm else 0,
        "length_tolerance": 1e-6,
        "angle_tolerance": 1e-6,
        "damping": 1e-3,
        "iterations": 60,
        "restarts": 3,
        "seed": int(rng.integers(2**63)),
        "seconds": 0.0,
        "ordered": bool(rng.integers(2)),
        "warm": bool(rng.integers(2)),
        "method": 0,
    }


def _asked(rng: Rng, *, arm: bool) -> tuple[Any, int, Any]:
    """Return a solver, how wide its rows are, and targets of a problem."""
    made = _rig_solver(rng, arm=arm)
    width = sum(WIDTHS[kind] for kind in made["types"].tolist())
    shape = (1, len(made["goals"]), WEIGHT_COLUMNS.stop)
    targets = rng.normal(scale=0.3, size=shape)
    targets[..., 3:7] = rotations(rng, *shape[:2])
    targets[..., WEIGHT_COLUMNS] = 1.0
    return _kernels.RigSolver(**made), width, targets


def _rig_solve(rng: Rng) -> dict[str, Any]:
    solver, width, targets = _asked(rng, arm=bool(rng.integers(2)))
    batch = int(rng.integers(0, 4))
    starts = rng.normal(size=(batch, width))
    return {
        "self": solver,
        "starts": starts,
        "targets": np.repeat(targets, batch, axis=0),
        "preferred": starts if rng.integers(2) else None,
        "returns_joint_poses": bool(rng.integers(2)),
    }


def _branches(rng: Rng) -> dict[str, Any]:
    solver, width, targets = _asked(rng, arm=True)
    return {"self": solver, "start": rng.normal(size=width), "targets": targets[0]}


CALLS: dict[str, Maker] = {
    "to_chain_targets": _place,
    "solve_ik": _solve,
    "extend_ik_limbs": _extend,
    "arm_kind": _arm,
    "RigSolver": _rig_solver,
    "RigSolver.solve": _rig_solve,
    "RigSolver.branches": _branches,
    "linearize_ik": _linearize,
    "smooth_ik": _smooth,
    "fit_ik": _fit,
    "cheapest_ik_path": _cheapest,
}
UNBOUNDED: frozenset[str] = frozenset()

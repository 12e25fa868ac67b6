"""Inverse kinematics."""

from __future__ import annotations

from typing import Any

import numpy as np

from animtool.ik.goals import KINDS, WEIGHTS
from fuzz.kernels import Maker
from fuzz.kernels.curves import rotations
from fuzz.kernels.points import parents

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
        numbers = rng.normal(size=(goals, 9 + len(KINDS)))
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
        values = rng.normal(scale=0.5, size=(batch, len(self.goals), WEIGHTS.stop))
        values[..., 3:7] = rotations(rng, batch, len(self.goals))
        values[..., WEIGHTS] = rng.choice([0.0, 1.0], values[..., WEIGHTS].shape)
        return values


def _place(rng: Rng) -> dict[str, Any]:
    batch, goals = (int(n) for n in rng.integers(0, 5, 2))
    return {
        "targets": rng.normal(size=(batch, goals, WEIGHTS.stop)),
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
        "sought": targets.copy() if rng.integers(2) else problem.targets(rng, batch),
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
        "sought": targets.copy(),
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
        "easy": rng.uniform(0, 1, steps),
        "open": bool(rng.integers(2)),
        "closed": bool(rng.integers(2)),
    }


CALLS: dict[str, Maker] = {
    "place_ik_targets": _place,
    "solve_ik": _solve,
    "linearize_ik": _linearize,
    "smooth_ik": _smooth,
    "fit_ik": _fit,
    "cheapest_ik_path": _cheapest,
}
UNBOUNDED: frozenset[str] = frozenset()

"""The loop of a process that solves what the driver asks for, one job at a time.

A job is a line of JSON; the answer is one too, below arrays in the file that the job
names. Models are built when a case is first asked for, which no time counts.
"""

from __future__ import annotations

import gc
import json
import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from clock import Taken, now, since
from ik_problems import Array, Case, read_cases

# Poses whose kinematics are compared, and how wide they are drawn.
POSES, SEED = 4, 5


@dataclass(frozen=True)
class Asked:
    """How near to come, and how long to try.

    Attributes:
        position: Of every position [m].
        angle: Of every rotation [rad].
        restarts: Most new starts.
        seconds: Most time for one problem [s].
        steps: Most steps from one start, of tools that are asked for each.
        timeout: So many steps without a miss smaller by a hundredth end a descent.
    """

    position: float
    angle: float
    restarts: int
    seconds: float
    steps: int = 30
    timeout: int = 3


# A pose and what it took.
Solved = tuple[Array, Taken]


class Solver(Protocol):
    """A tool that has built a case's model."""

    def places(self, pose: Array) -> tuple[Array, Array]:
        """Return effectors' rotations ``(E, 3, 3)`` and points ``(E, 3)``."""

    def solve(self, starts: Array, frames: range, asked: Asked) -> Iterator[Solved]:
        """Yield the pose of each target, from a start of its own."""

    def follow(self, start: Array, frames: range, asked: Asked) -> Iterator[Solved]:
        """Yield the pose of each frame, from the one before."""


class OneByOne(ABC):
    """A tool that takes one target a call."""

    @abstractmethod
    def one(self, start: Array, frame: int, asked: Asked) -> Solved:
        """Return the pose of a target, and what it took."""

    def solve(self, starts: Array, frames: range, asked: Asked) -> Iterator[Solved]:
        for start, frame in zip(starts, frames, strict=True):
            yield self.one(start, frame, asked)

    def follow(self, start: Array, frames: range, asked: Asked) -> Iterator[Solved]:
        pose = start
        for frame in frames:
            pose, taken = self.one(pose, frame, asked)
            yield pose, taken


class Draw:
    """Random poses within a case's limits; quaternions over all rotations."""

    def __init__(self, case: Case) -> None:
        width = case.starts.shape[1]
        self.low, self.high = np.full(width, -np.inf), np.full(width, np.inf)
        self.wide = np.zeros(width)
        self.balls = []
        for joint, place in zip(case.joints, case.slices, strict=True):
            if joint["type"] == "ball":
                self.balls.append(place)
            elif joint["type"] != "fixed":
                self.wide[place] = np.pi if joint["type"] == "pin" else case.length / 2
                if joint.get("limits"):
                    self.low[place], self.high[place] = joint["limits"]
        self.near = self.high - self.low > 4 * self.wide

    def pose(self, rng: np.random.Generator, start: Array) -> Array:
        """Return a pose; joints with no limits, or wide ones, stay near the start."""
        low = np.where(self.near, np.maximum(start - self.wide, self.low), self.low)
        high = np.where(self.near, np.minimum(start + self.wide, self.high), self.high)
        made = rng.uniform(low, high)
        for place in self.balls:
            turn = rng.normal(size=4)
            made[place] = turn / np.linalg.norm(turn)
        return made


class Stepper(Protocol):
    """A tool that has steps and no descents of its own."""

    def aim(self, frame: int) -> None:
        """Take the targets of a frame."""

    def put(self, pose: Array) -> None:
        """Stand in a pose."""

    def pose(self) -> Array:
        """Return the pose, within the limits."""

    def step(self) -> bool:
        """Take a step; False where there is none."""

    def misses(self) -> tuple[float, float]:
        """Return the largest miss of a position [m] and of a rotation [rad]."""

    def cost(self) -> float:
        """Return the sum of squares of what all goals miss, weighted."""


@dataclass
class Descents:
    """Steps until every goal is reached, with new starts where they end short.

    Attributes:
        stepper: Takes the steps.
        case: Its case.
    """

    stepper: Stepper
    case: Case

    def __post_init__(self) -> None:
        self.draw = Draw(self.case)

    def solve(self, starts: Array, frames: range, asked: Asked) -> Iterator[Solved]:
        """Yield poses, each from its own start."""
        rng = np.random.default_rng(SEED)
        for start, frame in zip(starts, frames, strict=True):
            yield self._timed(start, frame, asked, rng)

    def follow(self, start: Array, frames: range, asked: Asked) -> Iterator[Solved]:
        """Yield poses, each from the one before."""
        rng, pose = np.random.default_rng(SEED), start
        for frame in frames:
            pose, taken = self._timed(pose, frame, asked, rng)
            yield pose, taken

    def _timed(
        self, start: Array, frame: int, asked: Asked, rng: np.random.Generator
    ) -> Solved:
        began = now()
        self.stepper.aim(frame)
        if self._descend(start, asked):
            return self.stepper.pose(), since(began)
        best, pose = self.stepper.cost(), self.stepper.pose()
        for _ in range(asked.restarts):
            if time.perf_counter() - began.wall > asked.seconds:
                break
            reached = self._descend(self.draw.pose(rng, start), asked)
            cost = self.stepper.cost()
            if reached or cost < best:
                best, pose = cost, self.stepper.pose()
            if reached:
                break
        return pose, since(began)

    def _descend(self, start: Array, asked: Asked) -> bool:
        """Take steps; return whether every goal is reached."""
        self.stepper.put(start)
        best, waited = np.inf, 0
        for _ in range(asked.steps):
            position, angle = self.stepper.misses()
            miss = max(position / asked.position, angle / asked.angle)
            if miss <= 1:
                return True
            waited = 0 if miss < 0.99 * best else waited + 1
            best = min(best, miss)
            if waited > asked.timeout or not self.stepper.step():
                break
        position, angle = self.stepper.misses()
        return position <= asked.position and angle <= asked.angle


def serve(build: Callable[[Case], Solver]) -> None:
    """Answer the jobs on standard input until it ends."""
    files: dict[str, list[Case]] = {}
    solvers: dict[tuple[str, int], Solver] = {}
    for line in sys.stdin:
        job: dict[str, Any] = json.loads(line)
        path, index = job["file"], job["case"]
        if path not in files:
            files[path] = read_cases(Path(path))
        case = files[path][index]
        if (path, index) not in solvers:
            solvers[path, index] = build(case)
        arrays = _answer(job, case, solvers[path, index])
        np.savez(job["out"], allow_pickle=False, **arrays)
        print(json.dumps({"done": True}), flush=True)


def _answer(job: dict[str, Any], case: Case, solver: Solver) -> dict[str, Array]:
    if job["what"] == "places":
        rng, draw = np.random.default_rng(SEED), Draw(case)
        poses = np.array([draw.pose(rng, case.starts[0]) for _ in range(POSES)])
        found = [solver.places(pose) for pose in poses]
        turns, points = (np.array(part) for part in zip(*found, strict=True))
        return {"poses": poses, "turns": turns, "points": points}
    asked, frames = Asked(**job["asked"]), range(job["count"])
    gc.collect()
    gc.disable()
    if job["what"] == "follow":
        pairs = list(solver.follow(case.starts[0], frames, asked))
    else:
        pairs = list(solver.solve(case.starts[: job["count"]], frames, asked))
    gc.enable()
    poses = np.array([pose for pose, _ in pairs])
    wall, cpu = (
        np.array(part) for part in zip(*(one for _, one in pairs), strict=True)
    )
    return {"poses": poses, "wall": wall, "cpu": cpu}

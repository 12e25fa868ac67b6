"""Preferred velocities of agents."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.systems.crowds.agents import Agents
from animtool.systems.crowds.routes import FlowField, NavGrid, routes_to
from animtool.systems.crowds.spec import CrowdGoalModel

# Time constant of stopping at a goal, and of returning to a slot in a group or queue
# [s].
STOPPING = 0.5
# Speed of returning to a group, over the preferred speed.
CATCHING_UP = 0.5
# Distance at which agents join a queue's end, over its spacing.
JOINING = 2.0
# Packing fraction of agents at a goal, whose radius grows with them.
PACKED = 0.5
# Fraction of a goal's radius that staying agents enter.
INNER = 0.5
NO_TICKET = -1
GONE = -1


@dataclass(frozen=True, slots=True)
class Progress:
    """The progress of N agents on their routes.

    Attributes:
        stages: Number of passed goals; `GONE` for agents that left ``(N,)``.
        waited: Time waited at the goal ``(N,)`` [s].
        tickets: Order in the queue at its goal, `NO_TICKET` in none ``(N,)``.
    """

    stages: IntArray
    waited: FloatArray
    tickets: IntArray


@dataclass(frozen=True)
class Steering:
    """Goals of agents, and their flow fields.

    Attributes:
        points: x and z of each goal ``(G, 2)`` [m].
        lines: Of each, from one to the next of its queue ``(G, 2)``, 0 of none [m].
    """

    agents: Agents
    goals: Sequence[CrowdGoalModel]
    points: FloatArray
    lines: FloatArray
    grid: NavGrid | None  # None without obstacles

    @cached_property
    def routes(self) -> list[FlowField]:
        """Return the flow fields to each goal; none without obstacles."""
        return [] if self.grid is None else routes_to(self.grid, self.points)

    @cached_property
    def _plans(self) -> tuple[IntArray, IntArray, BoolArray, BoolArray]:
        """Return each agent's route, its length, and whether it repeats or leaves."""
        populations = self.agents.entries
        names = [goal.name for goal in self.goals]
        longest = max((len(one.route) for one in populations), default=0)
        table = np.full((len(populations), longest + 1), -1)
        for i, one in enumerate(populations):
            table[i, : len(one.route)] = [names.index(name) for name in one.route]
        counts = np.array([len(one.route) for one in populations])
        again = np.array([one.then == "repeat" for one in populations])
        leaves = np.array([one.then == "leave" for one in populations])
        kinds = self.agents.kinds
        return table[kinds], counts[kinds], again[kinds], leaves[kinds]

    def first(self) -> Progress:
        """Return the initial progress."""
        count = len(self.agents)
        return Progress(
            np.zeros(count, np.int64), np.zeros(count), np.full(count, NO_TICKET)
        )

    def heading_for(self, progress: Progress) -> IntArray:
        """Return the current goal of each agent ``(N,)``, -1 for none."""
        table, counts, again, _ = self._plans
        stages = progress.stages
        stage = np.where(
            again, stages % np.maximum(counts, 1), np.minimum(stages, counts)
        )
        goal = table[np.arange(len(stages)), np.maximum(stage, 0)]
        return np.where(stages == GONE, -1, goal)

    def targets(
        self, progress: Progress, goal: IntArray, x: FloatArray
    ) -> tuple[FloatArray, BoolArray]:
        """Return each agent's final position ``(N, 2)`` [m], and who queues."""
        if not len(self.points):
            return x, np.zeros(len(x), np.bool_)
        at = self._middles(goal, x)
        radii = np.array([one.radius for one in self.goals])
        next_to_goal = (
            at + self.agents.offsets * np.where(goal >= 0, radii[goal], 0.0)[:, None]
        )
        if self.grid is None:
            at = next_to_goal
        else:
            # Only if it is reachable from the centre.
            nodes = self.grid.at(np.stack([at, next_to_goal]).reshape(-1, 2))
            parts = self.grid.parts[nodes[:, 0], nodes[:, 1]].reshape(2, -1)
            at = np.where((parts[0] == parts[1])[:, None], next_to_goal, at)
        queued = progress.tickets != NO_TICKET
        for g in np.unique(goal[queued]).tolist():
            line = np.flatnonzero(queued & (goal == g))
            line = line[np.argsort(progress.tickets[line], kind="stable")]
            at[line] = self.points[g] + np.arange(len(line))[:, None] * self.lines[g]
        return at, queued

    def _middles(self, goal: IntArray, x: FloatArray) -> FloatArray:
        """Return each agent's reachable goal ``(N, 2)`` [m]; without one, x."""
        at = np.where((goal >= 0)[:, None], self.points[goal], x)
        for g, route in enumerate(self.routes):
            assigned = goal == g
            at[assigned] = route.goal(x[assigned])
        return np.asarray(at)

    def preferred(
        self, t: float, begin: float, progress: Progress, x: FloatArray
    ) -> FloatArray:
        """Return preferred velocities at a time [s] ``(N, 2)`` [m/s]."""
        agents = self.agents
        goal = self.heading_for(progress)
        target, queued = self.targets(progress, goal, x)
        off = target - x
        far = np.linalg.norm(off, axis=1)
        directions = off / np.maximum(far, np.finfo(float).tiny)[:, None]
        for g, route in enumerate(self.routes):
            assigned = (goal == g) & ~queued
            if assigned.any():
                directions[assigned] = route.directions(x[assigned], target[assigned])
        speeds = np.minimum(agents.speeds, far / STOPPING)
        speeds = np.where((goal >= 0) & (t - begin >= agents.delays), speeds, 0.0)
        # Waiting agents make room for those behind, and stay.
        waits = (progress.waited > 0) & ~queued
        if waits.any():
            radius = self._radius(goal, progress.waited > 0)
            inside = np.maximum(far - INNER * radius, 0.0) / STOPPING
            speeds = np.where(waits, np.minimum(speeds, inside), speeds)
        preferred = directions * speeds[:, None]
        return self._in_groups(preferred, queued | waits, x)

    def _in_groups(
        self, preferred: FloatArray, alone: BoolArray, x: FloatArray
    ) -> FloatArray:
        """Return velocities that keep groups side by side."""
        groups = self.agents.groups
        members = np.flatnonzero((groups >= 0) & ~alone & preferred.any(axis=1))
        if not len(members):
            return preferred
        number = groups[members]
        count = np.bincount(number)[number][:, None]

        def mean(values: FloatArray) -> FloatArray:
            sums = [np.bincount(number, column)[number] for column in values.T]
            return np.asarray(np.stack(sums, axis=1) / count)

        forward = mean(preferred[members])
        size = np.linalg.norm(forward, axis=1)[:, None]
        forward = forward / np.where(size > 0, size, 1.0)
        side = np.stack([forward[:, 1], -forward[:, 0]], axis=1)
        slot = mean(x[members]) + side * self.agents.sides[members, None]
        back = (slot - x[members]) / STOPPING
        sizes = np.linalg.norm(back, axis=1)[:, None]
        most = CATCHING_UP * self.agents.speeds[members, None]
        back = back * np.minimum(1.0, most / np.where(sizes > 0, sizes, 1.0))
        adjusted = preferred.copy()
        adjusted[members] = preferred[members] + back
        return adjusted

    def advanced(self, progress: Progress, x: FloatArray, dt: float) -> Progress:
        """Return progress after a step [s], with agents at x and z."""
        if not len(self.points):
            return progress
        _, counts, again, leaves = self._plans
        goal = self.heading_for(progress)
        has = goal >= 0
        wait, queues = (
            np.array(each)[goal]
            for each in (
                [one.wait for one in self.goals],
                [one.queue is not None for one in self.goals],
            )
        )
        radius = self._radius(goal, progress.waited > 0)
        tickets = self._joined(progress.tickets, goal, has & queues, x)
        target, queued = self.targets(replace(progress, tickets=tickets), goal, x)
        far = np.linalg.norm(target - x, axis=1)
        near = np.linalg.norm(self._middles(goal, x) - x, axis=1)
        first = queued & (far <= radius) & (target == self.points[goal]).all(axis=1)
        there = has & np.where(queues, first, near <= radius)
        waited = np.where(there | ((progress.waited > 0) & has & ~queues),
                          progress.waited + dt, 0.0)  # fmt: skip
        last = ~again & ~leaves & (progress.stages + 1 >= counts)
        # Agents that stay at their last goal never leave it.
        done = there & (waited >= wait) & ~(last & ~queues)
        stages = progress.stages + done
        stages = np.where(done & leaves & (stages >= counts), GONE, stages)
        return Progress(
            stages, np.where(done, 0.0, waited), np.where(done, NO_TICKET, tickets)
        )

    def _radius(self, goal: IntArray, there: BoolArray) -> FloatArray:
        """Return each goal's arrival radius ``(N,)`` [m], larger when crowded."""
        radii = np.array([one.radius for one in self.goals])[goal]
        count = np.bincount(goal[there & (goal >= 0)], minlength=len(self.goals))[goal]
        return np.asarray(
            np.maximum(radii, self.agents.radii * np.sqrt(count / PACKED))
        )

    def _joined(
        self, tickets: IntArray, goal: IntArray, queues: BoolArray, x: FloatArray
    ) -> IntArray:
        """Return tickets, with new ones for agents who reach the end of a queue."""
        joined = tickets
        for g in np.unique(goal[queues]).tolist():
            queuing = queues & (goal == g)
            waiting = queuing & (joined != NO_TICKET)
            end = self.points[g] + int(waiting.sum()) * self.lines[g]
            spacing = float(np.linalg.norm(self.lines[g]))
            far = np.linalg.norm(x - end, axis=1)
            near = np.flatnonzero(queuing & ~waiting & (far < JOINING * spacing))
            if len(near):
                joined = joined.copy()
                # The nearest comes first; equal ones in order.
                order = near[np.argsort(far[near], kind="stable")]
                joined[order] = joined.max() + 1 + np.arange(len(order))
        return joined

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

# Time constant of stopping at a goal, and of returning to the own position in a group
# or queue [s].
STOPPING_TIME = 0.5
# Speed of returning to a group, over the preferred speed.
CATCH_UP_SPEED = 0.5
# Distance at which agents join a queue's end, over its spacing.
JOINING_DISTANCE = 2.0
# Packing density of agents at a goal, whose radius grows with their number.
PACKING_FRACTION = 0.5
# Fraction of a goal's radius that staying agents enter.
INNER_RADIUS = 0.5
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
    """Computes preferred velocities from goals and flow fields.

    Attributes:
        points: x and z of each goal ``(G, 2)`` [m].
        lines: Offset between positions of its queue ``(G, 2)`` [m]; 0 without a queue.
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
    def _route_plans(self) -> tuple[IntArray, IntArray, BoolArray, BoolArray]:
        """Return each agent's route, its length, and whether it repeats or leaves."""
        populations = self.agents.entries
        names = [goal.name for goal in self.goals]
        longest = max((len(population.route) for population in populations), default=0)
        table = np.full((len(populations), longest + 1), -1)
        for i, population in enumerate(populations):
            table[i, : len(population.route)] = [
                names.index(name) for name in population.route
            ]
        counts = np.array([len(population.route) for population in populations])
        repeats = np.array([population.then == "repeat" for population in populations])
        leaves = np.array([population.then == "leave" for population in populations])
        kinds = self.agents.kinds
        return table[kinds], counts[kinds], repeats[kinds], leaves[kinds]

    def first(self) -> Progress:
        """Return the initial progress."""
        count = len(self.agents)
        return Progress(
            np.zeros(count, np.int64), np.zeros(count), np.full(count, NO_TICKET)
        )

    def current_goals(self, progress: Progress) -> IntArray:
        """Return the current goal of each agent ``(N,)``, -1 for none."""
        table, counts, repeats, _ = self._route_plans
        stages = progress.stages
        route_index = np.where(
            repeats, stages % np.maximum(counts, 1), np.minimum(stages, counts)
        )
        goal = table[np.arange(len(stages)), np.maximum(route_index, 0)]
        return np.where(stages == GONE, -1, goal)

    def targets(
        self, progress: Progress, goal: IntArray, x: FloatArray
    ) -> tuple[FloatArray, BoolArray]:
        """Return each agent's target ``(N, 2)`` [m], and a mask of queuing agents."""
        if not len(self.points):
            return x, np.zeros(len(x), np.bool_)
        positions = self._reachable_goals(goal, x)
        radii = np.array([entry.radius for entry in self.goals])
        next_to_goal = (
            positions
            + self.agents.goal_offsets * np.where(goal >= 0, radii[goal], 0.0)[:, None]
        )
        if self.grid is None:
            positions = next_to_goal
        else:
            # Offsets only apply if they are reachable from the centre.
            nodes = self.grid.nearest_nodes(
                np.stack([positions, next_to_goal]).reshape(-1, 2)
            )
            components = self.grid.components[nodes[:, 0], nodes[:, 1]].reshape(2, -1)
            positions = np.where(
                (components[0] == components[1])[:, None], next_to_goal, positions
            )
        is_queued = progress.tickets != NO_TICKET
        for g in np.unique(goal[is_queued]).tolist():
            queue = np.flatnonzero(is_queued & (goal == g))
            queue = queue[np.argsort(progress.tickets[queue], kind="stable")]
            positions[queue] = (
                self.points[g] + np.arange(len(queue))[:, None] * self.lines[g]
            )
        return positions, is_queued

    def _reachable_goals(self, goal: IntArray, x: FloatArray) -> FloatArray:
        """Return each agent's reachable goal ``(N, 2)`` [m]; without one, x."""
        positions = np.where((goal >= 0)[:, None], self.points[goal], x)
        for g, route in enumerate(self.routes):
            is_assigned = goal == g
            positions[is_assigned] = route.goal(x[is_assigned])
        return np.asarray(positions)

    def preferred(
        self, t: float, begin: float, progress: Progress, x: FloatArray
    ) -> FloatArray:
        """Return preferred velocities at a time [s] ``(N, 2)`` [m/s]."""
        agents = self.agents
        goal = self.current_goals(progress)
        target, is_queued = self.targets(progress, goal, x)
        offset = target - x
        distances = np.linalg.norm(offset, axis=1)
        directions = offset / np.maximum(distances, np.finfo(float).tiny)[:, None]
        for g, route in enumerate(self.routes):
            is_assigned = (goal == g) & ~is_queued
            if is_assigned.any():
                directions[is_assigned] = route.directions(
                    x[is_assigned], target[is_assigned]
                )
        speeds = np.minimum(agents.speeds, distances / STOPPING_TIME)
        speeds = np.where((goal >= 0) & (t - begin >= agents.delays), speeds, 0.0)
        # Waiting agents make room for those behind, and stay.
        is_waiting = (progress.waited > 0) & ~is_queued
        if is_waiting.any():
            radius = self._arrival_radii(goal, progress.waited > 0)
            inward_speeds = (
                np.maximum(distances - INNER_RADIUS * radius, 0.0) / STOPPING_TIME
            )
            speeds = np.where(is_waiting, np.minimum(speeds, inward_speeds), speeds)
        preferred = directions * speeds[:, None]
        return self._keep_groups(preferred, is_queued | is_waiting, x)

    def _keep_groups(
        self, preferred: FloatArray, is_excluded: BoolArray, x: FloatArray
    ) -> FloatArray:
        """Return velocities that keep groups side by side."""
        groups = self.agents.groups
        members = np.flatnonzero((groups >= 0) & ~is_excluded & preferred.any(axis=1))
        if not len(members):
            return preferred
        group_of_member = groups[members]
        count = np.bincount(group_of_member)[group_of_member][:, None]

        def mean(values: FloatArray) -> FloatArray:
            sums = [
                np.bincount(group_of_member, column)[group_of_member]
                for column in values.T
            ]
            return np.asarray(np.stack(sums, axis=1) / count)

        forward = mean(preferred[members])
        size = np.linalg.norm(forward, axis=1)[:, None]
        forward = forward / np.where(size > 0, size, 1.0)
        side = np.stack([forward[:, 1], -forward[:, 0]], axis=1)
        slot = mean(x[members]) + side * self.agents.lateral_offsets[members, None]
        correction = (slot - x[members]) / STOPPING_TIME
        lengths = np.linalg.norm(correction, axis=1)[:, None]
        max_correction = CATCH_UP_SPEED * self.agents.speeds[members, None]
        correction = correction * np.minimum(
            1.0, max_correction / np.where(lengths > 0, lengths, 1.0)
        )
        result = preferred.copy()
        result[members] = preferred[members] + correction
        return result

    def advance(self, progress: Progress, x: FloatArray, dt: float) -> Progress:
        """Return progress after a step [s], with agents at x and z."""
        if not len(self.points):
            return progress
        _, counts, repeats, leaves = self._route_plans
        goal = self.current_goals(progress)
        has_goal = goal >= 0
        wait, queues = (
            np.array(values)[goal]
            for values in (
                [entry.wait for entry in self.goals],
                [entry.queue is not None for entry in self.goals],
            )
        )
        radius = self._arrival_radii(goal, progress.waited > 0)
        tickets = self._with_new_tickets(progress.tickets, goal, has_goal & queues, x)
        target, is_queued = self.targets(replace(progress, tickets=tickets), goal, x)
        target_distances = np.linalg.norm(target - x, axis=1)
        goal_distances = np.linalg.norm(self._reachable_goals(goal, x) - x, axis=1)
        is_served = (
            is_queued
            & (target_distances <= radius)
            & (target == self.points[goal]).all(axis=1)
        )
        arrived = has_goal & np.where(queues, is_served, goal_distances <= radius)
        waited = np.where(arrived | ((progress.waited > 0) & has_goal & ~queues),
                          progress.waited + dt, 0.0)  # fmt: skip
        is_last = ~repeats & ~leaves & (progress.stages + 1 >= counts)
        # Agents that stay at their last goal never pass it.
        passed = arrived & (waited >= wait) & ~(is_last & ~queues)
        stages = progress.stages + passed
        stages = np.where(passed & leaves & (stages >= counts), GONE, stages)
        return Progress(
            stages, np.where(passed, 0.0, waited), np.where(passed, NO_TICKET, tickets)
        )

    def _arrival_radii(self, goal: IntArray, arrived: BoolArray) -> FloatArray:
        """Return each goal's arrival radius ``(N,)`` [m], larger when crowded."""
        radii = np.array([entry.radius for entry in self.goals])[goal]
        count = np.bincount(goal[arrived & (goal >= 0)], minlength=len(self.goals))[
            goal
        ]
        return np.asarray(
            np.maximum(radii, self.agents.radii * np.sqrt(count / PACKING_FRACTION))
        )

    def _with_new_tickets(
        self, tickets: IntArray, goal: IntArray, queues: BoolArray, x: FloatArray
    ) -> IntArray:
        """Return tickets, with new ones for agents that reach the end of a queue."""
        result = tickets
        for g in np.unique(goal[queues]).tolist():
            is_queuing = queues & (goal == g)
            is_waiting = is_queuing & (result != NO_TICKET)
            queue_end = self.points[g] + int(is_waiting.sum()) * self.lines[g]
            spacing = float(np.linalg.norm(self.lines[g]))
            distances = np.linalg.norm(x - queue_end, axis=1)
            joining_agents = np.flatnonzero(
                is_queuing & ~is_waiting & (distances < JOINING_DISTANCE * spacing)
            )
            if len(joining_agents):
                result = result.copy()
                # The nearest comes first; equal ones in order.
                order = joining_agents[
                    np.argsort(distances[joining_agents], kind="stable")
                ]
                result[order] = result.max() + 1 + np.arange(len(order))
        return result

"""Preferred velocities and route progress of agents."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.systems.crowds.agents import Agents
from animtool.systems.crowds.routes import FlowField, NavGrid, flow_field
from animtool.systems.crowds.spec import CrowdGoalModel

# Time constant of stopping at a goal, and of returning to a position in a group or
# queue [s].
STOPPING_TIME = 0.5
# Speed of returning to a group, relative to the preferred speed.
CATCH_UP_SPEED = 0.5
# Distance at which agents join the end of a queue, relative to its spacing.
JOINING_DISTANCE = 2.0
# Packing density of agents at a goal; its radius grows with their number.
PACKING_FRACTION = 0.5
# Fraction of a goal's radius that staying agents enter.
INNER_RADIUS = 0.5
NO_TICKET = -1
DEPARTED_STAGE = -1


@dataclass(frozen=True, slots=True)
class Progress:
    """Progress of N agents on their routes."""

    stages: (
        IntArray  # number of passed goals; `DEPARTED_STAGE` for agents that left (N,)
    )
    waited: FloatArray  # time waited at the current goal (N,) [s]
    tickets: IntArray  # order in the queue at the current goal, or `NO_TICKET` (N,)


@dataclass(frozen=True)
class Steering:
    """Computes preferred velocities from goals and flow fields."""

    agents: Agents
    goals: Sequence[CrowdGoalModel]
    goal_points: FloatArray  # (x, z) of each goal (G, 2) [m]
    # Offset between positions of a goal's queue (G, 2) [m]; 0 if it has no queue.
    queue_spacings: FloatArray
    grid: NavGrid | None  # walkable grid; None if there are no obstacles

    @cached_property
    def flow_fields(self) -> list[FlowField]:
        """Flow fields to each goal; empty if there are no obstacles."""
        if self.grid is None:
            return []
        return [flow_field(self.grid, goal) for goal in self.goal_points]

    @cached_property
    def _route_plans(self) -> tuple[IntArray, IntArray, BoolArray, BoolArray]:
        """Each agent's goal indices, goal count, and whether it repeats or leaves."""
        populations = self.agents.entries
        goal_names = [goal.name for goal in self.goals]
        route_lengths = np.array([len(population.route) for population in populations])
        route_table = np.full((len(populations), route_lengths.max(initial=0) + 1), -1)
        for i, population in enumerate(populations):
            route_table[i, : route_lengths[i]] = [
                goal_names.index(name) for name in population.route
            ]
        entry_indices = self.agents.entry_indices
        actions = np.array([population.then for population in populations])[
            entry_indices
        ]
        return (
            route_table[entry_indices],
            route_lengths[entry_indices],
            actions == "repeat",
            actions == "leave",
        )

    def initial_state(self) -> Progress:
        """Return the initial progress."""
        count = len(self.agents)
        stages, tickets = np.zeros(count, np.int64), np.full(count, NO_TICKET)
        return Progress(stages, np.zeros(count), tickets)

    def current_goals(self, progress: Progress) -> IntArray:
        """Return the current goal of each agent ``(N,)``; -1 if there is none."""
        route_table, route_lengths, is_repeating, _ = self._route_plans
        stages = progress.stages
        loop_stages = stages % np.maximum(route_lengths, 1)
        route_index = np.where(
            is_repeating, loop_stages, np.minimum(stages, route_lengths)
        )
        goal_indices = route_table[np.arange(len(stages)), np.maximum(route_index, 0)]
        return np.where(stages == DEPARTED_STAGE, -1, goal_indices)

    def targets(
        self, progress: Progress, goal_indices: IntArray, x: FloatArray
    ) -> tuple[FloatArray, BoolArray]:
        """Return each agent's target ``(N, 2)`` [m], and a mask of queuing agents."""
        if not len(self.goal_points):
            return x, np.zeros(len(x), np.bool_)
        positions = self._reachable_goals(goal_indices, x)
        radii = np.array([entry.radius for entry in self.goals])
        offset_radii = np.where(goal_indices >= 0, radii[goal_indices], 0.0)
        offsets = self.agents.goal_offsets * offset_radii[:, None]
        offset_positions = positions + offsets
        if self.grid is None:
            positions = offset_positions
        else:
            # Offsets only apply if they are reachable from the centre.
            both_positions = np.concatenate([positions, offset_positions])
            nodes = self.grid.nearest_nodes(both_positions)
            components = self.grid.components[nodes[:, 0], nodes[:, 1]].reshape(2, -1)
            is_reachable = (components[0] == components[1])[:, None]
            positions = np.where(is_reachable, offset_positions, positions)
        is_queued = progress.tickets != NO_TICKET
        for g in np.unique(goal_indices[is_queued]).tolist():
            queued_agents = np.flatnonzero(is_queued & (goal_indices == g))
            queued_agents = queued_agents[
                np.argsort(progress.tickets[queued_agents], kind="stable")
            ]
            queue_offsets = (
                np.arange(len(queued_agents))[:, None] * self.queue_spacings[g]
            )
            positions[queued_agents] = self.goal_points[g] + queue_offsets
        return positions, is_queued

    def _reachable_goals(self, goal_indices: IntArray, x: FloatArray) -> FloatArray:
        """Return each agent's reachable goal, its position without one ``(N, 2)``."""
        has_goal = (goal_indices >= 0)[:, None]
        positions = np.where(has_goal, self.goal_points[goal_indices], x)
        for g, goal_flow_field in enumerate(self.flow_fields):
            is_assigned = goal_indices == g
            positions[is_assigned] = goal_flow_field.path_ends(x[is_assigned])
        return np.asarray(positions)

    def preferred_velocities(
        self, t: float, begin: float, progress: Progress, x: FloatArray
    ) -> FloatArray:
        """Return the preferred velocities of agents ``(N, 2)`` [m/s]."""
        agents = self.agents
        goal_indices = self.current_goals(progress)
        target, is_queued = self.targets(progress, goal_indices, x)
        offset = target - x
        distances = np.linalg.norm(offset, axis=1)
        directions = offset / np.maximum(distances, np.finfo(float).tiny)[:, None]
        for g, goal_flow_field in enumerate(self.flow_fields):
            is_assigned = (goal_indices == g) & ~is_queued
            if is_assigned.any():
                directions[is_assigned] = goal_flow_field.path_directions(
                    x[is_assigned], target[is_assigned]
                )
        speeds = np.minimum(agents.speeds, distances / STOPPING_TIME)
        is_started = (goal_indices >= 0) & (t - begin >= agents.delays)
        speeds = np.where(is_started, speeds, 0.0)
        # Waiting agents make room for those behind, and stay.
        is_waiting = (progress.waited > 0) & ~is_queued
        if is_waiting.any():
            arrival_radii = self._arrival_radii(goal_indices, progress.waited > 0)
            inner_distances = np.maximum(distances - INNER_RADIUS * arrival_radii, 0.0)
            inward_speeds = inner_distances / STOPPING_TIME
            speeds = np.where(is_waiting, np.minimum(speeds, inward_speeds), speeds)
        velocities = directions * speeds[:, None]
        return self._keep_formation(velocities, is_queued | is_waiting, x)

    def _keep_formation(
        self, preferred_velocities: FloatArray, is_excluded: BoolArray, x: FloatArray
    ) -> FloatArray:
        """Return velocities that keep the members of groups side by side."""
        groups = self.agents.groups
        member_indices = np.flatnonzero(
            (groups >= 0) & ~is_excluded & preferred_velocities.any(axis=1)
        )
        if not len(member_indices):
            return preferred_velocities
        group_of_member = groups[member_indices]
        count = np.bincount(group_of_member)[group_of_member][:, None]

        def group_mean(values: FloatArray) -> FloatArray:
            sums = [
                np.bincount(group_of_member, column)[group_of_member]
                for column in values.T
            ]
            return np.asarray(np.stack(sums, axis=1) / count)

        forward = group_mean(preferred_velocities[member_indices])
        size = np.linalg.norm(forward, axis=1)[:, None]
        forward = forward / np.where(size > 0, size, 1.0)
        left_directions = np.stack([forward[:, 1], -forward[:, 0]], axis=1)
        lateral_offsets = self.agents.lateral_offsets[member_indices, None]
        group_positions = (
            group_mean(x[member_indices]) + left_directions * lateral_offsets
        )
        correction = (group_positions - x[member_indices]) / STOPPING_TIME
        lengths = np.linalg.norm(correction, axis=1)[:, None]
        max_correction = CATCH_UP_SPEED * self.agents.speeds[member_indices, None]
        max_factors = max_correction / np.where(lengths > 0, lengths, 1.0)
        correction = correction * np.minimum(1.0, max_factors)
        velocities = preferred_velocities.copy()
        velocities[member_indices] = preferred_velocities[member_indices] + correction
        return velocities

    def advance(self, progress: Progress, x: FloatArray, dt: float) -> Progress:
        """Return progress after a step [s], with agents at (x, z) points ``(N, 2)``."""
        if not len(self.goal_points):
            return progress
        _, route_lengths, is_repeating, is_leaving = self._route_plans
        goal_indices = self.current_goals(progress)
        has_goal = goal_indices >= 0
        wait_times = np.array([goal.wait for goal in self.goals])[goal_indices]
        has_queue = np.array([goal.queue is not None for goal in self.goals])
        has_queue = has_queue[goal_indices]
        arrival_radii = self._arrival_radii(goal_indices, progress.waited > 0)
        must_queue = has_goal & has_queue
        tickets = self._assign_tickets(progress.tickets, goal_indices, must_queue, x)
        queued_progress = replace(progress, tickets=tickets)
        target, is_queued = self.targets(queued_progress, goal_indices, x)
        target_distances = np.linalg.norm(target - x, axis=1)
        offsets = self._reachable_goals(goal_indices, x) - x
        goal_distances = np.linalg.norm(offsets, axis=1)
        is_at_front = (target == self.goal_points[goal_indices]).all(axis=1)
        is_served = is_queued & (target_distances <= arrival_radii) & is_at_front
        has_arrived = np.where(has_queue, is_served, goal_distances <= arrival_radii)
        has_arrived &= has_goal
        waited = np.where(has_arrived | ((progress.waited > 0) & has_goal & ~has_queue),
                          progress.waited + dt, 0.0)  # fmt: skip
        is_last = ~is_repeating & ~is_leaving & (progress.stages + 1 >= route_lengths)
        # Agents that stay at their last goal never pass it.
        has_passed = has_arrived & (waited >= wait_times) & ~(is_last & ~has_queue)
        stages = progress.stages + has_passed
        stages = np.where(
            has_passed & is_leaving & (stages >= route_lengths), DEPARTED_STAGE, stages
        )
        return Progress(
            stages,
            np.where(has_passed, 0.0, waited),
            np.where(has_passed, NO_TICKET, tickets),
        )

    def _arrival_radii(
        self, goal_indices: IntArray, has_arrived: BoolArray
    ) -> FloatArray:
        """Return the arrival radius of each agent's goal ``(N,)`` [m]."""
        radii = np.array([entry.radius for entry in self.goals])[goal_indices]
        reached_goals = goal_indices[has_arrived & (goal_indices >= 0)]
        count = np.bincount(reached_goals, minlength=len(self.goals))[goal_indices]
        crowd_radii = self.agents.radii * np.sqrt(count / PACKING_FRACTION)
        return np.asarray(np.maximum(radii, crowd_radii))

    def _assign_tickets(
        self,
        tickets: IntArray,
        goal_indices: IntArray,
        has_queue: BoolArray,
        x: FloatArray,
    ) -> IntArray:
        """Return tickets; agents at the end of a queue get new ones."""
        new_tickets = tickets
        for g in np.unique(goal_indices[has_queue]).tolist():
            is_queuing = has_queue & (goal_indices == g)
            is_waiting = is_queuing & (new_tickets != NO_TICKET)
            offset = self.queue_spacings[g]
            queue_end = self.goal_points[g] + int(is_waiting.sum()) * offset
            spacing = float(np.linalg.norm(offset))
            distances = np.linalg.norm(x - queue_end, axis=1)
            is_joining = is_queuing & ~is_waiting
            is_joining &= distances < JOINING_DISTANCE * spacing
            joining_indices = np.flatnonzero(is_joining)
            if len(joining_indices):
                new_tickets = new_tickets.copy()
                # The nearest comes first; equal ones in order.
                order = np.argsort(distances[joining_indices], kind="stable")
                order = joining_indices[order]
                new_tickets[order] = new_tickets.max() + 1 + np.arange(len(order))
        return new_tickets

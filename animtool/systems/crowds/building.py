"""Builds crowds from specs: agents, steering, obstacles and bodies."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import refuse
from animtool.systems.crowds.agents import Agents, build_agents
from animtool.systems.crowds.beginning import (
    clear_starts,
    ground_of,
    project_direction,
    unreachable_goal_warnings,
)
from animtool.systems.crowds.crowd import Crowd
from animtool.systems.crowds.ground import GroundFrame, Terrain
from animtool.systems.crowds.obstacles import Obstacles, navigation_grids
from animtool.systems.crowds.spec import CrowdsModel
from animtool.systems.crowds.steering import Steering
from animtool.systems.framework.simulation import SimContext

if TYPE_CHECKING:
    from animtool.systems.crowds.cast import AgentCast
    from animtool.systems.crowds.falls import FallSimulator


def build(spec: CrowdsModel, context: SimContext) -> Crowd:
    """Build the crowd of a spec.

    Raises:
        OptionError: The spec is invalid (SIM145).
    """
    begin, parts = context.begin, context.parts["populations"]
    frame, ground = ground_of(context)
    if context.colliders.sheets:
        message = "crowds avoid shapes, rigid bodies and the capsules of characters"
        hint = "use its colliders instead of the surface"
        refuse("SIM145", message, "systems", hint)
    agents, notices = build_agents(spec, parts, begin, frame)
    steering, obstacles = _build_steering(spec, agents, frame, ground, context)
    start, moved_warnings = clear_starts(agents, steering.grid, obstacles, begin)
    notices += moved_warnings
    notices += unreachable_goal_warnings(
        spec, agents, steering, obstacles, start, begin
    )
    prototypes = [part.get("shows") for part in parts]
    meshes_by_prototype = {show: show() for show in prototypes if show is not None}
    sources = list(meshes_by_prototype)
    mesh_indices = [sources.index(show) if show else 0 for show in prototypes]
    casting, falling = _build_bodies(spec, agents, frame, ground, context)
    if casting is not None:
        for group in casting.groups:
            notices += group.bodies.gaits.notices
    return Crowd(
        spec,
        begin,
        frame,
        ground,
        agents,
        steering,
        obstacles,
        start,
        notices,
        casting,
        falling,
        tuple(cycle[0] for cycle in meshes_by_prototype.values()),
        np.array(mesh_indices, np.int64),
    )


def _build_steering(
    spec: CrowdsModel,
    agents: Agents,
    frame: GroundFrame,
    ground: Terrain,
    context: SimContext,
) -> tuple[Steering, Obstacles]:
    """Return the steering towards goals, and the obstacles on the ground."""
    colliders, begin = context.colliders, context.begin
    goals = _project_on_ground(frame, [goal.at for goal in spec.goals])
    grid, edge = navigation_grids(spec, agents, frame, ground, colliders, goals, begin)
    queues = [
        [0.0, 0.0]
        if goal.queue is None
        else project_direction(frame, goal.queue.direction) * goal.queue.spacing
        for goal in spec.goals
    ]
    queue_spacings = np.array(queues).reshape(-1, 2)
    steering = Steering(agents, spec.goals, goals, queue_spacings, grid)
    begins = _project_on_ground(frame, [door.begin for door in spec.doors])
    ends = _project_on_ground(frame, [door.end for door in spec.doors])
    ends = np.stack([begins, ends], axis=1)
    for door, (first, last) in zip(spec.doors, ends, strict=True):
        if not ((last - first) ** 2).sum() > 0:
            message = f"both ends of {door.name!r} are at the same position on the "
            message += "ground"
            refuse("SIM145", message, "doors")
    horizon = spec.avoidance.obstacles
    obstacles = Obstacles(
        agents, frame, ground, colliders, spec.doors, edge, horizon, ends
    )
    return steering, obstacles


def _build_bodies(
    spec: CrowdsModel,
    agents: Agents,
    frame: GroundFrame,
    ground: Terrain,
    context: SimContext,
) -> tuple[AgentCast | None, FallSimulator | None]:
    """Return bodies if populations have gaits, and ragdolls if colliders move."""
    gait_sources = [part.get("gaits") for part in context.parts["populations"]]
    gaits = [source for source in gait_sources if source is not None]
    if not gaits:
        return None, None
    from animtool.systems.crowds.cast import AgentCast
    from animtool.systems.crowds.falls import FallSimulator

    colliders = context.colliders
    is_fixed = all(collider.poses.is_fixed for collider in colliders)
    has_moving_colliders = bool(colliders.bodies) or not is_fixed
    casting = AgentCast.of(agents, gaits, ground, can_fall=has_moving_colliders)
    can_fall = [FallSimulator.has_bodies(group.cast.rig) for group in casting.groups]
    if not (has_moving_colliders and all(can_fall) and len(agents)):
        return casting, None
    falling = FallSimulator(
        casting.rigs, agents.sizes, frame, ground, colliders, spec.step
    )
    return casting, falling


def _project_on_ground(
    frame: GroundFrame, points: Sequence[Sequence[float]]
) -> FloatArray:
    """Return world points projected on the ground: x and z ``(K, 2)``."""
    return frame.to_local(np.array(points, float).reshape(-1, 3))[:, [0, 2]]

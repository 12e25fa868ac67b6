"""Builds crowds from specs, and checks and corrects their initial state."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, counted, refuse, warning
from animtool.core.quantities import length_text
from animtool.maths.faces import triangulate
from animtool.sim.colliders import Mesh
from animtool.systems.crowds.agents import (
    OVERLAP_TOLERANCE,
    Agents,
    build_agents,
    separate_agents,
)
from animtool.systems.crowds.crowd import Crowd
from animtool.systems.crowds.ground import GroundFrame, Terrain
from animtool.systems.crowds.obstacles import (
    Obstacles,
    is_blocked,
    navigation_grids,
)
from animtool.systems.crowds.routes import NavGrid
from animtool.systems.crowds.spec import CrowdsModel
from animtool.systems.crowds.steering import Steering
from animtool.systems.framework.simulation import SimContext

if TYPE_CHECKING:
    from animtool.systems.crowds.cast import AgentCast
    from animtool.systems.crowds.falls import FallSimulator

# Most passes that move agents out of obstacles at the start.
MAX_CLEARING_PASSES = 20


def build(spec: CrowdsModel, context: SimContext) -> Crowd:
    """Build the crowd of a spec; raise SIM145 if the spec is invalid."""
    begin, population_data = context.begin, context.entry_data["populations"]
    ground_frame, ground = read_ground(context)
    if context.colliders.sheets:
        message = "crowds avoid shapes, rigid bodies and the capsules of characters"
        hint = "use its colliders instead of the surface"
        refuse("SIM145", message, "systems", hint)
    agents, notices = build_agents(spec, population_data, begin, ground_frame)
    steering, obstacles = _build_steering(spec, agents, ground_frame, ground, context)
    start_points, moved_warnings = clear_starts(agents, steering.grid, obstacles, begin)
    notices += moved_warnings
    notices += unreachable_goal_warnings(
        spec, agents, steering, obstacles, start_points, begin
    )
    prototypes = [data.get("shows") for data in population_data]
    meshes_by_prototype = {show: show() for show in prototypes if show is not None}
    sources = list(meshes_by_prototype)
    mesh_indices = [sources.index(show) if show else 0 for show in prototypes]
    cast, fall_simulator = _build_bodies(spec, agents, ground_frame, ground, context)
    if cast is not None:
        for group in cast.groups:
            notices += group.bodies.gaits.notices
    return Crowd(
        spec,
        begin,
        ground_frame,
        ground,
        agents,
        steering,
        obstacles,
        start_points,
        notices,
        cast,
        fall_simulator,
        tuple(cycle[0] for cycle in meshes_by_prototype.values()),
        np.array(mesh_indices, np.int64),
    )


def _build_steering(
    spec: CrowdsModel,
    agents: Agents,
    ground_frame: GroundFrame,
    ground: Terrain,
    context: SimContext,
) -> tuple[Steering, Obstacles]:
    """Return the steering towards goals, and the obstacles on the ground."""
    colliders, begin = context.colliders, context.begin
    goals = _project_on_ground(ground_frame, [goal.at for goal in spec.goals])
    grid, edge_grid = navigation_grids(
        spec, agents, ground_frame, ground, colliders, goals, begin
    )
    queue_vectors = [
        [0.0, 0.0]
        if goal.queue is None
        else project_direction(ground_frame, goal.queue.direction) * goal.queue.spacing
        for goal in spec.goals
    ]
    queue_spacings = np.array(queue_vectors).reshape(-1, 2)
    steering = Steering(agents, spec.goals, goals, queue_spacings, grid)
    door_begins = _project_on_ground(ground_frame, [door.begin for door in spec.doors])
    door_ends = _project_on_ground(ground_frame, [door.end for door in spec.doors])
    door_ends = np.stack([door_begins, door_ends], axis=1)
    for door, (first, last) in zip(spec.doors, door_ends, strict=True):
        if not ((last - first) ** 2).sum() > 0:
            message = f"both ends of {door.name!r} are at the same position on the "
            message += "ground"
            refuse("SIM145", message, "doors")
    horizon = spec.avoidance.obstacles
    obstacles = Obstacles(
        agents,
        ground_frame,
        ground,
        colliders,
        spec.doors,
        edge_grid,
        horizon,
        door_ends,
    )
    return steering, obstacles


def _build_bodies(
    spec: CrowdsModel,
    agents: Agents,
    ground_frame: GroundFrame,
    ground: Terrain,
    context: SimContext,
) -> tuple[AgentCast | None, FallSimulator | None]:
    """Return bodies if populations have gaits, and ragdolls if colliders move."""
    gait_sources = [data.get("gaits") for data in context.entry_data["populations"]]
    gaits = [source for source in gait_sources if source is not None]
    if not gaits:
        return None, None
    from animtool.systems.crowds.cast import AgentCast
    from animtool.systems.crowds.falls import FallSimulator

    colliders = context.colliders
    is_fixed = all(collider.poses.is_fixed for collider in colliders)
    has_moving_colliders = bool(colliders.bodies) or not is_fixed
    cast = AgentCast.from_sources(agents, gaits, ground, can_fall=has_moving_colliders)
    can_fall = all(group.cast.rig.colliders for group in cast.groups)
    if not (has_moving_colliders and can_fall and len(agents)):
        return cast, None
    fall_simulator = FallSimulator(
        cast.rigs, agents.sizes, ground_frame, ground, colliders, spec.step
    )
    return cast, fall_simulator


def _project_on_ground(
    ground_frame: GroundFrame, points: Sequence[Sequence[float]]
) -> FloatArray:
    """Return the (x, z) ground positions of world points ``(K, 2)``."""
    return ground_frame.to_local(np.array(points, float).reshape(-1, 3))[:, [0, 2]]


def clear_starts(
    agents: Agents, grid: NavGrid | None, obstacles: Obstacles, begin: float
) -> tuple[FloatArray, list[Fault]]:
    """Return start positions outside of obstacles, and warnings (SIM148)."""
    positions, notices = agents.start_points, list[Fault]()
    count = len(agents)
    if grid is not None and count and grid.is_free.any():
        is_off_grid = is_blocked(grid, positions)
        node_points = grid.node_positions(grid.nearest_free_node(positions))
        positions = np.where(is_off_grid[:, None], node_points, positions)
    max_radius = float(agents.radii.max(initial=1.0))
    for _ in range(MAX_CLEARING_PASSES):
        walls = obstacles.walls(begin, 0.0, positions)
        if not (walls.gaps < 0).any() and (positions == agents.start_points).all():
            break
        previous_positions = positions
        positions, _ = separate_agents(
            agents, positions, walls.first_walls, walls.half_planes
        )
        if (
            np.abs(positions - previous_positions).max(initial=0.0)
            <= OVERLAP_TOLERANCE * max_radius
        ):
            break
    distances = np.linalg.norm(positions - agents.start_points, axis=1)
    is_moved = distances > OVERLAP_TOLERANCE * agents.radii
    if is_moved.any():
        first = agents.label(int(np.argmax(is_moved)))
        verb = "was" if is_moved.sum() == 1 else "were"
        message = f"{counted(int(is_moved.sum()), 'agent')} would start in an obstacle "
        message += f"or off the ground and {verb} moved; the first is {first}"
        hint = "move the start region of the population"
        notices.append(warning("SIM148", message, hint))
    return positions, notices


def _goal_obstacle(
    obstacles: Obstacles, grid: NavGrid, position: FloatArray, t: float
) -> tuple[str, str] | None:
    """Return what blocks a goal at (x, z) ``(1, 2)``, and a hint; None if it is free.

    Nodes deep inside a low obstacle count as free, since the nearest face is its top.
    """
    depths = obstacles.collider_depths(t, position)
    max_depth = float(depths.max(initial=-np.inf))
    if max_depth > 0:
        name = obstacles.colliders.label(int(depths.argmax()))
        problem = f"{length_text(max_depth, 2)} inside the collider {name}"
        return problem, "move the goal or the collider"
    if not is_blocked(grid, position)[0]:
        return None
    max_radius = float(obstacles.agents.radii.max(initial=0.0))
    if -max_depth > max_radius:
        return "off the ground, or on a slope that is too steep", "move the goal"
    name = obstacles.colliders.label(int(depths.argmax()))
    problem = f"{length_text(-max_depth, 2)} from the collider {name}, less than the "
    return f"{problem}agents' radius of {length_text(max_radius)}", "move the goal"


def _nearest_reachable(
    grid: NavGrid, position: FloatArray, components: IntArray
) -> FloatArray:
    """Return the (x, z) point ``(2,)`` nearest to a goal among nodes of components."""
    node_indices = np.flatnonzero(np.isin(grid.components.ravel(), components))
    if not len(node_indices):
        node_indices = grid.nearest_free_node(position)
    points = grid.node_positions(node_indices)
    return np.asarray(points[int(((points - position) ** 2).sum(axis=1).argmin())])


def unreachable_goal_warnings(
    spec: CrowdsModel,
    agents: Agents,
    steering: Steering,
    obstacles: Obstacles,
    start_points: FloatArray,
    begin: float,
) -> list[Fault]:
    """Return warnings about goals that agents cannot reach (SIM146)."""
    grid, faults = steering.grid, list[Fault]()
    if grid is None or not grid.is_free.any():
        return []
    components = grid.components.ravel()
    start_components = components[grid.nearest_free_node(start_points)]
    for goal_index, goal in enumerate(spec.goals):
        position = steering.goal_points[goal_index : goal_index + 1]
        obstacle = _goal_obstacle(obstacles, grid, position, begin)
        if obstacle is not None:
            problem, hint = obstacle
            nearest_point = _nearest_reachable(grid, position, start_components)
            message = f"the goal {goal.name!r} is {problem}: agents go to "
            message += f"{obstacles.world_text(nearest_point)} instead"
            location = f"goals[{goal_index}].at"
            faults.append(warning("SIM146", message, hint, location))
            continue
        goal_component = components[grid.nearest_free_node(position)[0]]
        for population_index, population in enumerate(spec.populations):
            is_cut_off = start_components != goal_component
            is_cut_off &= agents.entry_indices == population_index
            if goal.name in population.route and is_cut_off.any():
                message = f"no path leads {counted(int(is_cut_off.sum()), 'agent')} of "
                message += f"{population.name!r} to the goal {goal.name!r}: they go "
                message += "to the nearest position that they can reach"
                hint = "leave a gap wider than the agents, or move the goal"
                faults.append(warning("SIM146", message, hint))
    return faults


def project_direction(
    ground_frame: GroundFrame, direction: Sequence[float]
) -> FloatArray:
    """Return a world direction projected on the ground, normalized ``(2,)``."""
    ground_direction = ground_frame.vector_to_local(np.array(direction, float))[[0, 2]]
    length = float(np.linalg.norm(ground_direction))
    if not length > 0:
        message = "the direction of a queue is vertical"
        refuse("SIM145", message, "goals", "use a direction along the ground")
    return np.asarray(ground_direction / length)


def read_ground(context: SimContext) -> tuple[GroundFrame, Terrain]:
    """Return the frame of the ground, and its height field."""
    ground_data = context.entry_data["ground"]
    poses = ground_data["poses"]
    shape = ground_data.get("shape")
    mesh = ground_data.get("mesh")
    if not poses.is_fixed:
        message = "the ground cannot move"
        refuse("SIM145", message, "ground", "remove moves and turns")
    pose = poses.at(context.begin)
    ground_frame = GroundFrame(pose[:3], pose[3:])
    if shape is not None and mesh is not None:
        message = "the ground is either a shape or a mesh of a file"
        refuse("SIM145", message, "ground", "remove one of them")
    if mesh is not None:
        surface = mesh()[0]
        corners = triangulate(surface.counts, surface.indices)
        return ground_frame, Terrain(surface.points[corners])
    if shape is None:
        return ground_frame, Terrain()
    if not isinstance(shape, Mesh):
        message = "the ground must be a mesh, a height_field or, without a shape, a "
        message += "plane"
        refuse("SIM145", message, "ground", "shape: {height_field: {...}}")
    points, faces = shape.weld()
    return ground_frame, Terrain(points[faces])

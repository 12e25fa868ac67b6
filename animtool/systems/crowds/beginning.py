"""Checks and corrections of the initial state of a crowd."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, counted, refuse, warning
from animtool.core.quantities import length_text
from animtool.maths.faces import triangulate
from animtool.sim.colliders import Mesh
from animtool.systems.crowds.agents import OVERLAP_TOLERANCE, Agents, separate_agents
from animtool.systems.crowds.ground import GroundFrame, Terrain
from animtool.systems.crowds.obstacles import Obstacles, is_blocked
from animtool.systems.crowds.routes import NavGrid
from animtool.systems.crowds.spec import CrowdsModel
from animtool.systems.crowds.steering import Steering
from animtool.systems.framework.simulation import SimContext

# Most passes that move agents out of obstacles at the start.
MAX_CLEARING_PASSES = 20


def clear_starts(
    agents: Agents, grid: NavGrid | None, obstacles: Obstacles, begin: float
) -> tuple[FloatArray, list[Fault]]:
    """Return start positions outside of obstacles, and warnings (SIM148)."""
    positions, notices = agents.starts, list[Fault]()
    count = len(agents)
    if grid is not None and count and grid.free.any():
        is_off_grid = is_blocked(grid, positions)
        nodes = grid.node_positions(grid.nearest_free_node(positions))
        positions = np.where(is_off_grid[:, None], nodes, positions)
    radius = float(agents.radii.max(initial=1.0))
    for _ in range(MAX_CLEARING_PASSES):
        walls = obstacles.walls(begin, 0.0, positions)
        if not (walls.gaps < 0).any() and (positions == agents.starts).all():
            break
        previous = positions
        positions, _ = separate_agents(agents, positions, walls.starts, walls.rows)
        if np.abs(positions - previous).max(initial=0.0) <= OVERLAP_TOLERANCE * radius:
            break
    distances = np.linalg.norm(positions - agents.starts, axis=1)
    is_moved = distances > OVERLAP_TOLERANCE * agents.radii
    if is_moved.any():
        first = agents.label(int(np.argmax(is_moved)))
        message = f"{counted(int(is_moved.sum()), 'agent')} would start in an obstacle "
        message += f"or off the ground, {first} first: moved out"
        notices.append(warning("SIM148", message, "begin elsewhere"))
    return positions, notices


def _blocking_obstacle(
    obstacles: Obstacles, grid: NavGrid, position: FloatArray, t: float
) -> tuple[str, str] | None:
    """Return what is at x and z of a goal ``(1, 2)``, and a hint; None if it is free.

    Nodes deep inside a low obstacle count as free, since the nearest face is its top.
    """
    depths = obstacles.collider_depths(t, position)
    depth = float(depths.max(initial=-np.inf))
    if depth > 0:
        name = obstacles.collider_name(int(depths.argmax()))
        problem = f"inside the collider {name}, {length_text(depth, 2)} deep"
        return problem, "move the goal or the collider"
    if not is_blocked(grid, position)[0]:
        return None
    radius = float(obstacles.agents.radii.max(initial=0.0))
    if -depth > radius:
        return "off the ground, or on a slope that is too steep", "move the goal"
    name = obstacles.collider_name(int(depths.argmax()))
    problem = f"{length_text(-depth, 2)} from the collider {name}, nearer than the "
    return f"{problem}radius of agents, {length_text(radius)}", "move the goal"


def _nearest_reachable(
    grid: NavGrid, position: FloatArray, components: IntArray
) -> FloatArray:
    """Return x and z of the node of some components nearest to a goal ``(2,)``."""
    nodes = np.flatnonzero(np.isin(grid.components.ravel(), components))
    if not len(nodes):
        nodes = grid.nearest_free_node(position)
    points = grid.node_positions(nodes)
    return np.asarray(points[int(((points - position) ** 2).sum(axis=1).argmin())])


def unreachable_goal_warnings(
    spec: CrowdsModel,
    agents: Agents,
    steering: Steering,
    obstacles: Obstacles,
    start: FloatArray,
    begin: float,
) -> list[Fault]:
    """Return warnings about goals that agents cannot reach (SIM146)."""
    grid, faults = steering.grid, list[Fault]()
    if grid is None or not grid.free.any():
        return []
    components = grid.components.ravel()
    start_components = components[grid.nearest_free_node(start)]
    for goal_index, goal in enumerate(spec.goals):
        position = steering.goal_points[goal_index : goal_index + 1]
        obstacle = _blocking_obstacle(obstacles, grid, position, begin)
        if obstacle is not None:
            problem, hint = obstacle
            nearest = _nearest_reachable(grid, position, start_components)
            message = f"the goal {goal.name!r} is {problem}: agents go to "
            message += f"{obstacles.world_text(nearest)} instead"
            where = f"goals[{goal_index}].at"
            faults.append(warning("SIM146", message, hint, where))
            continue
        goal_component = components[grid.nearest_free_node(position)[0]]
        for population_index, population in enumerate(spec.populations):
            is_cut_off = start_components != goal_component
            is_cut_off &= agents.kinds == population_index
            if goal.name in population.route and is_cut_off.any():
                message = f"no path leads {counted(int(is_cut_off.sum()), 'agent')} of "
                message += f"{population.name!r} to the goal {goal.name!r}: they go "
                message += "to the nearest position that they can reach"
                hint = "leave a gap wider than the agents, or move the goal"
                faults.append(warning("SIM146", message, hint))
    return faults


def project_direction(frame: GroundFrame, direction: Sequence[float]) -> FloatArray:
    """Return a world direction projected on the ground, normalized ``(2,)``."""
    ground_direction = frame.vector_to_local(np.array(direction, float))[[0, 2]]
    length = float(np.linalg.norm(ground_direction))
    if not length > 0:
        message = "the direction of a queue is vertical"
        refuse("SIM145", message, "goals", "use a direction along the ground")
    return np.asarray(ground_direction / length)


def ground_of(context: SimContext) -> tuple[GroundFrame, Terrain]:
    """Return the frame of the ground, and its height field."""
    ground_data = context.parts["ground"]
    poses = ground_data["poses"]
    shape = ground_data.get("shape")
    mesh = ground_data.get("mesh")
    if not poses.is_fixed:
        message = "the ground cannot move"
        refuse("SIM145", message, "ground", "remove moves and turns")
    pose = poses.at(context.begin)
    frame = GroundFrame(pose[:3], pose[3:])
    if shape is not None and mesh is not None:
        message = "the ground is either a shape or a mesh of a file"
        refuse("SIM145", message, "ground", "remove one of them")
    if mesh is not None:
        surface = mesh()[0]
        corners = triangulate(surface.counts, surface.indices)
        return frame, Terrain(surface.points[corners])
    if shape is None:
        return frame, Terrain()
    if not isinstance(shape, Mesh):
        message = "the ground must be a mesh, a height_field or, without a shape, a "
        message += "plane"
        refuse("SIM145", message, "ground", "shape: {height_field: {...}}")
    points, faces = shape.weld()
    return frame, Terrain(points[faces])

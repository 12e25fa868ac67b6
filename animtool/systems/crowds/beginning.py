"""Initial state of a crowd: its ground, clear start positions, reachable goals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, counted, refuse, warning
from animtool.maths.faces import triangulated
from animtool.sim.colliders import Mesh
from animtool.systems.crowds.agents import ENOUGH, Agents, separated
from animtool.systems.crowds.ground import Frame, Terrain
from animtool.systems.crowds.obstacles import Obstacles, lost
from animtool.systems.crowds.routes import NavGrid
from animtool.systems.crowds.spec import CrowdsModel
from animtool.systems.crowds.steering import Steering
from animtool.systems.framework.simulation import SimContext

# Passes that move agents out of obstacles at the start.
MOVES = 20


def outside(
    agents: Agents, grid: NavGrid | None, obstacles: Obstacles, begin: float
) -> tuple[FloatArray, list[Fault]]:
    """Return start positions clear of obstacles, and who was moved (SIM148)."""
    x, notices = agents.starts, list[Fault]()
    count = len(agents)
    if grid is not None and count and grid.free.any():
        off = lost(grid, x)
        x = np.where(off[:, None], grid.positions_of(grid.free_at(x)), x)
    radius = float(agents.radii.max(initial=1.0))
    for _ in range(MOVES):
        walls = obstacles.walls(begin, 0.0, x)
        if not (walls.gaps < 0).any() and (x == agents.starts).all():
            break
        before = x
        x, _ = separated(agents, x, walls.starts, walls.rows)
        if np.abs(x - before).max(initial=0.0) <= ENOUGH * radius:
            break
    moved = np.linalg.norm(x - agents.starts, axis=1) > ENOUGH * agents.radii
    if moved.any():
        first = agents.named(int(np.argmax(moved)))
        message = f"{counted(int(moved.sum()), 'agent')} would start in an obstacle "
        message += f"or off the ground, {first} first: moved out"
        notices.append(warning("SIM148", message, "begin elsewhere"))
    return x, notices


def unreachable(
    spec: CrowdsModel, agents: Agents, steering: Steering, start: FloatArray
) -> list[Fault]:
    """Return warnings of goals that no path leads to (SIM146)."""
    grid, faults = steering.grid, list[Fault]()
    if grid is None or not grid.free.any():
        return []
    parts = grid.parts.ravel()
    reachable = parts[grid.free_at(start)]
    for g, goal in enumerate(spec.goals):
        at = steering.points[g : g + 1]
        if lost(grid, at)[0]:
            message = f"the goal {goal.name!r} is in an obstacle or off the ground: "
            message += "agents go to the nearest free position"
            faults.append(warning("SIM146", message, "move the goal"))
        part = parts[grid.free_at(at)[0]]
        for kind, population in enumerate(spec.populations):
            mine = (agents.kinds == kind) & (reachable != part)
            if goal.name in population.route and mine.any():
                message = f"no path leads {counted(int(mine.sum()), 'agent')} of "
                message += f"{population.name!r} to the goal {goal.name!r}: they go "
                message += "to the nearest position that they can reach"
                hint = "leave a gap wider than the agents, or move the goal"
                faults.append(warning("SIM146", message, hint))
    return faults


def along_ground(frame: Frame, direction: Sequence[float]) -> FloatArray:
    """Return a world direction projected on the ground ``(2,)``, normalised."""
    flat = frame.turned_back(np.array(direction, float))[[0, 2]]
    size = float(np.linalg.norm(flat))
    if not size > 0:
        message = "the direction of a queue is vertical"
        refuse("SIM145", message, "goals", "use a direction along the ground")
    return np.asarray(flat / size)


def ground_of(context: SimContext) -> tuple[Frame, Terrain]:
    """Return the frame of the ground, and its terrain."""
    parts = context.parts["ground"]
    poses, shape, mesh = parts["poses"], parts.get("shape"), parts.get("mesh")
    if len(poses.sample_times) > 1:
        message = "the ground cannot move"
        refuse("SIM145", message, "ground", "remove moves and turns")
    pose = poses.at(context.begin)
    frame = Frame(pose[:3], pose[3:])
    if shape is not None and mesh is not None:
        message = "the ground is either a shape or a mesh of a file"
        refuse("SIM145", message, "ground", "remove one of them")
    if mesh is not None:
        surface = mesh()[0]
        corners = triangulated(surface.counts, surface.indices)
        return frame, Terrain(surface.points[corners])
    if shape is None:
        return frame, Terrain()
    if not isinstance(shape, Mesh):
        message = "the ground must be a mesh, a height_field or, without a shape, a "
        message += "plane"
        refuse("SIM145", message, "ground", "shape: {height_field: {...}}")
    points, faces = shape.weld()
    return frame, Terrain(points[faces])

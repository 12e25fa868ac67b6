"""Obstacles of agents: colliders, closed doors and the edge of the ground."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.quantities import vector_text
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.sim.colliders import Collider, Colliders, Plane
from animtool.sim.colliders.shapes import shape_bounds
from animtool.systems.crowds.agents import Agents
from animtool.systems.crowds.ground import (
    GroundFrame,
    Terrain,
    find_walkable_nodes,
    sample_ground,
)
from animtool.systems.crowds.routes import MAX_NODES, NavGrid
from animtool.systems.crowds.spec import CrowdsModel, DoorModel

# For N agents the gaps to an obstacle ``(N,)`` [m], directions from it ``(N, 2)``, and
# closing speeds ``(N,)`` [m/s].
AgentGaps: TypeAlias = tuple[FloatArray, FloatArray, FloatArray]

# Smallest horizontal component of the normal of a wall; surfaces with less are floors
# or ceilings.
MIN_WALL_NORMAL = 0.3
# Margin of the navigation grid around starts and goals: a fraction of their extent,
# plus a multiple of the largest radius.
GRID_MARGIN, GRID_MARGIN_RADII = 0.5, 40.0
# Grid nodes sampled in one call, to limit memory.
SAMPLE_BLOCK = 2**18
# Fraction of the top speed at which an agent leaves an obstacle.
LEAVING_SPEED = 0.8


@dataclass(frozen=True)
class Walls:
    """Obstacles near N agents, as half-planes sorted by agent."""

    first_walls: npt.NDArray[np.int32]  # index of each agent's first wall (N + 1,)
    # For each wall its unit normal (x, z), the minimum velocity along it [m/s], and the
    # minimum position along it [m] (M, 4).
    half_planes: FloatArray
    agents_of_walls: IntArray  # agent of each wall (M,)
    gaps: FloatArray  # distance between the surfaces of wall and agent (M,) [m]
    closing_speeds: FloatArray  # speed of the wall towards the agent (M,) [m/s]


@dataclass(frozen=True)
class Obstacles:
    """All obstacles of a crowd: colliders, closed doors and the edge of the ground."""

    agents: Agents
    ground_frame: GroundFrame
    ground: Terrain
    colliders: Colliders
    doors: Sequence[DoorModel] = ()
    # Grid of nodes on the ground; None for infinite ground.
    edge_grid: NavGrid | None = None
    horizon: float = 0.5  # look-ahead of avoidance [s]
    # (x, z) of both ends of each door ``(D, 2, 2)`` [m].
    door_ends: FloatArray = field(default_factory=lambda: np.zeros((0, 2, 2)))

    def walls(self, t: float, dt: float, x: FloatArray) -> Walls:
        """Return obstacles near agents at (x, z) ``(N, 2)``, in a step [s]."""
        obstacles = self._collider_gaps(t, dt, x)
        obstacles += self._door_gaps(t, x) + self._edge_gaps(x)
        count = len(x)
        if not obstacles:
            zeros = np.zeros(0)
            first_walls = np.zeros(count + 1, np.int32)
            return Walls(first_walls, np.zeros((0, 4)), zeros.astype(int), zeros, zeros)
        agents, max_speeds = self.agents, self.agents.max_speeds
        nearby_walls = []
        for gaps, directions, closing_speeds in obstacles:
            ranges = (max_speeds + np.abs(closing_speeds)) * self.horizon
            i = np.flatnonzero(gaps < np.maximum(ranges, agents.radii))
            columns = i, gaps[i], directions[i], closing_speeds[i]
            nearby_walls.append(columns)
        wall_columns = [
            np.concatenate(arrays) for arrays in zip(*nearby_walls, strict=True)
        ]
        order = np.argsort(wall_columns[0], kind="stable")
        agents_of_walls, gaps, directions, closing_speeds = (
            c[order] for c in wall_columns
        )
        leaving_speeds = LEAVING_SPEED * max_speeds[agents_of_walls]
        min_speeds = np.minimum(closing_speeds - gaps / self.horizon, leaving_speeds)
        positions = (directions * x[agents_of_walls]).sum(axis=1)
        offsets = positions - gaps + closing_speeds * dt
        wall_rows = np.column_stack([directions, min_speeds, offsets])
        first_walls = np.searchsorted(agents_of_walls, np.arange(count + 1)).astype(
            np.int32
        )
        return Walls(first_walls, wall_rows, agents_of_walls, gaps, closing_speeds)

    def _collider_gaps(self, t: float, dt: float, x: FloatArray) -> list[AgentGaps]:
        """Return the gaps of all colliders."""
        if not self.colliders.rigid_colliders:
            return []
        radii, body_heights = self.agents.radii, self.agents.heights
        base_heights, _ = sample_ground(self.ground, x)
        return [
            (distances - radii, directions, speeds)
            for distances, directions, speeds in capsule_distances(
                self.colliders,
                self.ground_frame,
                x,
                base_heights,
                radii,
                body_heights,
                t,
                dt,
            )
        ]

    def collider_depths(self, t: float, position: FloatArray) -> FloatArray:
        """Return the depth ``(C,)`` of an agent at (x, z) ``(1, 2)`` in each collider.

        It is that of the largest agent's axis [m], negative outside. Moving colliders,
        which block no paths, have minus infinity.
        """
        max_radius = float(self.agents.radii.max(initial=0.0))
        max_height = float(self.agents.heights.max(initial=max_radius))
        base = float(sample_ground(self.ground, position)[0][0])
        low, high = base + max_radius, base + max(max_height - max_radius, max_radius)
        x, z = position[0]
        points = np.array([[x, y, z] for y in (low, (low + high) / 2, high)])
        if not len(self.colliders):
            return np.zeros(0)
        samples = self.colliders.sample(self.ground_frame.to_world(points), t, t)
        depths = -samples.distances[: len(self.colliders)].min(axis=1)
        is_fixed = [collider.poses.is_fixed for collider in self.colliders]
        return np.where(is_fixed, depths, -np.inf)

    def world_text(self, x: FloatArray) -> str:
        """Return the ground position of an (x, z) point ``(2,)`` as text."""
        height = float(sample_ground(self.ground, x[None])[0][0])
        point = self.ground_frame.to_world(np.array([[x[0], height, x[1]]]))[0]
        return f"{vector_text(point)} m"

    def _door_gaps(self, t: float, x: FloatArray) -> list[AgentGaps]:
        """Return the gaps of closed doors."""
        door_gaps = []
        for door, (a, b) in zip(self.doors, self.door_ends, strict=True):
            if any(first <= t < last for first, last in door.opens):
                continue
            door_vector = b - a
            fraction = ((x - a) @ door_vector) / (door_vector @ door_vector)
            fraction = np.clip(fraction, 0.0, 1.0)
            offsets = x - a - fraction[:, None] * door_vector
            distances = np.linalg.norm(offsets, axis=1)
            directions = offsets / np.where(distances > 0, distances, 1.0)[:, None]
            door_gaps.append(
                (distances - self.agents.radii, directions, np.zeros(len(x)))
            )
        return door_gaps

    def _edge_gaps(self, x: FloatArray) -> list[AgentGaps]:
        """Return the gaps of the edge of the ground."""
        if self.edge_grid is None:
            return []
        gaps, directions = self.edge_grid.obstacle_distances(x)
        return [(gaps - self.agents.radii, directions, np.zeros(len(x)))]


def capsule_distances(
    colliders: Colliders,
    ground_frame: GroundFrame,
    x: FloatArray,
    base_heights: FloatArray,
    radii: FloatArray,
    body_heights: FloatArray,
    t: float,
    dt: float,
) -> list[AgentGaps]:
    """Return horizontal distances of colliders from upright capsules.

    For each collider it returns distances ``(K,)`` from the axes [m], infinite for
    floors, unit vectors away from the collider ``(K, 2)``, and its speeds along them
    ``(K,)`` [m/s]. The capsules have (x, z) positions ``(K, 2)``, base heights
    ``(K,)``, radii ``(K,)`` and total heights ``(K,)`` [m].
    """
    count = len(x)
    lows = base_heights + radii
    highs = base_heights + np.maximum(body_heights - radii, radii)
    level_heights = [lows, (lows + highs) / 2, highs]
    points = np.concatenate(
        [np.column_stack([x[:, 0], y, x[:, 1]]) for y in level_heights]
    )
    samples = colliders.sample(ground_frame.to_world(points), t, t + dt)
    capsule_gaps = []
    for distances, outwards, velocities in zip(
        samples.distances, samples.normals, samples.velocities, strict=True
    ):
        normals = ground_frame.vector_to_local(outwards)[:, [0, 2]]
        speeds = ground_frame.vector_to_local(velocities)[:, [0, 2]]
        lengths = np.linalg.norm(normals, axis=1)
        is_wall = lengths > MIN_WALL_NORMAL
        divisors = np.where(is_wall, lengths, 1.0)
        wall_distances = np.where(is_wall, distances / divisors, np.inf)
        wall_distances = wall_distances.reshape(len(level_heights), count)
        nearest = np.argmin(wall_distances, axis=0) * count + np.arange(count)
        directions = normals[nearest] / divisors[nearest, None]
        closing_speeds = (speeds[nearest] * directions).sum(axis=1)
        gaps = wall_distances.ravel()[nearest]
        capsule_gaps.append((gaps, directions, closing_speeds))
    return capsule_gaps


def navigation_grids(
    spec: CrowdsModel,
    agents: Agents,
    ground_frame: GroundFrame,
    ground: Terrain,
    colliders: Colliders,
    goals: FloatArray,
    t: float,
) -> tuple[NavGrid | None, NavGrid | None]:
    """Return a grid of walkable nodes, and a grid of all nodes on the ground.

    The first is None if there are no obstacles, the second if the ground is infinite.
    If agents are too far apart for one grid, it only covers the surroundings of
    obstacles.
    """
    static_obstacles = [collider for collider in colliders if collider.poses.is_fixed]
    if ground.is_plane and not static_obstacles:
        return None, None
    radius = float(agents.radii.max(initial=0.0)) or 1.0
    corners = np.concatenate([agents.start_points, goals])
    low = high = np.zeros(2)
    if len(corners):
        low, high = corners.min(axis=0), corners.max(axis=0)
    margin = GRID_MARGIN * (high - low).max() + GRID_MARGIN_RADII * radius
    low, high = low - margin, high + margin
    if not ground.is_plane:
        low = np.maximum(low, ground.bounds[0])
        high = np.minimum(high, ground.bounds[1])
        high = np.maximum(high, low)
    cell_size = spec.cell or radius
    if ground.is_plane and np.prod((high - low) / cell_size) > MAX_NODES:
        low, high = _obstacle_bounds(
            static_obstacles, ground_frame, low, high, GRID_MARGIN_RADII * radius
        )
        if not (low < high).all():
            return None, None
    node_spacing = max(cell_size, float(np.sqrt(np.prod(high - low) / MAX_NODES)))
    rows, columns = (np.floor((high - low) / node_spacing).astype(int) + 1).tolist()
    shape = rows, columns
    nodes = NavGrid.all_positions(low, node_spacing, shape)
    max_slope = np.radians(spec.ground.slope)
    ground_heights, has_ground = find_walkable_nodes(
        ground, nodes, shape, node_spacing, max_slope
    )
    is_free = has_ground.ravel().copy()
    if static_obstacles:
        static_colliders, heights = Colliders(static_obstacles), ground_heights.ravel()
        free_nodes = np.flatnonzero(is_free)
        max_height = float(agents.heights.max(initial=radius))
        for first in range(0, len(free_nodes), SAMPLE_BLOCK):
            block = free_nodes[first : first + SAMPLE_BLOCK]
            ones, is_clear = np.ones(len(block)), np.ones(len(block), bool)
            for distances, _, _ in capsule_distances(
                static_colliders, ground_frame, nodes[block], heights[block],
                radius * ones, max_height * ones, t, 0.0,
            ):  # fmt: skip
                # Gaps narrower than an agent are blocked.
                is_clear &= distances >= radius - node_spacing / 2
            is_free[block] = is_clear
    is_endless = ground.is_plane and has_ground.all()
    edge_grid = None if is_endless else NavGrid(low, node_spacing, has_ground)
    return NavGrid(low, node_spacing, is_free.reshape(shape)), edge_grid


def _obstacle_bounds(
    static_obstacles: Sequence[Collider],
    ground_frame: GroundFrame,
    low: FloatArray,
    high: FloatArray,
    margin: float,
) -> tuple[FloatArray, FloatArray]:
    """Return bounds around obstacles, within (x, z) bounds ``(2,)`` [m].

    Infinite walls are near everything; floors are no obstacles.
    """
    obstacle_low, obstacle_high = np.full(2, np.inf), np.full(2, -np.inf)
    for collider in static_obstacles:
        if isinstance(collider.shape, Plane):
            normal = np.array(collider.shape.normal, float)
            normal = so3.rotate(collider.poses.rows[0, 3:], normal)
            horizontal = ground_frame.vector_to_local(normal)[[0, 2]]
            if np.linalg.norm(horizontal) > MIN_WALL_NORMAL * np.linalg.norm(normal):
                return low, high
            continue
        span = shape_bounds(collider.shape)
        box_corners = np.array(
            [span[list(corner), range(3)] for corner in np.ndindex(2, 2, 2)]
        )
        corners = ground_frame.to_local(collider.poses.to_world(box_corners)[0])[
            :, [0, 2]
        ]
        obstacle_low = np.minimum(obstacle_low, corners.min(axis=0))
        obstacle_high = np.maximum(obstacle_high, corners.max(axis=0))
    low = np.maximum(low, obstacle_low - margin)
    return low, np.minimum(high, obstacle_high + margin)


def is_blocked(grid: NavGrid, x: FloatArray) -> BoolArray:
    """Return which (x, z) points ``(K, 2)`` are not walkable ``(K,)``."""
    row, column = grid.nearest_nodes(x).T
    return np.asarray(~grid.is_free[row, column])

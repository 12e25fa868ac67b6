"""Navigation grids, and distance fields to goals."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from animtool import _kernels
from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.record import dataclass

# Largest number of grid nodes; larger areas get larger cells.
MAX_NODES = 4_000_000
# Longest detour of a path that counts as straight, in cells: distances are approximate,
# and agents avoid obstacles anyway.
STRAIGHT_DETOUR = 1.5
# A straight path must be free for this many cells.
LOOKAHEAD_NODES = 8
TINY_LENGTH = 1e-300


@dataclass(frozen=True)
class NavGrid:
    """Grid of nodes on the ground, with a mask of walkable ones."""

    low: FloatArray  # (x, z) of the first node (2,) [m]
    cell: float  # distance between nodes [m]
    is_free: BoolArray  # mask of walkable nodes (R, C), rows along x

    @staticmethod
    def all_positions(
        low: FloatArray, cell: float, shape: tuple[int, int]
    ) -> FloatArray:
        """Return the (x, z) points of all nodes ``(R·C, 2)`` [m]."""
        rows, columns = np.indices(shape).reshape(2, -1)
        return np.asarray(low + cell * np.stack([rows, columns], axis=1))

    @cached_property
    def components(self) -> IntArray:
        """Connected component of each node ``(R, C)``; 0 for blocked nodes."""
        from scipy.ndimage import label

        return np.asarray(label(self.is_free)[0], np.int64)

    @cached_property
    def _nearest_free_nodes(self) -> IntArray:
        """Index of the free node nearest to each node ``(R, C)``."""
        from scipy.ndimage import distance_transform_edt

        rows, columns = distance_transform_edt(
            ~self.is_free, self.cell, return_distances=False, return_indices=True
        )
        return np.asarray(rows * self.is_free.shape[1] + columns)

    def nearest_nodes(self, points: FloatArray) -> IntArray:
        """Return row and column of the node nearest to each (x, z) point ``(K, 2)``."""
        last_indices = np.array(self.is_free.shape) - 1
        indices = np.floor((points - self.low) / self.cell + 0.5)
        return np.clip(indices, 0, last_indices).astype(np.int64)

    @property
    def high(self) -> FloatArray:
        """The (x, z) point of the last node ``(2,)`` [m]."""
        return np.asarray(self.low + self.cell * (np.array(self.is_free.shape) - 1))

    def border_distance(self, points: FloatArray) -> FloatArray:
        """Return distances of points ``(K, 2)`` from the border, negative outside."""
        distances = np.minimum(points - self.low, self.high - points)
        return np.asarray(distances.min(axis=1), np.float64)

    def border_nodes_facing(self, point: FloatArray) -> IntArray:
        """Return the border nodes on the sides that face a point outside the grid."""
        indices = np.arange(self.is_free.size).reshape(self.is_free.shape)
        border = [np.zeros(0, np.int64)]
        for axis, grid_rows in enumerate((indices, indices.T)):
            if point[axis] < self.low[axis] - self.cell:
                border.append(grid_rows[0])
            if point[axis] > self.high[axis] + self.cell:
                border.append(grid_rows[-1])
        return np.unique(np.concatenate(border))

    def nearest_free_node(self, points: FloatArray) -> IntArray:
        """Return the free node nearest to each (x, z) point ``(K, 2)``."""
        row, column = self.nearest_nodes(points).T
        return np.asarray(self._nearest_free_nodes[row, column])

    def node_positions(self, nodes: IntArray) -> FloatArray:
        """Return the (x, z) points of nodes by index ``(K, 2)`` [m]."""
        index = np.stack(np.divmod(nodes, self.is_free.shape[1]), axis=-1)
        return np.asarray(self.low + self.cell * index)

    @cached_property
    def _clearances(self) -> FloatArray:
        """Distance of each node from blocked nodes ``(R, C)`` [m]."""
        from scipy.ndimage import distance_transform_edt

        distances = distance_transform_edt(np.pad(self.is_free, 1), self.cell)
        return np.asarray(distances)[1:-1, 1:-1]

    def cell_corners(self, points: FloatArray) -> tuple[IntArray, IntArray, FloatArray]:
        """Return the nodes around (x, z) points, and bilinear weights ``(K, 2, 2)``.

        Rows of the four nodes are ``(K, 2, 1)``, and columns ``(K, 1, 2)``.
        """
        last_indices = np.array(self.is_free.shape) - 1
        coordinates = np.clip((points - self.low) / self.cell, 0, last_indices)
        lower_node = np.minimum(
            coordinates.astype(np.int64), np.maximum(last_indices - 1, 0)
        )
        corner_indices = np.minimum(
            lower_node[:, None] + np.array([[0], [1]]), last_indices
        )
        fraction = coordinates - lower_node
        axis_weights = np.stack([1 - fraction, fraction], axis=1)
        weights = axis_weights[:, :, None, 0] * axis_weights[:, None, :, 1]
        return corner_indices[:, :, None, 0], corner_indices[:, None, :, 1], weights

    def obstacle_distances(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return distances of (x, z) points from obstacles, and directions away.

        Distances ``(K,)`` [m] are to half a cell before blocked nodes, where obstacles
        begin. Directions are ``(K, 2)``.
        """
        rows, columns, weights = self.cell_corners(points)
        clearances = self._clearances[rows, columns]
        x_change = clearances[:, 1] - clearances[:, 0]
        z_change = clearances[:, :, 1] - clearances[:, :, 0]
        x_slope = (x_change * weights.sum(axis=1)).sum(axis=1)
        z_slope = (z_change * weights.sum(axis=2)).sum(axis=1)
        directions = np.stack([x_slope, z_slope], axis=1)
        lengths = np.linalg.norm(directions, axis=1)[:, None]
        directions = directions / np.where(lengths > 0, lengths, 1.0)
        return (clearances * weights).sum(axis=(1, 2)) - self.cell / 2, directions


@dataclass(frozen=True)
class FlowField:
    """Shortest paths to a goal, from all nodes of a grid."""

    grid: NavGrid
    goals: FloatArray  # (x, z) ends of paths by component ``(P, 2)`` [m]
    distances: FloatArray  # path lengths from nodes, infinite if unreachable (R, C) [m]

    @cached_property
    def gradient(self) -> FloatArray:
        """Unit vectors along the shortest path from each node ``(R, C, 2)``."""
        distances = self.distances
        padded_distances = np.pad(distances, 1, constant_values=np.inf)
        neighbours = (
            (padded_distances[:-2, 1:-1], padded_distances[2:, 1:-1]),
            (padded_distances[1:-1, :-2], padded_distances[1:-1, 2:]),
        )
        descent = np.zeros((*distances.shape, 2))
        for axis, (before, after) in enumerate(neighbours):
            lower_distances = np.minimum(before, after)
            is_descending = np.isfinite(distances) & (lower_distances < distances)
            distance_drops = np.zeros_like(distances)
            np.subtract(
                distances, lower_distances, out=distance_drops, where=is_descending
            )
            descent[..., axis] = np.where(
                before < after, -distance_drops, distance_drops
            )
        lengths = np.linalg.norm(descent, axis=2)[..., None]
        return descent / np.where(lengths > 0, lengths, 1.0)

    def path_directions(self, points: FloatArray, targets: FloatArray) -> FloatArray:
        """Return unit vectors ``(K, 2)`` along the paths from (x, z) points.

        They point straight at ``targets`` if the goal is near and visible. Agents on
        blocked nodes first return to a free node.
        """
        grid = self.grid
        rows, columns, weights = grid.cell_corners(points)
        weighted_gradients = self.gradient[rows, columns] * weights[..., None]
        unit_vectors = weighted_gradients.sum(axis=(1, 2))
        is_undefined = ~unit_vectors.any(axis=1)
        if is_undefined.any():
            blocked_points = points[is_undefined]
            free_nodes = grid.nearest_free_node(blocked_points)
            to_nodes = grid.node_positions(free_nodes) - blocked_points
            unit_vectors[is_undefined] = to_nodes
        goal_points = self.path_ends(points)
        offset = goal_points - points
        distances = np.linalg.norm(offset, axis=1)
        row, column = grid.nearest_nodes(points).T
        # Outside the grid, visibility is that of the nearest node.
        node_points = grid.node_positions(row * grid.is_free.shape[1] + column)
        node_to_goal = np.linalg.norm(goal_points - node_points, axis=1)
        is_outside = grid.border_distance(points) < 0
        straight_distance = np.maximum(distances, np.where(is_outside, node_to_goal, 0))
        max_distance = straight_distance + STRAIGHT_DETOUR * grid.cell
        is_near = self.distances[row, column] <= max_distance
        # Paths to a goal outside the grid end at its border, and go straight from
        # there.
        is_at_border = grid.border_distance(points) < grid.cell
        is_near &= is_at_border | (grid.border_distance(goal_points) > -grid.cell)
        is_near[is_near] = self._has_line_of_sight(points[is_near], targets[is_near])
        unit_vectors[is_near] = (targets - points)[is_near]
        lengths = np.linalg.norm(unit_vectors, axis=1)[:, None]
        return np.asarray(unit_vectors / np.where(lengths > 0, lengths, 1.0))

    def _has_line_of_sight(self, points: FloatArray, targets: FloatArray) -> BoolArray:
        """Return a mask of nearby targets ``(K, 2)`` in line of sight ``(K,)``."""
        grid = self.grid
        offset = targets - points
        distances = np.linalg.norm(offset, axis=1)
        lookahead = np.minimum(distances, LOOKAHEAD_NODES * grid.cell)[:, None]
        step_lengths = lookahead / LOOKAHEAD_NODES
        offsets = np.arange(1, LOOKAHEAD_NODES + 1)[:, None, None] * step_lengths
        directions = offset / np.maximum(distances, TINY_LENGTH)[:, None]
        samples = points + offsets * directions
        rows, columns = grid.nearest_nodes(samples.reshape(-1, 2)).T
        is_free = grid.is_free[rows, columns].reshape(LOOKAHEAD_NODES, -1)
        return np.asarray(is_free.all(axis=0), np.bool_)

    def path_ends(self, points: FloatArray) -> FloatArray:
        """Return the ends of the paths from (x, z) points ``(K, 2)`` [m]."""
        component = self.grid.components.ravel()[self.grid.nearest_free_node(points)]
        return self.goals[component]


def flow_field(grid: NavGrid, goal: FloatArray) -> FlowField:
    """Return the flow field to a goal at an (x, z) point ``(2,)``.

    In components of the grid without the goal, paths lead to the node nearest to it.
    """
    node = int(grid.nearest_free_node(goal[None])[0])
    goal_component = int(grid.components.ravel()[node])
    free_nodes = np.flatnonzero(grid.is_free.ravel())
    components = grid.components.ravel()[free_nodes]
    goal_distances = np.linalg.norm(grid.node_positions(free_nodes) - goal, axis=1)
    order = np.lexsort([goal_distances, components])
    nearest_to_goal = order[np.flatnonzero(np.diff(components[order], prepend=0))]
    row, column = grid.nearest_nodes(goal[None])[0]
    nearest_positions = grid.node_positions(free_nodes[nearest_to_goal])
    goals = np.concatenate([np.zeros((1, 2)), nearest_positions])
    goal_seeds: Sequence[int] | IntArray = []
    if grid.is_free[row, column]:
        goals[goal_component] = goal
        # Seeded around the goal, so that paths end there and not at a node; outside the
        # grid nothing blocks the facing sides.
        is_near = goal_distances < 1.5 * grid.cell
        nearby_nodes = free_nodes[is_near & (components == goal_component)]
        border = grid.border_nodes_facing(goal)
        border = border[grid.components.ravel()[border] == goal_component]
        goal_seeds = np.union1d(nearby_nodes, border)
    seeds = np.concatenate([free_nodes[nearest_to_goal], goal_seeds]).astype(np.int64)
    offsets = grid.node_positions(seeds) - goals[grid.components.ravel()[seeds]]
    lengths = np.linalg.norm(offsets, axis=1)
    distances = _kernels.travel_distances(grid.is_free, grid.cell, seeds, lengths)
    return FlowField(grid, goals, distances)

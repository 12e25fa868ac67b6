"""Navigation: distance fields to each goal, on a grid."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cached_property

import numpy as np

from animtool import _kernels
from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.record import dataclass

# Largest number of grid nodes: larger areas get larger cells.
MAX_NODES = 4_000_000
# Detours shorter than this many cells count as straight: distances are first-order, and
# agents avoid what they touch.
STRAIGHT = 1.5
# A straight path must be free for this many cells.
LOOKAHEAD_NODES = 8
TINY = 1e-300


@dataclass(frozen=True)
class NavGrid:
    """Nodes on the ground, and which of them are walkable.

    Attributes:
        low: x and z of the first ``(2,)`` [m].
        cell: From one to the next [m].
        free: ``(R, C)``, rows along x.
    """

    low: FloatArray
    cell: float
    free: BoolArray

    @staticmethod
    def nodes(low: FloatArray, cell: float, shape: tuple[int, int]) -> FloatArray:
        """Return x and z of nodes ``(R·C, 2)`` [m]."""
        rows, columns = np.indices(shape).reshape(2, -1)
        return np.asarray(low + cell * np.stack([rows, columns], axis=1))

    @cached_property
    def parts(self) -> IntArray:
        """Return the connected component of each node ``(R, C)``, 0 for none."""
        from scipy.ndimage import label

        return np.asarray(label(self.free)[0], np.int64)

    @cached_property
    def nearest(self) -> tuple[FloatArray, IntArray]:
        """Return the distance to the nearest free node ``(R, C)`` [m], and which."""
        from scipy.ndimage import distance_transform_edt

        far, which = distance_transform_edt(~self.free, self.cell, return_indices=True)
        return far, which[0] * self.free.shape[1] + which[1]

    def at(self, points: FloatArray) -> IntArray:
        """Return rows and columns of the nodes nearest to x and z ``(K, 2)``."""
        most = np.array(self.free.shape) - 1
        near = np.floor((points - self.low) / self.cell + 0.5)
        return np.clip(near, 0, most).astype(np.int64)

    @property
    def high(self) -> FloatArray:
        """The last node: x and z ``(2,)`` [m]."""
        return np.asarray(self.low + self.cell * (np.array(self.free.shape) - 1))

    def depth(self, points: FloatArray) -> FloatArray:
        """Return the distance of x and z ``(K, 2)`` to its border, negative outside."""
        sides = np.minimum(points - self.low, self.high - points)
        return np.asarray(sides.min(axis=1), np.float64)

    def facing(self, point: FloatArray) -> IntArray:
        """Return the border nodes on the sides that x and z ``(2,)`` lie beyond."""
        numbers = np.arange(self.free.size).reshape(self.free.shape)
        sides = [np.zeros(0, np.int64)]
        for axis, edges in enumerate((numbers, numbers.T)):
            if point[axis] < self.low[axis] - self.cell:
                sides.append(edges[0])
            if point[axis] > self.high[axis] + self.cell:
                sides.append(edges[-1])
        return np.unique(np.concatenate(sides))

    def free_at(self, points: FloatArray) -> IntArray:
        """Return the free nodes nearest to x and z ``(K, 2)``."""
        row, column = self.at(points).T
        return np.asarray(self.nearest[1][row, column])

    def positions_of(self, numbers: IntArray) -> FloatArray:
        """Return x and z of nodes by number ``(K, 2)`` [m]."""
        index = np.stack(np.divmod(numbers, self.free.shape[1]), axis=-1)
        return np.asarray(self.low + self.cell * index)

    @cached_property
    def _clearances(self) -> FloatArray:
        """Return the distance of each node to blocked ones ``(R, C)`` [m]."""
        from scipy.ndimage import distance_transform_edt

        far = distance_transform_edt(np.pad(self.free, 1), self.cell)
        return np.asarray(far)[1:-1, 1:-1]

    def corners(self, points: FloatArray) -> tuple[IntArray, IntArray, FloatArray]:
        """Return cells around x and z, and bilinear weights ``(K, 2, 2)``.

        They are those of a bilinear interpolation: rows ``(K, 2, 1)``, columns
        ``(K, 1, 2)``.
        """
        most = np.array(self.free.shape) - 1
        at = np.clip((points - self.low) / self.cell, 0, most)
        first = np.minimum(at.astype(np.int64), np.maximum(most - 1, 0))
        ends = np.minimum(first[:, None] + np.array([[0], [1]]), most)
        fraction = at - first
        sides = np.stack([1 - fraction, fraction], axis=1)
        shares = sides[:, :, None, 0] * sides[:, None, :, 1]
        return ends[:, :, None, 0], ends[:, None, :, 1], shares

    def edges(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return distances of x and z ``(K, 2)`` to blocked nodes, and directions.

        That is half a cell from the nodes that are not free: ``(K,)`` [m], ``(K, 2)``.
        """
        rows, columns, shares = self.corners(points)
        far = self._clearances[rows, columns]
        rises = far[:, 1] - far[:, 0], far[:, :, 1] - far[:, :, 0]
        directions = np.stack(
            [(rises[0] * shares.sum(axis=1)).sum(axis=1),
             (rises[1] * shares.sum(axis=2)).sum(axis=1)], axis=1,
        )  # fmt: skip
        size = np.linalg.norm(directions, axis=1)[:, None]
        directions = directions / np.where(size > 0, size, 1.0)
        return (far * shares).sum(axis=(1, 2)) - self.cell / 2, directions


@dataclass(frozen=True)
class FlowField:
    """The shortest paths to one goal from everywhere.

    Attributes:
        distances: Of each node, infinite where no way leads ``(R, C)`` [m].
    """

    grid: NavGrid
    goals: FloatArray  # path ends by component, x and z ``(P, 2)`` [m]
    distances: FloatArray

    @cached_property
    def gradient(self) -> FloatArray:
        """Return unit vectors along the shortest path by node ``(R, C, 2)``."""
        padded = np.pad(self.distances, 1, constant_values=np.inf)
        here = self.distances
        descent = np.zeros((*here.shape, 2))
        inner = slice(1, -1)
        for axis in (0, 1):
            before = padded[
                (slice(None, -2), inner) if axis == 0 else (inner, slice(None, -2))
            ]
            after = padded[
                (slice(2, None), inner) if axis == 0 else (inner, slice(2, None))
            ]
            least = np.minimum(before, after)
            falls = np.isfinite(here) & (least < here)
            drop = np.where(falls, here, 0) - np.where(falls, least, 0)
            descent[..., axis] = np.where(before < after, -drop, drop)
        size = np.linalg.norm(descent, axis=2)[..., None]
        return descent / np.where(size > 0, size, 1.0)

    def directions(self, points: FloatArray, targets: FloatArray) -> FloatArray:
        """Return unit vectors ``(K, 2)`` along the path from x and z ``(K, 2)``.

        Straight to ``targets`` near the goal if nothing is between. Agents on blocked
        nodes return to a free one first.
        """
        grid = self.grid
        rows, columns, shares = grid.corners(points)
        along = (self.gradient[rows, columns] * shares[..., None]).sum(axis=(1, 2))
        lost = ~along.any(axis=1)
        if lost.any():
            along[lost] = grid.positions_of(grid.free_at(points[lost])) - points[lost]
        goal = self.goal(points)
        off = goal - points
        far = np.linalg.norm(off, axis=1)
        row, column = grid.at(points).T
        # Outside the grid, visibility is that of the nearest node.
        to_goal = np.linalg.norm(
            goal - grid.positions_of(row * grid.free.shape[1] + column), axis=1
        )
        within = np.where(grid.depth(points) < 0, np.maximum(far, to_goal), far)
        near = self.distances[row, column] <= within + STRAIGHT * grid.cell
        # Paths to a goal outside the grid end at its border, and go straight from
        # there.
        near &= (grid.depth(points) < grid.cell) | (grid.depth(goal) > -grid.cell)
        near[near] = self._sees(points[near], targets[near])
        along[near] = (targets - points)[near]
        size = np.linalg.norm(along, axis=1)[:, None]
        return np.asarray(along / np.where(size > 0, size, 1.0))

    def _sees(self, points: FloatArray, targets: FloatArray) -> BoolArray:
        """Return whether nearby targets ``(K, 2)`` are in line of sight."""
        grid = self.grid
        off = targets - points
        far = np.linalg.norm(off, axis=1)
        reach = np.minimum(far, LOOKAHEAD_NODES * grid.cell)[:, None] / LOOKAHEAD_NODES
        steps = np.arange(1, LOOKAHEAD_NODES + 1)[:, None, None] * reach
        samples = points + steps * (off / np.maximum(far, TINY)[:, None])
        rows, columns = grid.at(samples.reshape(-1, 2)).T
        free = grid.free[rows, columns].reshape(LOOKAHEAD_NODES, -1)
        return np.asarray(free.all(axis=0), np.bool_)

    def goal(self, points: FloatArray) -> FloatArray:
        """Return the ends ``(K, 2)`` of paths from x and z ``(K, 2)`` [m]."""
        part = self.grid.parts.ravel()[self.grid.free_at(points)]
        return self.goals[part]


def route_to(grid: NavGrid, goal: FloatArray) -> FlowField:
    """Return the flow field to a goal at x and z ``(2,)``.

    From a part of the grid that it is not in they lead to the node there that is
    nearest to it.
    """
    number = int(grid.free_at(goal[None])[0])
    goal_part = int(grid.parts.ravel()[number])
    nodes = np.flatnonzero(grid.free.ravel())
    parts = grid.parts.ravel()[nodes]
    off = np.linalg.norm(grid.positions_of(nodes) - goal, axis=1)
    order = np.lexsort([off, parts])
    first = order[np.flatnonzero(np.diff(parts[order], prepend=0))]
    row, column = grid.at(goal[None])[0]
    goals = np.concatenate([np.zeros((1, 2)), grid.positions_of(nodes[first])])
    near: Sequence[int] | IntArray = []
    if grid.free[row, column]:
        goals[goal_part] = goal
        # Seeded around the goal, so that paths end there and not at a node; outside the
        # grid nothing blocks the facing sides.
        close = nodes[(parts == goal_part) & (off < 1.5 * grid.cell)]
        sides = grid.facing(goal)
        near = np.union1d(close, sides[grid.parts.ravel()[sides] == goal_part])
    seeds = np.concatenate([nodes[first], near]).astype(np.int64)
    starts = np.linalg.norm(
        grid.positions_of(seeds) - goals[grid.parts.ravel()[seeds]], axis=1
    )
    distances = _kernels.travel_distances(grid.free, grid.cell, seeds, starts)
    return FlowField(grid, goals, distances)


def routes_to(grid: NavGrid, goals: Iterable[FloatArray]) -> list[FlowField]:
    """Return the flow fields to several goals."""
    return [route_to(grid, goal) for goal in goals]

"""Obstacles of agents: colliders, closed doors and the edge of the ground."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field

import numpy as np
import numpy.typing as npt

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.sim.colliders import Collider, Colliders, Plane
from animtool.sim.colliders.shapes import bounds
from animtool.systems.crowds.agents import Agents
from animtool.systems.crowds.ground import Frame, Terrain, walkable
from animtool.systems.crowds.routes import MAX_NODES, NavGrid
from animtool.systems.crowds.spec import CrowdsModel, DoorModel

# Steeper normals are walls: the least horizontal part of a normal; others are floors or
# ceilings.
UPRIGHT = 0.3
# Margin of the navigation grid beyond starts and goals: a fraction of their extent, and
# largest radii.
BEYOND, RADII_BEYOND = 0.5, 40.0
# Grid nodes sampled at once: more take gigabytes.
AT_ONCE = 2**18
# Fraction of the top speed at which an agent leaves an obstacle.
LEAVING = 0.8


@dataclass(frozen=True)
class Walls:
    """Obstacles near N agents, sorted by agent.

    Attributes:
        starts: Index of each agent's first wall ``(N + 1,)``.
        rows: Unit normal (x, z), least velocity along it [m/s], least position along
            it [m] ``(M, 4)``.
        whose: Agent of each wall ``(M,)``.
        gaps: Distance from its surface to the agent's ``(M,)`` [m].
        closing: Closing speed towards the agent ``(M,)`` [m/s].
    """

    starts: npt.NDArray[np.int32]
    rows: FloatArray
    whose: IntArray
    gaps: FloatArray
    closing: FloatArray


@dataclass(frozen=True)
class Obstacles:
    """All obstacles of a crowd.

    Attributes:
        edge: Grid of nodes on the ground; None for infinite ground.
    """

    agents: Agents
    frame: Frame
    ground: Terrain
    colliders: Colliders
    doors: Sequence[DoorModel] = ()
    edge: NavGrid | None = None
    horizon: float = 0.5  # look-ahead of avoidance [s]
    ends: FloatArray = field(default_factory=lambda: np.zeros((0, 2, 2)))  # of doors

    def walls(self, t: float, dt: float, x: FloatArray) -> Walls:
        """Return obstacles near agents at x and z ``(N, 2)``, from a time on [s]."""
        obstacles = [*self._colliders(t, dt, x), *self._doors(t, x), *self._edges(x)]
        count = len(x)
        if not obstacles:
            nothing = np.zeros(0)
            starts = np.zeros(count + 1, np.int32)
            return Walls(
                starts, np.zeros((0, 4)), nothing.astype(int), nothing, nothing
            )
        agents, most = self.agents, self.agents.most
        parts = []
        for gaps, directions, closing in obstacles:
            reach = (most + np.abs(closing)) * self.horizon
            near = np.flatnonzero(gaps < np.maximum(reach, agents.radii))
            parts.append((near, gaps[near], directions[near], closing[near]))
        whose, gaps, directions, closing = (
            np.concatenate(each) for each in zip(*parts, strict=True)
        )
        order = np.argsort(whose, kind="stable")
        whose, gaps, directions, closing = (
            whose[order],
            gaps[order],
            directions[order],
            closing[order],
        )
        least = np.minimum(closing - gaps / self.horizon, LEAVING * most[whose])
        offsets = (directions * x[whose]).sum(axis=1) - gaps + closing * dt
        rows = np.column_stack([directions, least, offsets])
        starts = np.searchsorted(whose, np.arange(count + 1)).astype(np.int32)
        return Walls(starts, rows, whose, gaps, closing)

    def _colliders(
        self, t: float, dt: float, x: FloatArray
    ) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
        """Return gaps, directions away and closing speeds of each collider."""
        if not self.colliders.rigid:
            return []
        radii, tall = self.agents.radii, self.agents.heights
        heights, _ = self.ground(x)
        base = np.where(np.isfinite(heights), heights, 0.0)
        return [
            (distances - radii, directions, speeds)
            for distances, directions, speeds in upright(
                self.colliders, self.frame, x, base, radii, tall, t, dt
            )
        ]

    def _doors(
        self, t: float, x: FloatArray
    ) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
        """Return the same for doors that are closed at a time [s]."""
        doors = []
        for door, (a, b) in zip(self.doors, self.ends, strict=True):
            if any(first <= t < last for first, last in door.opens):
                continue
            along = b - a
            fraction = np.clip(((x - a) @ along) / (along @ along), 0.0, 1.0)
            off = x - a - fraction[:, None] * along
            far = np.linalg.norm(off, axis=1)
            directions = off / np.where(far > 0, far, 1.0)[:, None]
            doors.append((far - self.agents.radii, directions, np.zeros(len(x))))
        return doors

    def _edges(self, x: FloatArray) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
        """Return the same for the edge of the ground."""
        if self.edge is None:
            return []
        gaps, directions = self.edge.edges(x)
        return [(gaps - self.agents.radii, directions, np.zeros(len(x)))]


def upright(
    colliders: Colliders,
    frame: Frame,
    x: FloatArray,
    base: FloatArray,
    radii: FloatArray,
    tall: FloatArray,
    t: float,
    dt: float,
) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
    """Return horizontal distances of colliders from upright capsules.

    Per collider: distances ``(K,)`` from the axes [m], infinite for floors, unit
    vectors away from it ``(K, 2)`` and speeds along them ``(K,)`` [m/s]. The capsules
    have positions x and z ``(K, 2)``, base heights ``(K,)``, radii ``(K,)`` and total
    heights ``(K,)`` [m].
    """
    count = len(x)
    lows, highs = base + radii, base + np.maximum(tall - radii, radii)
    levels = [lows, (lows + highs) / 2, highs]
    points = np.concatenate([np.column_stack([x[:, 0], y, x[:, 1]]) for y in levels])
    samples = colliders.sample(frame.to_world(points), t, t + dt)
    capsule_gaps = []
    for distances, outwards, velocities in zip(
        samples.distances, samples.normals, samples.velocities, strict=True
    ):
        normals = frame.turned_back(outwards)[:, [0, 2]]
        speeds = frame.turned_back(velocities)[:, [0, 2]]
        size = np.linalg.norm(normals, axis=1)
        side = size > UPRIGHT
        far = np.where(side, distances / np.where(side, size, 1.0), np.inf)
        far = far.reshape(len(levels), count)
        nearest = np.argmin(far, axis=0) * count + np.arange(count)
        directions = normals[nearest] / np.where(side, size, 1.0)[nearest, None]
        closing = (speeds[nearest] * directions).sum(axis=1)
        capsule_gaps.append((far.ravel()[nearest], directions, closing))
    return capsule_gaps


def grids(
    spec: CrowdsModel,
    agents: Agents,
    frame: Frame,
    ground: Terrain,
    colliders: Colliders,
    goals: FloatArray,
    t: float,
) -> tuple[NavGrid | None, NavGrid | None]:
    """Return navigation grids of walkable nodes and of the ground.

    None where nothing is in the way, and where the ground has no end. Where agents are
    too far apart for one grid, it is what is near obstacles.
    """
    static = [one for one in colliders if len(one.poses.sample_times) == 1]
    if ground.flat and not static:
        return None, None
    radius = float(agents.radii.max(initial=0.0)) or 1.0
    corners = np.concatenate([agents.starts, goals])
    low, high = (
        (corners.min(axis=0), corners.max(axis=0)) if len(corners) else np.zeros((2, 2))
    )
    margin = BEYOND * (high - low).max() + RADII_BEYOND * radius
    low, high = low - margin, high + margin
    if not ground.flat:
        low, high = (
            np.maximum(low, ground.bounds[0]),
            np.minimum(high, ground.bounds[1]),
        )
        high = np.maximum(high, low)
    cell_size = spec.cell or radius
    if ground.flat and np.prod((high - low) / cell_size) > MAX_NODES:
        low, high = _about(static, frame, low, high, RADII_BEYOND * radius)
        if not (low < high).all():
            return None, None
    cell = max(cell_size, float(np.sqrt(np.prod(high - low) / MAX_NODES)))
    rows, columns = (np.floor((high - low) / cell).astype(int) + 1).tolist()
    shape = rows, columns
    nodes = NavGrid.nodes(low, cell, shape)
    base, on_ground = walkable(
        ground, nodes, shape, cell, np.radians(spec.ground.slope)
    )
    free = on_ground.ravel().copy()
    if static:
        met, heights = Colliders(static), base.ravel()
        within = np.flatnonzero(free)
        tall = float(agents.heights.max(initial=radius))
        for first in range(0, len(within), AT_ONCE):
            some = within[first : first + AT_ONCE]
            ones, clear = np.ones(len(some)), np.ones(len(some), bool)
            for far, _, _ in upright(
                met, frame, nodes[some], heights[some],
                radius * ones, tall * ones, t, 0.0,
            ):  # fmt: skip
                # Gaps narrower than an agent are closed by walls.
                clear &= far >= radius - cell / 2
            free[some] = clear
    edge = None if on_ground.all() and ground.flat else NavGrid(low, cell, on_ground)
    return NavGrid(low, cell, free.reshape(shape)), edge


def _about(
    static: Sequence[Collider],
    frame: Frame,
    low: FloatArray,
    high: FloatArray,
    margin: float,
) -> tuple[FloatArray, FloatArray]:
    """Return the area around obstacles within x and z bounds ``(2,)`` [m].

    Elsewhere nothing is in the way. Walls without an end are near everything; floors
    are in nobody's way.
    """
    first, last = np.full(2, np.inf), np.full(2, -np.inf)
    for one in static:
        if isinstance(one.shape, Plane):
            normal = so3.rotate(
                one.poses.rows[0, 3:], np.array(one.shape.normal, float)
            )
            flat = frame.turned_back(normal)[[0, 2]]
            if np.linalg.norm(flat) > UPRIGHT * np.linalg.norm(normal):
                return low, high
            continue
        ends = bounds(one.shape)
        box = np.array([ends[list(of), range(3)] for of in np.ndindex(2, 2, 2)])
        corners = frame.to_local(one.poses.to_world(box)[0])[:, [0, 2]]
        first = np.minimum(first, corners.min(axis=0))
        last = np.maximum(last, corners.max(axis=0))
    return np.maximum(low, first - margin), np.minimum(high, last + margin)


def lost(grid: NavGrid, x: FloatArray) -> BoolArray:
    """Return which of x and z ``(K, 2)`` are not walkable."""
    row, column = grid.at(x).T
    return np.asarray(~grid.free[row, column])

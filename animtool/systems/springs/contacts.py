"""Colliders over time cells, as kernel arguments."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.record import dataclass
from animtool.sim.colliders import Collider, Colliders

# Earliest time before a step at which surfaces of other systems are sampled [s].
LOOKBACK_TIME = 1 / 240
# Particles that start deeper than this in a collider are left inside [m].
INSIDE_TOLERANCE = 1e-6
# Kernel arguments of colliders for several cells; None without colliders.
CellColliders: TypeAlias = tuple[Any, ...] | None


@dataclass(frozen=True, slots=True)
class Cells:
    """Consecutive time cells of equal length."""

    origin: float  # start time of cell 0 [s]
    length: float  # length of each cell [s]
    index: int  # index of the first cell
    count: int


class PosedColliders(NamedTuple):
    """Poses of the last C colliders, which follow joints, and of moving skin meshes."""

    sizes: FloatArray  # sizes in the layout of kernels ``(C, 13)`` [m]
    poses: FloatArray  # at both ends of each cell ``(cells, C, 2, 7)``
    # Signed distances, at most 0, that particles may have from rigid colliders and
    # skin meshes ``(R, N)`` [m].
    depths: FloatArray
    skins: Sequence[Any]  # kernel surfaces of skins; they come before world surfaces
    inside_depth: float  # depth below which particles stay inside [m]


def cell_colliders(
    colliders: Colliders,
    radius: float,
    cells: Cells,
    posed: PosedColliders | None = None,
) -> CellColliders:
    """Return kernel arguments of colliders over ``cells``; None without colliders."""
    if not colliders.has_any and (posed is None or not posed.skins):
        return None
    origin, index, count = cells.origin, cells.index, cells.count
    steps = index + np.arange(count + 1)
    edges = np.asarray(origin + steps * cells.length, np.float64)
    poses = np.zeros((count, len(colliders.rigid), 2, 7))
    world_count = len(colliders) - (0 if posed is None else len(posed.sizes))
    for i in range(world_count):
        poses[:, i] = _poses_at_ends(colliders[i], edges)
    for cell, (begin, end) in enumerate(pairwise(edges.tolist())):
        poses[cell, len(colliders) :] = colliders.body_ends(begin, end)
    start = float(edges[0])
    arrays = colliders.arrays(start, start)
    surfaces = colliders.surfaces.kernel_arrays(origin, cells.length, index, count)
    if posed is None:
        return arrays, poses, radius, None, INSIDE_TOLERANCE, surfaces
    kinds, sizes, *materials = arrays
    sizes = sizes.copy()
    sizes[world_count : len(colliders)] = posed.sizes
    poses[:, world_count : len(colliders)] = posed.poses
    arrays, surfaces = (kinds, sizes, *materials), [*posed.skins, *surfaces]
    missing_rows = len(colliders.rigid) + len(surfaces) - len(posed.depths)
    depths = np.pad(posed.depths, ((0, missing_rows), (0, 0)))
    return arrays, poses, radius, depths, posed.inside_depth, surfaces


def _poses_at_ends(collider: Collider, edges: FloatArray) -> FloatArray:
    """Return poses of a collider at both ends of cells ``(cells, 2, 7)``."""
    times, rows = collider.poses.sample_times, collider.poses.rows
    poses = collider.poses.at_times(edges)
    intervals = np.clip(np.searchsorted(times, edges, "right") - 1, 0, len(times) - 1)
    is_teleport = np.append(collider.teleports, False)
    # Within a teleport, a collider stays where it was.
    stays = is_teleport[intervals]
    poses[stays] = rows[intervals[stays]]
    ends = np.stack([poses[:-1], poses[1:]], axis=1)
    # A collider that teleports within a cell is at its goal from the start of it.
    teleport_counts = np.cumsum(np.append(0, is_teleport))[intervals]
    has_teleported = teleport_counts[1:] > teleport_counts[:-1]
    ends[has_teleported, 0] = ends[has_teleported, 1]
    return ends

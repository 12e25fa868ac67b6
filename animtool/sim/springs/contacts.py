"""Colliders as springs meet them: their poses in each cell of time."""

from __future__ import annotations

from typing import Any

import numpy as np

from animtool._types import FloatArray
from animtool.maths import so3
from animtool.sim.colliders import Collider, Colliders
from animtool.sim.springs.options import Grid

# Particles that are deeper than this are left inside [m].
INSIDE = 1e-6


def cell_colliders(
    colliders: Colliders, radius: float, grid: Grid, cells: int
) -> tuple[Any, ...] | None:
    """Return what kernels take of colliders for some cells, None where there are none.

    Args:
        colliders: What springs may run into.
        radius: Distance that particles keep [m].
        grid: Of which cells.
        cells: How many.
    """
    if not colliders.meet:
        return None
    steps = grid.index + np.arange(cells + 1)
    edges = np.asarray(grid.origin + steps * grid.cell, np.float64)
    poses = np.zeros((cells, len(colliders), 2, 7))
    for i, collider in enumerate(colliders):
        poses[:, i] = _ends(collider, edges)
    at = float(edges[0])
    arrays = colliders.arrays(at, at)
    surfaces = colliders.surfaces.over(grid.origin, grid.cell, grid.index, cells)
    return arrays, poses, radius, None, INSIDE, surfaces


def _ends(collider: Collider, edges: FloatArray) -> FloatArray:
    """Return poses of a collider at both ends of cells ``(cells, 2, 7)``."""
    moments, rows = collider.poses.moments, collider.poses.rows
    before = np.clip(np.searchsorted(moments, edges, "right") - 1, 0, len(moments) - 1)
    after = np.minimum(before + 1, len(moments) - 1)
    gaps = np.where(after > before, moments[after] - moments[before], 1.0)
    share = np.clip((edges - moments[before]) / gaps, 0.0, 1.0)
    jumps = np.append(collider.jumps, False)
    share = np.where(jumps[before], 0.0, share)[:, None]
    origins = rows[before, :3] + (rows[after, :3] - rows[before, :3]) * share
    turns = so3.slerp(rows[before, 3:], rows[after, 3:], share[:, 0])
    poses = np.concatenate([origins, turns], axis=1)
    ends = np.stack([poses[:-1], poses[1:]], axis=1)
    # One that is put elsewhere within a cell is there from its beginning.
    crossed = np.cumsum(np.append(0, jumps))[before]
    jumped = crossed[1:] > crossed[:-1]
    ends[jumped, 0] = ends[jumped, 1]
    return ends

"""From a cell of time to later ones, by each solver."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np

from animtool import _kernels
from animtool._types import FloatArray
from animtool.maths import so3
from animtool.sim.colliders import Collider, Colliders
from animtool.systems.springs.motion import Grid, Through
from animtool.systems.springs.records import Solver, SpringOptions
from animtool.systems.springs.system import SpringSystem

# Steps of xpbd are not shorter than this [s].
SHORTEST = 1 / 61440
# Of a cell that is longer than so many of these, no more are tried.
LONG_CELL = 131072
# Newton's corrections of implicit steps go on until they are below this share of the
# mean length of springs.
SOLVED = 1e-6

# Particles that are deeper than this are left inside [m].
INSIDE = 1e-6


def cell_colliders(
    colliders: Colliders, radius: float, grid: Grid, cells: int
) -> tuple[Any, ...] | None:
    """Return what kernels take of colliders for some cells; None without any."""
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


Advance: TypeAlias = Callable[[SpringSystem, SpringOptions, Grid, int], Grid]


def _network(system: SpringSystem, grid: Grid) -> _kernels.SpringNetwork:
    """Return what is stepped in the cell that comes next."""
    return system.network(system.jumps.stage_of(grid))


def _explicit(
    system: SpringSystem,
    options: SpringOptions,  # noqa: ARG001
    grid: Grid,
    cells: int,
) -> Grid:
    met = cell_colliders(system.colliders, system.radius, grid, cells)
    state, torn, inside = _kernels.step_springs(
        _network(system, grid), grid.state, grid.torn, grid.origin, grid.index,
        grid.cell, cells, grid.substeps, met,
    )  # fmt: skip
    steps = cells * grid.substeps
    return replace(
        grid,
        index=grid.index + cells,
        state=state,
        torn=torn,
        unresolved=max(grid.unresolved, inside),
        steps=grid.steps + steps,
        evaluations=grid.evaluations + steps,
    )


def _projected(
    system: SpringSystem, options: SpringOptions, grid: Grid, cells: int
) -> Grid:
    most = max(grid.least, int(min(grid.cell / SHORTEST, LONG_CELL)))
    met = cell_colliders(system.colliders, system.radius, grid, cells)
    made = _kernels.project_springs(
        _network(system, grid), grid.state, grid.torn, grid.origin, grid.index,
        grid.cell, cells, grid.substeps, grid.calm, grid.least, most, options.stretch,
        met, system.layers, grid.passages,
    )  # fmt: skip
    state, torn, substeps, calm, stretch, steps, _, inside, passages, through = made
    return replace(
        grid,
        index=grid.index + cells,
        substeps=substeps,
        state=state,
        torn=torn,
        unresolved=max(grid.unresolved, inside),
        calm=calm,
        passages=passages,
        through=grid.through.with_more(Through(*through)),
        stretch=max(grid.stretch, stretch),
        steps=grid.steps + steps,
        evaluations=grid.evaluations + steps,
    )


def _implicit(
    system: SpringSystem,
    options: SpringOptions,  # noqa: ARG001
    grid: Grid,
    cells: int,
) -> Grid:
    rest = system.body.springs.rest
    size = float(rest.mean()) if rest.any() else 1.0
    met = cell_colliders(system.colliders, system.radius, grid, cells)
    found = _kernels.solve_springs(
        _network(system, grid), grid.state, grid.before, grid.torn, grid.origin,
        grid.index, grid.cell, cells, grid.substeps, grid.solver is Solver.BDF2,
        SOLVED * size, met,
    )  # fmt: skip
    state, before, known, torn, steps, corrections, lost, inside = found
    return replace(
        grid,
        index=grid.index + cells,
        state=state,
        before=before if known else None,
        torn=torn,
        unresolved=max(grid.unresolved, inside),
        steps=grid.steps + steps,
        evaluations=grid.evaluations + corrections,
        lost=lost > 0,
    )


ADVANCE: dict[Solver, Advance] = {
    Solver.SYMPLECTIC_EULER: _explicit,
    Solver.XPBD: _projected,
    Solver.BDF2: _implicit,
    Solver.IMPLICIT_EULER: _implicit,
}

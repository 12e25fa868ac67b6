"""From a cell of time to later ones, by each solver."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TypeAlias

from animtool import _kernels
from animtool.sim.springs.contacts import cell_colliders
from animtool.sim.springs.options import Grid, Solver, SpringOptions
from animtool.sim.springs.self_contact import Through
from animtool.sim.springs.system import SpringSystem

Advance: TypeAlias = Callable[[SpringSystem, SpringOptions, Grid, int], Grid]

# Steps of xpbd are not shorter than this [s].
SHORTEST = 1 / 61440
# Of a cell that is longer than so many of these, no more are tried.
LONG_CELL = 131072
# Newton's corrections of implicit steps go on until they are below this share of the
# mean length of springs.
SOLVED = 1e-6


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

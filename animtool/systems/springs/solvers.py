"""Choice of a solver, and its advance over cells of time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from animtool import _kernels
from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, OptionError
from animtool.core.record import dataclass
from animtool.sim.integrators.table import find_integrator
from animtool.sim.modes import allowed_step
from animtool.systems.framework.tied import TiedStep
from animtool.systems.springs.checks import check_supports_self_contact
from animtool.systems.springs.contacts import CellColliders, Cells, cell_colliders
from animtool.systems.springs.motion import (
    MAX_SUBSTEPS,
    Piercing,
    SpringState,
    TimeGrid,
)
from animtool.systems.springs.records import Solver, SpringOptions
from animtool.systems.springs.system import SpringSystem
from animtool.systems.springs.ties import BodyTies, TiedCell

# Shortest step of xpbd [s], and of xpbd chosen by auto, which also has to limit strain
# with self-contact.
SHORTEST, SHORTEST_OF_AUTO = 1 / 61440, 1 / 983040
# Largest number of steps in a long cell.
LONG_CELL = 131072
# Newton tolerance of implicit steps, relative to the mean spring length.
SOLVED = 1e-6
# The same with pins on bodies, which feel the residual times a stiffness [1].
TIED = 1e-11
# Rotation of bodies per part of a cell [rad], and most parts of a cell.
MAX_ANGLE, MAX_PARTS = 0.125, 16
# Refinement factors tried for an unsolved cell, and the safety factor of the proposed
# step.
SHORTER, ROOM = (2, 4, 8, 16), 4
# Default cell [s]: frames at 24, 30, 48, 60 and 120 per second are multiples of it.
CELL = 1 / 240
# Safety factor of the explicit step limit.
SAFE = 0.8
# Compute time per second of motion below which explicit steps are always chosen [s].
LITTLE = 0.03
# Explicit step rate above which implicit solves lose precision in float64.
SOLVABLE = 1e9
# Initial steps per cell.
FIRST = {Solver.XPBD: 2, Solver.BDF2: 4, Solver.IMPLICIT_EULER: 2}
# Time of a step per spring of a 20 by 20 sheet [s], on one core of a server of 2024
# (tests/bench/results/sim_springs.csv). With few springs the cost per spring is higher
# in all solvers alike; only the ratio matters.
COSTS = {
    # Forces of neighbouring springs are computed four at a time.
    Solver.SYMPLECTIC_EULER: 2.8e-9,
    # Newton corrections of about ten matrix products each; more for stiff systems, see
    # `implicit_cost`.
    Solver.BDF2: 150e-9,
}
# The same for chains, which are solved directly [s].
CHAIN_COST = 500e-9
# Largest index distance of spring ends in a chain; the kernels use the same limit.
WIDEST_CHAIN = 4


@dataclass(frozen=True, slots=True)
class Choice:
    """A solver and its steps."""

    solver: Solver  # not `Solver.AUTO`
    cell: float  # of time [s]
    substeps: int  # steps in a cell
    reason: str  # why, in words
    limit: float  # the largest stable step of semi-implicit Euler [s]


def explicit_limit(system: SpringSystem, t: float, state: FloatArray) -> float:
    """Return the largest stable step of semi-implicit Euler [s]."""
    modes = system.frequencies(t, state)
    if modes is None:
        return math.inf
    limit = allowed_step(find_integrator("symplectic_euler"), modes)
    return math.inf if limit is None else limit


def choose(
    system: SpringSystem,
    options: SpringOptions,
    requested: Solver,
    t: float,
    state: FloatArray,
) -> Choice:
    """Return the requested solver, or the one expected to be fastest."""
    limit = explicit_limit(system, t, state)
    rate = 1 / (SAFE * limit) if limit > 0 else math.inf
    solver, reason = requested, "it was requested"
    if system.self_contact is not None:
        check_supports_self_contact(requested)
        if requested is Solver.AUTO:
            solver, reason = Solver.XPBD, "it has self-contact"
    elif system.ties is not None:
        return tied_choice(system.ties, options, requested, t, limit)
    elif requested is Solver.AUTO:
        solver, reason = _cheapest(system, options, rate)
    if options.step is not None:
        steps = 1
        if requested is Solver.AUTO and solver is Solver.SYMPLECTIC_EULER:
            steps = max(1, math.ceil(options.step * rate))
        return Choice(solver, options.step, steps, reason, limit)
    if solver is Solver.SYMPLECTIC_EULER:
        max_rate = MAX_SUBSTEPS / CELL
        if rate > max_rate:
            message = (
                f"{solver} needs {rate:.3g} steps per second, but the limit is "
                f"{max_rate:.3g}"
            )
            hint = "use bdf2 or auto, less stiffness or damping, or more mass"
            fault = Fault("SIM004", f"{message} at most", where="solver", hint=hint)
            raise OptionError(fault)
        steps = max(1, math.ceil(CELL * rate))
        return Choice(solver, CELL, steps, reason, limit)
    return Choice(solver, CELL, FIRST[solver], reason, limit)


def tied_choice(
    ties: BodyTies,
    options: SpringOptions,
    requested: Solver,
    begin: float,
    limit: float,
) -> Choice:
    """Return a solver whose cells align with the steps of the pins' bodies."""
    solver, reason = requested, "it was requested"
    if requested is Solver.AUTO:
        solver, reason = Solver.BDF2, "rigid bodies hold its pins"
    lengths = sorted({carrier.step for carrier in ties.carriers})
    longest = lengths[-1]
    cell = longest
    substeps = max(FIRST[solver], math.ceil(cell / CELL * FIRST[solver]))
    if options.step is not None:
        cell = max(options.step, longest)
        substeps = max(1, round(cell / options.step))
    fits = all(_is_integer(cell / length) for length in lengths)
    fits &= options.step is None or _is_integer(cell / options.step)
    if not fits:
        bodies = " and ".join(f"{length:g}" for length in lengths)
        message = f"steps of {options.step or cell:g} s and those of the bodies that "
        message += f"hold its pins, of {bodies} s, do not end together"
        hint = f"use step: {longest:g}, a multiple of it, or a fraction"
        raise OptionError(Fault("SIM164", message, where="step", hint=hint))
    for carrier in ties.carriers:
        if carrier.begin > begin or not _is_integer((begin - carrier.begin) / cell):
            message = f"it starts at {begin:g} s, but the bodies of its pins "
            message += f"at {carrier.begin:g} s"
            hint = "give both the same preroll"
            raise OptionError(Fault("SIM164", message, where="preroll", hint=hint))
    return Choice(solver, cell, substeps, reason, limit)


def _is_integer(ratio: float) -> bool:
    """Return whether a ratio is an integer up to rounding."""
    return abs(ratio - round(ratio)) <= 1e-9 * max(1.0, abs(ratio))


def implicit_cost(system: SpringSystem, ratio: float) -> float:
    """Return the time of a bdf2 step per spring [s].

    The ratio is the number of semi-implicit Euler steps that one step replaces: matrix
    products grow with its square root.
    """
    bandwidth = np.abs(np.diff(system.body.springs.ends, axis=1)).max(initial=0)
    if bandwidth <= WIDEST_CHAIN:
        return CHAIN_COST
    return COSTS[Solver.BDF2] * math.sqrt(max(ratio, 1.0))


def _cheapest(
    system: SpringSystem, options: SpringOptions, rate: float
) -> tuple[Solver, str]:
    """Return the second-order solver that is expected to be fastest, and why.

    Stable explicit steps and bdf2 conserve energy equally well, so that steps times
    their cost decide. A requested step is an upper limit: explicit steps are as short
    as stability needs. With an error tolerance, bdf2 steps count at their lowest cost.
    """
    step = options.step
    limits = f"symplectic_euler is stable from {rate:.0f} steps per second"
    cell = CELL if step is None else step
    steps = FIRST[Solver.BDF2] / CELL if step is None else 1 / step
    if rate > SOLVABLE:
        return Solver.XPBD, f"{limits}, and bdf2 converges with no step"
    if math.ceil(cell * rate) > MAX_SUBSTEPS:
        return Solver.BDF2, f"{limits}, which are too many"
    explicit = max(rate, 1 / cell) * COSTS[Solver.SYMPLECTIC_EULER]
    ratio = rate / steps if options.error is None else 1.0
    implicit = steps * implicit_cost(system, ratio)
    alternative = f"about {steps:.0f} of {Solver.BDF2}"
    if explicit * len(system.body.springs.rest) <= LITTLE:
        cost_text = "little time"
    elif explicit <= implicit:
        cost_text = f"less time than {alternative}"
    else:
        comparison = f"{alternative} takes {implicit / explicit:.0%} of their time"
        return Solver.BDF2, f"{limits}, and {comparison}"
    return Solver.SYMPLECTIC_EULER, f"{limits}, which take {cost_text}"


def _colliders_over(system: SpringSystem, grid: TimeGrid, count: int) -> CellColliders:
    cells = Cells(grid.origin, grid.cell, grid.index, count)
    return cell_colliders(system.colliders, system.radius, cells)


def advance(
    system: SpringSystem, options: SpringOptions, grid: TimeGrid, cells: int
) -> TimeGrid:
    """Advance a motion by some cells."""
    if system.ties is not None and cells:
        return _advance_tied(system, grid, system.ties)
    network = system.network(system.jumps.stage_of(grid))
    colliders = _colliders_over(system, grid, cells)
    if grid.solver is Solver.SYMPLECTIC_EULER:
        return _explicit(network, grid, cells, colliders)
    if grid.solver is Solver.XPBD:
        shortest = SHORTEST_OF_AUTO if options.solver == Solver.AUTO else SHORTEST
        max_steps = int(min(grid.cell / shortest, LONG_CELL))
        return projected(
            network, grid, cells, colliders, system.layers, options.stretch, max_steps
        )
    return _implicit(network, grid, cells, colliders, SOLVED * system.spacing)


def _explicit(
    network: _kernels.SpringNetwork,
    grid: TimeGrid,
    cells: int,
    colliders: CellColliders,
) -> TimeGrid:
    state = grid.state
    motion, torn, inside, pushes = _kernels.step_springs(
        network, state.motion, state.torn, grid.origin, grid.index, grid.cell, cells,
        state.substeps, colliders,
    )  # fmt: skip
    after, steps = replace(state, motion=motion, torn=torn), cells * state.substeps
    return grid.crossed(cells, after, steps, steps, inside, pushes)


def projected(
    network: _kernels.SpringNetwork,
    grid: TimeGrid,
    cells: int,
    met: CellColliders,
    layers: _kernels.SpringLayers | None,
    stretch: float,
    most: int,
    limit: float = 0.0,
) -> TimeGrid:
    """Advance a motion by some cells in steps of xpbd.

    A cell whose springs are strained beyond the stretch [1] and their compliance is
    repeated with more steps, up to ``most``. A ``limit`` above 0 clamps the strain of
    stiff springs in each step [1].
    """
    state = grid.state
    (
        motion, torn, substeps, calm, longest, steps, touched, inside, passages,
        through, pushes,
    ) = _kernels.project_springs(
        network, state.motion, state.torn, grid.origin, grid.index, grid.cell, cells,
        state.substeps, state.calm, state.least, max(state.least, most), stretch, met,
        layers, state.passages, limit,
    )  # fmt: skip
    after = SpringState(
        motion, torn, substeps, state.least, calm, state.before, passages
    )
    return replace(
        grid.crossed(cells, after, steps, steps, inside, pushes),
        through=grid.through.with_more(Piercing(*through)),
        stretch=max(grid.stretch, longest),
        touching=max(grid.touching, touched),
    )


def followed(
    strands: _kernels.SpringStrands,
    grid: TimeGrid,
    path: FloatArray,
    span: float,
    met: CellColliders,
    own: tuple[int, int],
    threads: int,
) -> TimeGrid:
    """Advance strands of equal masses by a span [s], each solved directly.

    They follow animated particles ``(K, N, 3)`` [m], linear over each cell. Segments
    collide with rigid colliders too, except ``own``: first index and count.
    """
    state, cells = grid.state, len(path) - 1
    motion, touched, inside, strain = _kernels.follow_strands(
        strands, path, state.motion, span, state.substeps, met, threads, own
    )
    steps, after = cells * state.substeps, replace(state, motion=motion)
    return replace(
        grid.crossed(cells, after, steps, steps, inside, grid.pushes),
        stretch=max(grid.stretch, strain),
        touching=max(grid.touching, touched),
    )


def _advance_tied(system: SpringSystem, grid: TimeGrid, ties: BodyTies) -> TimeGrid:
    """Advance a motion by a cell together with the bodies that carry its pins.

    The cell is split into parts if bodies rotate fast or no solution is found.
    """
    t0, t1 = grid.time, grid.origin + (grid.index + 1) * grid.cell
    steps = [carrier.over(t0, t1) for carrier in ties.carriers]
    angle, parts = max(step.angle for step in steps), 1
    while parts < MAX_PARTS and angle > MAX_ANGLE * parts:
        parts *= 2
    while True:
        after = _advance_in_parts(system, grid, ties, steps, parts)
        if not after.lost or parts >= MAX_PARTS:
            return replace(after, origin=grid.origin, cell=grid.cell,
                           index=grid.index + 1)  # fmt: skip
        parts *= 2


def working_step(system: SpringSystem, grid: TimeGrid) -> float | None:
    """Return a step that solves a failed cell with a safety factor, or None [s].

    With pins on bodies it is a step of the bodies.
    """
    ties, state = system.ties, grid.state
    if ties is not None:
        t1 = grid.origin + (grid.index + 1) * grid.cell
        steps = [carrier.over(grid.time, t1) for carrier in ties.carriers]
        for k in SHORTER:
            if not _advance_in_parts(system, grid, ties, steps, k * MAX_PARTS).lost:
                return min(carrier.step for carrier in ties.carriers) / (ROOM * k)
        return None
    colliders = _colliders_over(system, grid, 1)
    network, size = system.network(system.jumps.stage_of(grid)), system.spacing
    for k in SHORTER:
        fine_state = replace(state, substeps=k * state.substeps, before=None)
        trial = replace(grid, state=fine_state)
        if not _implicit(network, trial, 1, colliders, SOLVED * size).lost:
            return grid.cell / (ROOM * fine_state.substeps)
    return None


def _advance_in_parts(
    system: SpringSystem,
    grid: TimeGrid,
    ties: BodyTies,
    steps: Sequence[TiedStep],
    parts: int,
) -> TimeGrid:
    """Advance a motion by a cell in parts, with the bodies after each part."""
    if parts == 1:
        return _advance_part(system, grid, ties, steps)[0]
    start_state, count = grid.state, -(-grid.state.substeps // parts)
    if count * parts != start_state.substeps:
        start_state = replace(start_state, before=None)
    state = replace(start_state, substeps=count)
    current = replace(
        grid, origin=grid.time, cell=grid.cell / parts, index=0, state=state
    )
    bodies, pushes = [step.begun for step in steps], []
    for _ in range(parts):
        part_steps = [
            step.part(state, current.time, current.cell)
            for step, state in zip(steps, bodies, strict=True)
        ]
        current, bodies = _advance_part(system, current, ties, part_steps)
        pushes.append(current.pushes)
        if current.lost:
            break
    body_results = [
        step.leading_to(state) for step, state in zip(steps, bodies, strict=True)
    ]
    total_push = np.sum(pushes, axis=0)
    total_push[:, 6] = np.max(pushes, axis=0)[:, 6]
    end_state = replace(current.state, substeps=grid.state.substeps)
    if count * parts != end_state.substeps:
        end_state = replace(end_state, before=None)
    return replace(
        current, state=end_state, tied=tuple(body_results), pushes=total_push
    )


def _advance_part(
    system: SpringSystem, grid: TimeGrid, ties: BodyTies, steps: Sequence[TiedStep]
) -> tuple[TimeGrid, list[Any]]:
    """Return the grid a cell later, and the states of the bodies."""
    t0, t1 = grid.time, grid.origin + (grid.index + 1) * grid.cell
    stage = system.jumps.stage_of(grid)
    network, pinned, targets = system.cell_network(stage, t0, t1)
    colliders = _colliders_over(system, grid, 1)
    columns = np.concatenate([tie.columns for tie in ties.ties])
    fraction = ((system.cell_knots(stage, t0, t1) - t0) / (t1 - t0))[:, None, None]

    def cross(begins: FloatArray, ends: FloatArray) -> Pulled:
        pinned[:, columns] = begins + fraction * (ends - begins)
        network.set_paths(pinned, targets)
        return _solve_with_pulls(network, grid, colliders, TIED * ties.size)

    solution = TiedCell(ties, steps).cross(cross, grid.state.known)
    result: Pulled = solution.crossed
    state = replace(result.grid.state, known=solution.known)
    bodies = [
        step.pulled(wrenches)[0]
        for step, wrenches in zip(steps, solution.wrenches, strict=True)
    ]
    end_grid = replace(
        result.grid, state=state, lost=result.lost, tied=solution.wrenches
    )
    return end_grid, bodies


@dataclass(slots=True)
class Pulled:
    """A grid after a cell, and impulses on pinned particles."""

    grid: TimeGrid
    pulls: FloatArray  # impulses and moments about the origin ``(H, 6)``
    lost: bool


def _solve_with_pulls(
    network: _kernels.SpringNetwork,
    grid: TimeGrid,
    colliders: CellColliders,
    tolerance: float,
) -> Pulled:
    state = grid.state
    (
        motion, before, has_previous, torn, steps, corrections, unsolved, inside,
        pushes, pulls,
    ) = _kernels.solve_springs(
        network, state.motion, state.before, state.torn, grid.origin, grid.index,
        grid.cell, 1, state.substeps, grid.solver is Solver.BDF2, tolerance, colliders,
        state.pulls,
    )  # fmt: skip
    after = replace(
        state, motion=motion, before=before if has_previous else None,
        torn=torn, pulls=pulls[1],
    )  # fmt: skip
    end_grid = grid.crossed(1, after, steps, corrections, inside, pushes)
    return Pulled(end_grid, pulls[0], unsolved > 0)


def _implicit(
    network: _kernels.SpringNetwork,
    grid: TimeGrid,
    cells: int,
    colliders: CellColliders,
    tolerance: float,
) -> TimeGrid:
    state = grid.state
    (
        motion, before, has_previous, torn, steps, corrections, lost, inside, pushes, _,
    ) = _kernels.solve_springs(
        network, state.motion, state.before, state.torn, grid.origin, grid.index,
        grid.cell, cells, state.substeps, grid.solver is Solver.BDF2, tolerance,
        colliders,
    )  # fmt: skip
    after = replace(
        state, motion=motion, before=before if has_previous else None, torn=torn
    )
    end_grid = grid.crossed(cells, after, steps, corrections, inside, pushes)
    return replace(end_grid, lost=lost > 0)

"""Steps of springs over time cells by each solver."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from animtool import _kernels
from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault
from animtool.core.record import dataclass
from animtool.systems.framework.body_carriers import CarrierStep
from animtool.systems.springs.body_coupling import (
    BodyCoupling,
    CoupledCell,
    CoupledSprings,
)
from animtool.systems.springs.choosing import SolverChoice
from animtool.systems.springs.contacts import CellColliders, Cells, cell_colliders
from animtool.systems.springs.motion import Piercing, SpringState, TimeGrid
from animtool.systems.springs.records import Solver, SpringOptions
from animtool.systems.springs.system import SpringSystem

# Shortest step of xpbd [s], and of xpbd chosen by auto, which must also limit strain
# with self-contact [s].
MIN_STEP, MIN_AUTO_STEP = 1 / 61440, 1 / 983040
# Largest number of xpbd steps in a cell.
MAX_CELL_STEPS = 131072
# Newton tolerance of implicit steps, relative to the mean spring length.
NEWTON_TOLERANCE = 1e-6
# The same with pins on bodies: a residual times a stiffness acts on the body [1].
COUPLED_TOLERANCE = 1e-11
# Largest rotation of bodies in a subcell [rad], and most subcells of a cell.
MAX_ANGLE, MAX_SUBCELLS = 0.125, 16
# Refinement factors tried for an unsolved cell, and the safety factor of the proposed
# step.
REFINEMENTS, STEP_SAFETY = (2, 4, 8, 16), 4


@dataclass(frozen=True, slots=True)
class SpringPlan:
    """A spring system with its solver and initial steps."""

    system: SpringSystem
    options: SpringOptions
    choice: SolverChoice
    error: float | None = None  # estimated position error, if requested [m]
    planning_notices: Sequence[Fault] = ()  # warnings of trial runs

    def start(self, begin: float, motion: FloatArray | None = None) -> TimeGrid:
        """Return the time grid at a begin time [s], by default in the initial state."""
        choice, system = self.choice, self.system
        motion = system.state if motion is None else motion
        pulls = None if system.coupling is None else np.zeros((len(system.pinned), 6))
        state = SpringState(
            np.ascontiguousarray(motion), system.untorn_flags, choice.substeps,
            choice.substeps, pulls=pulls,
        )  # fmt: skip
        return TimeGrid(choice.solver, begin, choice.cell, 0, state)

    def advance(
        self, grid: TimeGrid, cells: int, colliders: CellColliders = None
    ) -> TimeGrid:
        """Advance a motion by ``cells`` cells with the solver of the grid.

        None uses the colliders of the system at the times of the grid.
        """
        system, options = self.system, self.options
        if system.coupling is not None and cells:
            return _advance_coupled(system, grid, system.coupling)
        if colliders is None:
            colliders = _cell_colliders(system, grid, cells)
        if grid.solver is Solver.XPBD and system.body.strands:
            return _advance_strands(system, options, grid, cells, colliders)
        network = system.network(system.teleports.cell_stage(grid))
        if grid.solver is Solver.SYMPLECTIC_EULER:
            return _advance_explicit(network, grid, cells, colliders)
        if grid.solver is Solver.XPBD:
            layers = system.kernel_self_contact
            return _advance_xpbd(network, options, grid, cells, colliders, layers)
        tolerance = NEWTON_TOLERANCE * system.mean_rest_length
        return _advance_implicit(network, grid, cells, colliders, tolerance).grid


def _cell_colliders(system: SpringSystem, grid: TimeGrid, count: int) -> CellColliders:
    """Return the kernel arguments of colliders over the next ``count`` cells."""
    cells = Cells(grid.origin, grid.cell, grid.index, count)
    return cell_colliders(system.colliders, system.radius, cells)


def _advance_explicit(
    network: _kernels.SpringNetwork,
    grid: TimeGrid,
    cells: int,
    colliders: CellColliders,
) -> TimeGrid:
    """Advance a motion by ``cells`` cells of semi-implicit (symplectic) Euler."""
    state = grid.state
    motion, torn, inside, pushes = _kernels.step_springs(
        network, state.motion, state.torn, grid.origin, grid.index, grid.cell, cells,
        state.substeps, colliders,
    )  # fmt: skip
    after, steps = replace(state, motion=motion, torn=torn), cells * state.substeps
    return grid.after_cells(cells, after, steps, steps, inside, pushes)


def _advance_xpbd(
    network: _kernels.SpringNetwork,
    options: SpringOptions,
    grid: TimeGrid,
    cells: int,
    colliders: CellColliders,
    layers: _kernels.SpringLayers | None,
) -> TimeGrid:
    """Advance a motion by ``cells`` cells of xpbd (extended position-based dynamics).

    A cell whose springs are strained beyond the limit and their compliance is repeated
    with more steps.
    """
    state, max_substeps = grid.state, options.max_substeps
    if max_substeps is None:
        shortest = MIN_AUTO_STEP if options.solver == Solver.AUTO else MIN_STEP
        max_substeps = int(min(grid.cell / shortest, MAX_CELL_STEPS))
    (
        motion, torn, substeps, calm, excess_strain, steps, contact_count, inside,
        passages, piercing, pushes,
    ) = _kernels.project_springs(
        network, state.motion, state.torn, grid.origin, grid.index, grid.cell, cells,
        state.substeps, state.calm, state.least, max(state.least, max_substeps),
        options.stretch, colliders, layers, state.passages, options.clamped_strain,
    )  # fmt: skip
    after = SpringState(
        motion, torn, substeps, state.least, calm, state.before, passages
    )
    return replace(
        grid.after_cells(cells, after, steps, steps, inside, pushes),
        piercing=grid.piercing.maximum(Piercing(*piercing)),
        stretch=max(grid.stretch, excess_strain),
        max_contacts=max(grid.max_contacts, contact_count),
    )


def _advance_strands(
    system: SpringSystem,
    options: SpringOptions,
    grid: TimeGrid,
    cells: int,
    colliders: CellColliders,
) -> TimeGrid:
    """Advance strands by ``cells`` cells of xpbd, with a direct solver per strand.

    Segments collide with rigid colliders too, except those that follow joints.
    """
    state, (span, path) = grid.state, system.particle_path
    motion, contact_count, inside, strain = _kernels.follow_strands(
        system.kernel_strands(options.stretch), path, state.motion, span,
        state.substeps, colliders, thread_count(), system.joint_colliders,
    )  # fmt: skip
    steps, after = cells * state.substeps, replace(state, motion=motion)
    return replace(
        grid.after_cells(cells, after, steps, steps, inside, grid.pushes),
        stretch=max(grid.stretch, strain),
        max_contacts=max(grid.max_contacts, contact_count),
    )


def thread_count() -> int:
    """Return the thread count: ``OMP_NUM_THREADS``, else the number of processors.

    Batch workers set it to 1, one worker per processor.
    """
    setting = os.environ.get("OMP_NUM_THREADS", "")
    if setting.isdecimal() and int(setting) > 0:
        return int(setting)
    return os.cpu_count() or 1


def _advance_coupled(
    system: SpringSystem, grid: TimeGrid, coupling: BodyCoupling
) -> TimeGrid:
    """Advance springs by one cell, coupled to the rigid bodies that carry their pins.

    The cell is split into subcells if bodies rotate fast or no solution is found.
    """
    t0, t1 = grid.time, grid.origin + (grid.index + 1) * grid.cell
    steps = [carrier.step_over(t0, t1) for carrier in coupling.carriers]
    angle, subcells = max(step.max_angle for step in steps), 1
    while subcells < MAX_SUBCELLS and angle > MAX_ANGLE * subcells:
        subcells *= 2
    while True:
        after = _advance_in_subcells(system, grid, coupling, steps, subcells)
        if not after.unsolved or subcells >= MAX_SUBCELLS:
            return replace(after, origin=grid.origin, cell=grid.cell,
                           index=grid.index + 1)  # fmt: skip
        subcells *= 2


def find_solvable_step(system: SpringSystem, grid: TimeGrid) -> float | None:
    """Return a step that solves a failed cell, with a safety factor [s]; None if none.

    With pins on rigid bodies, this is a step of the bodies.
    """
    coupling, state = system.coupling, grid.state
    if coupling is not None:
        t1 = grid.origin + (grid.index + 1) * grid.cell
        steps = [carrier.step_over(grid.time, t1) for carrier in coupling.carriers]
        min_step = min(carrier.step for carrier in coupling.carriers)
        for k in REFINEMENTS:
            subcells = k * MAX_SUBCELLS
            if not _advance_in_subcells(
                system, grid, coupling, steps, subcells
            ).unsolved:
                return min_step / (STEP_SAFETY * k)
        return None
    colliders = _cell_colliders(system, grid, 1)
    network = system.network(system.teleports.cell_stage(grid))
    tolerance = NEWTON_TOLERANCE * system.mean_rest_length
    for k in REFINEMENTS:
        fine_state = replace(state, substeps=k * state.substeps, before=None)
        trial = replace(grid, state=fine_state)
        if not _advance_implicit(network, trial, 1, colliders, tolerance).grid.unsolved:
            return grid.cell / (STEP_SAFETY * fine_state.substeps)
    return None


def _advance_in_subcells(
    system: SpringSystem,
    grid: TimeGrid,
    coupling: BodyCoupling,
    steps: Sequence[CarrierStep],
    subcells: int,
) -> TimeGrid:
    """Advance springs and coupled bodies by one cell, split into equal subcells."""
    if subcells == 1:
        return _advance_subcell(system, grid, coupling, steps)[0]
    start_state, substeps = grid.state, -(-grid.state.substeps // subcells)
    if substeps * subcells != start_state.substeps:
        start_state = replace(start_state, before=None)
    state = replace(start_state, substeps=substeps)
    current = replace(
        grid, origin=grid.time, cell=grid.cell / subcells, index=0, state=state
    )
    bodies, pushes = [step.start_state for step in steps], []
    for _ in range(subcells):
        subcell_steps = [
            step.subcell(state, current.time, current.cell)
            for step, state in zip(steps, bodies, strict=True)
        ]
        current, bodies = _advance_subcell(system, current, coupling, subcell_steps)
        pushes.append(current.pushes)
        if current.unsolved:
            break
    ends = zip(steps, bodies, strict=True)
    body_pushes = tuple(step.push_to(state) for step, state in ends)
    total_push = np.sum(pushes, axis=0)
    total_push[:, 6] = np.max(pushes, axis=0)[:, 6]
    end_state = replace(current.state, substeps=grid.state.substeps)
    if substeps * subcells != end_state.substeps:
        end_state = replace(end_state, before=None)
    return replace(
        current, state=end_state, body_wrenches=body_pushes, pushes=total_push
    )


def _advance_subcell(
    system: SpringSystem,
    grid: TimeGrid,
    coupling: BodyCoupling,
    steps: Sequence[CarrierStep],
) -> tuple[TimeGrid, list[Any]]:
    """Advance springs and bodies by a cell; return the grid and body states."""
    t0, t1 = grid.time, grid.origin + (grid.index + 1) * grid.cell
    stage = system.teleports.cell_stage(grid)
    network, prescribed = system.cell_network(stage, t0, t1)
    pinned = prescribed.pin_positions
    colliders = _cell_colliders(system, grid, 1)
    columns = np.concatenate(
        [attachment.columns for attachment in coupling.attachments]
    )
    fraction = ((prescribed.knots - t0) / (t1 - t0))[:, None, None]

    def solve_springs(begins: FloatArray, ends: FloatArray) -> CoupledSprings:
        pinned[:, columns] = begins + fraction * (ends - begins)
        network.set_paths(pinned, prescribed.target_positions)
        tolerance, pulls = COUPLED_TOLERANCE * coupling.spring_length, grid.state.pulls
        return _advance_implicit(network, grid, 1, colliders, tolerance, pulls)

    solution = CoupledCell(coupling, steps).solve(solve_springs, grid.state.known)
    end_grid = solution.grid
    state = replace(end_grid.state, known=solution.warm_start)
    bodies = [
        step.pushed(wrenches)[0]
        for step, wrenches in zip(steps, solution.wrenches, strict=True)
    ]
    return replace(end_grid, state=state, body_wrenches=solution.wrenches), bodies


def _advance_implicit(
    network: _kernels.SpringNetwork,
    grid: TimeGrid,
    cells: int,
    colliders: CellColliders,
    tolerance: float,
    pulls: FloatArray | None = None,
) -> CoupledSprings:
    """Advance a motion by ``cells`` cells of BDF2 or implicit Euler.

    With the ``pulls`` of the last step, also returns the impulses on pinned particles.
    """
    state = grid.state
    (
        motion, before, has_previous, torn, steps, corrections, failed_cells, inside,
        pushes, impulses,
    ) = _kernels.solve_springs(
        network, state.motion, state.before, state.torn, grid.origin, grid.index,
        grid.cell, cells, state.substeps, grid.solver is Solver.BDF2, tolerance,
        colliders, pulls,
    )  # fmt: skip
    after = replace(
        state, motion=motion, before=before if has_previous else None, torn=torn,
        pulls=state.pulls if pulls is None else impulses[1],
    )  # fmt: skip
    end_grid = grid.after_cells(cells, after, steps, corrections, inside, pushes)
    return CoupledSprings(replace(end_grid, unsolved=failed_cells > 0), impulses[0])

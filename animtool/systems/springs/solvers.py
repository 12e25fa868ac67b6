"""Steps of springs over time cells by each solver."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from animtool import _kernels
from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault
from animtool.core.record import dataclass
from animtool.sim.colliders import Colliders
from animtool.systems.framework.body_carriers import CarrierStep
from animtool.systems.springs.body_coupling import CoupledCell, CoupledSprings
from animtool.systems.springs.choosing import SolverChoice
from animtool.systems.springs.motion import SpringState, TimeGrid
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
# Earliest time before a step at which surfaces of other systems are sampled [s].
LOOKBACK_TIME = 1 / 240
# Particles that start deeper than this in a collider are left inside [m].
INSIDE_TOLERANCE = 1e-6


class CellColliders(NamedTuple):
    """Kernel arguments of R rigid colliders and of surfaces for several cells."""

    arrays: tuple[Any, ...]  # as of `Colliders.kernel_arrays`
    poses: FloatArray  # of rigid colliders at both ends of each cell ``(K, R, 2, 7)``
    radius: float  # distance that particles keep [m]
    # Signed distances, at most 0, that particles may have from rigid colliders and
    # surfaces ``(R + S, N)`` [m].
    depths: FloatArray | None
    max_depth: float  # particles that start deeper are left inside [m]
    surfaces: Sequence[Any]  # kernel surfaces ``(S,)``


def cell_colliders(
    colliders: Colliders, radius: float, grid: TimeGrid, count: int
) -> CellColliders:
    """Return colliders over the next cells of a grid; particles keep a radius [m]."""
    steps = grid.index + np.arange(count + 1)
    edges = np.asarray(grid.origin + steps * grid.cell, np.float64)
    poses = np.zeros((count, len(colliders.rigid_colliders), 2, 7))
    for i, collider in enumerate(colliders):
        poses[:, i] = collider.end_poses(edges)
    for cell, (begin, end) in enumerate(pairwise(edges.tolist())):
        poses[cell, len(colliders) :] = colliders.body_end_poses(begin, end)
    start = float(edges[0])
    arrays = colliders.kernel_arrays(start, start)
    surfaces = colliders.surfaces.kernel_arrays(
        grid.origin, grid.cell, grid.index, count
    )
    return CellColliders(arrays, poses, radius, None, INSIDE_TOLERANCE, surfaces)


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
        self, grid: TimeGrid, cell_count: int, colliders: CellColliders | None = None
    ) -> TimeGrid:
        """Advance a motion by ``cell_count`` cells with the solver of the grid.

        None uses the colliders of the system at the times of the grid.
        """
        system = self.system
        if system.coupling is not None and cell_count:
            return self._advance_coupled(grid)
        if colliders is None:
            colliders = self._colliders(grid, cell_count)
        if grid.solver is Solver.XPBD and system.body.strands:
            return self._advance_strands(grid, cell_count, colliders)
        network = system.network(system.teleports.cell_stage(grid))
        if grid.solver is Solver.SYMPLECTIC_EULER:
            return _advance_explicit(network, grid, cell_count, colliders)
        if grid.solver is Solver.XPBD:
            return self._advance_xpbd(network, grid, cell_count, colliders)
        tolerance = NEWTON_TOLERANCE * system.mean_rest_length
        return _advance_implicit(network, grid, cell_count, colliders, tolerance).grid

    def _colliders(self, grid: TimeGrid, cell_count: int) -> CellColliders | None:
        """Return the colliders of the system over the next cells; None without any."""
        colliders = self.system.colliders
        if not colliders.has_any:
            return None
        return cell_colliders(colliders, self.system.radius, grid, cell_count)

    def _advance_xpbd(
        self,
        network: _kernels.SpringNetwork,
        grid: TimeGrid,
        cell_count: int,
        colliders: CellColliders | None,
    ) -> TimeGrid:
        """Advance by ``cell_count`` cells of xpbd (extended position-based dynamics).

        A cell whose springs are strained beyond the limit and their compliance is
        repeated with more steps.
        """
        state, options = grid.state, self.options
        max_substeps = options.max_substeps
        if max_substeps is None:
            shortest = MIN_AUTO_STEP if options.solver == Solver.AUTO else MIN_STEP
            max_substeps = int(min(grid.cell / shortest, MAX_CELL_STEPS))
        (
            motion, torn, substeps, calm, excess_strain, steps, contact_count, inside,
            passages, piercing, pushes,
        ) = _kernels.project_springs(
            network, state.motion, state.torn, grid.origin, grid.index, grid.cell,
            cell_count, state.substeps, state.calm, state.least,
            max(state.least, max_substeps), options.stretch, colliders,
            self.system.kernel_self_contact, state.passages, options.clamped_strain,
        )  # fmt: skip
        after = SpringState(
            motion, torn, substeps, state.least, calm, state.before, passages
        )
        return replace(
            grid.after_cells(cell_count, after, steps, steps, inside, pushes),
            piercing=grid.piercing.maximum(piercing),
            max_strain=max(grid.max_strain, excess_strain),
            max_contact_count=max(grid.max_contact_count, contact_count),
        )

    def _advance_strands(
        self, grid: TimeGrid, cell_count: int, colliders: CellColliders | None
    ) -> TimeGrid:
        """Advance strands by ``cell_count`` cells of xpbd, each with a direct solver.

        Segments collide with rigid colliders too, except those that follow joints.
        """
        state, system = grid.state, self.system
        span, path = system.particle_path
        motion, contact_count, inside, strain = _kernels.follow_strands(
            system.kernel_strands(self.options.stretch), path, state.motion, span,
            state.substeps, colliders, thread_count(), system.joint_colliders,
        )  # fmt: skip
        steps, after = cell_count * state.substeps, replace(state, motion=motion)
        return replace(
            grid.after_cells(cell_count, after, steps, steps, inside, grid.pushes),
            max_strain=max(grid.max_strain, strain),
            max_contact_count=max(grid.max_contact_count, contact_count),
        )

    def _carrier_steps(self, grid: TimeGrid) -> list[CarrierStep]:
        """Return the next cell of the bodies that carry pins, without springs."""
        assert self.system.coupling is not None
        t1 = grid.origin + (grid.index + 1) * grid.cell
        carriers = self.system.coupling.carriers
        return [carrier.step_over(grid.time, t1) for carrier in carriers]

    def _advance_coupled(self, grid: TimeGrid) -> TimeGrid:
        """Advance springs by one cell, coupled to the bodies that carry their pins.

        The cell is split into subcells if bodies rotate fast or no solution is found.
        """
        steps, subcell_count = self._carrier_steps(grid), 1
        max_angle = max(step.max_angle for step in steps)
        while subcell_count < MAX_SUBCELLS and max_angle > MAX_ANGLE * subcell_count:
            subcell_count *= 2
        while True:
            after = self._advance_in_subcells(grid, steps, subcell_count)
            if not after.is_unsolved or subcell_count >= MAX_SUBCELLS:
                return replace(
                    after, origin=grid.origin, cell=grid.cell, index=grid.index + 1
                )
            subcell_count *= 2

    def solvable_step(self, grid: TimeGrid) -> float | None:
        """Return a step that solves a failed cell, with a safety factor [s]; else None.

        With pins on rigid bodies, this is a step of the bodies.
        """
        system, state = self.system, grid.state
        if system.coupling is not None:
            steps = self._carrier_steps(grid)
            min_step = min(carrier.step for carrier in system.coupling.carriers)
            for k in REFINEMENTS:
                trial = self._advance_in_subcells(grid, steps, k * MAX_SUBCELLS)
                if not trial.is_unsolved:
                    return min_step / (STEP_SAFETY * k)
            return None
        colliders = self._colliders(grid, 1)
        network = system.network(system.teleports.cell_stage(grid))
        tolerance = NEWTON_TOLERANCE * system.mean_rest_length
        for k in REFINEMENTS:
            fine = replace(state, substeps=k * state.substeps, before=None)
            trial = replace(grid, state=fine)
            trial = _advance_implicit(network, trial, 1, colliders, tolerance).grid
            if not trial.is_unsolved:
                return grid.cell / (STEP_SAFETY * fine.substeps)
        return None

    def _advance_in_subcells(
        self, grid: TimeGrid, steps: Sequence[CarrierStep], subcell_count: int
    ) -> TimeGrid:
        """Advance springs and coupled bodies by one cell, split into equal subcells."""
        if subcell_count == 1:
            return self._advance_subcell(grid, steps)[0]
        start_state, substeps = grid.state, -(-grid.state.substeps // subcell_count)
        if substeps * subcell_count != start_state.substeps:
            start_state = replace(start_state, before=None)
        state = replace(start_state, substeps=substeps)
        current = replace(
            grid, origin=grid.time, cell=grid.cell / subcell_count, index=0, state=state
        )
        bodies, pushes = [step.start_state for step in steps], []
        for _ in range(subcell_count):
            subcell_steps = [
                step.subcell(state, current.time, current.cell)
                for step, state in zip(steps, bodies, strict=True)
            ]
            current, bodies = self._advance_subcell(current, subcell_steps)
            pushes.append(current.pushes)
            if current.is_unsolved:
                break
        ends = zip(steps, bodies, strict=True)
        body_pushes = tuple(step.push_to(state) for step, state in ends)
        total_push = np.sum(pushes, axis=0)
        total_push[:, 6] = np.max(pushes, axis=0)[:, 6]
        end_state = replace(current.state, substeps=grid.state.substeps)
        if substeps * subcell_count != end_state.substeps:
            end_state = replace(end_state, before=None)
        return replace(
            current, state=end_state, body_wrenches=body_pushes, pushes=total_push
        )

    def _advance_subcell(
        self, grid: TimeGrid, steps: Sequence[CarrierStep]
    ) -> tuple[TimeGrid, list[Any]]:
        """Advance springs and bodies by a cell; return the grid and body states."""
        system, coupling = self.system, self.system.coupling
        assert coupling is not None
        t0, t1 = grid.time, grid.origin + (grid.index + 1) * grid.cell
        stage = system.teleports.cell_stage(grid)
        network, prescribed = system.cell_network(stage, t0, t1)
        pin_positions = prescribed.pin_positions
        colliders = self._colliders(grid, 1)
        columns = np.concatenate([row.columns for row in coupling.attachments])
        fraction = ((prescribed.knots - t0) / (t1 - t0))[:, None, None]

        def solve_springs(begins: FloatArray, ends: FloatArray) -> CoupledSprings:
            pin_positions[:, columns] = begins + fraction * (ends - begins)
            network.set_paths(pin_positions, prescribed.target_positions)
            tolerance = COUPLED_TOLERANCE * coupling.spring_length
            pulls = grid.state.pulls
            return _advance_implicit(network, grid, 1, colliders, tolerance, pulls)

        end = CoupledCell(coupling, steps, solve_springs).solve(grid.state.known)
        pushes = zip(steps, end.body_wrenches, strict=True)
        return end, [step.pushed(wrenches)[0] for step, wrenches in pushes]


def _advance_explicit(
    network: _kernels.SpringNetwork,
    grid: TimeGrid,
    cell_count: int,
    colliders: CellColliders | None,
) -> TimeGrid:
    """Advance a motion by ``cell_count`` cells of semi-implicit (symplectic) Euler."""
    state = grid.state
    motion, torn, inside, pushes = _kernels.step_springs(
        network, state.motion, state.torn, grid.origin, grid.index, grid.cell,
        cell_count, state.substeps, colliders,
    )  # fmt: skip
    after, steps = replace(state, motion=motion, torn=torn), cell_count * state.substeps
    return grid.after_cells(cell_count, after, steps, steps, inside, pushes)


def thread_count() -> int:
    """Return the thread count: ``OMP_NUM_THREADS``, else the number of processors.

    Batch workers set it to 1, one worker per processor.
    """
    setting = os.environ.get("OMP_NUM_THREADS", "")
    if setting.isdecimal() and int(setting) > 0:
        return int(setting)
    return os.cpu_count() or 1


def _advance_implicit(
    network: _kernels.SpringNetwork,
    grid: TimeGrid,
    cell_count: int,
    colliders: CellColliders | None,
    tolerance: float,
    pulls: FloatArray | None = None,
) -> CoupledSprings:
    """Advance a motion by ``cell_count`` cells of BDF2 or implicit Euler.

    With the ``pulls`` of the last step, also returns the impulses on pinned particles.
    """
    state = grid.state
    (
        motion, before, has_previous, torn, steps, corrections, failed_cell_count,
        inside, pushes, impulses,
    ) = _kernels.solve_springs(
        network, state.motion, state.before, state.torn, grid.origin, grid.index,
        grid.cell, cell_count, state.substeps, grid.solver is Solver.BDF2, tolerance,
        colliders, pulls,
    )  # fmt: skip
    after = replace(
        state, motion=motion, before=before if has_previous else None, torn=torn,
        pulls=state.pulls if pulls is None else impulses[1],
    )  # fmt: skip
    end_grid = grid.after_cells(cell_count, after, steps, corrections, inside, pushes)
    return CoupledSprings(
        replace(end_grid, is_unsolved=failed_cell_count > 0), impulses[0]
    )

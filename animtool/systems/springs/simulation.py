"""Simulation of springs in time cells."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, Severity
from animtool.motion.frames import PointsFrame
from animtool.sim.checks import EnergyWatch
from animtool.sim.colliders.bodies import Wrenches
from animtool.sim.options import IntegrateOptions
from animtool.sim.system import Energy
from animtool.sim.trajectory import Stats, Status
from animtool.systems.framework.run import STEP_TOLERANCE
from animtool.systems.framework.simulation import (
    Diagnostics,
    Progress,
    SteppedState,
    StoppedError,
    TrialSettings,
)
from animtool.systems.springs.choosing import trial_settings
from animtool.systems.springs.motion import SpringState, TimeGrid
from animtool.systems.springs.notices import (
    DAMPING_SOLVERS,
    MAX_LENGTH_RATIO,
    EnergyLoss,
    MotionCounts,
    motion_notices,
    stretch_warning,
)
from animtool.systems.springs.records import Solver
from animtool.systems.springs.solvers import LOOKBACK_TIME, SpringPlan

# Cells between two checks for divergence.
CELLS_PER_CHECK = 120
# Codes of faults that stop a simulation.
STOP_CODES = {"SIM102", "SIM105"}


class SpringSimulation(MotionCounts):
    """Simulates springs in time cells; counters are used for warnings only.

    Attributes:
        intact_system: The system without torn springs.
        wrenches: Impulses on rigid bodies of other systems in the last cells.
        max_strain: Largest strain of springs in sampled states.
    """

    checked = True
    status, stop_reason = Status.OK, ""
    max_strain, _longest_stiffness = 0.0, 0.0
    # Whether surfaces of other systems may release states before the current time.
    releases_states = True

    def __init__(
        self,
        plan: SpringPlan,
        start_grid: TimeGrid,
        last_time: float,
        clock: Progress = None,
    ) -> None:
        super().__init__(plan, start_grid)
        self.begin, self.last, self.clock = start_grid.origin, last_time, clock
        self.step_length = start_grid.cell
        self._start, self.wrenches = start_grid, list[Wrenches]()
        self._start_notices = [] if start_grid.index else self.system.notices()
        # Pushed bodies react before the next cell.
        is_coupled = self.system.colliders.bodies or self.system.coupling is not None
        self._max_cells_per_call = 1 if is_coupled else CELLS_PER_CHECK
        self.intact_system, self._torn_count = self.system, 0
        self._energy_watch = EnergyWatch(self.system, self._divergence_limits())
        self._exclude_torn()
        self._energy_watch.start(start_grid.time, start_grid.state.motion)
        self._measured_motion: FloatArray | None = None
        self._energy_loss = EnergyLoss(float(self.system.free_masses.sum()))
        self.measure(start_grid.state, start_grid.time)
        self._initial_strain = self.max_strain

    def _divergence_limits(self) -> IntegrateOptions:
        """Return limits of energy and length beyond which the motion diverges.

        Residual strain of xpbd, and of implicit steps with colliders, is not energy
        that the motion continues with.
        """
        solver, has_colliders = self.choice.solver, self.system.colliders.has_any
        implicit_contacts = solver is not Solver.SYMPLECTIC_EULER and has_colliders
        has_coupling = self.system.coupling is not None
        ignores_growth = implicit_contacts or solver is Solver.XPBD or has_coupling
        growth = np.inf if ignores_growth else self.options.growth
        return IntegrateOptions(growth=growth, stretch=self.options.longest)

    def initial_state(self) -> SpringState:
        """Return the initial state."""
        return self._start.state

    def step(
        self, state: SpringState, t: float, dt: float
    ) -> SpringState | SteppedState[SpringState]:
        """Return the state after a cell, or within the cell; raise SIM102 or SIM105."""
        if dt >= (1 - STEP_TOLERANCE) * self.step_length:
            return self.steps(state, t, dt, 1)
        self.grid = self._grid_at(state, t)
        start_grid, fraction = self._after_teleports(), dt / self.step_length
        with np.errstate(all="ignore"):
            end = self.plan.advance(start_grid, 1).state.motion
            begin, cell = start_grid.state.motion, start_grid.cell
            motion = _interpolate(begin, end, cell, fraction)
        if not np.isfinite(motion).all():
            self._stop(Status.UNSTABLE, "its state is not finite")
        return replace(state, motion=motion)

    def steps(
        self,
        state: SpringState,
        t: float,
        dt: float,  # noqa: ARG002
        count: int,
    ) -> SteppedState[SpringState]:
        """Advance by ``count`` grid intervals.

        Return the state, and impulses on other bodies.
        """
        self.grid = self._grid_at(state, t)
        target = self.grid.index + count
        while self.grid.index < target:
            self._advance(min(self._max_cells_per_call, target - self.grid.index))
            if self.clock is not None:
                self.clock(self.grid.time)
        if self.releases_states:
            for sheet in self.system.colliders.sheets:
                sheet.motion.forget(self.grid.time - max(LOOKBACK_TIME, self.grid.cell))
        return SteppedState(self.grid.state, self.wrenches)

    def pulls(self, state: SpringState, t: float) -> Sequence[Wrenches]:
        """Return the impulses on bodies of other systems in the next cell."""
        grid = self.grid
        self.grid = self._grid_at(state, t)
        self._advance(1)
        self.grid = grid
        return self.wrenches

    def _grid_at(self, state: SpringState, t: float) -> TimeGrid:
        """Return the time grid at a time [s], with a given state."""
        index = round((t - self.begin) / self.grid.cell)
        return replace(self.grid, index=index, state=state)

    def incompatibility(self, state: SpringState, t: float) -> str:
        """Return why kernels cannot resume from a state; empty if they can."""
        before, shape = state.before, state.motion.shape
        if before is not None and before.shape != shape:
            return f"before has shape {before.shape}, but motion {shape}"
        try:
            self.plan.advance(self._grid_at(state, t), 0)
        except ValueError as error:
            return str(error)
        except (TypeError, OverflowError):
            return "a whole number of it is out of bounds"
        return ""

    def _after_teleports(self) -> TimeGrid:
        """Return the grid at the start of the next cell, with its teleports applied."""
        grid, teleports = self.grid, self.system.teleports
        stage = teleports.cell_stage(grid)
        previous_stage = teleports.cell_stage(replace(grid, index=grid.index - 1))
        if stage == previous_stage:
            return grid
        motion = teleports.apply(grid.state.motion, previous_stage, stage)
        return replace(grid, state=replace(grid.state, motion=motion, before=None))

    def _exclude_torn(self) -> None:
        """Exclude torn springs from energy and strain checks."""
        torn = self.grid.state.torn
        torn_count = int(torn.sum())
        if torn_count != self._torn_count:
            self._torn_count = torn_count
            self.intact_system = self.system.without_springs(self.system.torn(torn))
            self._energy_watch.set_system(self.intact_system)

    def _advance(self, cell_count: int) -> None:
        """Advance by at most ``cell_count`` cells; raise if the solver must stop."""
        start_grid, self.wrenches = self._after_teleports(), []
        max_count = self.system.teleports.cells_until_next(start_grid)
        cell_count = int(min(cell_count, max_count))
        with np.errstate(all="ignore"):
            self.grid = self.plan.advance(start_grid, cell_count)
            t, state = self.grid.time, self.grid.state
            self.max_substeps = max(self.max_substeps, state.substeps)
            self._exclude_torn()
            reason = self._energy_watch.divergence_reason(t, state.motion)
            if start_grid.solver is Solver.XPBD:
                length_ratio = self.intact_system.stretch(t, state.motion)
                self.longest = max(self.longest, length_ratio or 0.0)
        if reason:
            self._stop(Status.UNSTABLE, reason)
        if self.grid.is_unsolved:
            self.unsolved_grid = start_grid
            self._stop(Status.NOT_SOLVED, "Newton's method did not converge")
        if self.is_auto and self.is_overstrained:
            reason = f"a spring is strained by {self.grid.max_strain:.2%}"
            self._stop(Status.NOT_SOLVED, reason)
        self.wrenches = [*self._contact_wrenches(), *self.grid.body_wrenches]

    def _stop(self, status: Status, reason: str) -> None:
        """Record the status of the stop, and raise the warnings about it as errors."""
        self.status, self.stop_reason = status, reason
        stats = self.stats(self.grid.time)
        # The fault that stopped it comes last and is reported with the frame.
        errors = as_errors(motion_notices(self, stats))
        faults = sorted(errors, key=lambda fault: fault.code in STOP_CODES)
        if self.system.coupling is not None:
            # Otherwise the fault would be attributed to the bodies.
            names = " and ".join(view.member.name for view in self.views)
            faults[-1] = replace(faults[-1], message=f"{names}: {faults[-1].message}")
        raise StoppedError(faults, stats)

    def _contact_wrenches(self) -> list[Wrenches]:
        """Return contact impulses on bodies of other systems.

        Impulses are limited to those of the mass of the body: heavier contacts would
        throw it off.
        """
        wrenches, row = [], len(self.system.colliders)
        for bodies in self.system.colliders.bodies:
            pushes = self.grid.pushes[row : row + len(bodies.colliders)]
            row += len(bodies.colliders)
            body_pushes = np.zeros((bodies.count, 7))
            is_dynamic = bodies.owners >= 0
            np.add.at(body_pushes, bodies.owners[is_dynamic], pushes[is_dynamic])
            pushing_masses = np.maximum(body_pushes[:, 6], bodies.masses)
            fraction = np.minimum(1.0, bodies.masses / pushing_masses)
            smallest = float(fraction.min(initial=1.0))
            self.min_applied_fraction = min(self.min_applied_fraction, smallest)
            impulses = body_pushes[:, :6] * fraction[:, None]
            # A constant force over a cell moves bodies as an impulse at its middle.
            wrenches.append(Wrenches(impulses, self.grid.cell / 2 * impulses))
        return wrenches

    def stats(self, reached_time: float) -> Stats:
        """Return the statistics up to a time [s]."""
        grid = self.grid
        stable = self.choice.limit if self.status is Status.UNSTABLE else None
        return Stats(
            self.status,
            grid.time if self.stop_reason else reached_time,
            self.stop_reason,
            grid.step_count,
            None,
            grid.evaluation_count,
            self.shortest_step,
            grid.cell / self.choice.substeps,
            None,
            stable_step=stable,
        )

    def energy_of(self, t: float, motion: FloatArray) -> float:
        """Return the energy of a state, without torn springs [J]."""
        cached_energy = (
            self._energy_watch.energy if motion is self.grid.state.motion else None
        )
        return (cached_energy or self.intact_system.energy(t, motion)).total

    def measure(self, state: SpringState, t: float) -> None:
        """Record the strain and energy of a sampled state."""
        if state.motion is self._measured_motion:
            return
        self._measured_motion = state.motion
        springs = self.system.body.springs
        is_intact = ~self.system.torn(state.torn) & (springs.rest > 0)
        if is_intact.any():
            lengths = springs.lengths(state.motion[0])[is_intact]
            ratios = lengths / springs.rest[is_intact]
            if float(ratios.max()) - 1.0 > self.max_strain:
                longest = np.flatnonzero(is_intact)[ratios.argmax()]
                self.max_strain = float(ratios.max()) - 1.0
                self._longest_stiffness = float(springs.stiffness[longest])
        if self.choice.solver in DAMPING_SOLVERS and self.system.self_contact is None:
            energy = self._energy(state, t)
            if energy is not None:
                self._energy_loss.record(t, energy)

    @property
    def needs_final_state(self) -> bool:
        """Whether frames need the final state, because a surface can tear.

        Its topology then includes the tears of all later frames.
        """
        return any(view.can_tear for view in self.views)

    def set_final_state(self, state: SpringState) -> None:
        """Split surfaces along the tears of the final state."""
        for view in self.views:
            if view.can_tear:
                view.prepare_tears(state)

    def frame(self, state: SpringState, t: float) -> PointsFrame:
        """Return all particles as points."""
        self.measure(state, t)
        points, velocities = state.motion
        radii = np.full(len(points), self.system.radius)
        return PointsFrame(np.arange(len(points)), points, velocities, radii, {})

    def diagnostics(self, state: SpringState, t: float) -> Diagnostics:
        """Return the energy if it is conserved, and counters."""
        has_lengths = (self.system.body.springs.rest > 0).any()
        return Diagnostics(
            self._energy(state, t),
            notices=self.notices,
            steps=self.grid.step_count,
            stretch=self.max_strain if has_lengths else None,
        )

    @property
    def notices(self) -> list[Fault]:
        """Warnings collected so far, one of each kind."""
        current = [
            *self._start_notices,
            *motion_notices(self, self.stats(self.grid.time)),
        ]
        codes = {fault.code for fault in current}
        planning_notices = self.plan.planning_notices
        notices = [fault for fault in planning_notices if fault.code not in codes]
        notices += [*current, *self._energy_loss.notices(self.choice.solver)]
        return list({str(fault): fault for fault in notices}.values())

    def _energy(self, state: SpringState, t: float) -> Energy | None:
        """Return the energy of a state; None if it is not conserved."""
        if self._is_dissipative or state.torn.any() or self.system.coupling is not None:
            return None
        energy = self.system.energy(t, state.motion)
        return None if energy.supply else energy

    @cached_property
    def _is_dissipative(self) -> bool:
        """Whether drag, damping or colliders dissipate energy."""
        system = self.system
        coefficients = [
            system.drags,
            system.body.springs.damping,
            system.target_springs.damping,
            np.array(system.air_coefficients),
        ]
        return system.colliders.has_any or any(values.any() for values in coefficients)

    def trial_settings(self) -> TrialSettings:
        """Return the settings to compare: solvers with steps around their defaults."""
        return trial_settings(self.system, self.options, self.begin)

    def strain_notices(self, owner: str = "") -> list[Fault]:
        """Return a warning if springs that cannot tear were strained a lot (SIM187)."""
        can_tear = np.isfinite(self.system.body.springs.limit).any()
        max_length = MAX_LENGTH_RATIO * (1 + self._initial_strain)
        if can_tear or 1 + self.max_strain <= max_length:
            return []
        return [stretch_warning(self.max_strain, self._longest_stiffness, owner)]


def as_errors(notices: Sequence[Fault]) -> list[Fault]:
    """Return notices with the severity of errors."""
    return [replace(fault, severity=Severity.ERROR) for fault in notices]


def _interpolate(begin: FloatArray, end: FloatArray, h: float, s: float) -> FloatArray:
    """Interpolate a state in a cell: cubic Hermite positions, linear velocities."""
    (x0, v0), (x1, v1) = begin, end
    displacement = x1 - x0
    x = x0 + s * (
        h * v0 + s * ((3 - 2 * s) * displacement - h * ((2 - s) * v0 + (1 - s) * v1))
    )
    return np.array((x, v0 + s * (v1 - v0)))

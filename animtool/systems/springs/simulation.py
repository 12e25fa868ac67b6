"""Springs as a simulation in cells of time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, Severity
from animtool.core.record import dataclass
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
    Stepped,
    StoppedError,
    TrialSettings,
)
from animtool.systems.springs.contacts import LOOK_BACK
from animtool.systems.springs.losses import DAMPING, Losses
from animtool.systems.springs.motion import SpringState, TimeGrid
from animtool.systems.springs.notices import motion_notices
from animtool.systems.springs.records import Solver, SpringOptions
from animtool.systems.springs.solvers import Choice, advance
from animtool.systems.springs.system import SpringSystem
from animtool.systems.springs.trials import trial_settings

# Cells between two checks for blow-up.
LOOK_EVERY = 120
# Codes that end a motion.
STOPS = {"SIM102", "SIM105"}
# Length relative to the start above which springs are reported as too soft [1].
LONG = 2.0


@dataclass(frozen=True, slots=True)
class SpringPlan:
    """Initial springs and their solver steps."""

    system: SpringSystem
    options: SpringOptions
    choice: Choice
    reason: str  # for the solver and its steps
    error: float | None = None  # position error, if requested [m]
    planning_notices: Sequence[Fault] = ()  # of the runs that planned it

    def start(self, begin: float, motion: FloatArray | None = None) -> TimeGrid:
        """Return the time grid at ``begin`` [s], in a state or the initial one."""
        choice, system = self.choice, self.system
        motion = system.state if motion is None else motion
        pulls = None if system.ties is None else np.zeros((len(system.pinned), 6))
        state = SpringState(
            np.ascontiguousarray(motion), system.none_torn, choice.substeps,
            choice.substeps, pulls=pulls,
        )  # fmt: skip
        return TimeGrid(choice.solver, begin, choice.cell, 0, state)


class SpringSimulation:
    """Simulates springs in cells of time; counters serve warnings only.

    Attributes:
        grid: Current grid position, with counts over all cells so far.
        left: The system without torn springs.
        wrenches: Impulses on rigid bodies of other systems in the last cells.
        unsolved: Start of the cell that was not solved.
        longest: Longest xpbd spring relative to its rest length.
        applied: Smallest fraction of an impulse that a body received.
        stretch: Largest strain of springs in sampled states.
    """

    checked = True
    views: Sequence[Any] = ()  # of `SpringView`
    status, sign = Status.OK, ""
    longest = applied = 1.0
    stretch = 0.0
    unsolved: TimeGrid | None = None
    # Whether surfaces of other systems may release states before its time.
    forgets = True

    def __init__(
        self, plan: SpringPlan, begun: TimeGrid, last: float, clock: Progress = None
    ) -> None:
        self.system, self.options, self.choice = plan.system, plan.options, plan.choice
        self.reason, self.error = plan.reason, plan.error
        self.begin, self.last, self.clock = begun.origin, last, clock
        self.step_length = begun.cell
        self.grid, self.wrenches = begun, list[Wrenches]()
        self._start, self._planning_notices = begun, plan.planning_notices
        self._start_notices = [] if begun.index else self.system.notices()
        self._max_substeps = begun.state.substeps
        # Pushed bodies react before the next cell.
        is_coupled = self.system.colliders.bodies or self.system.ties is not None
        self._cells = 1 if is_coupled else LOOK_EVERY
        self.left, self._gone = self.system, 0
        self._watch = EnergyWatch(self.system, self._bounds())
        self._exclude_torn()
        self._watch.start(begun.time, begun.state.motion)
        self._measured: FloatArray | None = None
        self._losses = Losses(float(self.system.free_masses.sum()))
        self.measure(begun.state, begun.time)
        self._stretch_at_start = self.stretch

    def _bounds(self) -> IntegrateOptions:
        # Residual strain of xpbd, and of implicit steps with colliders, is not energy
        # that the motion continues with.
        solver, active = self.choice.solver, self.system.colliders.active
        implicit_contacts = solver is not Solver.SYMPLECTIC_EULER and active
        ignores_growth = (
            implicit_contacts or solver is Solver.XPBD or self.system.ties is not None
        )
        growth = np.inf if ignores_growth else self.options.growth
        return IntegrateOptions(growth=growth, stretch=self.options.longest)

    def initial(self) -> SpringState:
        """Return the initial state."""
        return self._start.state

    def step(
        self, state: SpringState, t: float, dt: float
    ) -> SpringState | Stepped[SpringState]:
        """Return the state a cell later, or within it; raise SIM102, SIM105."""
        if dt >= (1 - STEP_TOLERANCE) * self.step_length:
            return self.steps(state, t, dt, 1)
        self._go_to(state, t)
        start_grid, fraction = self._after_teleports(), dt / self.step_length
        with np.errstate(all="ignore"):
            after = advance(self.system, self.options, start_grid, 1).state.motion
            motion = _interpolate(
                start_grid.state.motion, after, start_grid.cell, fraction
            )
        if not np.isfinite(motion).all():
            self._stop(Status.UNSTABLE, "its state is not finite")
        return replace(state, motion=motion)

    def steps(
        self,
        state: SpringState,
        t: float,
        dt: float,  # noqa: ARG002
        count: int,
    ) -> Stepped[SpringState]:
        """Return the state some cells later, and impulses on other bodies."""
        self._go_to(state, t)
        target = self.grid.index + count
        while self.grid.index < target:
            self._advance(min(self._cells, target - self.grid.index))
            if self.clock is not None:
                self.clock(self.grid.time)
        if self.forgets:
            for sheet in self.system.colliders.sheets:
                sheet.motion.forget(self.grid.time - max(LOOK_BACK, self.grid.cell))
        return Stepped(self.grid.state, self.wrenches)

    def pulls(self, state: SpringState, t: float) -> Sequence[Wrenches]:
        """Return impulses on bodies of other systems in the next cell."""
        grid = self.grid
        self._go_to(state, t)
        self._advance(1)
        self.grid = grid
        return self.wrenches

    def _grid_at(self, state: SpringState, t: float) -> TimeGrid:
        index = round((t - self.begin) / self.grid.cell)
        return replace(self.grid, index=index, state=state)

    def _go_to(self, state: SpringState, t: float) -> None:
        self.grid = self._grid_at(state, t)

    def incompatibility(self, state: SpringState, t: float) -> str:
        """Return why kernels cannot resume from a state; empty if they can."""
        try:
            advance(self.system, self.options, self._grid_at(state, t), 0)
        except ValueError as error:
            return str(error)
        except (TypeError, OverflowError):
            return "a whole number of it is out of bounds"
        return ""

    def _after_teleports(self) -> TimeGrid:
        """Return the grid at the start of the next cell, after its teleports."""
        grid, jumps = self.grid, self.system.jumps
        stage = jumps.stage_of(grid)
        previous_stage = jumps.stage_of(replace(grid, index=grid.index - 1))
        if stage == previous_stage:
            return grid
        motion = jumps.across(grid.state.motion, previous_stage, stage)
        return replace(grid, state=replace(grid.state, motion=motion, before=None))

    def _exclude_torn(self) -> None:
        """Exclude torn springs from energy and strain checks."""
        torn = self.grid.state.torn
        torn_count = int(torn.sum())
        if torn_count != self._gone:
            self._gone = torn_count
            self.left = self.system.without_springs(self.system.torn(torn))
            self._watch.watch_system(self.left)

    def _advance(self, cells: int) -> None:
        """Advance by at most some cells; raise if it cannot continue."""
        start_grid, self.wrenches = self._after_teleports(), []
        cells = int(min(cells, self.system.jumps.cells(start_grid)))
        with np.errstate(all="ignore"):
            self.grid = advance(self.system, self.options, start_grid, cells)
            t, state = self.grid.time, self.grid.state
            self._max_substeps = max(self._max_substeps, state.substeps)
            self._exclude_torn()
            reason = self._watch.divergence(t, state.motion)
            if start_grid.solver is Solver.XPBD:
                ratio = self.left.stretch(t, state.motion)
                self.longest = max(self.longest, ratio or 0.0)
        if reason:
            self._stop(Status.UNSTABLE, reason)
        if self.grid.lost:
            self.unsolved = start_grid
            self._stop(Status.NOT_SOLVED, "Newton's method did not converge")
        if self.auto and self.strained:
            reason = f"a spring is strained by {self.grid.stretch:.2%}"
            self._stop(Status.NOT_SOLVED, reason)
        self.wrenches = [*self._contact_wrenches(), *self.grid.tied]

    def _stop(self, status: Status, reason: str) -> None:
        """Stop the run: raise its warnings as errors."""
        self.status, self.sign = status, reason
        stats = self.stats(self.grid.time)
        # The fault that stopped it comes last and is reported with the frame.
        errors = _as_errors(motion_notices(self, stats))
        faults = sorted(errors, key=lambda fault: fault.code in STOPS)
        if self.system.ties is not None:
            # Otherwise the fault would be attributed to the bodies.
            names = " and ".join(view.member.name for view in self.views)
            faults[-1] = replace(faults[-1], message=f"{names}: {faults[-1].message}")
        raise StoppedError(faults, stats)

    def _contact_wrenches(self) -> list[Wrenches]:
        """Return contact impulses on bodies of other systems.

        Impulses are limited to those of the mass of the body: heavier contacts would
        throw it off.
        """
        wrenches, first = [], len(self.system.colliders)
        for bodies in self.system.colliders.bodies:
            rows = self.grid.pushes[first : first + len(bodies.colliders)]
            first += len(bodies.colliders)
            sums = np.zeros((bodies.count, 7))
            dynamic = bodies.owners >= 0
            np.add.at(sums, bodies.owners[dynamic], rows[dynamic])
            fraction = np.minimum(
                1.0, bodies.masses / np.maximum(sums[:, 6], bodies.masses)
            )
            self.applied = min(self.applied, float(fraction.min(initial=1.0)))
            impulses = sums[:, :6] * fraction[:, None]
            # A constant force over a cell moves bodies as an impulse at its middle.
            wrenches.append(Wrenches(impulses, self.grid.cell / 2 * impulses))
        return wrenches

    @property
    def auto(self) -> bool:
        """Whether the solver was chosen automatically."""
        return self.options.solver == Solver.AUTO

    @property
    def strained(self) -> bool:
        """Whether xpbd strains springs beyond the limit and their compliance."""
        return not self.grid.stretch <= self.options.stretch

    @property
    def shortest(self) -> float:
        """The shortest step so far [s]."""
        return self.grid.cell / self._max_substeps

    def stats(self, reached: float) -> Stats:
        """Return the statistics up to a time [s]."""
        grid = self.grid
        stable = self.choice.limit if self.status is Status.UNSTABLE else None
        return Stats(
            self.status, grid.time if self.sign else reached, self.sign, grid.steps,
            None, grid.evaluations, self.shortest, grid.cell / self.choice.substeps,
            None, stable_step=stable,
        )  # fmt: skip

    def energy_of(self, t: float, motion: FloatArray) -> float:
        """Return the energy of a state at the last time, without torn springs [J]."""
        cached = self._watch.energy if motion is self.grid.state.motion else None
        return (cached or self.left.energy(t, motion)).total

    def measure(self, state: SpringState, t: float) -> None:
        """Record strain and energy of a visited state."""
        if state.motion is self._measured:
            return
        self._measured = state.motion
        springs = self.system.body.springs
        intact = ~self.system.torn(state.torn) & (springs.rest > 0)
        if intact.any():
            lengths = springs.lengths(state.motion[0])[intact]
            longest = float((lengths / springs.rest[intact]).max()) - 1.0
            self.stretch = max(self.stretch, longest)
        if self.choice.solver in DAMPING and self.system.self_contact is None:
            energy = self._energy(state, t)
            if energy is not None:
                self._losses.look(t, energy)

    @property
    def needs_final_state(self) -> bool:
        """Whether a surface can tear: its topology must include the final tears."""
        return any(view.tears for view in self.views)

    def set_final_state(self, last: SpringState) -> None:
        """Prepare surfaces for the tears of the final state."""
        for view in self.views:
            if view.tears:
                view.part(last)

    def frame(self, state: SpringState, t: float) -> PointsFrame:
        """Return all particles."""
        self.measure(state, t)
        points, velocities = state.motion
        radii = np.full(len(points), self.system.radius)
        return PointsFrame(np.arange(len(points)), points, velocities, radii, {})

    def diagnostics(self, state: SpringState, t: float) -> Diagnostics:
        """Return the energy of a conservative system, and counters."""
        has_lengths = (self.system.body.springs.rest > 0).any()
        return Diagnostics(
            self._energy(state, t),
            notices=self.notices,
            steps=self.grid.steps,
            stretch=self.stretch if has_lengths else None,
        )

    @property
    def notices(self) -> list[Fault]:
        """Warnings collected so far, one of each kind."""
        current = [
            *self._start_notices,
            *motion_notices(self, self.stats(self.grid.time)),
        ]
        codes = {fault.code for fault in current}
        collected = [
            fault for fault in self._planning_notices if fault.code not in codes
        ]
        collected += [*current, *self._losses.notices(self.choice.solver)]
        return list({str(fault): fault for fault in collected}.values())

    def _energy(self, state: SpringState, t: float) -> Energy | None:
        if self._dissipates or state.torn.any() or self.system.ties is not None:
            return None
        energy = self.system.energy(t, state.motion)
        return None if energy.supply else energy

    @cached_property
    def _dissipates(self) -> bool:
        """Whether drag, damping or colliders dissipate energy."""
        system = self.system
        coefficients = [
            system.drags,
            system.body.springs.damping,
            system.target_springs.damping,
        ]
        coefficients.append(np.array(system.pressures))
        return system.colliders.active or any(values.any() for values in coefficients)

    def trial_settings(self) -> TrialSettings:
        """Return solvers with several step lengths around their defaults."""
        return trial_settings(self.system, self.options, self.begin)

    @property
    def long(self) -> bool:
        """Whether untearable springs became very long."""
        tears = np.isfinite(self.system.body.springs.limit).any()
        longest = LONG * (1 + self._stretch_at_start)
        return bool(not tears and 1 + self.stretch > longest)


def _as_errors(notices: Sequence[Fault]) -> list[Fault]:
    return [replace(fault, severity=Severity.ERROR) for fault in notices]


def _interpolate(begin: FloatArray, end: FloatArray, h: float, s: float) -> FloatArray:
    """Return the state at a fraction of a cell, on the cubic through its ends."""
    (x0, v0), (x1, v1) = begin, end
    slope = x1 - x0
    x = x0 + s * (
        h * v0 + s * ((3 - 2 * s) * slope - h * ((2 - s) * v0 + (1 - s) * v1))
    )
    return np.array((x, v0 + s * (v1 - v0)))

"""Springs of a scene as a simulation in steps."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Protocol

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, Severity
from animtool.core.record import dataclass
from animtool.motion.frames import PointsFrame
from animtool.sim.colliders.bodies import Wrenches
from animtool.sim.system import Energy
from animtool.sim.trajectory import Status
from animtool.systems.framework.run import STEP_TOLERANCE
from animtool.systems.framework.simulation import (
    Diagnostics,
    Progress,
    SimContext,
    Stepped,
    StoppedError,
    TrialSettings,
)
from animtool.systems.framework.spec import Member
from animtool.systems.springs.checks import check_options
from animtool.systems.springs.contacts import LOOK_BACK
from animtool.systems.springs.losses import DAMPING, Losses
from animtool.systems.springs.motion import SpringState, TimeGrid
from animtool.systems.springs.records import Solver, SpringOptions
from animtool.systems.springs.settling import rest_of_xpbd
from animtool.systems.springs.simulating import SpringRun, simulate_springs
from animtool.systems.springs.solvers import Choice, advance, choose
from animtool.systems.springs.system import SpringSystem
from animtool.systems.springs.trials import trial_settings

# Times at which a motion is compared with one in half steps.
COMPARED = 64
# Notices whose message contains a running maximum.
_GROWING = {"SIM131", "SIM123"}
# Codes that end a motion.
STOPS = {"SIM102", "SIM105"}
# Length relative to the start above which springs are reported as too soft [1].
LONG = 2.0


class TearingView(Protocol):
    """A view that may tear."""

    member: Member

    @property
    def tears(self) -> bool:
        """Whether it is a surface that can tear."""

    def part(self, last: SpringState) -> None:
        """Prepare the split topology for the torn springs of the final state."""


@dataclass(frozen=True, slots=True)
class SpringPlan:
    """Initial springs and their solver steps."""

    system: SpringSystem
    options: SpringOptions
    choice: Choice
    reason: str  # for the solver and its steps
    error: float | None = None  # position error, if requested [m]
    # Notices of the planning runs, each with the strain reached [1].
    planning_notices: Sequence[tuple[Sequence[Fault], float]] = ()


def plan_springs(
    system: SpringSystem, options: SpringOptions, context: SimContext, *, settled: bool
) -> SpringPlan:
    """Return the springs and steps that meet a requested error.

    With ``settled``, xpbd starts in its rest state.
    """
    begin, reason, error = context.begin, "", None
    planning_notices: list[tuple[Sequence[Fault], float]] = []
    if options.error is not None:
        times = np.linspace(begin, max(context.last, begin), COMPARED)
        progress = _by_motions(context.phase, begin, float(times[-1]))
        motion = simulate_springs(system, times, options, progress=progress)
        if motion.stats.status is not Status.OK:
            raise StoppedError(_as_errors(motion.notices), motion.stats)
        planning_notices.append((motion.notices, motion.stretch))
        error, reason = motion.stats.error, motion.reason
        options = replace(options, solver=motion.solver, step=motion.step, error=None)
    choice = choose(system, options, check_options(options), begin, system.state)
    if settled and choice.solver is Solver.XPBD:
        rested = rest_of_xpbd(system, options, choice, begin)
        system, choice = rested.system, rested.choice
        planning_notices.append((rested.notices, 0.0))
    return SpringPlan(
        system, options, choice, reason or choice.reason, error, planning_notices
    )


class SpringSimulation:
    """Simulates springs in cells of time; counters serve warnings only."""

    checked = True
    views: Sequence[TearingView] = ()

    def __init__(self, plan: SpringPlan, context: SimContext) -> None:
        self.begin, self.last = context.begin, context.last
        self.system, self.options, self.choice = plan.system, plan.options, plan.choice
        self.reason, self.error = plan.reason, plan.error
        self._notices: dict[str, Fault] = {}
        self._worst = 0.0
        for notices, stretch in plan.planning_notices:
            self._keep_notices(notices, stretch)
        self.clock: Progress = None
        self.step_length = self.choice.cell
        self.shortest, self.taken, self.stretch, self.unresolved = math.inf, 0, 0.0, 0
        self._measured: FloatArray | None = None
        self._losses = Losses(float(self.system.free_masses.sum()))
        start = self.initial()
        self._take_note(self._run(start, self.begin), self.begin)
        self.measure(start, self.begin)
        self._stretch_at_start = self.stretch
        self.clock = context.clock()

    def initial(self) -> SpringState:
        """Return the initial state."""
        substeps, state = self.choice.substeps, self.system.state
        untorn, tied = self.system.none_torn, self.system.ties is not None
        pulls = np.zeros((len(self.system.pinned), 6)) if tied else None
        return SpringState(
            np.ascontiguousarray(state), untorn, substeps, substeps, pulls=pulls
        )

    def step(
        self, state: SpringState, t: float, dt: float
    ) -> SpringState | Stepped[SpringState]:
        """Return the state a cell later, or within it; raise SIM102, SIM105."""
        if dt >= (1 - STEP_TOLERANCE) * self.step_length:
            return self.steps(state, t, dt, 1)
        run = self._run(state, t)
        motion = run.within(dt / self.step_length)
        self._take_note(run, t + dt)
        return replace(state, motion=motion)

    def steps(
        self,
        state: SpringState,
        t: float,
        dt: float,  # noqa: ARG002
        count: int,
    ) -> Stepped[SpringState]:
        """Return the state some cells later, and impulses on other bodies."""
        run = self._run(state, t)
        run.cross(run.grid.index + count)
        self._take_note(run, run.grid.time)
        grid = run.grid
        for sheet in self.system.colliders.sheets:
            sheet.motion.forget(grid.time - max(LOOK_BACK, grid.cell))
        return Stepped(grid.state, run.wrenches)

    def pulls(self, state: SpringState, t: float) -> Sequence[Wrenches]:
        """Return impulses on bodies of other systems in the next cell."""
        run = self._run(state, t)
        run.cross(run.grid.index + 1)
        if run.status is not Status.OK:
            self._take_note(run, run.grid.time)
        return run.wrenches

    def _run(self, state: SpringState, t: float) -> SpringRun:
        """Return a run that continues from a state at its time [s]."""
        grid, choice = self._grid(state, t), self.choice
        return SpringRun(self.system, self.options, choice, grid, self.clock)

    def _grid(self, state: SpringState, t: float) -> TimeGrid:
        choice, begin = self.choice, self.begin
        index = round((t - begin) / choice.cell)
        return TimeGrid(choice.solver, begin, choice.cell, index, state)

    def incompatibility(self, state: SpringState, t: float) -> str:
        """Return why kernels cannot resume from a state; empty if they can."""
        try:
            advance(self.system, self.options, self._grid(state, t), 0)
        except ValueError as error:
            return str(error)
        except (TypeError, OverflowError):
            return "a whole number of it is out of bounds"
        return ""

    def _take_note(self, run: SpringRun, reached: float) -> None:
        """Add the counts of a run; raise if it stopped."""
        stats = run.stats(reached)
        notices = run.notices(stats)
        self.taken += run.grid.steps
        if stats.status is not Status.OK:
            # The fault that stopped it comes last and is reported with the frame.
            faults = sorted(_as_errors(notices), key=lambda one: one.code in STOPS)
            if self.system.ties is not None:
                # Otherwise the fault would be attributed to the bodies.
                names = " and ".join(view.member.name for view in self.views)
                faults[-1] = replace(
                    faults[-1], message=f"{names}: " + faults[-1].message
                )
            raise StoppedError(faults, stats)
        self._keep_notices(notices, run.grid.stretch)
        self.shortest = min(self.shortest, run.shortest)
        self.unresolved = max(self.unresolved, run.grid.unresolved)

    def _keep_notices(self, notices: Sequence[Fault], stretch: float) -> None:
        """Keep notices of a run, the worst of each kind."""
        for fault in notices:
            # Keep the first, or the worst, of notices with changing numbers.
            key = fault.code if fault.code in _GROWING else str(fault)
            worse = fault.code == "SIM131" and stretch >= self._worst
            if key not in self._notices or worse:
                self._notices[key] = fault
        self._worst = max(self._worst, stretch)

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
        long = (self.system.body.springs.rest > 0).any()
        return Diagnostics(
            self._energy(state, t),
            notices=self.notices,
            steps=self.taken,
            stretch=self.stretch if long else None,
        )

    @property
    def notices(self) -> list[Fault]:
        """Warnings collected so far."""
        return [*self._notices.values(), *self._losses.notices(self.choice.solver)]

    def _energy(self, state: SpringState, t: float) -> Energy | None:
        if self._slowed or state.torn.any() or self.system.ties is not None:
            return None
        energy = self.system.energy(t, state.motion)
        return None if energy.supply else energy

    @cached_property
    def _slowed(self) -> bool:
        """Whether drag, damping or colliders dissipate energy."""
        system = self.system
        slowing = [
            system.drags,
            system.body.springs.damping,
            system.target_springs.damping,
        ]
        slowing.append(np.array(system.pressures))
        return system.colliders.active or any(values.any() for values in slowing)

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


def _by_motions(
    phase: Callable[[], Progress], begin: float, last: float
) -> Callable[[float], None]:
    """Return a progress callback; a time that falls starts a new phase."""
    span, before, tell = max(last - begin, 1e-9), math.inf, None

    def show(t: float) -> None:
        nonlocal before, tell
        if t < before:
            tell = phase()
        before = t
        if tell is not None:
            tell((t - begin) / span)

    return show

"""Springs of a scene in steps, and what each entry shows of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, cast

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.errors import Fault, Severity, counted, percent
from animtool.core.quantities import length_text, plain
from animtool.motion.frames import Frame, MeshFrame, PointsFrame
from animtool.sim.colliders.bodies import Wrenches
from animtool.sim.system import Energy
from animtool.sim.trajectory import Status
from animtool.systems.fields import Member
from animtool.systems.run import ON_STEP
from animtool.systems.simulation import (
    Diagnostics,
    Progress,
    SimContext,
    Stepped,
    StoppedError,
    TrialSettings,
)
from animtool.systems.springs.checks import check_options
from animtool.systems.springs.crossings import SelfCrossings, thin_notices, widest_gap
from animtool.systems.springs.drawing import Faces, Tearing
from animtool.systems.springs.losses import DAMPING, Losses
from animtool.systems.springs.motion import Grid, SpringState, warning
from animtool.systems.springs.records import Solver, SpringOptions
from animtool.systems.springs.settling import rest_of_xpbd
from animtool.systems.springs.simulating import SpringRun, simulate_springs
from animtool.systems.springs.solvers import advance, choose
from animtool.systems.springs.system import SpringSystem
from animtool.systems.springs.trials import trial_settings

# Times of a whole motion that are compared with those of one in half steps.
COMPARED = 64
# Notices whose message says how much it is so far.
_GROWING = {"SIM131", "SIM123"}
# Why a motion ends.
STOPS = {"SIM102", "SIM105"}
# Over how long they were at the beginning, springs that are as long as this are
# hardly meant: no rope or cloth becomes twice as long [1].
LONG = 2.0
# Surfaces of others are asked for from one look before a step on [s].
LOOK_BACK = 1 / 240


class SpringSimulation:
    """Springs in cells of time; what went on is counted for warnings alone."""

    checked = True
    views: Sequence[SpringView] = ()

    def __init__(
        self,
        system: SpringSystem,
        options: SpringOptions,
        begin: float,
        context: SimContext,
        *,
        settled: bool = False,
    ) -> None:
        self.system, self.begin, self.last = system, begin, context.last
        self.error: float | None = None  # of positions, where it was asked for [m]
        self._said: dict[str, Fault] = {}
        self._worst = 0.0
        self.clock: Progress = None
        reason = ""
        if options.error is not None:
            options, reason = self._fine_enough(options, context)
        self.options = options
        solver = check_options(options)
        self.choice = choose(system, options, solver, begin, system.state)
        if settled and self.choice.solver is Solver.XPBD:
            rested = rest_of_xpbd(system, options, self.choice, begin)
            self.system, self.choice = rested.system, rested.choice
            self._say(rested.notices, 0.0)
        self.reason = reason or self.choice.reason
        self.step_length = self.choice.cell
        self.shortest, self.taken, self.stretch, self.unresolved = math.inf, 0, 0.0, 0
        self._measured: FloatArray | None = None
        self._losses = Losses(float(system.free_masses.sum()))
        start = self.initial()
        self._take_note(self._run(start, begin), begin)
        self.measure(start, begin)
        self._stretch_at_start = self.stretch
        self.clock = context.clock()

    def _fine_enough(
        self, options: SpringOptions, context: SimContext
    ) -> tuple[SpringOptions, str]:
        """Return options whose steps keep the error over the whole motion, and why."""
        begin, last = self.begin, max(context.last, self.begin)
        times = np.linspace(begin, last, COMPARED)
        progress = _by_motions(context.phase, begin, last)
        motion = simulate_springs(self.system, times, options, progress=progress)
        if motion.stats.status is not Status.OK:
            raise StoppedError(_as_errors(motion.notices), motion.stats)
        self._say(motion.notices, motion.stretch)
        self.error = motion.stats.error
        fine = replace(options, solver=motion.solver, step=motion.step, error=None)
        return fine, motion.reason

    def initial(self) -> SpringState:
        """Return the state that they begin in."""
        substeps, state = self.choice.substeps, self.system.state
        whole, tied = self.system.whole, self.system.ties is not None
        pulls = np.zeros((len(self.system.pinned), 6)) if tied else None
        return SpringState(
            np.ascontiguousarray(state), whole, substeps, substeps, pulls=pulls
        )

    def step(
        self, state: SpringState, t: float, dt: float
    ) -> SpringState | Stepped[SpringState]:
        """Return the state a cell later, or on the way to it; raise SIM102, SIM105."""
        if dt >= (1 - ON_STEP) * self.step_length:
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
        """Return the state some cells later, and what pressed on bodies of others."""
        run = self._run(state, t)
        run.cross(run.grid.index + count)
        self._take_note(run, run.grid.time)
        grid = run.grid
        for sheet in self.system.colliders.sheets:
            sheet.motion.forget(grid.time - max(LOOK_BACK, grid.cell))
        return Stepped(grid.state, run.wrenches)

    def pulls(self, state: SpringState, t: float) -> Sequence[Wrenches]:
        """Return what bodies of others are pressed and pulled by in the next cell."""
        run = self._run(state, t)
        run.cross(run.grid.index + 1)
        if run.status is not Status.OK:
            self._take_note(run, run.grid.time)
        return run.wrenches

    def _run(self, state: SpringState, t: float) -> SpringRun:
        """Return a motion that goes on from a state at its time [s]."""
        grid, choice = self._grid(state, t), self.choice
        return SpringRun(self.system, self.options, choice, grid, self.clock)

    def _grid(self, state: SpringState, t: float) -> Grid:
        choice, begin = self.choice, self.begin
        index = round((t - begin) / choice.cell)
        return Grid(choice.solver, begin, choice.cell, index, state)

    def misfit(self, state: SpringState, t: float) -> str:
        """Return why kernels cannot go on from a state; empty where they can."""
        try:
            advance(self.system, self.options, self._grid(state, t), 0)
        except ValueError as error:
            return str(error)
        except (TypeError, OverflowError):
            return "a whole number of it is out of bounds"
        return ""

    def _take_note(self, run: SpringRun, reached: float) -> None:
        """Count what a motion took, and stop where it ended."""
        stats = run.stats(reached)
        notices = run.notices(stats)
        self.taken += run.grid.steps
        if stats.status is not Status.OK:
            # What stopped it comes last, and is told with the frame.
            faults = sorted(_as_errors(notices), key=lambda one: one.code in STOPS)
            if self.system.ties is not None:
                # Bodies that are asked for first would have it said of them.
                names = " and ".join(view.member.name for view in self.views)
                faults[-1] = replace(
                    faults[-1], message=f"{names}: {faults[-1].message}"
                )
            raise StoppedError(faults, stats)
        self._say(notices, run.grid.stretch)
        self.shortest = min(self.shortest, run.shortest)
        self.unresolved = max(self.unresolved, run.grid.unresolved)

    def _say(self, notices: Sequence[Fault], stretch: float) -> None:
        """Keep what a motion says, the worst of each kind."""
        for fault in notices:
            # Of what has a number that changes, the first, or the worst.
            key = fault.code if fault.code in _GROWING else str(fault)
            worse = fault.code == "SIM131" and stretch >= self._worst
            if key not in self._said or worse:
                self._said[key] = fault
        self._worst = max(self._worst, stretch)

    def measure(self, state: SpringState, t: float) -> None:
        """Count how long springs are in a state that is looked at, and its energy."""
        if state.motion is self._measured:
            return
        self._measured = state.motion
        springs = self.system.body.springs
        whole = ~self.system.torn(state.torn) & (springs.rest > 0)
        if whole.any():
            lengths = springs.lengths(state.motion[0])[whole]
            longest = float((lengths / springs.rest[whole]).max()) - 1.0
            self.stretch = max(self.stretch, longest)
        if self.choice.solver in DAMPING and self.system.self_contact is None:
            energy = self._energy(state, t)
            if energy is not None:
                self._losses.look(t, energy)

    @property
    def ahead(self) -> bool:
        """Whether a surface may part, which has all its points from the first frame."""
        return any(view.tears for view in self.views)

    def see(self, last: SpringState) -> None:
        """Let surfaces part where springs are torn in the end."""
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
        """Return the energy where nothing takes or brings any, and what was counted."""
        long = (self.system.body.springs.rest > 0).any()
        return Diagnostics(
            self._energy(state, t),
            notices=self.notices,
            steps=self.taken,
            stretch=self.stretch if long else None,
        )

    @property
    def notices(self) -> list[Fault]:
        """What is odd so far."""
        return [*self._said.values(), *self._losses.notices(self.choice.solver)]

    def _energy(self, state: SpringState, t: float) -> Energy | None:
        if self._slowed or state.torn.any() or self.system.ties is not None:
            return None
        energy = self.system.energy(t, state.motion)
        return None if energy.supply else energy

    @cached_property
    def _slowed(self) -> bool:
        """Whether anything takes energy."""
        system = self.system
        slowing = [system.drags, system.body.springs.damping, system.draws.damping]
        slowing.append(np.array(system.pressures))
        return system.colliders.active or any(values.any() for values in slowing)

    def trial_settings(self) -> TrialSettings:
        """Return solvers in several steps, about those that each takes itself."""
        return trial_settings(self.system, self.options, self.begin)

    @property
    def long(self) -> bool:
        """Whether springs that never tear became very long."""
        tears = np.isfinite(self.system.body.springs.limit).any()
        longest = LONG * (1 + self._stretch_at_start)
        return bool(not tears and 1 + self.stretch > longest)


@dataclass
class SpringView:
    """What a rope, strands, cloth or a volume shows."""

    simulation: SpringSimulation
    member: Member  # its entry
    rows: IntArray  # its particles in the simulation ``(N,)``
    springs: slice  # its springs there
    own: Sequence[Fault]  # what is odd about it alone
    first: bool  # whether it speaks for all that it is joined to
    _torn_mesh: Tearing | Faces | None = None
    # How many springs are torn, and the faces that are whole then.
    _whole: tuple[int, IntArray, IntArray] | None = None
    _crossings: SelfCrossings | None = None

    @property
    def body(self) -> Any:
        """Its particles and springs, and what is drawn of them."""
        return self.member.record.body

    @property
    def tears(self) -> bool:
        """Whether it is a surface that may part."""
        return isinstance(self.body.shape, Faces) and self.body.shape.tears

    def torn(self, state: SpringState) -> BoolArray:
        """Return which of its springs are torn ``(S,)``."""
        return self.simulation.system.torn(state.torn)[self.springs]

    def part(self, last: SpringState) -> None:
        """Draw it so that it can part where springs are torn in a later state."""
        shape = cast(Faces, self.body.shape)
        self._torn_mesh = shape.parted(self.torn(last), self.body.body.positions)

    def frame(self, state: SpringState, t: float) -> Frame:
        """Return what is drawn of it."""
        self.simulation.measure(state, t)
        points, velocities = state.motion[:, self.rows]
        self._look(points, t)
        shape = self._torn_mesh or self.body.shape
        frame: Frame = shape.row(points, velocities, self.torn(state))
        return frame

    def _look(self, points: FloatArray, t: float) -> None:
        """Count what of a surface goes through it, where nothing keeps it apart."""
        made, shape = self.simulation, self.body.shape
        if made.system.self_contact is not None or not isinstance(shape, Faces):
            return
        if self._crossings is None:
            corners = self.body.body.triangles
            self._crossings = SelfCrossings(corners, made.begin, made.last)
        self._crossings.look(t, points)

    def _crossing_notices(self) -> list[Fault]:
        """Return warnings of what went through it, or may have (SIM194, SIM195)."""
        made, body, name = self.simulation, self.body, self.member.name
        found = self._crossings.notices(name) if self._crossings is not None else []
        gap = widest_gap(body.shape, body.body.positions)
        colliders, radius = list(made.system.colliders), made.system.radius
        return found + thin_notices(name, colliders, radius, gap, made.stretch)

    @property
    def radius(self) -> float:
        """Half its thickness [m]."""
        radius: float = self.member.spec.radius
        return radius

    @property
    def closed(self) -> bool:
        """Whether only its outside is run into."""
        return getattr(self.body.shape, "closed", False)

    def surface(self, state: SpringState, t: float) -> MeshFrame:
        """Return those of its faces that are not torn."""
        self.simulation.measure(state, t)
        shape, torn = cast(Faces, self.body.shape), self.torn(state)
        gone = int(torn.sum())
        if self._whole is None or gone != self._whole[0]:
            whole = shape.whole(torn) if gone else (shape.counts, shape.indices)
            self._whole = gone, *whole
        points, velocities = state.motion[:, self.rows]
        return MeshFrame(points, velocities, *self._whole[1:], self.closed)

    def diagnostics(self, state: SpringState, t: float) -> Diagnostics:  # noqa: ARG002
        """Return what became of it, and what is odd so far."""
        made, body, name = self.simulation, self.body.body, self.member.name
        values: dict[str, Any] = {
            "kind": self.member.kind,
            "particles": len(body.positions),
            "springs": len(body.springs.rest),
            "solver": str(made.choice.solver),
            "reason": made.reason,
            "step": made.shortest,
            "steps": made.taken,
            "stretch": made.stretch,
            "torn": int(self.torn(state).sum()),
            "unresolved": made.unresolved,
        }
        if made.error is not None:
            values["error"] = made.error if math.isfinite(made.error) else None
        notices = [*self.own, *self._crossing_notices()]
        if self.first:
            notices += made.notices
            if made.long:
                message = f"{name}: springs become {percent(made.stretch)} longer than "
                hint = "raise the stiffness [N/m], which is that of each spring, or "
                hint += "lower the mass [kg]"
                notices.append(warning("SIM187", f"{message}at rest", hint))
            notices.append(self._note(int(state.torn.sum())))
        return Diagnostics(values=values, notices=notices)

    def _note(self, torn: int) -> Fault:
        made = self.simulation
        parts = [
            f"{made.choice.solver} ({made.reason})",
            f"steps of {plain(made.shortest)} s and more",
            f"springs up to {percent(made.stretch)} longer than at rest",
        ]
        if made.error is not None and math.isfinite(made.error):
            parts.append(f"error {length_text(made.error)}")
        if torn:
            parts.append(f"{counted(torn, 'spring')} torn")
        message = f"{self.member.name}: {', '.join(parts)}"
        return Fault("SIM130", message, severity=Severity.NOTE)


def _as_errors(notices: Sequence[Fault]) -> list[Fault]:
    return [replace(fault, severity=Severity.ERROR) for fault in notices]


def _by_motions(
    phase: Callable[[], Progress], begin: float, last: float
) -> Callable[[float], None]:
    """Return a function of the time reached; each motion it sees is a phase."""
    span, before, tell = max(last - begin, 1e-9), math.inf, None

    def show(t: float) -> None:
        nonlocal before, tell
        if t < before:
            tell = phase()
        before = t
        if tell is not None:
            tell((t - begin) / span)

    return show

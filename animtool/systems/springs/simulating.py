"""Simulate springs and return their states at given times."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from animtool.core.array_types import ArrayLike, FloatArray
from animtool.core.errors import Fault, OptionError, Severity, counted, excerpt, warning
from animtool.core.quantities import floored, length_text, plain
from animtool.sim.checks import EnergyWatch, check_times
from animtool.sim.colliders.bodies import Wrenches
from animtool.sim.options import IntegrateOptions
from animtool.sim.trajectory import Checkpoint, Stats, Status
from animtool.systems.springs.checks import check_options
from animtool.systems.springs.motion import (
    MAX_SUBSTEPS,
    SpringMotion,
    SpringState,
    TimeGrid,
    through_notices,
)
from animtool.systems.springs.records import Solver, SpringOptions
from animtool.systems.springs.solvers import (
    Choice,
    advance,
    choose,
    explicit_limit,
    working_step,
)
from animtool.systems.springs.system import SpringSystem

# A time within this fraction of a cell counts as its start.
ON_GRID = 1e-9
# Cells between two checks for blow-up.
LOOK_EVERY = 120
# Multiple of the xpbd stretch above which compliance is reported: at least three
# quarters of the strain is then compliance.
GIVES = 2
# A body with less than this fraction of the mass of its springs is unstable.
LIGHT = 0.01
# Most halvings of the step to reach an error.
MAX_HALVINGS = 8
# Error of a step relative to that of half the step.
GAIN = {
    Solver.SYMPLECTIC_EULER: 2.0,
    Solver.XPBD: 2.0,
    Solver.BDF2: 4.0,
    Solver.IMPLICIT_EULER: 2.0,
}


def simulate_springs(
    system: SpringSystem,
    times: ArrayLike,
    options: SpringOptions | None = None,
    checkpoint: Checkpoint | None = None,
    *,
    progress: Callable[[float], None] | None = None,
) -> SpringMotion:
    """Simulate springs and return their states at times.

    Steps lie on a fixed time grid, so that the output rate does not change the motion.
    Times between two grid points are interpolated by a cubic.

    Args:
        system: Particles, springs and external forces.
        times: Ascending ``(F,)`` [s]; the first is the start.
        options: Solver, steps and limits.
        checkpoint: End of an earlier motion to resume from. The parts are then equal to
            the uninterrupted motion, bit for bit. Without its memory, a new motion
            starts from its state.
        progress: Called with the time reached [s]; with an error tolerance, restarted
            for each motion that is compared.

    Raises:
        OptionError: The solver is unknown (SIM001); times descend, are empty or not
            finite (SIM002); the start is not finite or has another shape (SIM003); an
            option is out of range (SIM004); the requested solver does not support
            self-contact (SIM046).

    >>> from animtool.systems.springs import Family, Pins, SpringSystem, rope
    >>> line = rope([0, 0, 0], [1, 0, 0], 8, Family(1e4), mass=0.01)
    >>> system = SpringSystem(line, pins=Pins([0]), drag=0.5)
    >>> motion = simulate_springs(system, [0, 0.5, 1])
    >>> motion.positions.shape, motion.stats.status
    ((3, 8, 3), <Status.OK: 'ok'>)
    """
    options = options or SpringOptions()
    solver = check_options(options)
    knots = check_times(times, checkpoint)
    grid = checkpoint.memory if checkpoint is not None else None
    if isinstance(grid, TimeGrid):
        limit = explicit_limit(system, grid.time, grid.state.motion)
        choice = Choice(
            grid.solver, grid.cell, grid.state.substeps, "it was carried on", limit
        )
        # Start with zero counts.
        begun = TimeGrid(grid.solver, grid.origin, grid.cell, grid.index, grid.state)
        return _motion(SpringRun(system, options, choice, begun, progress), knots)
    t = float(knots[0])
    state = np.ascontiguousarray(
        system.state if checkpoint is None else checkpoint.state
    )
    _check_start(system, state)
    choice = choose(system, options, solver, t, state)

    def simulate_with(substeps: int) -> SpringMotion:
        fine = replace(choice, substeps=substeps)
        start = SpringState(state, system.none_torn, substeps, substeps)
        begun = TimeGrid(fine.solver, t, fine.cell, 0, start)
        return _motion(SpringRun(system, options, fine, begun, progress), knots)

    if options.error is None:
        return simulate_with(choice.substeps)
    return _near_enough(simulate_with, choice, options.error)


def _check_start(system: SpringSystem, state: FloatArray) -> None:
    shape, message = system.state.shape, ""
    if state.shape != shape:
        message = f"the start must have shape {shape}, not {state.shape}"
    elif not np.isfinite(state).all():
        lost = int(np.argmin(np.isfinite(state).all(axis=(0, 2))))
        message = f"particle {lost} is not finite at the start"
    if message:
        raise OptionError(Fault("SIM003", message, where="state"))


def _near_enough(
    simulate_with: Callable[[int], SpringMotion], choice: Choice, error: float
) -> SpringMotion:
    """Return the motion in the longest steps whose estimated error is in bounds."""
    coarse = simulate_with(choice.substeps)
    factor = 1 / (GAIN[choice.solver] - 1)
    substeps, estimate = choice.substeps, np.inf
    for _ in range(MAX_HALVINGS):
        substeps *= 2
        if substeps > MAX_SUBSTEPS:
            break
        fine = simulate_with(substeps)
        if coarse.stats.status is Status.OK is fine.stats.status:
            estimate = factor * float(np.abs(fine.positions - coarse.positions).max())
        coarse = replace(fine, stats=replace(fine.stats, error=estimate))
        if estimate <= error:
            return coarse
    reached = length_text(estimate) if math.isfinite(estimate) else "not known"
    message = f"the position error is {reached}, but the limit is "
    message += length_text(error)
    hint = (
        "use bdf2, or raise the limit: motion after a fold or a contact is not smooth"
    )
    notice = warning("SIM142", message, hint)
    return replace(coarse, notices=(*coarse.notices, notice))


def _motion(run: SpringRun, times: FloatArray) -> SpringMotion:
    states = [run.states_at(float(times[0]))]
    energies = [run.energy_of(float(times[0]), states[0])]
    for t in times[1:].tolist():
        state = run.states_at(t)
        if run.status is not Status.OK:
            break
        states.append(state)
        energies.append(run.energy_of(t, state))
    reached = times[: len(states)]
    stats = run.stats(float(reached[-1]))
    return SpringMotion(
        reached,
        np.array(states),
        np.array(energies),
        stats,
        tuple(run.notices(stats)),
        Checkpoint(float(reached[-1]), states[-1], run.kept),
        second_order=True,
        solver=run.choice.solver,
        reason=run.choice.reason,
        step=run.shortest,
        stretch=run.grid.stretch,
        torn=run.system.torn(run.grid.state.torn),
        unresolved=run.grid.unresolved,
        passed=run.grid.through.passed,
        cut=run.grid.through.cut,
    )


class SpringRun:
    """Advances a motion in the chosen steps."""

    def __init__(
        self,
        system: SpringSystem,
        options: SpringOptions,
        choice: Choice,
        grid: TimeGrid,
        progress: Callable[[float], None] | None,
    ) -> None:
        self.system, self.choice = system, choice
        self._options, self._progress = options, progress
        # Grid at the start, now, and at the last requested time.
        self._begun = self.grid = self.kept = grid
        self._lost: TimeGrid | None = None  # start of the cell that was not solved
        # Impulses on rigid bodies of other systems in the last cells.
        self.wrenches: list[Wrenches] = []
        self.max_substeps = grid.state.substeps
        self.status = Status.OK
        self.sign = ""
        # Pushed bodies react before the next cell.
        together = system.colliders.bodies or system.ties is not None
        self._cells = 1 if together else LOOK_EVERY
        # Smallest fraction of an impulse that a body received.
        self.taken = 1.0
        # Longest xpbd spring relative to its rest length.
        self.longest = 1.0
        # Residual strain of xpbd, and of implicit steps with colliders, is not energy
        # that the motion continues with.
        stable = grid.solver is not Solver.SYMPLECTIC_EULER and system.colliders.active
        calm = stable or grid.solver is Solver.XPBD or system.ties is not None
        growth = np.inf if calm else options.growth
        bounds = IntegrateOptions(growth=growth, stretch=options.longest)
        # The system without torn springs, and their number.
        self.left, self._gone = system, 0
        self._watch = EnergyWatch(system, bounds)
        self._exclude_torn()
        self._watch.start(grid.time, grid.state.motion)

    def states_at(self, t: float) -> FloatArray:
        """Return the state at a time not before the last requested one.

        Contacts push bodies of other systems.
        """
        position = (t - self.grid.origin) / self.grid.cell
        near = round(position)
        on_grid = abs(position - near) <= ON_GRID * max(1.0, abs(position))
        self.cross(near if on_grid else int(np.floor(position)), push=True)
        if self.status is Status.OK:
            self.kept = self.grid
        if self.status is not Status.OK or on_grid:
            return self.grid.state.motion
        return self.within((t - self.grid.time) / self.grid.cell)

    def cross(self, target: int, *, push: bool = False) -> None:
        """Advance to the start of a cell by its index, as far as possible."""
        while self.grid.index < target and self.status is Status.OK:
            self._advance(min(self._cells, target - self.grid.index))
            pushed = self.system.colliders.bodies if push else ()
            for bodies, wrenches in zip(pushed, self.wrenches, strict=False):
                bodies.push(self.grid.time, wrenches)
                bodies.forget(self.grid.time)
            if self._progress is not None:
                self._progress(self.grid.time)

    def within(self, fraction: float) -> FloatArray:
        """Return the state at a fraction of the next cell, which is discarded."""
        begun = self._entered()
        with np.errstate(all="ignore"):
            after = advance(self.system, self._options, begun, 1)
            motion = _between(
                begun.state.motion, after.state.motion, begun.cell, fraction
            )
        if np.isfinite(motion).all():
            return motion
        self.status, self.sign = Status.UNSTABLE, "its state is not finite"
        return self.grid.state.motion

    @property
    def shortest(self) -> float:
        """The shortest step so far [s]."""
        return self.grid.cell / self.max_substeps

    def stats(self, reached: float) -> Stats:
        """Return the statistics up to a time [s]."""
        grid = self.grid
        stable = self.choice.limit if self.status is Status.UNSTABLE else None
        return Stats(
            self.status, reached if not self.sign else grid.time, self.sign,
            grid.steps, None, grid.evaluations, self.shortest,
            grid.cell / self._begun.state.substeps, None, stable_step=stable,
        )  # fmt: skip

    def energy_of(self, t: float, state: FloatArray) -> float:
        """Return the energy of the last state [J]."""
        known = self._watch.energy if state is self.grid.state.motion else None
        return (known or self.left.energy(t, state)).total

    @property
    def _stretched(self) -> bool:
        """Whether xpbd strains springs beyond the limit and their compliance."""
        return not self.grid.stretch <= self._options.stretch

    @property
    def _auto(self) -> bool:
        """Whether the solver was chosen automatically."""
        return self._options.solver == Solver.AUTO

    def _entered(self) -> TimeGrid:
        """Return the grid at the start of the next cell, after its teleports."""
        grid, jumps = self.grid, self.system.jumps
        here = jumps.stage_of(grid)
        last = jumps.stage_of(replace(grid, index=grid.index - 1))
        if here == last:
            return grid
        motion = jumps.across(grid.state.motion, last, here)
        return replace(grid, state=replace(grid.state, motion=motion, before=None))

    def _exclude_torn(self) -> None:
        """Exclude torn springs from energy and strain checks."""
        torn = self.grid.state.torn
        gone = int(torn.sum())
        if gone != self._gone:
            self._gone = gone
            self.left = self.system.without_springs(self.system.torn(torn))
            self._watch.watch_system(self.left)

    def _advance(self, cells: int) -> None:
        begun, self.wrenches = self._entered(), []
        cells = int(min(cells, self.system.jumps.cells(begun)))
        with np.errstate(all="ignore"):
            self.grid = advance(self.system, self._options, begun, cells)
            t, state = self.grid.time, self.grid.state
            self.max_substeps = max(self.max_substeps, state.substeps)
            self._exclude_torn()
            self.sign = self._watch.divergence(t, state.motion)
            if begun.solver is Solver.XPBD:
                ratio = self.left.stretch(t, state.motion)
                self.longest = max(self.longest, ratio or 0.0)
        if self.sign:
            self.status = Status.UNSTABLE
        elif self.grid.lost:
            self.status, self._lost = Status.NOT_SOLVED, begun
            self.sign = "Newton's method did not converge"
        elif self._auto and self._stretched:
            self.status = Status.NOT_SOLVED
            self.sign = f"a spring is strained by {self.grid.stretch:.2%}"
        else:
            self.wrenches = [*self._pressed(), *self.grid.tied]

    def _convergence_hint(self) -> str:
        """Return a hint for a cell where Newton's method did not converge."""
        step = None if self._lost is None else working_step(self.system, self._lost)
        ties, hint = self.system.ties, "use a shorter step"
        if step is not None:
            hint = f"step: {plain(floored(step))}"
            if ties is not None:
                hint += " of the bodies of its pins"
        if ties is None:
            return hint
        light = ties.lightest
        spring_mass = float(self.system.free_masses.sum())
        if light is not None and light[1] < LIGHT * spring_mass:
            name, mass = light
            more = f"more mass than {mass:.3g} kg for {excerpt(name)}, which the "
            more += f"springs of {spring_mass:.3g} kg make unstable"
            hint = more if step is None else f"{hint}, or {more}"
        return hint

    def _pressed(self) -> list[Wrenches]:
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
            self.taken = min(self.taken, float(fraction.min(initial=1.0)))
            now = sums[:, :6] * fraction[:, None]
            # A constant force over a cell moves bodies as an impulse at its middle.
            wrenches.append(Wrenches(now, self.grid.cell / 2 * now))
        return wrenches

    def notices(self, stats: Stats) -> list[Fault]:
        """Return warnings collected so far."""
        system, options, choice = self.system, self._options, self.choice
        begins = self._begun.index == 0
        notices = system.notices() if begins else system.colliders.surfaces.notices()
        limit = choice.limit
        h = choice.cell / self._begun.state.substeps
        if choice.solver is Solver.SYMPLECTIC_EULER and h > limit:
            message = f"{choice.solver} is not stable with steps of {plain(h)} s"
            notices.append(
                warning("SIM101", message, f"it is stable up to {plain(limit)} s")
            )
        if stats.status is Status.UNSTABLE:
            message = f"{choice.solver} blew up at {stats.time:.6g} s: {stats.reason}"
            hint = f"semi-implicit Euler is stable with steps up to {plain(limit)} s"
            notices.append(warning("SIM102", message, hint))
        elif stats.status is Status.NOT_SOLVED and self._stretched:
            notices.append(self._refused(stats))
        elif stats.status is Status.NOT_SOLVED:
            message = f"{choice.solver} stopped at {stats.time:.6g} s: {stats.reason}"
            notices.append(warning("SIM105", message, self._convergence_hint()))
        if self._stretched and not self._auto:
            message = f"a spring was strained by {self.grid.stretch:.1%}, beyond "
            message += f"its own compliance; the limit is {options.stretch:.1%}"
            hint = "use auto or bdf2, or less stiffness or mass"
            if system.self_contact is not None:
                hint = "use less stiffness or mass, or a larger stretch"
            notices.append(warning("SIM131", message, hint))
        elif self.longest > 1 + GIVES * options.stretch:
            least = f"{GIVES * options.stretch:.3g}"
            message = f"springs are strained by {least} of that or more, "
            message += "mostly by their own compliance: more steps do not change that"
            hint = "raise their stiffness, or reduce the attached mass"
            notices.append(Fault("SIM161", message, hint=hint, severity=Severity.NOTE))
        if self.grid.unresolved:
            many = counted(self.grid.unresolved, "particle")
            message = f"{many} could not be pushed out of colliders at once"
            hint = "they start inside, or colliders close in on them from several sides"
            notices.append(warning("SIM123", message, hint))
        if self.taken < 1:
            message = "what presses on a rigid body is heavier than the body: only "
            message += f"{self.taken:.0%} of the push acts, to keep it stable"
            hint = "give the body more mass, or less to what rests on it"
            notices.append(warning("SIM135", message, hint))
        return notices + through_notices(self.grid.through)

    def _refused(self, stats: Stats) -> Fault:
        """Return why auto stopped, and alternatives."""
        allowed = self._options.stretch
        message = f"auto finds no solver for it: {self.choice.solver}, chosen because "
        message += (
            f"{self.choice.reason}, leaves a spring strained by "
            f"{self.grid.stretch:.2%} "
        )
        message += f"at {stats.time:.6g} s, in steps of "
        message += f"{plain(self.shortest)} s; {allowed:.2%} is allowed"
        hint = "use less stiffness or more uniform masses, a larger "
        hint += f"stretch, or solver: {self.choice.solver}, which continues"
        return warning("SIM178", message, hint)


def _between(begin: FloatArray, end: FloatArray, h: float, s: float) -> FloatArray:
    """Return the state at a fraction of a cell, on the cubic through its ends."""
    (x0, v0), (x1, v1) = begin, end
    slope = x1 - x0
    x = x0 + s * (
        h * v0 + s * ((3 - 2 * s) * slope - h * ((2 - s) * v0 + (1 - s) * v1))
    )
    return np.array((x, v0 + s * (v1 - v0)))

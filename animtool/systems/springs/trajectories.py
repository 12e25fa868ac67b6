"""Simulate springs and return their states at given times."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from animtool.core.array_types import ArrayLike, FloatArray
from animtool.core.errors import Fault, refuse, warning
from animtool.core.quantities import length_text
from animtool.sim.checks import check_times
from animtool.sim.trajectory import Checkpoint, Status
from animtool.systems.framework.run import ReachedState, SimulationRun
from animtool.systems.framework.simulation import Progress, SimContext, StoppedError
from animtool.systems.springs.checks import checked_solver
from animtool.systems.springs.choosing import (
    SolverChoice,
    choose_solver,
    explicit_limit,
)
from animtool.systems.springs.equilibrium import find_xpbd_rest
from animtool.systems.springs.motion import (
    MAX_SUBSTEPS_PER_CELL,
    SpringMotion,
    TimeGrid,
)
from animtool.systems.springs.records import Solver, SpringOptions
from animtool.systems.springs.simulation import SpringSimulation, as_errors
from animtool.systems.springs.solvers import SpringPlan
from animtool.systems.springs.system import SpringSystem

# Most halvings of the step to reach an error tolerance.
MAX_HALVINGS = 8
# Number of times at which a motion is compared with one in half steps.
COMPARISON_TIMES = 64


# Codes of notices that the frames of a run give again.
FRAME_CODES = frozenset({"SIM187", "SIM196"})


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
    solver = checked_solver(options)
    sample_times = check_times(times, checkpoint)
    grid = checkpoint.memory if checkpoint is not None else None
    if isinstance(grid, TimeGrid):
        limit = explicit_limit(system, grid.time, grid.state.motion)
        choice = SolverChoice(
            grid.solver, grid.cell, grid.state.substeps, "it was carried on", limit
        )
        # Start with zero counts.
        start_grid = TimeGrid(
            grid.solver, grid.origin, grid.cell, grid.index, grid.state
        )
        plan = SpringPlan(system, options, choice)
        return _run_plan(plan, start_grid, sample_times, progress)
    t = float(sample_times[0])
    start = system.state if checkpoint is None else checkpoint.state
    state = np.ascontiguousarray(start)
    shape, message = system.state.shape, ""
    if state.shape != shape:
        message = f"the start must have shape {shape}, not {state.shape}"
    elif not np.isfinite(state).all():
        particle_index = int(np.argmin(np.isfinite(state).all(axis=(0, 2))))
        message = f"particle {particle_index} is not finite at the start"
    if message:
        refuse("SIM003", message, "state")
    choice = choose_solver(system, options, solver, t, state)

    def simulate_with(substeps: int) -> SpringMotion:
        plan = SpringPlan(system, options, replace(choice, substeps=substeps))
        return _run_plan(plan, plan.start(t, state), sample_times, progress)

    if options.error is None:
        return simulate_with(choice.substeps)
    return _refine_until(simulate_with, choice, options.error)


def _refine_until(
    simulate_with: Callable[[int], SpringMotion], choice: SolverChoice, error: float
) -> SpringMotion:
    """Return the motion with the longest steps that keep the error within bounds."""
    coarse = simulate_with(choice.substeps)
    # Half the step divides the error by 2, and by 4 in the second-order bdf2.
    factor = 1 / (4 - 1) if choice.solver is Solver.BDF2 else 1 / (2 - 1)
    substeps, estimate = choice.substeps, np.inf
    for _ in range(MAX_HALVINGS):
        substeps *= 2
        if substeps > MAX_SUBSTEPS_PER_CELL:
            break
        fine = simulate_with(substeps)
        if coarse.stats.status is Status.OK is fine.stats.status:
            estimate = factor * float(np.abs(fine.positions - coarse.positions).max())
        coarse = replace(fine, stats=replace(fine.stats, error=estimate))
        if estimate <= error:
            return coarse
    error_text = length_text(estimate) if math.isfinite(estimate) else "not known"
    message = f"the position error is {error_text}, but the limit is "
    message += length_text(error)
    hint = "use bdf2, or raise the limit: motion after a fold or a contact is not "
    notice = warning("SIM142", message, hint + "smooth")
    return replace(coarse, notices=(*coarse.notices, notice))


def _run_plan(
    plan: SpringPlan, start_grid: TimeGrid, times: FloatArray, progress: Progress
) -> SpringMotion:
    """Return the motion at the sample times that were reached before a stop."""
    simulation = SpringSimulation(plan, start_grid, float(times[-1]), progress)
    simulation.releases_states = False
    start = ReachedState(start_grid.index, start_grid.state)
    simulation_run = SimulationRun(
        "springs", simulation, start_grid.origin, start_grid.cell, start
    )
    simulation_run.collide_with(plan.system.colliders.bodies)
    last_grid, states, energies = start_grid, [], []
    for t in times.tolist():
        try:
            spring_state = simulation_run.sample(t)[0]
        except StoppedError:
            break
        simulation.measure(spring_state, t)
        state = spring_state.motion
        last_grid = simulation.grid
        states.append(state)
        energies.append(simulation.energy_of(t, state))
    reached_times = times[: len(states)]
    grid, stats = simulation.grid, simulation.stats(float(reached_times[-1]))
    return SpringMotion(
        reached_times,
        np.array(states),
        np.array(energies),
        stats,
        (*simulation.notices, *simulation.strain_notices()),
        Checkpoint(float(reached_times[-1]), states[-1], last_grid),
        second_order=True,
        solver=plan.choice.solver,
        reason=plan.choice.reason,
        step=simulation.shortest_step,
        stretch=grid.max_strain,
        torn=plan.system.torn(grid.state.torn),
        unresolved=grid.unresolved_count,
        passed=grid.piercing.passed,
        cut=grid.piercing.cut,
    )


def plan_springs(
    system: SpringSystem,
    options: SpringOptions,
    context: SimContext,
    *,
    starts_at_rest: bool,
) -> SpringPlan:
    """Return springs with a solver and steps that meet the requested error bound.

    With ``starts_at_rest``, xpbd starts in its own rest state.
    """
    begin, reason, error = context.begin, None, None
    notices: list[Fault] = []
    if options.error is not None:
        times = np.linspace(begin, max(context.last, begin), COMPARISON_TIMES)
        progress = _progress_by_motion(context.phase, begin, float(times[-1]))
        motion = simulate_springs(system, times, options, progress=progress)
        if motion.stats.status is not Status.OK:
            raise StoppedError(as_errors(motion.notices), motion.stats)
        notices += [n for n in motion.notices if n.code not in FRAME_CODES]
        error, reason = motion.stats.error, motion.reason
        options = replace(options, solver=motion.solver, step=motion.step, error=None)
    choice = choose_solver(
        system, options, checked_solver(options), begin, system.state
    )
    choice = replace(choice, reason=reason or choice.reason)
    plan = SpringPlan(system, options, choice)
    if starts_at_rest and choice.solver is Solver.XPBD:
        plan = find_xpbd_rest(system, options, choice, begin)
    all_notices = (*notices, *plan.planning_notices)
    return replace(plan, error=error, planning_notices=all_notices)


def _progress_by_motion(
    phase: Callable[[], Progress], begin: float, last: float
) -> Callable[[float], None]:
    """Return a progress callback; a time that decreases starts a new phase."""
    span, previous_time, report = max(last - begin, 1e-9), math.inf, None

    def report_time(t: float) -> None:
        nonlocal previous_time, report
        if t < previous_time:
            report = phase()
        previous_time = t
        if report is not None:
            report((t - begin) / span)

    return report_time
